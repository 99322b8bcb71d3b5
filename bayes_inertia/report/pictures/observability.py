"""Information on each parameter: what is lost to which others, and when it comes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bayes_inertia.observability.result import InformationArrival, Observability, in_windows
from bayes_inertia.report.formatting import brief
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style

_PRODUCTS_OF_INERTIA = ("Jxy", "Jxz", "Jyz")
_COLORS = {
    "determined": style.BLUE,
    "partly": style.SKY,
    "weakly": style.ORANGE,
    "prior": style.VERMILLION,
}


@style.styled
def draw_observability(observability: Observability) -> Figure:
    """Prior to posterior, what not knowing the others costs, and when information arrives.

    Left: sd over prior sd, a mark where it would be were everything else known. Right: by how
    much each group of unknowns widens the sd. Below: when the information on the cross terms
    arrives, in the slews that tell most of them.
    """
    names = observability.names
    shown = [name for name in _PRODUCTS_OF_INERTIA if name in names] or list(names[:3])
    arrivals = _telling(observability, shown)
    n, slews = len(observability.parameters), len(arrivals)
    bars, below, top, gap = 0.34 * n + 0.3, 2.2, 0.75, 1.15
    height = top + bars + gap + below + 0.55
    figure = Figure(figsize=(style.WIDTH, height))
    place = (height - top - bars) / height
    left = figure.add_axes((0.13, place, 0.36, bars / height))
    sd_panel(left, observability)
    right = figure.add_axes((0.56, place, 0.42, bars / height), sharey=left)
    _inflation(right, observability)
    width = 0.87 / slews
    panels = [
        figure.add_axes((0.11 + s * width, 0.55 / height, 0.86 * width, below / height))
        for s in range(slews)
    ]
    _times(panels, observability, arrivals, shown)
    return figure


def _telling(observability: Observability, shown: list[str]) -> list[InformationArrival]:
    """The slews that tell most of the shown parameters, in the order flown."""
    parts = np.sum([observability[name].share.sum(1) for name in shown], axis=0)
    return [
        observability.arrivals[s]
        for s in sorted(np.argsort(-parts)[: LAYOUT.most_slews_of_information])
    ]


def sd_panel(axes: Axes, observability: Observability) -> None:
    """Draw sd over prior sd of every parameter."""
    y = np.arange(len(observability.parameters))
    sd = np.array([p.sd / p.prior_sd for p in observability.parameters])
    known = np.array([p.conditional_sd / p.prior_sd for p in observability.parameters])
    low = 0.5 * min(known.min(), sd.min())
    colors = [_COLORS[p.verdict] for p in observability.parameters]
    axes.barh(y, sd - low, left=low, height=0.55, color=colors)
    axes.plot(known, y, "|", color=style.INK, ms=10, mew=1.4)
    axes.axvline(1.0, color=style.MUTED, ls=(0, (4, 2)))
    axes.set(
        xscale="log",
        xlim=(low, 1.6),
        yticks=y,
        yticklabels=observability.names,
        ylim=(len(y) - 0.4, -0.6),
        xlabel="sd / prior sd (mark: were all else known)",
    )
    axes.set_title("how far the data narrow the prior", pad=22.0)


def _inflation(axes: Axes, observability: Observability) -> None:
    groups = list(observability.parameters[0].inflation)
    axes.set_title("what fitting the others along costs", pad=22.0)
    for y, p in enumerate(observability.parameters):
        start = 0.0
        for k, group in enumerate(groups):
            length = max(0.0, 0.5 * np.log10(p.inflation[group]))
            color = style.COLORS[k % 6]
            hatch = "///" if k % 2 else None
            axes.barh(
                y, length, left=start, height=0.55, color=color, hatch=hatch, ec="white", lw=0
            )
            start += length
        style.note(axes, start, y, f"  ×{brief(np.sqrt(p.variance_inflation))}")
    axes.tick_params(axis="y", labelleft=False)
    most = max(0.5 * np.log10(max(p.variance_inflation, 1.0)) for p in observability.parameters)
    end = 1.2 * max(most, 0.1)
    axes.set(xlim=(0.0, end), xlabel="the sd is so many times larger for it")
    fine = end < LAYOUT.decades_of_sd_factors
    powers = {np.log10(factor): f"×{factor:g}" for factor in LAYOUT.sd_factors}
    shown = [power for power in powers if power <= end and (fine or power % 1.0 == 0.0)]
    axes.set_xticks(shown, [powers[power] for power in shown])
    handles = [
        Patch(fc=style.COLORS[k % 6], hatch="///" if k % 2 else None, ec="white", label=g)
        for k, g in enumerate(groups)
    ]
    place = (-0.02, 1.0)
    columns = min(len(groups), 4)
    axes.legend(
        handles=handles, loc="lower left", bbox_to_anchor=place, ncols=columns, columnspacing=1.2
    )


def _times(
    panels: list[Axes],
    observability: Observability,
    arrivals: list[InformationArrival],
    shown: list[str],
) -> None:
    highest = 0.0
    for s, (axes, arrival) in enumerate(zip(panels, arrivals, strict=True)):
        edges, precision = in_windows(arrival)
        for k, name in enumerate(shown):
            told = precision[..., observability.names.index(name)].sum(1)
            share = 100.0 * told * observability[name].sd ** 2
            highest = max(highest, float(share.max()))
            axes.stairs(share, edges, **style.line(k), lw=1.2, label=name)
        axes.set(xlabel="time in the slew [s]")
        axes.set_title(arrival.slew)
        axes.locator_params(axis="x", nbins=3)
        if s:
            axes.tick_params(labelleft=False)
    for axes in panels:
        axes.set_ylim(0.0, 1.08 * highest if highest else 1.0)
    panels[0].set_ylabel("share of the information [%]")
    panels[0].legend(loc="upper center", handlelength=1.6)
