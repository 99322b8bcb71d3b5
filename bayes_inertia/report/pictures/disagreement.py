"""Map of mean residuals in short stretches of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

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
    rows, columns = style.grid_shape(len(chosen))
    components = [name for part in cells["channels"].values() for name in part["components"]]
    height = 0.5 + 0.19 * len(components)
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
        axes.set_yticks(np.arange(len(components)))
        axes.set_yticklabels(components if k % columns == 0 else [])
        axes.tick_params(length=0, axis="y")
        if k >= len(chosen) - columns:
            axes.set_xlabel("time in slew [s]")
    _map_legend(figure)
    return figure


def most_disagreeing_slews(
    cells: Mapping[str, Any], windows: Sequence[Mapping[str, Any]]
) -> list[int]:
    """At most nine slews: those with the most significant windows.

    Examples
    --------
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
        axes.pcolormesh(
            edges,
            np.arange(row, row + len(shift) + 1) - 0.5,
            shift,
            cmap=_COLORS,
            vmin=-LAYOUT.color_limit_sigma,
            vmax=LAYOUT.color_limit_sigma,
            rasterized=True,
        )
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
    axes.add_patch(
        Rectangle(
            (begin, first - 0.42),
            max(window["t_end"] - begin, narrowest),
            n - 0.16,
            fill=False,
            ec=style.INK,
            lw=1.3,
            zorder=5,
        )
    )


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
