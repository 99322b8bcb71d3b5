"""The pictures of `paper_tables.py`: pure functions that return a matplotlib `Figure`."""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from analyses.paper.ferguson import ARCSEC, DEG, NAMES, PaperTable
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood import residuals
from bayes_inertia.report.pictures import style

_AXES = ("x", "y", "z")


def _unit(name: str) -> str:
    return "kg m²" if name.startswith("J") else "–"


@style.styled
def posterior(draws: np.ndarray, paper: PaperTable, wls: np.ndarray) -> Figure:
    """Nine densities with truth, initial, the paper's new estimate and ours."""
    figure = Figure(figsize=(style.WIDTH, 6.6), layout="constrained")
    axes = figure.subplots(3, 3)
    for i, (ax, name) in enumerate(zip(axes.ravel(), NAMES, strict=True)):
        marks = [paper.truth[i], paper.initial[i], paper.new[i], wls[i]]
        low, high = min(*marks, draws[:, i].min()), max(*marks, draws[:, i].max())
        pad = 0.04 * (high - low)
        x, p = style.density(draws[:, i], low - pad, high + pad)
        ax.fill_between(x, p, color=style.BLUE, alpha=0.3, lw=0, label="posterior")
        lines = (
            (style.INK, "-", "truth"),
            (style.ORANGE, (0, (5, 2)), "initial estimate"),
            (style.VERMILLION, (0, (1.5, 1.2)), "paper's new estimate"),
            (style.BLUE, "-", "WLS here"),
        )
        for value, (color, dash, label) in zip(marks, lines, strict=True):
            ax.axvline(value, color=color, ls=dash, lw=1.5, label=label)
        ax.set(yticks=[], ylim=(0, 1.08 * p.max()), xlabel=f"{name} [{_unit(name)}]")
        ax.spines["left"].set_visible(False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=5)
    return figure


