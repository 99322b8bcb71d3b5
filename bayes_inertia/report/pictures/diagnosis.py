"""Pictures of a diagnosis: where the model disagrees, candidates, steps, and what has no name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from bayes_inertia.report.formatting import brief, channel_name, plain, tenths
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style

_NOT_MEASURED = "#f0f0f0"
# Blue and vermillion differ in hue and lightness for every reader; white is "as expected".
_COLORS = LinearSegmentedColormap.from_list("residual", [style.BLUE, "#ffffff", style.VERMILLION])


@style.styled
def draw_disagreement(
    cells: Mapping[str, Any], windows: Sequence[Mapping[str, Any]], starts: Mapping[str, float]
) -> Figure:
    """Mean residuals in short bins, one panel a slew, one row a component."""
    windows = [
        dict(w) | {key: w[key] - starts.get(w["slew"], 0.0) for key in ("t_start", "t_end")}
        for w in windows
    ]
    chosen = most_disagreeing_slews(cells, windows)
    components = [name for part in cells["channels"].values() for name in part["components"]]
    height = 0.5 + 0.19 * len(components)
    names = [cells["slews"][s] for s in chosen]
    figure, panels, columns = style.slew_panels(
        names, 1.05, height + 0.35, left=1.2, top=0.75, gap_x=0.25, gap_y=0.55
    )
    for k, (axes, s) in enumerate(zip(panels, chosen, strict=True)):
        _map_panel(axes, cells, windows, s)
        axes.set_yticks(np.arange(len(components)), [] if k % columns else components)
        axes.tick_params(length=0, axis="y")
    _map_legend(figure)
    return figure


def most_disagreeing_slews(
    cells: Mapping[str, Any], windows: Sequence[Mapping[str, Any]]
) -> list[int]:
    """At most nine slews: those with the most significant windows.

    >>> most_disagreeing_slews({"slews": ["a", "b"]}, [])
    [0, 1]
    """
    score = {
        name: max([w["score"] for w in windows if w["slew"] == name], default=0.0)
        for name in cells["slews"]
    }
    order = sorted(range(len(cells["slews"])), key=lambda s: -score[cells["slews"][s]])
    return sorted(order[: LAYOUT.most_slews_drawn])


def _map_panel(
    axes: Axes, cells: Mapping[str, Any], windows: Sequence[Mapping[str, Any]], s: int
) -> None:
    row, rows_of_channel = 0, {}
    for channel, part in cells["channels"].items():
        shift = np.array(part["shift"][s], float)
        rows_of_channel[channel] = (row, len(shift))
        edges = np.array(part["edges"][s], float)
        ends = np.arange(row, row + len(shift) + 1) - 0.5
        most = LAYOUT.color_limit_sigma
        axes.pcolormesh(edges, ends, shift, cmap=_COLORS, vmin=-most, vmax=most, rasterized=True)
        if row:
            axes.axhline(row - 0.5, color=style.MUTED, lw=0.8)
        row += len(shift)
    for channel, (first, n) in rows_of_channel.items():
        # Where nearly everything disagrees, frames side by side would only hide it.
        framed = [w for w in windows if w["slew"] == cells["slews"][s] and w["channel"] == channel]
        for window in framed[: LAYOUT.most_frames]:
            _frame(axes, window, edges, first, n)
    axes.set(ylim=(row - 0.5, -0.5), xlim=(edges[0], edges[-1]), facecolor=_NOT_MEASURED)


def _frame(axes: Axes, window: Mapping[str, Any], edges: np.ndarray, first: int, n: int) -> None:
    """A frame around `n` rows of the map."""
    narrowest = 0.008 * (edges[-1] - edges[0])
    begin = min(window["t_start"], edges[-1] - narrowest)
    corner = (begin, first - 0.42)
    width = max(window["t_end"] - begin, narrowest)
    axes.add_patch(Rectangle(corner, width, n - 0.16, fill=False, ec=style.INK, lw=1.3, zorder=5))


def _map_legend(figure: Figure) -> None:
    handles = [
        Patch(
            fc=_COLORS(0.5 + 0.5 * level / LAYOUT.color_limit_sigma),
            ec=style.PALE,
            lw=0.5,
            label=f"{level:+d} σ".replace("-", "−").replace("+0", "0"),
        )
        for level in (-6, -3, 0, 3, 6)
    ]
    handles += [
        Patch(fc=_NOT_MEASURED, ec=style.PALE, label="not measured"),
        Patch(fc="none", ec=style.INK, lw=1.2, label="noise does not explain this (p < 0.05)"),
    ]
    title = "mean of measured − predicted"
    how: dict[str, Any] = {"columnspacing": 1.2, "title_fontsize": 8.5, "alignment": "left"}
    style.legend(figure, handles, title=title, **how)


@style.styled
def draw_candidates(
    candidates: Sequence[Mapping[str, Any]], threshold: float, named: Sequence[str]
) -> Figure | None:
    """Strength of the evidence for each candidate, −log10 p, with the line of significance."""
    scored = [c for c in candidates if c["p_value"] is not None and c["dof"]]
    if not scored:
        return None
    figure, (place,) = style.grid(0.9 + 0.23 * len(scored), 1, 1, left=2.3, right=1.9, top=0.4)
    candidates_panel(figure.add_axes(place), scored, threshold, named)
    handles = [
        Patch(fc=style.VERMILLION, hatch="////", ec="white", label="named"),
        Patch(fc=style.BLUE, label="significant by itself, before anything was added"),
        style.mark("significance", style.INK, ls=(0, (4, 2)), lw=1.0),
    ]
    style.legend(figure, handles)
    return figure


def candidates_panel(
    axes: Axes, scored: Sequence[Mapping[str, Any]], threshold: float, named: Sequence[str]
) -> None:
    """One bar a candidate that the campaign can see, the strongest on top."""
    scored = sorted(scored, key=lambda c: (-c["p_value"], c["log_bayes_factor"]))
    strength = np.array([-np.log10(max(c["p_value"], LAYOUT.smallest_p_drawn)) for c in scored])
    limit = -np.log10(max(threshold, LAYOUT.smallest_p_drawn))
    _bars(axes, [c["effect"] for c in scored], strength, limit, named)
    if strength.max() > LAYOUT.largest_on_linear_axis:
        axes.set_xscale("symlog", linthresh=10.0, linscale=1.5)
        axes.set_xticks(LAYOUT.strength_ticks, [str(tick) for tick in LAYOUT.strength_ticks])
        axes.minorticks_off()
    axes.set_xlim(0, 1.02 * max(strength.max(), 1.5 * limit))
    axes.axvline(limit, color=style.INK, ls=(0, (4, 2)), lw=1.0)
    _bayes_factors(axes, [c["log_bayes_factor"] for c in scored], strength > limit)
    off_scale = " (300: off the scale)" if strength.max() >= 299 else ""
    axes.set_xlabel(f"strength of the evidence: −log₁₀ of the p-value{off_scale}")


def _bars(
    axes: Axes, effects: Sequence[str], strength: np.ndarray, limit: float, named: Sequence[str]
) -> None:
    colors = [
        style.VERMILLION if effect in named else style.BLUE if s > limit else style.PALE
        for effect, s in zip(effects, strength, strict=True)
    ]
    y = np.arange(len(effects))
    hatch = ["////" if effect in named else "" for effect in effects]
    axes.barh(y, strength, color=colors, height=0.66, hatch=hatch, edgecolor="white", lw=0)
    axes.set_yticks(y, [plain(effect) for effect in effects], color=style.INK)


def _bayes_factors(axes: Axes, log_factors: Sequence[float], significant: np.ndarray) -> None:
    """The log Bayes factors, as a column of numbers to the right of the bars."""
    right = axes.get_yaxis_transform()
    for i, log_factor in enumerate(log_factors):
        color = style.INK if significant[i] else style.MUTED
        style.note(axes, 1.02, i, tenths(log_factor), transform=right, fontsize=8, color=color)
    head, above = "log Bayes factor\n(first order)", len(log_factors) - 0.2
    style.note(axes, 1.02, above, head, transform=right, fontsize=8, va="bottom")


@style.styled
def draw_misfit_by_step(steps: Sequence[Mapping[str, Any]]) -> Figure:
    """Reduced chi^2 by channel, and of slews held out of the fit, after each step."""
    stages = ["base", *(f"+ {plain(step['added'])}" for step in steps)]
    figure, (place,) = style.grid(3.2, 1, 1, left=0.9, right=2.2, top=0.35, bottom=0.55)
    axes = figure.add_axes(place)
    axes.axhline(1.0, color=style.MUTED, lw=0.9)
    lines = _misfit_lines(steps)
    for k, (label, values, color, marker, dash) in enumerate(lines):
        x = np.arange(len(stages)) + 0.015 * (k - 2)
        drawn = [np.nan if value is None else value for value in values]
        axes.plot(x, drawn, marker=marker, ms=6, color=color, ls=dash, label=label)
    known = [value for _, values, *_ in lines for value in values if value is not None]
    axes.set_yscale("log")
    axes.set_ylim(min(0.7, 0.9 * min(known)), 1.35 * max(*known, 1.5))
    axes.set_xlim(-0.3, len(stages) - 0.7)
    axes.set_xticks(range(len(stages)), stages)
    low, high = axes.get_ylim()
    ticks = [tick for tick in LAYOUT.misfit_ticks if low <= tick <= high]
    axes.set_yticks(ticks, [brief(tick, 4) for tick in ticks])
    axes.minorticks_off()
    axes.set_ylabel("reduced χ²")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _misfit_lines(steps: Sequence[Mapping[str, Any]]) -> list[tuple[str, list, str, str, Any]]:
    """Label, reduced chi^2 of every stage, colour, marker and dashes of each line."""
    lines: list[tuple[str, list, str, str, Any]] = []
    for i, channel in enumerate(steps[0]["reduced_chi2_before"]):
        values = [steps[0]["reduced_chi2_before"][channel]]
        values += [step["reduced_chi2_after"][channel] for step in steps]
        if values[0] is not None:
            lines.append((channel_name(channel), values, style.color(i), style.MARKERS[i % 6], "-"))
    held_out = [steps[0]["held_out_before"], *(step["held_out_after"] for step in steps)]
    if held_out[0] is not None:
        lines.append(("slews left out of the fit", held_out, style.INK, "X", (0, (4, 2))))
    return lines


@style.styled
def draw_shifts(steps: Sequence[Mapping[str, Any]]) -> Figure:
    """J and K before and after the effects were added, as differences from the last value."""
    first, last = steps[0]["shift"], steps[-1]["shift"]
    rows = -(-len(last) // 3)
    figure, places = style.grid(
        0.33 + 1.19 * rows, rows, 3, left=0.35, right=0.2, top=0.45, gap_x=0.35, gap_y=0.62
    )
    for place, name in zip(places, last, strict=False):
        _shift_panel(figure.add_axes(place), name, first[name], last[name])
    handles = [
        style.mark("base model ± sd", style.MUTED, "s", ls="-"),
        style.mark("with the effects added ± sd", style.BLUE, "o", ls="-"),
    ]
    style.legend(figure, handles)
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


@style.styled
def draw_signal(signal: Mapping[str, Any], *, whole_band: bool = False) -> Figure:
    """A signal over time with its band of two sd, one panel a slew.

    `whole_band`: whether most of the band must be seen. Otherwise the signal alone decides the
    scale: where nothing pins it down its band is wide. Returns: at most nine panels: the slews with
    most power.
    """
    time, mean, sd = (np.array(signal[key], float) for key in ("time", "mean", "sd"))
    power = np.sqrt(np.mean(mean**2, axis=(1, 2)))
    chosen = sorted(np.argsort(-power, kind="stable")[: LAYOUT.most_slews_drawn].tolist())
    band = float(np.quantile(2.0 * sd, 0.9) if whole_band else np.median(sd))
    top = 1.25 * max(float(np.abs(mean).max()), band)
    scale = style.scale(signal["source"], signal["unit"], 0.0, top)
    names = [signal["slews"][s] for s in chosen]
    figure, panels, columns = style.slew_panels(
        names, 0.75, 1.75, left=0.85, top=0.7, gap_x=0.35, gap_y=0.55
    )
    for k, (axes, s) in enumerate(zip(panels, chosen, strict=True)):
        axes.axhline(0.0, color=style.PALE, lw=0.8, zorder=0)
        for i in range(mean.shape[-1]):
            low, high = mean[s, :, i] - 2.0 * sd[s, :, i], mean[s, :, i] + 2.0 * sd[s, :, i]
            axes.fill_between(
                time[s], scale(low), scale(high), color=style.color(i), alpha=0.18, lw=0
            )
            axes.plot(time[s], scale(mean[s, :, i]), **style.line(i), lw=1.2)
        axes.set(ylim=(-top / scale.factor, top / scale.factor), xlim=(time[s][0], time[s][-1]))
        axes.tick_params(labelleft=k % columns == 0)
    for axes in panels[::columns]:
        axes.set_ylabel(scale.label)
    handles = [*style.component_lines(signal["components"]), Patch(fc=style.PALE, label="±2 sd")]
    style.legend(figure, handles)
    return figure
