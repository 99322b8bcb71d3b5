"""The page and the figure of SUCHAI-3, from the content of `tumble.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment
from matplotlib.figure import Figure

from analyses import results_of
from analyses.pages.figures import save_svg
from analyses.suchai3.campaign import CAD, DEGREE
from analyses.suchai3.spin import SPIN_SIGMA
from bayes_inertia.files import write_atomically
from bayes_inertia.report.pictures import style
from bayes_inertia.version import __version__

_TEMPLATE = Path(__file__).parent / "tumble.md.jinja"
SDS_OF_90 = 1.6449  # half of a 90 % interval, in sds
_DAY = 86_400.0  # [s]
_DIFFERENCE = "largest minus middle, in 1000 of the largest"
# An interval that reaches beyond these, which no body can have, says that nothing is determined.
_POSSIBLE = {
    "middle over largest": (0.0, 1.0),
    _DIFFERENCE: (0.0, 1000.0),
    "nutation over spin": (0.0, 1.0),
    "spin axis towards x [deg]": (-45.0, 45.0),
    "spin axis towards z [deg]": (-45.0, 45.0),
}


def widened(fit: Mapping[str, Any]) -> dict[str, Any]:
    """A fit whose intervals and sds are widened by as much as its slews disagree."""
    factor = fit["spread_of_slews"]["factor"]
    ratios = {
        name: {key: row["median"] + factor * (value - row["median"]) for key, value in row.items()}
        for name, row in fit["ratios"].items()
    }
    for name, (low, high) in _POSSIBLE.items():
        ratios[name]["determined"] = ratios[name]["low"] >= low and ratios[name]["high"] <= high
    rows = {name: row | {"sd": factor * row["sd"]} for name, row in fit["parameters"].items()}
    return dict(fit) | {"ratios": ratios, "parameters": rows, "factor": factor}


def quoted(content: Mapping[str, Any]) -> dict[str, Any]:
    """The content of `tumble.json` as the page says it."""
    fits = {name: widened(fit) for name, fit in content["fits"].items()}
    held_out = content["held_out"] and quoted(content["held_out"] | {"held_out": None})
    return dict(content) | {"fits": fits, "held_out": held_out}


def within(held_out: Mapping[str, Any], channel: str) -> float:
    """Share of a channel's readings within 90 % intervals, of both halves."""
    of_halves = [half[channel] for half in held_out["predicted"].values()]
    readings = sum(half["readings"] for half in of_halves)
    return sum(half["readings"] * half["within_90"] for half in of_halves) / readings


def apart(held_out: Mapping[str, Any], name: str) -> float:
    """Difference of a ratio between the halves, in sds of the difference."""
    one, other = (fit["ratios"][name] for fit in held_out["fits"].values())
    widths = [row["high"] - row["low"] for row in (one, other)]
    return 2.0 * SDS_OF_90 * (one["median"] - other["median"]) / math.hypot(*widths)


def page(content: Mapping[str, Any]) -> str:
    """Markdown."""
    content = quoted(content)
    template = Environment(autoescape=False, keep_trailing_newline=True).from_string(
        _TEMPLATE.read_text(encoding="utf-8")
    )
    return template.render(
        content,
        version=__version__,
        whole=content["fits"]["all sessions"],
        difference=_DIFFERENCE,
        spin_sigma=SPIN_SIGMA,
        torque_sum=1e9 * _mean_torque(content["spin"]),
        old=content["fits"]["sessions of 2023"]["parameters"]["magnetometer.offset_x"],
        new=content["fits"]["sessions of 2024"]["parameters"]["magnetometer.offset_x"],
        share=partial(within, content["held_out"]),
        apart=partial(apart, content["held_out"]),
    )


def _mean_torque(spin: Mapping[str, Any]) -> float:
    """What changed the spin from the first to the last session [N m], on the CAD's scale."""
    change = (spin["spin"][-1] - spin["spin"][0]) / (spin["day"][-1] - spin["day"][0])
    return float(CAD[1, 1] * change * DEGREE / _DAY)


