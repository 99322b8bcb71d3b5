"""Style of all pictures: colours, sizes, units, decimation.

Colours are safe for colour-blind readers and for grey printing. Nothing here touches matplotlib's
global state for longer than one picture: `styled` wraps a function that makes a `Figure` in an
rc context, and pictures use the object API only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from bayes_inertia.report.formatting import unit_text
from bayes_inertia.report.layout import LAYOUT

# Okabe & Ito (2008), ordered so that neighbours differ in lightness and hue.
BLUE, VERMILLION, GREEN, PURPLE, SKY, ORANGE = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#E69F00",
)
COLORS = (BLUE, VERMILLION, GREEN, PURPLE, SKY, ORANGE)
INK, MUTED, PALE = "#222222", "#6b6b6b", "#d9d9d9"
MARKERS = ("o", "s", "^", "D", "v", "P")
WIDTH, DASHES = LAYOUT.picture_width, LAYOUT.dashes

RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "text.color": INK,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "path.simplify_threshold": 0.3,
    "hatch.linewidth": 0.5,
}


def styled[**P, F: Figure | None](picture: Callable[P, F]) -> Callable[P, F]:
    """Make a picture in the package's style, leaving matplotlib's settings as they were.

    >>> styled(lambda: Figure())().get_facecolor()
    (1.0, 1.0, 1.0, 1.0)
    """

    @wraps(picture)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> F:
        with rc_context(RC):
            return picture(*args, **kwargs)

    return drawn


def color(i: int) -> str:
    """Colour of a component (components repeat after six).

    >>> color(0) == color(6) == BLUE
    True
    """
    return COLORS[i % len(COLORS)]


def line(i: int) -> dict[str, Any]:
    """How the line of a component is drawn."""
    return {"color": color(i), "ls": DASHES[i % 6]}


def dots(i: int) -> dict[str, Any]:
    """How the many dots of a component are drawn."""
    return {"color": color(i), "marker": MARKERS[i % 6], "ls": "", "mew": 0, "rasterized": True}


@dataclass(frozen=True)
class Scale:
    """Scale of an axis: `(value - offset) / factor` is shown."""

    offset: float  # in the unit of the values
    factor: float
    label: str  # of the axis: name, offset, power of ten and unit

    def __call__(self, values: np.ndarray | float) -> np.ndarray:
        """Values as drawn."""
        return (np.asarray(values) - self.offset) / self.factor


def scale(name: str, unit: str, center: float, half_range: float) -> Scale:
    """A scale whose tick labels stay short.

    Values near `center` are shown as differences, tiny ones in powers of ten.

    >>> scale("Jxx", "kg m^2", 3.33117, 1e-3).label
    'Jxx − 3.3312 [× 10⁻³ kg m²]'
    >>> scale("K1", "", 1.0, 0.2).label
    'K1 [–]'
    """
    # Offsets only where plain ticks would need five digits,
    # and not for numbers that a power of ten makes short.
    near = half_range < (0.03 if abs(center) >= 0.05 else 0.003) * abs(center)
    decimals = max(0, 1 - int(np.floor(np.log10(half_range)))) if half_range > 0 else 0
    offset = round(center, decimals) if near else 0.0
    largest = half_range if near else max(abs(center - half_range), abs(center + half_range))
    power = 3 * int(np.floor(np.log10(largest) / 3.0 + 1e-9)) if largest > 0 else 0
    power = 0 if 0.05 <= largest < 1e4 else power
    sign = "−" if offset >= 0 else "+"
    shown = f"{name} {sign} {abs(offset):.{decimals}f}" if near else name
    return Scale(offset, 10.0**power, f"{shown} [{unit_text(unit, power)}]")


def slew_panels(
    slews: Sequence[str], head: float, height: float, **gaps: float
) -> tuple[Figure, list[Axes], int]:
    """A figure with a named panel for each slew, and how many stand in a row.

    `head` of the figure and `height` of a row [in]; `gaps`: see `grid`.
    """
    columns = 1 if len(slews) == 1 else 2 if len(slews) <= 4 else 3
    rows = -(-len(slews) // columns)
    figure, cells = grid(head + height * rows, rows, columns, **gaps)
    panels = [figure.add_axes(cell) for cell in cells[: len(slews)]]
    for k, (axes, name) in enumerate(zip(panels, slews, strict=True)):
        axes.set_title(name)
        if k >= len(slews) - columns:
            axes.set_xlabel("time in slew [s]")
    return figure, panels, columns


def mark(label: str, color: str, marker: str = "", **line: Any) -> Line2D:
    """A line of a legend, or a mark; both with `ls`."""
    return Line2D([], [], color=color, label=label, marker=marker, **{"ls": "", **line})


def component_marks(names: Sequence[str], prefix: str = "") -> list[Artist]:
    """Marks of a legend, one a component."""
    return [mark(f"{prefix}{n}", color(i), MARKERS[i % 6], ms=4) for i, n in enumerate(names)]


def component_lines(names: Sequence[str], prefix: str = "") -> list[Artist]:
    """Lines of a legend, one a component."""
    return [mark(f"{prefix}{n}", **line(i)) for i, n in enumerate(names)]


def legend(figure: Figure, handles: Sequence[Artist], ncols: int = 7, **how: Any) -> None:
    """A legend along the upper edge of a figure."""
    place = {"loc": "upper left", "bbox_to_anchor": (0.01, 1.0)}
    figure.legend(handles=handles, ncols=ncols, **(place | how))


def note(axes: Axes, x: float, y: float, text: str, **how: Any) -> Text:
    """A small text beside what it is about."""
    return axes.text(x, y, text, **{"color": MUTED, "fontsize": 7.5, "va": "center", **how})


def thinned_rows(values: np.ndarray, most: int) -> np.ndarray:
    """Rows to show: evenly spaced ones, and in each stretch the lowest and the highest.

    Extremes alone would leave the middle of noise empty; evenly spaced rows alone would lose
    outliers.

    `values` (rows, components): in any unit; NaN where a component was not measured. Returns
    (kept,): indices in their order, of rows in which something was measured; all of them where
    there are not more.

    >>> values = np.zeros((1000, 1))
    >>> values[[7, 901], 0] = 5.0, -4.0
    >>> rows = thinned_rows(values, 100)
    >>> 7 in rows, 901 in rows, len(rows) <= 100
    (True, True, True)
    """
    measured = np.flatnonzero(np.isfinite(values).any(1))
    if len(measured) <= most:
        return measured
    kept = set(np.linspace(0, len(measured) - 1, max(2, most // 2)).astype(int).tolist())
    stretches = max(1, most // (4 * values.shape[1]))
    edges = np.linspace(0, len(measured), stretches + 1).astype(int)
    for a, b in pairwise(edges):
        stretch = values[measured[a:b]]
        low = np.where(np.isfinite(stretch), stretch, np.inf).argmin(0)
        high = np.where(np.isfinite(stretch), stretch, -np.inf).argmax(0)
        kept.update((a + low).tolist(), (a + high).tolist())
    return measured[sorted(kept)]


def density(
    draws: np.ndarray, low: float, high: float, bins: int = 160
) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed density of draws: a Gaussian kernel (Silverman's width) on a fine histogram.

    `draws` (n,). Returns `x, density` (bins,): middles of the bins, and the density in inverse
    units of the draws.

    >>> x, p = density(np.random.default_rng(0).normal(size=20_000), -4.0, 4.0)
    >>> bool(abs(p.max() - 0.399) < 0.02)
    True
    """
    from scipy.ndimage import gaussian_filter1d

    counts, edges = np.histogram(draws, bins=bins, range=(low, high))
    step = edges[1] - edges[0]
    quartiles = np.subtract(*np.quantile(draws, [0.75, 0.25])) / 1.349
    width = 0.9 * min(draws.std(), quartiles or draws.std()) * len(draws) ** -0.2
    smooth = gaussian_filter1d(counts / (len(draws) * step), width / step, mode="nearest")
    return 0.5 * (edges[1:] + edges[:-1]), smooth