@style.styled
def noise(multipliers: np.ndarray, likelihood: dict) -> Figure:
    """Likelihood over the noise multiplier, and the nine errors in sds at its mode."""
    figure = Figure(figsize=(style.WIDTH, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    _draw_likelihood(left, multipliers, likelihood)
    _draw_errors(right, likelihood)
    return figure


def _draw_likelihood(ax, multipliers: np.ndarray, likelihood: dict) -> None:
    inside = (multipliers >= likelihood["low"]) & (multipliers <= likelihood["high"])
    ax.fill_between(
        multipliers,
        likelihood["density"],
        where=inside,
        color=style.BLUE,
        alpha=0.25,
        lw=0,
        label="90 % interval",
    )
    ax.plot(multipliers, likelihood["density"], color=style.BLUE, lw=1.6)
    ax.axvline(
        likelihood["best"],
        color=style.INK,
        lw=1.0,
        ls=(0, (4, 2)),
        label=f"most likely: {likelihood['best']:.0f}",
    )
    ax.set(
        xscale="log",
        xlabel="noise of all sensors, as a multiple of ours",
        yticks=[],
        xlim=(20, 400),
        ylim=(0, 1.1),
        title="Likelihood of the paper's nine errors",
    )
    ax.set_xticks([20, 50, 100, 200, 400], ["20", "50", "100", "200", "400"], minor=False)
    ax.minorticks_off()
    ax.spines["left"].set_visible(False)
    ax.legend(loc="upper right")


def _draw_errors(ax, likelihood: dict) -> None:
    style.sigma_guides(ax, (1, 2))
    ax.bar(
        range(9),
        likelihood["z"],
        color=[style.BLUE] * 3 + [style.VERMILLION] * 3 + [style.GREEN] * 3,
        width=0.6,
        zorder=2,
    )
    ax.set(
        xticks=range(9),
        xticklabels=NAMES,
        ylabel="paper's error [sd]",
        ylim=(-2.6, 2.6),
        title=f"Where the nine errors lie at {likelihood['best']:.0f} times our noise",
    )


@style.styled
def cross_terms(paper: PaperTable, sd: np.ndarray, own_sd: np.ndarray) -> Figure:
    """Errors that went in, errors that came out and the posterior's sd; absolute and relative."""
    figure = Figure(figsize=(style.WIDTH, 3.9), layout="constrained")
    axes = figure.subplots(1, 2)
    went, came = np.abs(paper.initial - paper.truth)[:6], np.abs(paper.new - paper.truth)[:6]
    series = (
        ("error of the initial estimate", went, style.ORANGE, "s"),
        ("error of the paper's new estimate", came, style.VERMILLION, "o"),
        ("posterior sd at the inferred noise", sd[:6], style.BLUE, "_"),
        ("posterior sd at our noise", own_sd[:6], style.SKY, "_"),
    )
    for ax, divide, unit in (
        (axes[0], np.ones(6), "kg m²"),
        (axes[1], 0.01 * np.abs(paper.truth[:6]), "% of the element"),
    ):
        ax.axvspan(2.5, 5.5, color="#f3f3f3", lw=0, zorder=0)
        for label, values, color, marker in series:
            size = {"ms": 24, "mew": 2.6} if marker == "_" else {"ms": 7}
            ax.plot(
                range(6), values / divide, ls="", marker=marker, color=color, label=label, **size
            )
        ax.set(
            yscale="log",
            xticks=range(6),
            xticklabels=NAMES[:6],
            xlim=(-0.5, 5.5),
            ylabel=f"[{unit}]",
        )
    axes[0].set_title("Absolute: the slews determine all six about equally well")
    axes[1].set_title("Relative: small products look bad")
    handles, labels = axes[0].get_legend_handles_labels()
    for handle in handles:
        handle.set_markersize(8)
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=4)
    for handle in legend.legend_handles:
        handle.set_markersize(8)
    for ax in axes:
        for line in ax.lines:
            if line.get_marker() == "_":
                line.set_markersize(24)
    return figure


@style.styled
def corrections(table2: dict, table4: dict, simulated: tuple, flight: tuple) -> Figure:
    """Predicted correction slews over all axes, beside the paper's numbers."""
    figure = Figure(figsize=(style.WIDTH, 4.0), layout="constrained")
    axes = figure.subplots(1, 2)
    for ax, table, (angle, before, after), limit in (
        (axes[0], table2, simulated, 480.0),
        (axes[1], table4, flight, 2000.0),
    ):
        tops = []
        for key, number, color in (("before", before, style.ORANGE), ("after", after, style.BLUE)):
            x, p = style.density(table[key].ravel(), 0.0, limit)
            tops.append(p.max())
            ax.fill_between(x, p, color=color, alpha=0.3, lw=0, label=f"predicted {key}")
            ax.axvline(
                number,
                color=color,
                lw=1.8,
                ls=(0, (5, 2)) if key == "before" else "-",
                label=f'paper, {key}: {number:.0f}"',
            )
        ax.set(
            xlabel="correction slew [arcsec]", yticks=[], xlim=(0, limit), ylim=(0, 1.1 * max(tops))
        )
        ax.spines["left"].set_visible(False)
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2)
        ax.set_title(
            f"After a {angle / DEG:.0f} degree slew about any axis "
            f"({'simulation' if simulated[0] == angle else 'flight'})"
        )
    return figure