@style.styled
def _picture(content: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(7.6, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    spin, best = content["spin"], content["torques"][0]
    left.axhline(0.0, color=style.PALE, lw=0.8)
    left.plot(spin["day"], best["modelled"], color=style.VERMILLION, label="best torques")
    left.plot(spin["day"], spin["spin"], "o", ms=4, color=style.BLUE, label="sessions")
    left.set(xlabel="days since 2023-09-04", ylabel="spin [deg/s]", title="Spin about y")
    left.legend()
    names = list(content["fits"])
    name = _DIFFERENCE
    for k, fit in enumerate(names):
        row = content["fits"][fit]["ratios"][name]
        if not row["determined"]:
            right.annotate("not determined", (2.0, k), va="center", color=style.MUTED)
            continue
        right.plot([row["low"], row["high"]], [k, k], color=style.color(k), lw=3)
        right.plot(row["median"], k, style.MARKERS[k], color=style.color(k))
    right.axvline(content["cad"][name], color=style.INK, ls="--", lw=1)
    right.annotate("CAD", (content["cad"][name], len(names) - 0.6), ha="left", va="top")
    right.set(
        yticks=range(len(names)),
        yticklabels=names,
        ylim=(-0.6, len(names) - 0.4),
        xlim=(0.0, None),
        xlabel="(Jyy - Jxx) / Jyy, in thousandths; bars: 90 %",
        title="How far the body is from round",
    )
    return figure


@style.styled
def _picture_of_prediction(held_out: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(7.6, 3.2), layout="constrained")
    axes = figure.subplots(1, 2, width_ratios=[2.2, 1.0])
    examples = (half["example"] for half in held_out["predicted"].values())
    one = max(examples, key=lambda slew: np.ptp(slew["mean"]))
    mean, sd = (np.degrees(one[key]) for key in ("mean", "sd"))
    begun = one["later"][0]
    left, right = axes
    left.fill_between(
        one["later"], mean - SDS_OF_90 * sd, mean + SDS_OF_90 * sd, color=style.PALE, lw=0
    )
    left.plot(one["later"], mean, color=style.VERMILLION, lw=1, label="predicted, 90 % interval")
    left.plot(one["time"], np.degrees(one["measured"]), ".", ms=3, color=style.BLUE, label="gyro")
    left.axvline(begun, color=style.INK, ls="--", lw=1)
    left.set(
        xlabel="time [s]", ylabel="x rate [deg/s]", title=f"{one['slew'].capitalize()}: not fitted"
    )
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
    shares = {
        sensor: [
            100 * share
            for half in held_out["predicted"].values()
            for share in half[channel]["within_90_by_slew"]
        ]
        for sensor, channel in (("gyro", "rate"), ("magnetometer", "magnetometer"))
    }
    for k, of_sensor in enumerate(shares.values()):
        place = k + np.linspace(-0.25, 0.25, len(of_sensor))
        right.plot(place, sorted(of_sensor), style.MARKERS[k], ms=4, color=style.color(k))
    right.axhline(90.0, color=style.INK, ls="--", lw=1)
    right.set(
        xticks=range(len(shares)),
        xticklabels=list(shares),
        ylim=(0.0, 102.0),
        ylabel="within 90 % intervals [%]",
        title="Each slew",
    )
    return figure


def write_page() -> None:
    """Write page and figures from the committed numbers of both studies."""
    folder = results_of(__file__)
    content = json.loads((folder / "tumble.json").read_text())
    held_out = folder / "held_out.json"
    content["held_out"] = json.loads(held_out.read_text()) if held_out.exists() else None
    write_atomically(folder / "tumble.md", page(content))
    save_svg(_picture(quoted(content)), "suchai3")
    if content["held_out"]:
        save_svg(_picture_of_prediction(content["held_out"]), "suchai3_held_out")
