"""Every pair of parameters of a posterior, and each parameter against its prior.

All pairs stand in one axes, so that it is quick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PatchCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from scipy.ndimage import gaussian_filter

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.criteria import sd_in_print, sharpened
from bayes_inertia.report.formatting import common_exponents, number, unit_text, with_minus_sign
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style
from bayes_inertia.report.pictures.posterior_data import values_of


@style.styled
def draw_pairs(posterior: Posterior, max_parameters: int = 16) -> Figure:
    """Draw density and 90 % ellipse of each pair below, correlation above the diagonal."""
    d = min(len(posterior.names), max_parameters)
    size = min(style.WIDTH, 2.6 + 0.72 * d)
    figure = Figure(figsize=(size, size * 0.98))
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.94))
    pairs_panel(axes, posterior, most_correlated(posterior, max_parameters))
    handles = [
        Patch(fc=style.BLUE, alpha=0.5, label="posterior draws"),
        style.mark("90 % (model)", style.BLUE, ls="-"),
    ]
    style.legend(figure, handles, loc="upper right", bbox_to_anchor=None)
    return figure


def pairs_panel(axes: Axes, posterior: Posterior, shown: Sequence[int]) -> None:
    """All pairs of the parameters of these indices in one axes, labels included."""
    # Where nothing ties the size of J, what is told of pairs is told at one size.
    draws = posterior.sized_samples[:, shown]
    names = [posterior.names[i] for i in shown]
    half = LAYOUT.cell_half_width_sd * draws.std(0, ddof=1)
    z = (draws - draws.mean(0)) / half
    d = len(names)
    _densities(axes, z)
    _diagonal(axes, z)
    correlation = np.atleast_2d(np.corrcoef(draws.T))
    _ellipses(axes, correlation)
    _correlations(axes, correlation)
    left, below = _labels(axes, names, _row_labels(posterior, names, draws.mean(0), half))
    axes.set(xlim=(-left, d + 0.02), ylim=(d + below, -0.02), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def most_correlated(posterior: Posterior, max_parameters: int) -> list[int]:
    """Indices of the parameters with the strongest correlations, in their order."""
    d = len(posterior.names)
    if d <= max_parameters:
        return list(range(d))
    strength = np.abs(np.corrcoef(posterior.sized_samples.T) - np.eye(d)).max(0)
    return sorted(np.argsort(-strength, kind="stable")[:max_parameters].tolist())


def _place(z: np.ndarray, cell: int, flip: bool = False) -> np.ndarray:
    """Positions in [-1, 1] of a cell on the picture's axes (rows count downwards: `flip`)."""
    inside = 0.5 * (1.0 - LAYOUT.cell_gap)
    return cell + 0.5 + (-inside if flip else inside) * z


def _densities(axes: Axes, z: np.ndarray) -> None:
    """All 2-D histograms as one image."""
    d = z.shape[1]
    image = np.full((d * LAYOUT.cell_pixels, d * LAYOUT.cell_pixels), np.nan)
    pad = round(0.5 * LAYOUT.cell_gap * LAYOUT.cell_pixels)
    n = LAYOUT.cell_pixels - 2 * pad
    for row in range(d):
        for column in range(row):
            counts = np.histogram2d(z[:, row], z[:, column], bins=n, range=[[-1, 1], [-1, 1]])[0]
            smooth = gaussian_filter(counts, 1.2)[::-1]
            y, x = row * LAYOUT.cell_pixels + pad, column * LAYOUT.cell_pixels + pad
            image[y : y + n, x : x + n] = smooth / smooth.max()
    axes.imshow(
        image,
        extent=(0, d, d, 0),
        cmap=_blues(),
        vmin=0.0,
        vmax=1.0,
        interpolation="nearest",
        aspect="auto",
        zorder=1,
    )
    frames = [_square(row, column) for row in range(d) for column in range(row + 1)]
    axes.add_collection(PatchCollection(frames, fc="none", ec=style.PALE, lw=0.6, zorder=2))


def _blues() -> Colormap:
    return LinearSegmentedColormap.from_list(
        "posterior",
        ["#ffffff", "#cfe3f1", "#7db4d8", "#2f84bd", "#003f66"],
        N=LAYOUT.density_shades,
    ).with_extremes(bad="#ffffff")


def _diagonal(axes: Axes, z: np.ndarray) -> None:
    for i in range(z.shape[1]):
        x, p = style.density(z[:, i], -1.0, 1.0, 80)
        heights = -1.0 + 1.8 * p / p.max()
        axes.fill(_place(x, i), _place(heights, i, flip=True), color=style.BLUE, alpha=0.35, lw=0)
        axes.plot(_place(x, i), _place(heights, i, flip=True), color=style.BLUE, lw=1.0)


