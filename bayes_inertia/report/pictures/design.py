"""Plans side by side: sds expected and achieved, the slews themselves, and what they cost."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_inertia.design.comparison import Contender
from bayes_inertia.physics.parameters import base_names
from bayes_inertia.report.formatting import plain, sd_column, unit_text
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures import style


@style.styled
def draw_comparison(contenders: Sequence[Contender]) -> Figure:
    """Plans side by side: what they give above, what they cost below.

    Above: sd of every parameter, expected (bar) and achieved in simulated campaigns (mark with
    2 sd of Monte Carlo error). Below: each plan's slews, and the momentum and torque it uses.
    """
    n, colors = len(contenders), _colors(contenders)
    figure = Figure(figsize=(style.WIDTH, 5.0 + 0.28 * n), layout="constrained")
    top, bottom = figure.subfigures(2, 1, squeeze=False, height_ratios=(3.0, 1.5 + 0.28 * n))[:, 0]
    left, right = top.subplots(1, 2, width_ratios=(2.0, 1.0))
    _sds(left, contenders, range(6), "J, 1 sd", "kg m^2")
    numbers = len(contenders[0].expected)
    if numbers > 6:
        _sds(right, contenders, range(6, numbers), "K, 1 sd", "")
    else:
        right.set_axis_off()
    top.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=min(n, 3))
    slews, costs = bottom.subplots(1, 2, width_ratios=(2.0, 1.0), sharey=True)
    _slews(slews, contenders, colors)
    _costs(costs, contenders, colors)
    return figure


def _colors(contenders: Sequence[Contender]) -> list[str]:
    """One colour a plan, in every picture: grey for slews like the paper's."""
    others = [c.name for c in contenders if not c.is_reference]
    return [
        style.MUTED if c.is_reference else style.color(others.index(c.name)) for c in contenders
    ]


def _sds(axes: Axes, contenders: Sequence[Contender], which: range, label: str, unit: str) -> None:
    x = np.arange(len(which))
    width, chosen = 0.7 / len(contenders), list(which)
    power, _ = sd_column([float(sd) for c in contenders for sd in c.expected[chosen]])
    for k, (contender, color) in enumerate(zip(contenders, _colors(contenders), strict=True)):
        places = x + (k - 0.5 * (len(contenders) - 1)) * width
        achieved = contender.achieved
        name = plain(contender.name)
        height = contender.expected[chosen] / 10.0**power
        alpha = 0.35 if achieved else 0.9
        axes.bar(places, height, 0.85 * width, color=color, alpha=alpha, label=name)
        if achieved:
            sd, error = (x[chosen] / 10.0**power for x in (achieved.sd, achieved.sd_error))
            mark = style.MARKERS[k % 6]
            error = 2.0 * error
            axes.errorbar(places, sd, error, fmt=mark, ms=4.0, color=color, capsize=2.0, lw=1.0)
    label = f"{label} [{unit_text(unit, power)}]"
    names = base_names(len(contenders[0].expected))
    axes.set(xticks=x, xticklabels=[names[i] for i in which], ylabel=label, ylim=(0.0, None))
    if any(c.achieved for c in contenders) and which.start == 0:
        axes.set_title("bars: expected; marks: simulated campaigns (± 2 standard errors)")


def _slews(axes: Axes, contenders: Sequence[Contender], colors: Sequence[str]) -> None:
    """Each slew as a bar from its start to its end, as long as it lasts, with its angle."""
    for y, contender in enumerate(contenders):
        plan = contender.plan
        for slew, start in zip(plan.slews, plan.starts, strict=True):
            begin = (start + plan.rest_before) / 60.0
            axes.barh(y, slew.motion_time / 60.0, left=begin, height=0.5, color=colors[y])
            turn = f"{np.degrees(slew.angle):.0f}° {_axis(slew.axis_B)}"
            style.note(axes, begin, y - 0.3, turn, fontsize=7.0, va="bottom")
        axes.plot([0.0, contender.total_time / 60.0], [y, y], color=style.PALE, lw=1.0, zorder=0)
    axes.set(
        yticks=range(len(contenders)),
        yticklabels=[textwrap.fill(plain(c.name), LAYOUT.plan_label_width) for c in contenders],
        ylim=(len(contenders) - 0.4, -0.7),
        xlabel="time [min]",
    )
    axes.set_title("slews: angle, and body axes that they turn about")


def _axis(axis_B: Sequence[float]) -> str:
    """The body axes that an axis is nearest to.

    >>> _axis((0.0, -1.0, 0.0)), _axis((0.6, 0.1, -0.79))
    ('−y', '+x−z')
    """
    return "".join(
        f"{'+' if x > 0.0 else '−'}{name}"
        for x, name in zip(axis_B, "xyz", strict=True)
        if abs(x) > 0.4
    )


def _costs(axes: Axes, contenders: Sequence[Contender], colors: Sequence[str]) -> None:
    """Share used of each limit: wheel momentum and torque, reach of what flies in their place."""
    for y, contender in enumerate(contenders):
        shares: dict[str, float] = {}
        for m in contender.margins:
            key = m.limit.partition(" of ")[0]
            if key in ("momentum", "torque", "reach"):
                shares[key] = max(shares.get(key, 0.0), 100.0 * m.used / m.allowed)
        for k, key in enumerate(sorted(shares)):
            place, alpha = y + 0.32 * (k - 0.5 * (len(shares) - 1)), 0.5 if key == "torque" else 1.0
            axes.barh(place, shares[key], height=0.28, color=colors[y], alpha=alpha)
            beside = min(shares[key], 100.0) + 1.5  # within the axes however long the bar
            text = style.note(axes, beside, place, f"{key} {shares[key]:.0f} %")
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5})
    axes.axvline(100.0, color=style.MUTED, ls=(0, (4, 2)), zorder=0)
    axes.set(xlim=(0.0, 150.0), xlabel="largest use of a limit [%]")
