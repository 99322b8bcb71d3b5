"""Halves of the throws that predict each other: does a diagnosis bring J nearer to what it is?

No truth is wanted: each half of a body's throws is fitted and diagnosed alone. What is real repeats
itself in the other half; what a free shape takes for motion, or leaves of it, need not. A common
change of all moments is a scale: with wheels alone J is known on the scale of their momentum.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from analyses.pages.table import table_lines
from bayes_inertia.campaign.block_means import without_surplus_rows
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.inference import optimizer
from bayes_inertia.physics.forward_model import Model

_MOMENTS = slice(0, 3)  # Jxx, Jyy, Jzz
_NINETY_PERCENT = 1.645  # of a normal distribution [sd]


def halves_of(folder: Path) -> list[dict]:
    """Every second throw, and the others: each fitted and diagnosed alone."""
    campaign = without_surplus_rows(read_campaign(folder))
    return [_half(replace(campaign, slews=campaign.slews[k::2])) for k in (0, 1)]


def _half(campaign: Campaign) -> dict:
    plain = optimizer.estimate(Model(campaign, (), "measured"))
    diagnosis = diagnose(campaign, drive="measured")
    quoted = quoted_parameters(diagnosis)
    robust = np.sqrt(np.diag(plain.robust_covariance))
    return {
        "throws": len(campaign.slews),
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "tried": [step.added for step in diagnosis.steps],
        "plain": plain.theta[_MOMENTS].tolist(),
        "plain_sd": robust[_MOMENTS].tolist(),
        "quoted": quoted.mean[_MOMENTS].tolist(),
        "quoted_sd": quoted.sd[_MOMENTS].tolist(),
    }


def agreement(halves: list[dict], key: str) -> dict:
    """How two halves differ: in percent, in common and beside that, and in sds."""
    one, other = (np.array(half[key]) for half in halves)
    sds = np.array([half[f"{key}_sd"] for half in halves])
    percent = 100.0 * (one - other) / (0.5 * (one + other))
    return {
        "common": float(percent.mean()),
        "beside": float(np.sqrt(np.mean((percent - percent.mean()) ** 2))),
        "rms": float(np.sqrt(np.mean(percent**2))),
        "z": ((one - other) / np.sqrt((sds**2).sum(0))).tolist(),
    }


def halves_lines(rows: list[dict]) -> list[str]:
    """The agreement of the halves of all bodies, in Markdown."""
    rows = [row for row in rows if "halves" in row]
    if not rows:
        return []
    cells, held = [], {"plain": [], "quoted": []}
    for row in rows:
        for key, said in (("plain", "plain fit"), ("quoted", "after `diagnose`")):
            found = agreement(row["halves"], key)
            held[key] += [abs(z) < _NINETY_PERCENT for z in found["z"]]
            verdicts = ", ".join(half["verdict"] for half in row["halves"])
            cells.append(
                [
                    row["configuration"] if key == "plain" else "",
                    said if key == "plain" else f"{said}: {verdicts}",
                    f"{found['rms']:.2f} %",
                    f"{found['common']:+.2f} %",
                    f"{found['beside']:.2f} %",
                    ", ".join(f"{z:+.1f}" for z in found["z"]),
                ]
            )
    columns = ("body", "J from", "halves differ, rms", "in common (scale)", "beside", "in sds")
    shares = [f"{sum(h)} of {len(h)} {name}" for name, h in held.items()]
    return [
        "## Halves of the throws that predict each other",
        "",
        "Every second throw against the others, each half diagnosed alone; Jxx, Jyy, Jzz.",
        "Plain sds are those that count each throw as it scatters.",
        "",
        *table_lines(columns, cells),
        "",
        f"Differences inside the 90 % interval of their sds: {', '.join(shares)}.",
        "",
    ]