def _ellipses(axes: Axes, correlation: np.ndarray) -> None:
    """Ellipses of all pairs that hold 90 % of a bivariate normal distribution."""
    rows, columns = np.tril_indices(len(correlation), -1)
    r = np.clip(correlation[rows, columns], -1.0, 1.0)
    size = np.sqrt(2.0 * np.log(10.0)) * (1.0 - LAYOUT.cell_gap) / LAYOUT.cell_half_width_sd
    ellipses = EllipseCollection(
        size * np.sqrt(1.0 + r),
        size * np.sqrt(1.0 - r),
        np.full(len(r), -45.0),  # rows count downwards
        units="xy",
        offsets=np.column_stack([columns, rows]) + 0.5,
        offset_transform=axes.transData,
        facecolors="none",
        edgecolors=style.BLUE,
        linewidths=1.0,
        zorder=3,
    )
    axes.add_collection(ellipses)


def _correlations(axes: Axes, correlation: np.ndarray) -> None:
    """Numbers in the upper triangle, larger and darker where stronger."""
    d = len(correlation)
    for row in range(d):
        for column in range(row + 1, d):
            r = correlation[row, column]
            strong = abs(r)
            if strong > 0.9:
                axes.add_patch(_square(row, column))
            axes.text(
                column + 0.5,
                row + 0.5,
                with_minus_sign(f"{r:+.2f}"),
                ha="center",
                va="center",
                fontsize=6.5 + 3.0 * strong,
                color=style.INK if strong > 0.3 else "#9a9a9a",
                weight="bold" if strong > 0.9 else "normal",
            )


def _square(row: int, column: int) -> Rectangle:
    return Rectangle(
        (column + 0.5 * LAYOUT.cell_gap, row + 0.5 * LAYOUT.cell_gap),
        1 - LAYOUT.cell_gap,
        1 - LAYOUT.cell_gap,
        fc="#fdf0d5",
        ec=style.ORANGE,
        lw=0.8,
    )


def _row_labels(
    posterior: Posterior, names: list[str], mean: np.ndarray, half: np.ndarray
) -> list[str]:
    """Name and unit of each row, and what its cells span; a kind of parameters shares its unit."""
    units = [str(posterior.tree["posterior"][name].attrs.get("units", "")) for name in names]
    powers = common_exponents(zip(names, units, mean, half, strict=True))
    labels = []
    for name, unit, middle, width in zip(names, units, mean, half, strict=True):
        scale = 10.0 ** powers[name]
        ends = [number(end / scale, width / scale) for end in (middle - width, middle + width)]
        shown = unit_text(unit, powers[name])
        labels.append(f"{_broken(name)} [{shown}]\n{' to '.join(ends)}")
    return labels


def _broken(name: str) -> str:
    return name.replace(".", "\n")


def _labels(axes: Axes, names: list[str], row_labels: list[str]) -> list[float]:
    """Names below; left also the units, and what the cells span.

    Returns: the room [cells] that they take inside the axes, left and below.
    """
    d = len(names)
    place: dict[str, Any] = (
        {"rotation": 45, "ha": "right"} if d > LAYOUT.most_upright_labels else {"ha": "center"}
    )
    small: dict[str, Any] = {"fontsize": 7.5, "clip_on": False}
    left, below = (
        [axes.text(-0.06, -0.04, "name [unit]\nends of the cells", ha="right", **small)],
        [],
    )
    for i, (name, label) in enumerate(zip(names, row_labels, strict=True)):
        left.append(axes.text(-0.06, i + 0.5, label, ha="right", va="center", **small))
        below.append(axes.text(i + 0.5, d + 0.06, _broken(name), va="top", **small, **place))
    width = max(text.get_window_extent().width for text in left) / axes.bbox.width
    height = max(text.get_window_extent().height for text in below) / axes.bbox.height
    return [0.1 + d * share / max(1.0 - share, 0.3) for share in (width, height)]


