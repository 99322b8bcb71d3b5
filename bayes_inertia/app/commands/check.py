"""`check`, `doctor` and `effects`: what a campaign contains, and whether all is sound.

Sound are conventions that are those of the data, an installation that computes right, and an effect
that keeps its contract; effects are what can be fitted beside J and K.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from bayes_inertia.app.compiled_code import size_of
from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.terminal import (
    headed,
    indented,
    plain_console,
    print_json,
    print_or_show,
    print_table,
    progress_bar,
    say,
)
from bayes_inertia.maths.printed import counted
from bayes_inertia.progress import Progress, silent
from bayes_inertia.version import versions

if TYPE_CHECKING:
    from bayes_inertia.campaign.campaign import Campaign
    from bayes_inertia.campaign.slew import Slew
    from bayes_inertia.conventions.check import ConventionsCheck
    from bayes_inertia.physics.check_effect import CheckedEffect
    from bayes_inertia.physics.effect import Effect

FORMAT, INSTALLATION_FORMAT = "bayes-inertia-check/1", "bayes-inertia-installation/1"
_COLUMNS = (
    "slew",
    "rows",
    "step [s]",
    "duration [s]",
    "peak rate [deg/s]",
    "fixes",
    # The last two are of wheels.
    "commands",
    "wheel momentum",
)


def check_command(campaign: Path, anyway: bool = False, as_json: bool = False) -> None:
    """Read a campaign, check it and its conventions, and say what it contains."""
    from bayes_inertia.campaign.reader import read_campaign

    flown = read_campaign(campaign)
    if not as_json:
        show_campaign(flown)
    if not anyway:
        refuse_or_warn(campaign)
    if as_json:
        print_json(campaign_json(flown))


def campaign_json(campaign: Campaign) -> dict[str, Any]:
    """Content of `check --json`."""
    from bayes_inertia.maths.values import json_ready

    inertia, sensor = campaign.inertia, campaign.rate_sensor
    turning = campaign.with_body_rates.slews
    return json_ready(
        {
            "format": FORMAT,
            "campaign": campaign.name,
            "slews": [_slew_row(*each) for each in zip(campaign.slews, turning, strict=True)],
            "wheels": [wheel.name for wheel in campaign.wheels],
            "inertia_kgm2": inertia.tensor,
            "inertia_sd_kgm2": inertia.sd,
            "includes_wheel_spin": inertia.includes_wheel_spin,
            "principal_moments_kgm2": np.linalg.eigvalsh(inertia.tensor),
            "rate_sigma_radps": sensor.sigma if sensor else None,
            "star_tracker": campaign.star_tracker is not None,
            "devices": [{"name": name, "is": kind} for name, kind in _devices(campaign)],
            "possible_drives": _possible_drives(campaign),
            "dirt": [record.json() for record in campaign.dirt],
        }
    )


def _devices(campaign: Campaign) -> list[tuple[str, str]]:
    """Sensors, devices and changes beside wheels: each with what it is."""
    from bayes_inertia.campaign.sensors import stream_of_device

    return [
        *(
            (name, _axes_in_words(stream_of_device(name, campaign).sensor, name, campaign))
            for name in campaign.sensors
        ),
        *((device.name, _gain_in_words(device)) for device in campaign.actuators),
        *((n, f"input, {counted(k, 'number')}") for n, k in campaign.further_inputs.items()),
        *(
            (x.name, f"{x.part} changes at {x.time:.6g} s, by {_percent(x.sigma_fraction)} or so")
            for x in campaign.changes
        ),
    ]


def _axes_in_words(kind: str, name: str, campaign: Campaign) -> str:
    axes = getattr(campaign.sensors[name], "axes", None)
    said = kind if axes is None else f"{kind}, {len(axes)} axes"
    return f"{said}, reference of frames" if name == campaign.frame_reference else said


def _gain_in_words(device: Any) -> str:
    kind = re.sub(r"(?<!^)([A-Z])", r" \1", type(device).__name__).lower()
    gain = f"to {_percent(device.gain_sigma)}" if device.gain_sigma else "exactly"
    return f"{kind}, gain known {gain}"


def _percent(fraction: float) -> str:
    from bayes_inertia.report.formatting import brief

    return f"{brief(100 * fraction)} %"


def _slew_row(slew: Slew, turning: Slew) -> dict[str, Any]:
    """A slew in numbers; the peak rate is that of the body (`turning`), None where unknown."""
    _, rates = turning.complete_rates()
    return {
        "name": slew.name,
        "rows": len(slew.time),
        "step_s": slew.rate_step,
        "duration_s": float(slew.duration),
        "peak_rate_radps": float(np.linalg.norm(rates, axis=1).max()) if len(rates) else None,
        "fixes": int(slew.fixes.sum()),
        "commands": slew.wheel_torque is not None,
        "wheel_momentum": slew.wheel_momentum is not None,
    }


def show_campaign(campaign: Campaign) -> None:
    """Print what a campaign contains, and what can be done with it."""
    from bayes_inertia.campaign.hardware import RateSensor
    from bayes_inertia.report.words import dirt_sentences, sentences

    console, content, most = plain_console(), campaign_json(campaign), LAYOUT.slews_shown
    wheels = len(campaign.wheels)
    turned_by = counted(wheels, "wheel") if wheels else "no wheels"
    count = f": {counted(len(campaign.slews), 'slew')}, {turned_by}"
    console.print(headed(campaign.name, count))
    columns = len(_COLUMNS) - (0 if wheels else 2)
    print_table(_COLUMNS[:columns], (_slew_cells(row)[:columns] for row in content["slews"][:most]))
    further = [sensor for _, sensor in campaign.more_sensors]
    angles = campaign.star_tracker or not all(isinstance(each, RateSensor) for each in further)
    told = {
        "devices": bool(
            further or campaign.actuators or campaign.changes or campaign.further_inputs
        ),
        "angles": bool(angles),
        "prior": campaign.prior.names if campaign.prior else (),
        "dirt": dirt_sentences(content["dirt"]),
    }
    for line in sentences("commands", "campaign", content, most, told):
        console.print(line)


def _slew_cells(row: dict[str, Any]) -> tuple[str, ...]:
    from bayes_inertia.report.formatting import brief

    peak = row["peak_rate_radps"]
    return (
        row["name"],
        str(row["rows"]),
        brief(row["step_s"], 4),
        brief(row["duration_s"], 4),
        "none" if peak is None else brief(np.degrees(peak), 3),
        str(row["fixes"]),
        "yes" if row["commands"] else "no",
        "yes" if row["wheel_momentum"] else "no",
    )


def _possible_drives(campaign: Campaign) -> list[str]:
    drives = ["commanded"] if campaign.has_commands or not campaign.wheels else []
    return [*drives, "measured"] if campaign.has_tachometers else drives


# The verdict as people read it, and the exit code. Doubtful ends with 3, as results that are not
# to be trusted do: a script that goes on after `doctor` must not go on over a doubt.
_WORDS = {"consistent": ("agrees", 0), "doubtful": ("doubtful", 3), "wrong": ("wrong", 2)}
_CHECKING = "holding the telemetry against the laws of motion"
# Keys in a doubt's words, such as columns.rate.names or wheels.x.max_torque.
_KEY = re.compile(r"\b(?:columns|wheels|rate_sensor)\.[\w.-]*\w")


def doctor_command(campaign: Path | None = None, as_json: bool = False) -> None:
    """Hold a campaign's conventions against physics; without a campaign, check the installation.

    Units, signs, orders, frames and clocks are those of the data, or the change that makes them so
    is named. Nothing is changed. Exit code 2 if a convention is wrong; 3 if the data are doubtful:
    then what fails, and where, is said.
    """
    if campaign is None:
        with progress_bar() as progress:
            installation = installation_json(progress)
        print_or_show(installation, as_json, show_installation, installation)
        return
    from bayes_inertia.app.told_torques import check_conventions

    with progress_bar() as progress:
        progress(_CHECKING, 0, 0)
        check = check_conventions(campaign).doubting(_left_out(campaign))
        lines = _mapping_lines(campaign, check)
    content = check.json() | {"mapping_lines": lines}
    print_or_show(content, as_json, show_check, check, campaign, lines)
    code = _WORDS[check.verdict][1]
    if code:
        raise typer.Exit(code)


def refuse_or_warn(
    campaign: Path, progress: Progress = silent, effects: Sequence[str] = ()
) -> None:
    """Stop if a campaign's conventions are wrong, and say on stderr what is doubtful."""
    from bayes_inertia.app.told_torques import refuse_impossible

    progress(_CHECKING, 0, 0)
    check = refuse_impossible(campaign, effects).doubting(_left_out(campaign))
    if check.verdict == "doubtful":
        say(f"warning: {check.sentence}")


