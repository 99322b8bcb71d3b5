"""The picture of a cut log: rates over time, slews shaded, what was left out and why."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from bayes_inertia.faults.motion_scan import MotionScan
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.slew_cutting import SlewCut

_SLEW, _DROPPED, _LINE = "#2a78d6", "#c2541b", "#4d4d4d"


def cut_picture(cut: SlewCut, clock: str) -> str:
    """Draw how a log was cut into slews."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator, StrMethodFormatter

    scan = cut.scan
    assert scan is not None
    settings: Any = {"svg.hashsalt": "bayes-inertia", "svg.fonttype": "none", "font.size": 9}
    with mpl.rc_context(settings):
        figure = Figure(figsize=LIMITS.picture_size)
        FigureCanvasSVG(figure)
        axes = figure.add_axes(LIMITS.picture_axes)
        _shade(axes, cut)
        time, speed = _thinned(scan)
        axes.plot(time, speed, color=_LINE, linewidth=0.8)
        for value, name in ((scan.high, "a slew begins above"), (scan.low, "and lasts above")):
            level = np.degrees(value)
            axes.axhline(level, color=_DROPPED, linewidth=0.8, linestyle="--")
            text, at, mixed = f"{name} {level:.2g} deg/s", (0.005, level), ("axes fraction", "data")
            axes.annotate(text, at, xycoords=mixed, va="bottom", color=_DROPPED, fontsize=8)
        axes.set_yscale("log")
        # Powers of ten as formulas, and marks between them, take longer than all the rest.
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.set_ylim(bottom=LIMITS.bottom_of_axis * np.degrees(scan.low))
        axes.set_xlabel(f"time since {clock} [s]")
        axes.set_ylabel("rate [deg/s], smoothed, less the rate at rest")
        axes.set_title(f"{len(cut.windows)} slews; left out: {_reasons(cut)}", fontsize=9)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def _shade(axes: Any, cut: SlewCut) -> None:
    """Slews as bands with their names, dropped motions hatched with their reasons."""
    assert cut.scan is not None
    mixed = ("data", "axes fraction")
    for window in cut.windows:
        axes.axvspan(window.start, window.end, color=_SLEW, alpha=0.18, linewidth=0)
        at = (0.5 * (window.start + window.end), LIMITS.label_height)
        axes.annotate(window.name, at, xycoords=mixed, ha="center", va="top", fontsize=8)
    edges = {float(edge) for motion in cut.scan.motions for edge in motion}
    upright: dict[str, Any] = {"rotation": 90, "ha": "center", "va": "center", "fontsize": 7}
    for part in cut.dropped:
        if part.start in edges and part.end in edges:  # Others are parts of a rest.
            axes.axvspan(part.start, part.end, facecolor="none", edgecolor=_DROPPED, hatch="///")
            at = (0.5 * (part.start + part.end), 0.5)
            axes.annotate(part.reason, at, xycoords=mixed, color=_DROPPED, **upright)


def _reasons(cut: SlewCut) -> str:
    """Seconds left out for each reason."""
    seconds: dict[str, float] = {}
    for part in cut.dropped:
        seconds[part.reason] = seconds.get(part.reason, 0.0) + part.end - part.start
    return "; ".join(f"{total:.0f} s, {reason}" for reason, total in seconds.items()) or "nothing"


def _thinned(scan: MotionScan) -> tuple[np.ndarray, np.ndarray]:
    """Few enough points to draw, the peaks among them; pauses break the line."""
    width = max(1, len(scan.time) // LIMITS.most_points_drawn)
    times: list[np.ndarray] = []
    speeds: list[np.ndarray] = []
    pause = np.array([np.nan])
    for k in np.unique(scan.segment):
        rows = np.flatnonzero(scan.segment == k)
        starts = np.arange(0, len(rows), width)
        times += [scan.time[rows[starts]], pause]
        speeds += [np.maximum.reduceat(scan.speed[rows], starts), pause]
    return np.concatenate(times), np.degrees(np.concatenate(speeds))
