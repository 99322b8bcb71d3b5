"""J and K over campaigns, over the spacecraft of a fleet, and of two runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from bayes_inertia.physics.parameters import base_names, base_units
from bayes_inertia.report.formatting import exponent, unit_text
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style
from bayes_inertia.report.run_comparison import ParameterDifference
from bayes_inertia.series.fleet import Fleet
from bayes_inertia.series.history import OF_PART, History


@style.styled
def draw_history(history: History) -> Figure:
    """Each element of J and K against the campaigns: each campaign alone, and all together."""
    figure, panels = _panels(history.mean.shape[1], sharex=True)
    for k, axes in enumerate(panels):
        history_panel(axes, history, k)
        axes.tick_params(labelbottom=k + 3 >= len(panels))
    return figure


def history_panel(axes: Axes, history: History, k: int) -> None:
    """One element of J or K against the campaigns, or the times that are told of them."""
    known = history.time
    x: np.ndarray = np.arange(len(history.campaigns)) if known is None else known
    center, power = _center_and_power(history.mean[:, k], history.alone_sd[:, k])
    size = 10.0**power
    mean, sd = (history.mean[:, k] - center) / size, history.sd[:, k] / size
    reach = LAYOUT.sds_of_90_percent * sd
    band: dict[str, Any] = {"color": style.SKY, "alpha": 0.35, "lw": 0, "label": "90 % interval"}
    axes.fill_between(x, mean - reach, mean + reach, **band)
    axes.plot(x, mean, color=style.BLUE, label="all campaigns together")
    alone, sd = (history.alone[:, k] - center) / size, history.alone_sd[:, k] / size
    dots: dict[str, Any] = {
        "fmt": "o",
        "ms": 3.5,
        "color": style.INK,
        "ecolor": style.MUTED,
        "elinewidth": 0.8,
    }
    axes.errorbar(x, alone, sd, **dots, label="each alone ± sd")
    for jump in history.jumps:
        of_part = range(history.mean.shape[1])[OF_PART[jump.part]]
        if jump.probability > LAYOUT.possible_change and k in of_part:
            before, after = x[jump.after : jump.after + 2]
            axes.axvline(before + (after - before) / 2, color=style.VERMILLION, ls=(0, (4, 2)))
    _labels(axes, k, history.mean.shape[1], center, power)
    if known is None:
        named_ticks(axes, history.campaigns)
    elif np.issubdtype(known.dtype, np.datetime64):
        dates = AutoDateLocator(maxticks=LAYOUT.most_dates)
        axes.xaxis.set_major_locator(dates)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(dates))


def named_ticks(axes: Axes, names: Sequence[str]) -> None:
    """A tick for each name; what a user calls a campaign is no formula."""
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right", parse_math=False)


@style.styled
def draw_fleet(fleet: Fleet) -> Figure:
    """Each element of J and K of each spacecraft: from its own campaigns, and with its sisters'."""
    figure, panels = _panels(fleet.mean.size)
    for k, axes in enumerate(panels):
        fleet_panel(axes, fleet, k)
    return figure