def _left_out(campaign: Path) -> list[str]:
    """Streams that an import left out of slews in part, and the offset that is known."""
    from bayes_inertia.importing.mapped_lines import streams_beside

    said = streams_beside(campaign)
    if len(said) > 1:
        said.append("or it is the clock of the rates: columns.rate.offset_s, with the other sign")
    return said


def _mapping_lines(campaign: Path, check: ConventionsCheck) -> list[str]:
    """Lines of the mapping that proposal and doubts are about, of a folder that was imported."""
    keys = [change.key for change in check.changes if change.proposal == 1]
    keys = list(dict.fromkeys([*keys, *(k for doubt in check.doubts for k in _KEY.findall(doubt))]))
    if not keys:
        return []
    from bayes_inertia.importing.mapped_lines import mapped_lines

    return [line for key in keys for line in mapped_lines(campaign, key)]


def show_check(check: ConventionsCheck, campaign: Path, mapping_lines: Sequence[str] = ()) -> None:
    """Print a check for people."""
    from bayes_inertia.conventions.wording import invisible_in_brief
    from bayes_inertia.report.formatting import typeset
    from bayes_inertia.report.words import dirt_sentences

    console = plain_console()
    hidden = invisible_in_brief(check.cannot_show)
    style = "bold red" if check.verdict == "wrong" else "bold"
    asked = check.misfits or check.verdict != "consistent"
    word = _WORDS[check.verdict][0] if asked else "nothing to check"
    console.print(headed(f"{check.campaign}: {word}", style=style))
    for line in check.sentence.splitlines():
        exact = line.strip() in check.edits  # to be pasted
        console.print(line if exact else typeset(line), soft_wrap=exact)
    for title, lines in (
        ("the folder was imported; look here and import again:", mapping_lines),
        ("telemetry:", dirt_sentences(check.dirt)),
        ("physical, no wrong convention:", check.remarks),
        ("this campaign cannot show (all of it with --json):", hidden),
    ):
        if lines:
            console.print(title)
            for line in lines:
                console.print(indented(f"- {typeset(line)}"))
    if check.verdict == "consistent":
        console.print(f"next: bayes-inertia fit {campaign} -o RUN", soft_wrap=True)


