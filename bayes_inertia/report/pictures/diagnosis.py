"""Pictures of a diagnosis, drawn from the content of diagnosis.json."""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from bayes_inertia.report.pictures import style

CHANNEL_NAMES = {
    "rate": "rate sensor",
    "attitude": "star tracker",
    "momentum": "wheels",
    "total": "all",
}
_LIMIT = 6.0  # sigma at which colours saturate
_MOST_SLEWS = 9
_MOST_FRAMES = 2  # in one channel and slew
# Blue and vermillion differ in hue and lightness for every reader; white is "as expected".
_COLORS = LinearSegmentedColormap.from_list("residual", [style.BLUE, "#ffffff", style.VERMILLION])


@style.styled
def disagreement_map(
    cells: Mapping[str, Any], windows: Sequence[Mapping[str, Any]], starts: Mapping[str, float]
) -> Figure:
    """Mean residuals in short bins, one panel a slew, one row a component; significant windows framed.

    Parameters
    ----------
    cells : `pictures.before` or `pictures.after` of a diagnosis. windows : its `disagreement`. starts : its `slew_start`.
    """
    windows = [
        dict(w) | {key: w[key] - starts.get(w["slew"], 0.0) for key in ("t_start", "t_end")}
        for w in windows
    ]
    chosen = worst_slews(cells, windows)
    columns = 1 if len(chosen) == 1 else 2 if len(chosen) <= 4 else 3
    rows = -(-len(chosen) // columns)
    labels = [
        (channel, component)
        for channel, part in cells["channels"].items()
        for component in part["components"]
    ]
    height = 0.5 + 0.19 * len(labels)
    figure, places = style.grid(
        1.05 + rows * (height + 0.35),
        rows,
        columns,
        left=1.2,
        right=0.15,
        top=0.75,
        gap_x=0.25,
        gap_y=0.55,
    )
    for k, s in enumerate(chosen):
        axes = figure.add_axes(places[k])
        _map_panel(axes, cells, windows, s)
        axes.set_title(cells["slews"][s])
        axes.set_yticks(np.arange(len(labels)))
        axes.set_yticklabels([c for _, c in labels] if k % columns == 0 else [])
        axes.tick_params(length=0, axis="y")
        if k >= len(chosen) - columns:
            axes.set_xlabel("time in slew [s]")
    _map_legend(figure)
    return figure


def worst_slews(cells: Mapping[str, Any], windows: Sequence[Mapping[str, Any]]) -> list[int]:
    """At most nine slews, in flown order: those with the most significant windows.

    >>> worst_slews({"slews": ["a", "b"]}, [])
    [0, 1]
    """
    score = {
        name: max([w["score"] for w in windows if w["slew"] == name], default=0.0)
        for name in cells["slews"]
    }
    order = sorted(range(len(cells["slews"])), key=lambda s: -score[cells["slews"][s]])
    return sorted(order[:_MOST_SLEWS])


def _map_panel(
    axes: Axes, cells: Mapping[str, Any], windows: Sequence[Mapping[str, Any]], s: int
) -> None:
    row, first = 0, {}
    for channel, part in cells["channels"].items():
        shift = np.array(part["shift"][s], float)
        first[channel] = (row, len(shift))
        edges = np.array(part["edges"][s], float)
        axes.pcolormesh(
            edges,
            np.arange(row, row + len(shift) + 1) - 0.5,
            shift,
            cmap=_COLORS,
            vmin=-_LIMIT,
            vmax=_LIMIT,
            rasterized=True,
        )
        if row:
            axes.axhline(row - 0.5, color=style.MUTED, lw=0.8)
        row += len(shift)
    least = 0.008 * (edges[-1] - edges[0])
    for channel, (below, n) in first.items():
        # Where nearly everything disagrees, frames side by side would only hide it.
        for w in [w for w in windows if w["slew"] == cells["slews"][s] and w["channel"] == channel][
            :_MOST_FRAMES
        ]:
            begin = min(w["t_start"], edges[-1] - least)
            axes.add_patch(
                Rectangle(
                    (begin, below - 0.42),
                    max(w["t_end"] - begin, least),
                    n - 0.16,
                    fill=False,
                    ec=style.INK,
                    lw=1.3,
                    zorder=5,
                )
            )
    axes.set(ylim=(row - 0.5, -0.5), xlim=(edges[0], edges[-1]), facecolor="#f0f0f0")


def _map_legend(figure: Figure) -> None:
    handles = [
        Patch(
            fc=_COLORS(0.5 + 0.5 * level / _LIMIT),
            ec=style.PALE,
            lw=0.5,
            label=f"{level:+d} σ".replace("-", "−").replace("+0", "0"),
        )
        for level in (-6, -3, 0, 3, 6)
    ]
    handles += [
        Patch(fc="#f0f0f0", ec=style.PALE, label="not measured"),
        Patch(fc="none", ec=style.INK, lw=1.2, label="noise does not explain this (p < 0.05)"),
    ]
    figure.legend(
        handles=handles,
        loc="upper left",
        ncols=7,
        bbox_to_anchor=(0.01, 1.0),
        columnspacing=1.2,
        title="mean of measured − predicted",
        title_fontsize=8.5,
        alignment="left",
    )


@style.styled
def ranking(
    candidates: Sequence[Mapping[str, Any]], threshold: float, named: Sequence[str]
) -> Figure | None:
    """How strongly the residuals of the base fit speak for each candidate: −log10 p, with the line of significance."""
    scored = [c for c in candidates if c["p_value"] is not None and c["dof"]]
    if not scored:
        return None
    scored = sorted(scored, key=lambda c: (-c["p_value"], c["log_bayes_factor"]))
    strength = np.array([-np.log10(max(c["p_value"], 1e-300)) for c in scored])
    limit = -np.log10(max(threshold, 1e-300))
    figure, (place,) = style.grid(0.9 + 0.23 * len(scored), 1, 1, left=2.3, right=1.9, top=0.4)
    axes = figure.add_axes(place)
    colors = [
        style.VERMILLION if c["effect"] in named else style.BLUE if s > limit else style.PALE
        for c, s in zip(scored, strength, strict=True)
    ]
    axes.barh(
        np.arange(len(scored)),
        strength,
        color=colors,
        height=0.66,
        hatch=["////" if c["effect"] in named else "" for c in scored],
        edgecolor="white",
        lw=0,
    )
    axes.set_yticks(np.arange(len(scored)))
    axes.set_yticklabels([c["effect"].replace("_", " ") for c in scored], color=style.INK)
    if strength.max() > 40:
        axes.set_xscale("symlog", linthresh=10.0, linscale=1.5)
        axes.set_xticks([0, 2, 5, 10, 30, 100, 300], ["0", "2", "5", "10", "30", "100", "300"])
        axes.minorticks_off()
    axes.set_xlim(0, 1.02 * max(strength.max(), 1.5 * limit))
    axes.axvline(limit, color=style.INK, ls=(0, (4, 2)), lw=1.0)
    right = axes.get_yaxis_transform()
    for i, c in enumerate(scored):
        axes.text(
            1.02,
            i,
            style.tenths(c["log_bayes_factor"]),
            transform=right,
            va="center",
            fontsize=8,
            color=style.INK if strength[i] > limit else style.MUTED,
        )
    axes.text(
        1.02,
        len(scored) - 0.2,
        "log Bayes factor\n(first order)",
        transform=right,
        va="bottom",
        fontsize=8,
        color=style.MUTED,
    )
    axes.set_xlabel(
        "strength of the evidence: −log₁₀ of the p-value"
        + (" (300: off the scale)" if strength.max() >= 299 else "")
    )
    handles = [
        Patch(fc=style.VERMILLION, hatch="////", ec="white", label="named"),
        Patch(fc=style.BLUE, label="significant by itself, before anything was added"),
        Line2D([], [], color=style.INK, ls=(0, (4, 2)), lw=1.0, label="significance"),
    ]
    figure.legend(handles=handles, loc="upper left", ncols=3, bbox_to_anchor=(0.01, 1.0))
    return figure


@style.styled
def gap(steps: Sequence[Mapping[str, Any]]) -> Figure | None:
    """Reduced chi^2 by channel, and of slews held out of the fit, from the base model to the last effect added; None without steps."""
    if not steps:
        return None
    stages = ["base", *(f"+ {s['added'].replace('_', ' ')}" for s in steps)]
    figure, (place,) = style.grid(3.2, 1, 1, left=0.9, right=2.2, top=0.35, bottom=0.55)
    axes = figure.add_axes(place)
    axes.axhline(1.0, color=style.MUTED, lw=0.9)
    lines = []
    for i, channel in enumerate(("rate", "attitude", "momentum", "total")):
        values = [
            steps[0]["reduced_chi2_before"][channel],
            *(s["reduced_chi2_after"][channel] for s in steps),
        ]
        if values[0] is not None:
            lines.append(
                (
                    CHANNEL_NAMES[channel] if channel != "total" else "all channels",
                    values,
                    style.color(i),
                    style.MARKERS[i],
                    "-",
                )
            )
    held = [steps[0]["held_out_before"], *(s["held_out_after"] for s in steps)]
    if held[0] is not None:
        lines.append(("slews left out of the fit", held, style.INK, "X", (0, (4, 2))))
    for k, (label, values, color, marker, dash) in enumerate(lines):
        x = np.arange(len(stages)) + 0.015 * (k - 2)
        axes.plot(
            x,
            [np.nan if v is None else v for v in values],
            marker=marker,
            ms=6,
            color=color,
            ls=dash,
            label=label,
        )
    axes.set_yscale("log")
    top = max(v for _, values, *_ in lines for v in values if v is not None)
    low = min(v for _, values, *_ in lines for v in values if v is not None)
    axes.set_ylim(min(0.7, 0.9 * low), 1.35 * max(top, 1.5))
    axes.set_xlim(-0.3, len(stages) - 0.7)
    axes.set_xticks(range(len(stages)), stages)
    ticks = [
        t
        for t in (0.5, 1, 2, 5, 10, 30, 100, 300, 1000, 1e4, 1e5, 1e6)
        if axes.get_ylim()[0] <= t <= axes.get_ylim()[1]
    ]
    axes.set_yticks(ticks, [f"{t:,.4g}" if t < 1e4 else f"{t:.0e}" for t in ticks])
    axes.minorticks_off()
    axes.set_ylabel("reduced χ²")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


@style.styled
def shifts(steps: Sequence[Mapping[str, Any]]) -> Figure | None:
    """J and K before and after the effects were added, each with its sd, as differences from the last value; None without steps."""
    if not steps:
        return None
    first, last = steps[0]["shift"], steps[-1]["shift"]
    figure, places = style.grid(
        3.9, 3, 3, left=0.35, right=0.2, top=0.45, bottom=0.5, gap_x=0.35, gap_y=0.62
    )
    for place, name in zip(places, last, strict=True):
        axes = figure.add_axes(place)
        before, after = first[name], last[name]
        center = after["after"]
        ends = [
            before["before"] - center - before["sd_before"],
            before["before"] - center + before["sd_before"],
            after["sd_after"],
            -after["sd_after"],
        ]
        half = 1.15 * max(abs(e) for e in ends)
        scale = style.scale(name, after["unit"], 0.0, half)
        axes.axvline(0.0, color=style.PALE, lw=0.8)
        axes.errorbar(
            scale(before["before"] - center),
            1,
            xerr=before["sd_before"] / scale.factor,
            fmt="s",
            color=style.MUTED,
            ms=5,
            capsize=3,
        )
        axes.errorbar(
            0.0,
            0,
            xerr=after["sd_after"] / scale.factor,
            fmt="o",
            color=style.BLUE,
            ms=5,
            capsize=3,
        )
        axes.set(ylim=(-0.7, 1.7), xlim=(-half / scale.factor, half / scale.factor))
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.set_xlabel(
            scale.label.replace(name, f"{name} {'−' if center >= 0 else '+'} {abs(center):.5g}"),
            labelpad=1,
        )
    handles = [
        Line2D([], [], marker="s", color=style.MUTED, ls="-", label="base model ± sd"),
        Line2D([], [], marker="o", color=style.BLUE, ls="-", label="with the effects added ± sd"),
    ]
    figure.legend(handles=handles, loc="upper left", ncols=2, bbox_to_anchor=(0.01, 1.0))
    return figure


@style.styled
def torque(found: Mapping[str, Any]) -> Figure:
    """A signal over time with its band of two sd, one panel a slew.

    Parameters
    ----------
    found : `pictures.torque` or `pictures.other` of a diagnosis.
    """
    time, mean, sd = (np.array(found[key], float) for key in ("time", "mean", "sd"))
    power = np.sqrt(np.mean(mean**2, axis=(1, 2)))
    chosen = sorted(np.argsort(-power, kind="stable")[:_MOST_SLEWS].tolist())
    columns = 1 if len(chosen) == 1 else 2 if len(chosen) <= 4 else 3
    rows = -(-len(chosen) // columns)
    figure, places = style.grid(
        0.75 + 1.75 * rows, rows, columns, left=0.85, top=0.7, gap_x=0.35, gap_y=0.55
    )
    # Where nothing pins it down the band is wide: the signal decides the scale, not the band.
    top = 1.25 * max(float(np.abs(mean).max()), float(np.median(sd)))
    scale = style.scale(found["source"], found["unit"], 0.0, top)
    for k, s in enumerate(chosen):
        axes = figure.add_axes(places[k])
        axes.axhline(0.0, color=style.PALE, lw=0.8, zorder=0)
        for i in range(mean.shape[-1]):
            low, high = mean[s, :, i] - 2.0 * sd[s, :, i], mean[s, :, i] + 2.0 * sd[s, :, i]
            axes.fill_between(
                time[s], scale(low), scale(high), color=style.color(i), alpha=0.18, lw=0
            )
            axes.plot(
                time[s], scale(mean[s, :, i]), color=style.color(i), ls=style.DASHES[i % 6], lw=1.2
            )
        axes.set(ylim=(-top / scale.factor, top / scale.factor), xlim=(time[s][0], time[s][-1]))
        axes.set_title(found["slews"][s])
        if k % columns == 0:
            axes.set_ylabel(scale.label)
        else:
            axes.tick_params(labelleft=False)
        if k >= len(chosen) - columns:
            axes.set_xlabel("time in slew [s]")
    handles = [
        Line2D([], [], color=style.color(i), ls=style.DASHES[i % 6], label=c)
        for i, c in enumerate(found["components"])
    ]
    handles.append(Patch(fc=style.PALE, label="±2 sd"))
    figure.legend(handles=handles, loc="upper left", ncols=7, bbox_to_anchor=(0.01, 1.0))
    return figure
