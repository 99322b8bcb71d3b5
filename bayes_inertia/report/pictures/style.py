"""How every picture looks: colours safe for colour-blind readers and grey printing, sizes, units, decimation.

Nothing here touches matplotlib's global state for longer than one picture: `styled` wraps a function
that makes a `Figure` in an rc context, and pictures use the object API only.
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
# With colours gone, dash pattern and marker still tell components apart.
DASHES = (
    (0, ()),
    (0, (5, 2)),
    (0, (1.5, 1.5)),
    (0, (6, 2, 1.5, 2)),
    (0, (8, 3)),
    (0, (3, 1, 1, 1, 1, 1)),
)
MARKERS = ("o", "s", "^", "D", "v", "P")
WIDTH = 10.0  # [in] of every picture
_LIMIT = 2000

_RC = {
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


def styled[**P](picture: Callable[P, Figure]) -> Callable[P, Figure]:
    """Make a picture in the package's style, leaving matplotlib's settings as they were.

    >>> styled(lambda: Figure())().get_facecolor()
    (1.0, 1.0, 1.0, 1.0)
    """

    @wraps(picture)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with rc_context(_RC):
            return picture(*args, **kwargs)

    return drawn


def tenths(value: float) -> str:
    """A score or log Bayes factor as printed: nobody decides anything by its second decimal.

    >>> tenths(2254.3), tenths(602.94), tenths(-1.0748), tenths(-0.0056)
    ('2,254', '602.9', '−1.1', '0.0')
    """
    text = f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.1f}"
    return "0.0" if text == "-0.0" else text.replace("-", "−")


def color(i: int) -> str:
    """Colour of component i (components repeat after six)."""
    return COLORS[i % len(COLORS)]


def unit_text(unit: str) -> str:
    """A unit as it is printed.

    >>> unit_text("kg m^2"), unit_text("rad/s"), unit_text("")
    ('kg m²', 'rad/s', '')
    """
    return unit.replace("^2", "²").replace("^3", "³")


@dataclass(frozen=True)
class Scale:
    """How values are shown on an axis: `(value - offset) / factor`, labelled `label`."""

    offset: float
    factor: float
    label: str

    def __call__(self, values: np.ndarray | float) -> np.ndarray:
        """Values as drawn."""
        return (np.asarray(values) - self.offset) / self.factor


def scale(name: str, unit: str, center: float, half_range: float) -> Scale:
    """A scale whose tick labels stay short: values near `center` are shown as differences, tiny ones in powers of ten.

    >>> scale("Jxx", "kg m^2", 3.33117, 1e-3).label
    'Jxx − 3.3312 [10⁻³ kg m²]'
    >>> scale("K1", "", 1.0, 0.2).label
    'K1 [–]'
    """
    # Offsets only where plain ticks would need five digits, and not for numbers that a power of ten makes short.
    near = half_range < (0.03 if abs(center) >= 0.05 else 0.003) * abs(center)
    decimals = max(0, 1 - int(np.floor(np.log10(half_range)))) if half_range > 0 else 0
    offset = round(center, decimals) if near else 0.0
    largest = half_range if near else max(abs(center - half_range), abs(center + half_range))
    power = 3 * int(np.floor(np.log10(largest) / 3.0 + 1e-9)) if largest > 0 else 0
    power = 0 if 0.05 <= largest < 1e4 else power
    shown = unit_text(unit)
    factor = f"10{str(power).translate(_SUPERSCRIPT)}" if power else ""
    bracket = " ".join(part for part in (factor, shown) if part) or "–"
    sign = "−" if offset >= 0 else "+"
    label = (
        f"{name} {sign} {abs(offset):.{decimals}f} [{bracket}]" if near else f"{name} [{bracket}]"
    )
    return Scale(offset, 10.0**power, label)


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def envelope(x: np.ndarray, y: np.ndarray, limit: int = _LIMIT) -> tuple[np.ndarray, np.ndarray]:
    """At most about `limit` points that look like the whole line: lowest and highest value of each stretch; NaN dropped.

    >>> x, y = envelope(np.arange(10_000.0), np.zeros(10_000), 100)
    >>> len(x), len(envelope(np.arange(5.0), np.array([0.0, 1.0, np.nan, 2.0, 3.0]))[0])
    (100, 4)
    """
    keep = np.isfinite(x) & np.isfinite(y)
    x, y = np.asarray(x)[keep], np.asarray(y)[keep]
    if len(x) <= limit:
        return x, y
    edges = np.linspace(0, len(x), limit // 2 + 1).astype(int)
    index = []
    for a, b in pairwise(edges):
        low, high = a + int(np.argmin(y[a:b])), a + int(np.argmax(y[a:b]))
        index += sorted((low, high))
    return x[index], y[index]


def density(
    draws: np.ndarray, low: float, high: float, bins: int = 160
) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed density of draws between `low` and `high`: a Gaussian kernel (Silverman's width) on a fine histogram.

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
    """Zero line and dotted lines at whole sigmas, darkest at three."""
    axes.axhline(0.0, color=MUTED, lw=0.6, zorder=0.5)
    for level in levels:
        grey = {1: "#c9c9c9", 2: "#9a9a9a", 3: "#555555"}.get(level, MUTED)
        for sign in (-1, 1):
            axes.axhline(sign * level, color=grey, lw=0.7, ls=(0, (4, 3)), zorder=3)


def symmetric_limit(values: np.ndarray, least: float = 4.2) -> float:
    """Half height of a residual panel: all of it visible, at least `least` sigma.

    >>> symmetric_limit(np.array([1.0, -10.0, np.nan]))
    10.8
    """
    finite = np.abs(values[np.isfinite(values)])
    return max(least, round(1.08 * float(finite.max()), 6)) if finite.size else least


def grid(
    figure_height: float,
    rows: int,
    columns: int,
    *,
    left=0.75,
    right=0.15,
    top=0.45,
    bottom=0.5,
    gap_x=0.55,
    gap_y=0.62,
    width=WIDTH,
):
    """A figure and its cells as rectangles [left, bottom, width, height] in figure fractions, margins and gaps in inches.

    Rows of cells run from top to bottom. Much faster than a layout engine on many panels.
    """
    figure = Figure(figsize=(width, figure_height))
    w = (width - left - right - gap_x * (columns - 1)) / columns
    h = (figure_height - top - bottom - gap_y * (rows - 1)) / rows
    cells = [
        [
            (left + c * (w + gap_x)) / width,
            (figure_height - top - (r + 1) * h - r * gap_y) / figure_height,
            w / width,
            h / figure_height,
        ]
        for r in range(rows)
        for c in range(columns)
    ]
    return figure, cells