def installation_json(progress: Progress = silent) -> dict[str, Any]:
    """Versions, the device that computes, a self-test, and the library of effects."""
    progress("loading JAX", 0, 0)
    import jax
    import jax.numpy as jnp

    from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC

    progress("self-test: a free tumble", 0, 0)
    drift = _energy_drift()
    return {
        "format": INSTALLATION_FORMAT,
        "versions": versions(),
        "devices": [str(device) for device in jax.devices()],
        "double_precision": bool(jnp.zeros(1).dtype == jnp.float64),
        "energy_drift": drift,
        "self_test_passed": drift < LAYOUT.energy_drift_allowed,
        "compiled_code": _compiled_code(),
        "effects": [effect.name for effect in LIBRARY],
        "effects_without_fixed_shape": [effect.name for effect in STOCHASTIC],
    }


def show_installation(content: Mapping[str, Any]) -> None:
    """Print what this installation consists of, and whether it works."""
    from bayes_inertia.report.formatting import brief
    from bayes_inertia.report.words import sentences

    console, passed = plain_console(), content["self_test_passed"]
    drift = f"energy of a free tumble constant to {brief(content['energy_drift'], 1)}"
    says = "self-test passed" if passed else "self-test FAILED: do not use this installation"
    console.print(headed(says, f" ({drift})", style="bold green" if passed else "bold red"))
    for line in sentences("commands", "installation", content):
        console.print(line)


def _compiled_code() -> str:
    """Folder of compiled code between runs."""
    import jax

    folder = jax.config.values["jax_compilation_cache_dir"]
    if folder is None or not jax.config.values["jax_enable_compilation_cache"]:
        return "not kept between runs"
    return f"kept in {folder} ({size_of(Path(folder)) / 1e6:.0f} MB)"


def _energy_drift() -> float:
    """Largest relative change of the energy of a body that tumbles freely for 100 s."""
    import jax.numpy as jnp

    from bayes_inertia.physics.simulator import simulate_slew
    from bayes_inertia.physics.slew_input import Start, idle_slew

    slew = idle_slew(np.arange(100.0))
    start = Start(jnp.array([0.01, 0.02, 0.01]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0))
    J = jnp.diag(jnp.array([3.0, 2.0, 2.0]))
    rate = simulate_slew(slew, start, J)[0].rate_B
    energy = jnp.einsum("ni,ij,nj->n", rate, J, rate)
    return float(jnp.abs(energy / (rate[0] @ J @ rate[0]) - 1.0).max())


EFFECTS_CHECK_FORMAT = "bayes-inertia-effects-check/1"


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
        _list_effects(tuple(e for e in known if not lacks(e, flown)), flown, as_json)
        return
    _check_effects(check, None if campaign is None else flown, as_json)


def _check_effects(text: str, campaign: Campaign | None, as_json: bool) -> None:
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
        print_json({"format": EFFECTS_CHECK_FORMAT, "effects": rows})
        return
    for result in checked:
        show_checked_effect(result)


def _list_effects(effects: tuple[Effect, ...], campaign: Campaign, as_json: bool) -> None:
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
