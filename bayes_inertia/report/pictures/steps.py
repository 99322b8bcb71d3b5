"""What adding effects changes: the misfit, step by step, and J and K."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.report.formatting import CHANNEL_NAMES, plain
from bayes_inertia.report.pictures import style

_TICKS = (0.5, 1, 2, 5, 10, 30, 100, 300, 1000, 1e4, 1e5, 1e6)


@style.styled
def draw_misfit_by_step(steps: Sequence[Mapping[str, Any]]) -> Figure:
    """Reduced chi^2 by channel, and of slews held out of the fit, after each step."""
    stages = ["base", *(f"+ {plain(step['added'])}" for step in steps)]
    figure, (place,) = style.grid(3.2, 1, 1, left=0.9, right=2.2, top=0.35, bottom=0.55)
    axes = figure.add_axes(place)
    axes.axhline(1.0, color=style.MUTED, lw=0.9)
    lines = _misfit_lines(steps)
    for k, (label, values, color, marker, dash) in enumerate(lines):
        axes.plot(
            np.arange(len(stages)) + 0.015 * (k - 2),
            [np.nan if value is None else value for value in values],
            marker=marker,
            ms=6,
            color=color,
            ls=dash,
            label=label,
        )
    known = [value for _, values, *_ in lines for value in values if value is not None]
    axes.set_yscale("log")
    axes.set_ylim(min(0.7, 0.9 * min(known)), 1.35 * max(*known, 1.5))
    axes.set_xlim(-0.3, len(stages) - 0.7)
    axes.set_xticks(range(len(stages)), stages)
    low, high = axes.get_ylim()
    ticks = [tick for tick in _TICKS if low <= tick <= high]
    axes.set_yticks(ticks, [f"{t:,.4g}" if t < 1e4 else f"{t:.0e}" for t in ticks])
    axes.minorticks_off()
    axes.set_ylabel("reduced χ²")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _misfit_lines(steps: Sequence[Mapping[str, Any]]) -> list[tuple[str, list, str, str, Any]]:
    """Label, reduced chi^2 of every stage, colour, marker and dashes of each line."""
    lines: list[tuple[str, list, str, str, Any]] = []
    for i, channel in enumerate((*CHANNELS, "total")):
        values = [steps[0]["reduced_chi2_before"][channel]]
        values += [step["reduced_chi2_after"][channel] for step in steps]
        if values[0] is not None:
            lines.append((CHANNEL_NAMES[channel], values, style.color(i), style.MARKERS[i], "-"))
    held_out = [steps[0]["held_out_before"], *(step["held_out_after"] for step in steps)]
    if held_out[0] is not None:
        lines.append(("slews left out of the fit", held_out, style.INK, "X", (0, (4, 2))))
    return lines


@style.styled
def draw_shifts(steps: Sequence[Mapping[str, Any]]) -> Figure:
    """J and K before and after the effects were added, as differences from the last value."""
    first, last = steps[0]["shift"], steps[-1]["shift"]
    figure, places = style.grid(
        3.9, 3, 3, left=0.35, right=0.2, top=0.45, bottom=0.5, gap_x=0.35, gap_y=0.62
    )
    for place, name in zip(places, last, strict=True):
        _shift_panel(figure.add_axes(place), name, first[name], last[name])
    handles = [
        Line2D([], [], marker="s", color=style.MUTED, ls="-", label="base model ± sd"),
        Line2D([], [], marker="o", color=style.BLUE, ls="-", label="with the effects added ± sd"),
    ]
    figure.legend(handles=handles, loc="upper left", ncols=2, bbox_to_anchor=(0.01, 1.0))
    return figure


def _shift_panel(axes: Axes, name: str, first: Mapping[str, Any], last: Mapping[str, Any]) -> None:
    center = last["after"]
    shift, sd_before, sd_after = first["before"] - center, first["sd_before"], last["sd_after"]
    half = 1.15 * max(abs(shift - sd_before), abs(shift + sd_before), abs(sd_after))
    scale = style.scale(name, last["unit"], 0.0, half)
    axes.axvline(0.0, color=style.PALE, lw=0.8)
    axes.errorbar(
        scale(shift), 1, xerr=sd_before / scale.factor, fmt="s", color=style.MUTED, ms=5, capsize=3
    )
    axes.errorbar(0.0, 0, xerr=sd_after / scale.factor, fmt="o", color=style.BLUE, ms=5, capsize=3)
    axes.set(ylim=(-0.7, 1.7), xlim=(-half / scale.factor, half / scale.factor))
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    difference = f"{name} {'−' if center >= 0 else '+'} {abs(center):.5g}"
    axes.set_xlabel(scale.label.replace(name, difference), labelpad=1)