def sigma_guides(axes: Axes, levels: tuple[int, ...] = (1, 2, 3)) -> None:
    """Draw the zero line and dotted lines at whole sigmas, darkest at three."""
    axes.axhline(0.0, color=MUTED, lw=0.6, zorder=0.5)
    for level in levels:
        grey = {1: "#c9c9c9", 2: "#9a9a9a", 3: "#555555"}.get(level, MUTED)
        for sign in (-1, 1):
            axes.axhline(sign * level, color=grey, lw=0.7, ls=(0, (4, 3)), zorder=3)


def sigma_mark() -> Line2D:
    """The line of a legend that explains `sigma_guides`."""
    return mark("±1, 2, 3 σ", "#555555", lw=0.7, ls=(0, (4, 3)))


def symmetric_limit(values: np.ndarray) -> float:
    """Half height of a residual panel in which every value can be seen.

    `values`: of any shape, in sigmas; NaN are left out.

    >>> symmetric_limit(np.array([1.0, -10.0, np.nan]))
    10.8
    """
    finite = np.abs(values[np.isfinite(values)])
    return max(4.2, round(1.08 * float(finite.max(initial=0.0)), 6))


def grid(
    figure_height: float,
    rows: int,
    columns: int,
    *,
    left: float = 0.75,
    right: float = 0.15,
    top: float = 0.45,
    bottom: float = 0.5,
    gap_x: float = 0.55,
    gap_y: float = 0.62,
    width: float = WIDTH,
) -> tuple[Figure, list[tuple[float, float, float, float]]]:
    """A figure and its cells; much faster than a layout engine on many panels.

    `figure_height` and `width` [in]; `left` and `right` and `top` and `bottom` [in]; `gap_x` and
    `gap_y` [in]. Returns `cells`: in figure fractions, row by row from the top.

    >>> figure, cells = grid(4.0, 2, 3)
    >>> len(cells)
    6
    """
    figure = Figure(figsize=(width, figure_height))
    w = (width - left - right - gap_x * (columns - 1)) / columns
    h = (figure_height - top - bottom - gap_y * (rows - 1)) / rows
    cells = [
        (
            (left + c * (w + gap_x)) / width,
            (figure_height - top - (r + 1) * h - r * gap_y) / figure_height,
            w / width,
            h / figure_height,
        )
        for r in range(rows)
        for c in range(columns)
    ]
    return figure, cells
