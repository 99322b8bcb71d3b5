"""`doctor`: is this installation sound; and are a campaign's conventions those of its data?"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from bayes_inertia.app.commands.options import AsJson
from bayes_inertia.app.compiled_code import size_of
from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.terminal import (
    headed,
    indented,
    plain_console,
    print_json,
    progress_bar,
    say,
)
from bayes_inertia.progress import Progress, silent

if TYPE_CHECKING:
    from bayes_inertia.conventions.check import ConventionsCheck

# The verdict as people read it, and the exit code. Doubtful ends with 3, as results that are not
# to be trusted do: a script that goes on after `doctor` must not go on over a doubt.
_WORDS = {"consistent": ("agrees", 0), "doubtful": ("doubtful", 3), "wrong": ("wrong", 2)}
_CHECKING = "holding the telemetry against the laws of motion"
# Keys in a doubt's words, such as columns.rate.names or wheels.x.max_torque.
_KEY = re.compile(r"\b(?:columns|wheels|rate_sensor)\.[\w.-]*\w")
_CampaignOrNone = Annotated[
    Path | None,
    typer.Argument(help="Campaign folder; without it the installation is looked at."),
]


def doctor_command(campaign: _CampaignOrNone = None, as_json: AsJson = False) -> None:
    """Hold a campaign's conventions against physics; without a campaign, check the installation.

    Units, signs, orders, frames and clocks are those of the data, or the change that makes them so
    is named. Nothing is changed. Exit code 2 if a convention is wrong; 3 if the data are doubtful:
    then what fails, and where, is said.
    """
    if campaign is None:
        with progress_bar() as progress:
            installation = installation_json(progress)
        if as_json:
            print_json(installation)
        else:
            show_installation(installation)
        return
    from bayes_inertia.app.told_torques import check_conventions

    with progress_bar() as progress:
        progress(_CHECKING, 0, 0)
        check = check_conventions(campaign).doubting(_left_out(campaign))
        lines = _mapping_lines(campaign, check)
    if as_json:
        print_json(check.json() | {"mapping_lines": lines})
    else:
        show_check(check, campaign, lines)
    code = _WORDS[check.verdict][1]
    if code:
        raise typer.Exit(code)


def refuse_or_warn(
    campaign: Path, progress: Progress = silent, effects: Sequence[str] = ()
) -> None:
    """Stop if a campaign's conventions are wrong, and say on stderr what is doubtful."""
    from bayes_inertia.app.told_torques import torques_of
    from bayes_inertia.conventions.check import refuse_impossible

    progress(_CHECKING, 0, 0)
    check = refuse_impossible(campaign, partial(torques_of, effects=effects))
    check = check.doubting(_left_out(campaign))
    if check.verdict == "doubtful":
        say(f"warning: {check.sentence}")


def _left_out(campaign: Path) -> list[str]:
    """Streams that an import left out of slews, in whole or in part, and the offset if known."""
    from bayes_inertia.conventions.clocks import apart_in_words
    from bayes_inertia.importing.mapped_lines import streams_beside, streams_outside

    said = streams_beside(campaign)
    said += [
        apart_in_words(key, count, [(np.array(own), np.array(slews))])
        for key, (count, own, slews) in streams_outside(campaign).items()
    ]
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
    console.print(headed(f"{check.campaign}: {_WORDS[check.verdict][0]}", style=style))
    console.print(typeset(check.sentence))
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


FORMAT = "bayes-inertia-installation/1"
_PACKAGES = ("bayes-inertia", "numpy", "scipy", "jax", "emcee", "arviz", "xarray", "matplotlib")
_STOCHASTIC = "effects_without_fixed_shape"


def installation_json(progress: Progress = silent) -> dict[str, Any]:
    """Versions, the device that computes, a self-test, and the library of effects."""
    progress("loading JAX", 0, 0)
    import jax
    import jax.numpy as jnp

    from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC

    progress("self-test: a free tumble", 0, 0)
    drift = _energy_drift()
    return {
        "format": FORMAT,
        "versions": {name: metadata.version(name) for name in _PACKAGES},
        "devices": [str(device) for device in jax.devices()],
        "double_precision": bool(jnp.zeros(1).dtype == jnp.float64),
        "energy_drift": drift,
        "self_test_passed": drift < LAYOUT.energy_drift_allowed,
        "compiled_code": _compiled_code(),
        "effects": [effect.name for effect in LIBRARY],
        _STOCHASTIC: [effect.name for effect in STOCHASTIC],
    }


def show_installation(content: Mapping[str, Any]) -> None:
    """Print what this installation consists of, and whether it works."""
    console, passed = plain_console(), content["self_test_passed"]
    drift = f"energy of a free tumble constant to {content['energy_drift']:.1g}"
    says = "self-test passed" if passed else "self-test FAILED: do not use this installation"
    console.print(headed(says, f" ({drift})", style="bold green" if passed else "bold red"))
    bits = "64-bit" if content["double_precision"] else "32-bit: do not use it"
    for what, value in (
        ("packages", ", ".join(f"{name} {of}" for name, of in content["versions"].items())),
        ("computing on", f"{', '.join(content['devices'])}, {bits}"),
        ("compiled code", content["compiled_code"]),
        ("effects", ", ".join(content["effects"])),
        ("stochastic effects", ", ".join(content[_STOCHASTIC])),
    ):
        console.print(f"{what}: {value}")


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