def fleet_panel(axes: Axes, fleet: Fleet, k: int) -> np.ndarray:
    """One element of J or K of each spacecraft; returns their order (craft,) from left to right."""
    x, order = np.arange(len(fleet.spacecraft)), np.argsort(fleet.craft_mean[:, k])
    center, power = _center_and_power(fleet.craft_mean[:, k], fleet.craft_sd[:, k])
    size = 10.0**power
    mean, spread = (fleet.mean[k] - center) / size, fleet.spread[k] / size
    band: dict[str, Any] = {
        "color": style.SKY,
        "alpha": 0.3,
        "lw": 0,
        "label": "spread between spacecraft",
    }
    axes.axhspan(mean - spread, mean + spread, **band)
    axes.axhline(mean, color=style.BLUE, lw=0.8, label="mean of the fleet")
    for shift, values, sds, color, marker, label in (
        (-0.15, fleet.alone, fleet.alone_sd, style.MUTED, "s", "alone ± sd"),
        (0.15, fleet.craft_mean, fleet.craft_sd, style.INK, "o", "with its sisters ± sd"),
    ):
        value, sd = (values[order, k] - center) / size, sds[order, k] / size
        dots: dict[str, Any] = {
            "fmt": marker,
            "ms": 3.0,
            "color": color,
            "elinewidth": 0.8,
            "label": label,
        }
        axes.errorbar(x + shift, value, sd, **dots)
    low, high = axes.get_ylim()
    reach = 6.0 * max(spread, float(np.median(fleet.craft_sd[:, k])) / size)
    axes.set_ylim(max(low, mean - reach), min(high, mean + reach))
    _labels(axes, k, fleet.mean.size, center, power)
    axes.set_xticks([])
    axes.set_xlabel("spacecraft, the smallest first")
    return order


def _panels(n: int, *, sharex: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure with a panel for each of n parameters, three in a row."""
    rows = -(-n // 3)
    figure = Figure(figsize=(style.WIDTH, 2.4 * rows), layout="constrained")
    panels = list(figure.subplots(rows, 3, sharex=sharex, squeeze=False).ravel())
    for unused in panels[n:]:
        unused.set_visible(False)
    return figure, panels[:n]


def _center_and_power(values: np.ndarray, sds: np.ndarray) -> tuple[float, int]:
    """What a panel counts from, rounded, and its power of ten."""
    power = exponent(float(np.ptp(values)), float(np.median(sds)))
    return float(np.round(np.median(values), 1 - power)), power


def _labels(axes: Axes, k: int, n: int, center: float, power: int) -> None:
    less = f" {'less' if center > 0.0 else 'plus'} {abs(center):.6g}" if center else ""
    unit = base_units(n)[k]
    axes.set_title(f"{base_names(n)[k]}{less}")
    if unit or power:
        axes.set_ylabel(unit_text(unit, power))


@style.styled
def draw_run_differences(parameters: Sequence[ParameterDifference]) -> Figure | None:
    """Both runs' values of each parameter with their quoted sd, relative to the first run's."""
    if not parameters:
        return None
    figure, (place,) = style.grid(
        1.1 + 0.3 * len(parameters), 1, 1, left=0.8, right=0.3, top=0.45, bottom=0.55
    )
    axes = figure.add_axes(place)
    rows = np.arange(len(parameters))
    combined = np.array([p.combined_sd or 1.0 for p in parameters])
    sides = [
        [row["quoted_sd"] for row in (p.first, p.second) if row is not None] for p in parameters
    ]
    first, second = (np.array(column) / combined for column in zip(*sides, strict=True))
    shift = np.array([p.in_sd or 0.0 for p in parameters])
    axes.axvspan(-LAYOUT.noticeable_sd, LAYOUT.noticeable_sd, color=style.PALE, alpha=0.4, lw=0)
    axes.axvline(0.0, color=style.MUTED, lw=0.7)
    axes.errorbar(
        np.zeros(len(rows)), rows - 0.15, xerr=first, fmt="s", color=style.MUTED, ms=5, capsize=2
    )
    axes.errorbar(shift, rows + 0.15, xerr=second, fmt="o", color=style.BLUE, ms=5, capsize=2)
    half = 1.1 * max(LAYOUT.noticeable_sd, float(np.max(np.abs(shift) + second)))
    axes.set(xlim=(-half, half), ylim=(len(rows) - 0.5, -0.5))
    axes.set_yticks(rows, [p.name for p in parameters])
    axes.set_xlabel("difference from A [combined sd]")
    handles = [
        style.mark("A ± sd", style.MUTED, "s", ls="-"),
        style.mark("B ± sd", style.BLUE, "o", ls="-"),
    ]
    style.legend(figure, handles)
    return figure
