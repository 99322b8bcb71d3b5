"""The signal that would explain what no candidate does, over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayes_inertia.report.pictures import style

_MOST_SLEWS = 9


@style.styled
def draw_signal(signal: Mapping[str, Any], *, whole_band: bool = False) -> Figure:
    """A signal over time with its band of two sd, one panel a slew.

    `whole_band`: whether most of the band must be seen. Otherwise the signal alone decides the
    scale: where nothing pins it down its band is wide. Returns: at most nine panels: the slews with
    most power.
    """
    time, mean, sd = (np.array(signal[key], float) for key in ("time", "mean", "sd"))
    power = np.sqrt(np.mean(mean**2, axis=(1, 2)))
    chosen = sorted(np.argsort(-power, kind="stable")[:_MOST_SLEWS].tolist())
    rows, columns = style.grid_shape(len(chosen))
    figure, places = style.grid(
        0.75 + 1.75 * rows, rows, columns, left=0.85, top=0.7, gap_x=0.35, gap_y=0.55
    )
    band = float(np.quantile(2.0 * sd, 0.9) if whole_band else np.median(sd))
    top = 1.25 * max(float(np.abs(mean).max()), band)
    scale = style.scale(signal["source"], signal["unit"], 0.0, top)
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
        axes.set_title(signal["slews"][s])
        if k % columns == 0:
            axes.set_ylabel(scale.label)
        else:
            axes.tick_params(labelleft=False)
        if k >= len(chosen) - columns:
            axes.set_xlabel("time in slew [s]")
    handles: list[Artist] = [
        Line2D([], [], color=style.color(i), ls=style.DASHES[i % 6], label=c)
        for i, c in enumerate(signal["components"])
    ]
    handles.append(Patch(fc=style.PALE, label="±2 sd"))
    figure.legend(handles=handles, loc="upper left", ncols=7, bbox_to_anchor=(0.01, 1.0))
    return figure
