"""`check`: read a campaign and say what it contains."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_inertia.app.commands.options import Anyway, AsJson, CampaignFolder
from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.terminal import headed, plain_console, print_json, print_table

if TYPE_CHECKING:
    from bayes_inertia.campaign.campaign import Campaign

FORMAT = "bayes-inertia-check/1"
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


def check_command(
    campaign: CampaignFolder, anyway: Anyway = False, as_json: AsJson = False
) -> None:
    """Read a campaign, check it and its conventions, and say what it contains."""
    from bayes_inertia.app.commands.doctor import refuse_or_warn
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
    return json_ready(
        {
            "format": FORMAT,
            "campaign": campaign.name,
            "slews": [_slew_row(campaign, k) for k in range(len(campaign.slews))],
            "wheels": [wheel.name for wheel in campaign.wheels],
            "inertia_kgm2": inertia.tensor,
            "inertia_sd_kgm2": inertia.sd,
            "includes_wheel_spin": inertia.includes_wheel_spin,
            "principal_moments_kgm2": np.linalg.eigvalsh(inertia.tensor),
            "rate_sigma_radps": sensor.sigma if sensor else None,
            "star_tracker": campaign.star_tracker is not None,
            "devices": [
                dict(zip(("name", "is"), each, strict=True)) for each in _devices(campaign)
            ],
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
        *(
            (x.name, f"{x.part} changes at {x.time:.6g} s, by {100 * x.sigma_fraction:.2g} % or so")
            for x in campaign.changes
        ),
    ]


def _axes_in_words(kind: str, name: str, campaign: Campaign) -> str:
    axes = getattr(campaign.sensors[name], "axes", None)
    said = kind if axes is None else f"{kind}, {len(axes)} axes"
    return f"{said}, reference of frames" if name == campaign.frame_reference else said


def _gain_in_words(device: Any) -> str:
    kind = re.sub(r"(?<!^)([A-Z])", r" \1", type(device).__name__).lower()
    gain = f"to {100 * device.gain_sigma:.2g} %" if device.gain_sigma else "exactly"
    return f"{kind}, gain known {gain}"


def _slew_row(campaign: Campaign, k: int) -> dict[str, Any]:
    """A slew in numbers; the peak rate is that of the body, None where nothing tells it."""
    slew, seen = campaign.slews[k], campaign.with_body_rates
    _, rates = seen.slews[k].complete_rates()
    return {
        "name": slew.name,
        "rows": len(slew.time),
        "step_s": float(np.median(slew.rate_steps)),
        "duration_s": float(slew.duration),
        "peak_rate_radps": float(np.linalg.norm(rates, axis=1).max()) if len(rates) else None,
        "fixes": int(slew.fixes.sum()),
        "commands": slew.wheel_torque is not None,
        "wheel_momentum": slew.wheel_momentum is not None,
    }


def show_campaign(campaign: Campaign) -> None:
    """Print what a campaign contains, and what can be done with it."""
    from bayes_inertia.campaign.hardware import RateSensor
    from bayes_inertia.report.words import dirt_sentences

    console = plain_console()
    slews, wheels = len(campaign.slews), len(campaign.wheels)
    console.print(headed(campaign.name, f": {slews} slews, {wheels or 'no'} wheels"))
    columns = len(_COLUMNS) - (0 if wheels else 2)
    shown = (_slew_row(campaign, k) for k in range(min(slews, LAYOUT.slews_shown)))
    print_table(_COLUMNS[:columns], (_slew_cells(row)[:columns] for row in shown))
    if slews > LAYOUT.slews_shown:
        console.print(f"... and {slews - LAYOUT.slews_shown} slews more (all of them with --json)")
    if campaign.more_sensors or campaign.actuators or campaign.changes:
        said = (f"{name} ({what})" for name, what in _devices(campaign))
        console.print(f"devices: {', '.join(said)}")
    moments = ", ".join(f"{m:.4g}" for m in np.linalg.eigvalsh(campaign.inertia.tensor))
    kind = "with" if campaign.inertia.includes_wheel_spin else "without"
    spin = f" ({kind} the wheels' spin inertia)" if wheels else ""
    console.print(f"prior principal moments: {moments} kg m²{spin}")
    drives = ", ".join(_possible_drives(campaign))
    if wheels:
        console.print(
            f"possible drives: {drives or 'none: add wheel_torque or wheel_momentum columns'}"
        )
    if campaign.star_tracker is None and all(
        isinstance(sensor, RateSensor) for _, sensor in campaign.more_sensors
    ):
        console.print(
            "no star tracker: attitude is not compared, "
            "start and final attitude errors stay unknown"
        )
    for sentence in dirt_sentences([record.json() for record in campaign.dirt]):
        console.print(sentence)


def _slew_cells(row: dict[str, Any]) -> tuple[str, ...]:
    peak = row["peak_rate_radps"]
    return (
        row["name"],
        str(row["rows"]),
        f"{row['step_s']:.4g}",
        f"{row['duration_s']:.4g}",
        "none" if peak is None else f"{np.degrees(peak):.3g}",
        str(row["fixes"]),
        "yes" if row["commands"] else "no",
        "yes" if row["wheel_momentum"] else "no",
    )


def _possible_drives(campaign: Campaign) -> list[str]:
    drives = ["commanded"] if campaign.has_commands or not campaign.wheels else []
    return [*drives, "measured"] if campaign.has_tachometers else drives