@style.styled
def rates(flight: Flight) -> Figure:
    """Measured rates of all slews."""
    figure = Figure(figsize=(style.WIDTH, 2.5), layout="constrained")
    panels = figure.subplots(1, 5, sharey=True)
    for ax, slew in zip(panels, flight.campaign.slews, strict=True):
        for i in range(3):
            ax.plot(
                slew.time,
                slew.rate[:, i] / DEG,
                color=style.color(i),
                ls=style.DASHES[i],
                lw=1.4,
                label=f"about {_AXES[i]}",
            )
        ax.set(title=f"{slew.name}: {slew.angle / DEG:.0f}°", xlabel="time [s]")
    panels[0].set_ylabel("measured rate [deg/s]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


@style.styled
def wheels(flight: Flight) -> Figure:
    """Momenta and motor torques of all wheels."""
    figure = Figure(figsize=(style.WIDTH, 4.2), layout="constrained")
    panels = figure.subplots(2, 5, sharey="row", sharex="col")
    for k, slew in enumerate(flight.campaign.slews):
        above, below = panels[:, k]
        for i in range(3):
            line = {
                "color": style.color(i),
                "ls": style.DASHES[i],
                "lw": 1.3,
                "label": f"wheel {_AXES[i]}",
            }
            above.plot(slew.time, 1e3 * slew.wheel_momentum[:, i], **line)
            below.plot(slew.time, 1e3 * slew.wheel_torque[:, i], **line)
        above.set_title(f"{slew.name}: {slew.angle / DEG:.0f}°")
        below.set_xlabel("time [s]")
    panels[0, 0].set_ylabel("momentum [10⁻³ N m s]")
    panels[1, 0].set_ylabel("motor torque [10⁻³ N m]")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def _gaps(at: Estimate, theta: np.ndarray):
    """Whitened residuals by channel, with start states as fitted but J and K as given."""
    return residuals(at.model.structure, replace(at.point, theta=theta), at.model.data, at.stated)


@style.styled
def rate_residuals(at: Estimate, initial: np.ndarray) -> Figure:
    """Measured minus simulated rates with the initial estimate and with the new one, from the same
    start states.
    """
    figure = Figure(figsize=(style.WIDTH, 4.4), layout="constrained")
    panels = figure.subplots(2, 5, sharex="col", sharey="row")
    sigma = np.array(at.model.campaign.rate_sensor.sigma)
    for row, theta, label in ((0, initial, "before"), (1, at.theta, "after")):
        gap = np.asarray(_gaps(at, theta)[0]).reshape(len(panels[0]), -1, 3) * sigma / DEG * 3600.0
        for k, slew in enumerate(at.model.campaign.slews):
            n = len(slew.time)
            for i in range(3):
                dots = (
                    {"ls": "", "marker": ".", "ms": 1.6}
                    if row
                    else {"ls": style.DASHES[i], "lw": 1.4}
                )
                panels[row, k].plot(
                    slew.time, gap[k, :n, i], color=style.color(i), label=f"axis {_AXES[i]}", **dots
                )
            panels[row, k].axhline(0.0, color=style.MUTED, lw=0.5, zorder=0)
        panels[row, 0].set_ylabel(f"{label}: measured minus\nsimulated rate [arcsec/s]")
    for k, slew in enumerate(at.model.campaign.slews):
        panels[0, k].set_title(slew.name)
        panels[1, k].set_xlabel("time [s]")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


@style.styled
def attitude_residuals(at: Estimate, initial: np.ndarray) -> Figure:
    """Star tracker minus simulated attitude at the fixes after each slew, before and after."""
    figure = Figure(figsize=(style.WIDTH, 3.2), layout="constrained")
    panels = figure.subplots(1, 2)
    tracker, telemetry = at.model.campaign.star_tracker, at.model.data.arrays.telemetry
    sigma = np.where(np.array(tracker.boresight_B) > 0.5, tracker.sigma_roll, tracker.sigma_cross)
    valid = np.asarray(telemetry.readings[1].valid).all(-1)
    for ax, theta, label in ((panels[0], initial, "before"), (panels[1], at.theta, "after")):
        gap = np.asarray(_gaps(at, theta)[1]).reshape(*valid.shape, 3) * sigma / ARCSEC
        for i in range(3):
            values = np.where(valid, gap[..., i], np.nan).ravel()
            ax.plot(
                np.arange(len(values)),
                values,
                ls="",
                marker=style.MARKERS[i],
                ms=2.6,
                mew=0,
                color=style.color(i),
                label=f"about {_AXES[i]}",
            )
        for s in range(1, len(valid)):
            ax.axvline(s * valid.shape[1] - 0.5, color=style.PALE, lw=0.8, zorder=0)
        middles = (np.arange(len(valid)) + 0.5) * valid.shape[1]
        ax.set(
            xticks=middles,
            xticklabels=[s.name for s in at.model.campaign.slews],
            title=f"{label}: star tracker minus simulated attitude",
        )
        ax.set_xlabel("fixes in their order, before and after each slew")
        ax.tick_params(axis="x", length=0)
        ax.set_ylabel("attitude difference [arcsec]")
        if label == "before":
            ax.set_yscale("symlog", linthresh=100.0)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure
