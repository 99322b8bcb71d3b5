"""`effects`: what can be fitted beside J and K, and does an effect keep its contract?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayes_inertia.app.terminal import headed, indented, plain_console, print_json, say

if TYPE_CHECKING:
    from bayes_inertia.campaign.campaign import Campaign
    from bayes_inertia.physics.check_effect import CheckedEffect
    from bayes_inertia.physics.effect import Effect

CHECK_FORMAT = "bayes-inertia-effects-check/1"


def effects_command(
    campaign: Path | None = None, check: str | None = None, as_json: bool = False
) -> None:
    """List the effects: parameters, units, priors, and where they act.

    `--check my_effects.py` proves that effects of your own keep the contract, and says what was
    proven. Then name them anywhere: `--effects my_effects.py:MyEffect`.
    """
    from bayes_inertia.campaign.reader import read_campaign
    from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC, candidates_in
    from bayes_inertia.physics.forward_model import lacks
    from bayes_inertia.physics.small_campaign import small_campaign

    flown = small_campaign() if campaign is None else read_campaign(campaign)
    if check is None:
        known = (*candidates_in(flown, LIBRARY), *STOCHASTIC)
        _list(tuple(e for e in known if not lacks(e, flown)), flown, as_json)
        return
    _check(check, None if campaign is None else flown, as_json)


def _check(text: str, campaign: Campaign | None, as_json: bool) -> None:
    """Prove the contract of all effects of a file, or of one that is named."""
    from bayes_inertia.physics.check_effect import check_effect
    from bayes_inertia.physics.named_effects import effects_in_file, effects_named

    checked = []
    for effect in effects_in_file(Path(text)) if text.endswith(".py") else effects_named([text]):
        if not as_json:
            say(f"checking {effect.name} ...")
        checked.append(check_effect(effect, campaign))
    if as_json:
        rows = [
            {"name": c.name, "fingerprint": dict(c.fingerprint), "warnings": list(c.warnings)}
            for c in checked
        ]
        print_json({"format": CHECK_FORMAT, "effects": rows})
        return
    for result in checked:
        show_checked_effect(result)


def _list(effects: tuple[Effect, ...], campaign: Campaign, as_json: bool) -> None:
    from bayes_inertia.app.effect_table import effect_lines, effects_json

    content = effects_json(effects, campaign)
    if as_json:
        print_json(content)
        return
    console = plain_console()
    for row in content["effects"]:
        console.print(headed(row["name"]))
        for line in effect_lines(row):
            console.print(indented(line))
    for name, reference in content["installed"].items():
        console.print(headed(name, f": of an installed package ({reference}), not loaded"))


def show_checked_effect(checked: CheckedEffect) -> None:
    """Print what was proven of an effect."""
    from bayes_inertia.report.formatting import brief
    from bayes_inertia.report.words import sentences

    console = plain_console()
    console.print(headed(f"{checked.name}: keeps the contract", style="bold green"))
    for line in sentences("commands", "checked_effect"):
        console.print(indented(line))
    console.print("every parameter leaves a trace [noise sigmas per prior sd, all samples]:")
    for drive, sizes in checked.fingerprint.items():
        for name, size in sizes.items():
            console.print(indented(f"{name}, {drive} drive: {brief(size, 3)}"))
    for warning in checked.warnings:
        console.print(headed("warning", f": {warning}", style="bold yellow"))