@style.styled
def draw_priors(posterior: Posterior) -> Figure:
    """Posterior density with its sd (blue) and a wider quoted sd (orange), and the prior.

    Where the data narrow the prior by more than a factor of eight, the panel zooms in on the
    posterior, and a strip above it shows its place (blue mark) inside the prior's +-3 sd range.
    """
    summary = posterior.summary()["parameters"]
    names = posterior.names
    columns = 3 if len(names) <= 12 else 4
    rows = -(-len(names) // columns)
    figure, cells = style.grid(
        0.75 + 1.95 * rows, rows, columns, left=0.25, top=0.5, bottom=0.5, gap_x=0.3, gap_y=0.62
    )
    for name, cell in zip(names, cells, strict=False):
        prior_panel(figure.add_axes(cell), posterior, name, summary[name])
    handles = [
        Patch(fc=style.BLUE, alpha=0.35, ec=style.BLUE, label="posterior"),
        style.mark("prior", style.MUTED, ls=(0, (4, 2))),
        style.mark("mean ± sd (model)", style.BLUE, lw=3, ls="-"),
    ]
    if any(_is_widened(row) for row in summary.values()):
        handles.append(style.mark("mean ± quoted sd", style.ORANGE, "|", lw=3, ms=9, ls="-"))
    style.legend(figure, handles)
    return figure


def prior_panel(axes: Axes, posterior: Posterior, name: str, row: dict) -> None:
    """One parameter: its posterior, its prior, and its row of the summary as bars."""
    i = posterior.names.index(name)
    draws = posterior.averaged_samples[:, i]
    prior = values_of(posterior, "prior", name).ravel()
    prior_mean = float(values_of(posterior, "estimate", "prior_mean")[i])
    mean, prior_sd = row["mean"], row["prior_sd"]
    quoted = sd_in_print(row)
    zoomed = quoted < LAYOUT.zoomed_sd_ratio * prior_sd
    low, high = mean - 4.5 * quoted, mean + 4.5 * quoted
    if not zoomed:
        low, high = min(low, prior_mean - 3.2 * prior_sd), max(high, prior_mean + 3.2 * prior_sd)
    scale = style.scale(name, row["unit"], mean, 0.5 * (high - low))
    x, p = style.density(draws, low, high, LAYOUT.density_bins)
    top = p.max()
    axes.fill(scale(x), p / top, color=style.BLUE, alpha=0.35, lw=0)
    axes.plot(scale(x), p / top, color=style.BLUE)
    if not zoomed:
        x, p = style.density(prior, low, high, LAYOUT.density_bins)
        axes.plot(scale(x), p / top, color=style.MUTED, ls=(0, (4, 2)))
    _bar(axes, scale, mean, row["sd"], style.BLUE, -0.09)
    if _is_widened(row):
        _bar(axes, scale, mean, quoted, style.ORANGE, -0.2, marker="|")
    axes.set(xlim=(scale(low), scale(high)), ylim=(-0.3, 1.75), yticks=[], xlabel=scale.label)
    axes.spines["left"].set_visible(False)
    axes.locator_params(axis="x", nbins=5)
    if zoomed:
        _strip(axes, (mean - prior_mean) / prior_sd)
    gain = _gain_text(sharpened(row))
    style.note(axes, 0.99, 0.74, gain, transform=axes.transAxes, ha="right", va="top")


def _is_widened(row: dict) -> bool:
    """Whether the sd to quote is not the model's."""
    return sd_in_print(row) > row["sd"]


def _bar(
    axes: Axes,
    scale: style.Scale,
    mean: float,
    sd: float,
    color: str,
    height: float,
    marker: str | None = None,
) -> None:
    """Mean and sd as a bar below the density."""
    x, y = scale(np.array([mean - sd, mean + sd])), [height] * 2
    axes.plot(x, y, color=color, lw=3, marker=marker, ms=9, solid_capstyle="butt")
    axes.plot([scale(mean)], [height], marker="o", ms=3.2, color="white", mec=color, mew=0.9)


def _gain_text(gain: float) -> str:
    """Gain over the prior, in words."""
    if gain >= 10:
        return f"{gain:,.0f}× sharper than the prior"
    return f"{gain:.1f}× sharper than the prior" if gain >= 1.05 else "no sharper than the prior"


def _strip(axes: Axes, place: float) -> None:
    """The prior over +-3.2 sd, and the posterior's place in it [prior sd]."""
    z = np.linspace(-3.2, 3.2, 60)
    bottom, top = LAYOUT.prior_strip_height
    x, height = 0.5 + z / 6.4, bottom + (top - bottom) * np.exp(-0.5 * z**2)
    within: dict[str, Any] = {"transform": axes.transAxes}
    axes.fill_between(x, bottom, height, color=style.PALE, lw=0, **within)
    axes.plot(x, height, color=style.MUTED, ls=(0, (4, 2)), lw=0.8, **within)
    mark = 0.5 + np.clip(place, -3.2, 3.2) / 6.4
    axes.plot([mark, mark], [bottom, top], color=style.BLUE, lw=1.6, **within)
    style.note(axes, 0.0, top, "prior\n±3 sd", va="top", fontsize=6.5, **within)
