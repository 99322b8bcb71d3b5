"""Claims about disturbances: a stale bias snapshot, and a magnetic dipole against the time the
campaign takes.

Run it with `python -m analyses.paper.claim_disturbances` (about two minutes).
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from analyses.paper.ferguson import (
    DEG,
    NAMES,
    SIMULATION,
    Claim,
    Everything,
    Result,
    Table,
    controller_of,
    flown,
    prior_of,
    run,
    spacecraft_of,
    with_sensor,
)
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import ConstantTorque, MagneticDipole
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.pictures import style

NAME = "claim_disturbances"
TRUTH = SIMULATION.truth
DIPOLE = 0.1  # [A m^2], each component's sd: a microsatellite without magnetic cleanliness
EFFECTS = (ConstantTorque(sigma=1e-3), MagneticDipole(sigma=10.0))  # wide priors: the data decide
BASE, TORQUE, FIELD = np.arange(9), np.arange(9, 12), np.arange(12, 15)
HALF_ORBIT = math.pi / math.sqrt(3.986004418e14 / Orbit().radius ** 3)  # [s]


def stale(offsets: np.ndarray, seeds: int) -> dict[str, np.ndarray]:
    """Errors (offsets, seeds, 9) of WLS when the bias has moved by `offsets` [rad/s] on every axis
    since the snapshot.

    "trusted": the snapshot is taken as exact, as the paper does. "fitted": the bias is one of the
    unknowns.
    """
    errors_by_case = {"trusted": [], "fitted": []}
    for offset in offsets:
        for seed in range(seeds):
            campaign = flown(
                paper_like_plan(), spacecraft_of(TRUTH, bias=(offset,) * 3), seed=seed
            ).campaign
            for kind, sigma in (("trusted", 1e-9), ("fitted", 1e-3)):
                fitted = estimate(
                    Model(with_sensor(campaign, bias_sigma=(sigma,) * 3)), starts=1, discount=False
                )
                errors_by_case[kind].append(fitted.theta - TRUTH)
    return {k: np.array(v).reshape(len(offsets), seeds, 9) for k, v in errors_by_case.items()}


def plan_of(pause: float, argument: float) -> Plan:
    """The five slews with another pause [s] between them, begun elsewhere on the orbit [rad]."""
    return replace(paper_like_plan(), pause=pause, orbit=Orbit(argument=argument))


def campaign_time(pause: float) -> float:
    """From the first row to the last [s]."""
    plan = plan_of(pause, 0.0)
    return plan.starts[-1] + plan.durations[-1]


def dipole_errors(pause: float, arguments: np.ndarray) -> dict[str, np.ndarray]:
    """rms errors (arguments, 9) over dipoles of any direction, and the sd with the dipole fitted;
    to first order.
    """
    errors_by_case = {"not modelled": [], "constant torque fitted": [], "dipole fitted (sd)": []}
    for argument in arguments:
        campaign = flown(
            plan_of(pause, argument), spacecraft_of(TRUTH, bias=(0.0, 0.0, 0.0)), seed=None
        ).campaign
        fitted = estimate(
            Model(campaign, EFFECTS),
            starts=1,
            start=np.concatenate([TRUTH, np.zeros(6)]),
            free=BASE,
        )
        every = Everything.of(fitted)
        errors_by_case["not modelled"].append(
            DIPOLE * np.linalg.norm(every.unmodelled(BASE, FIELD), axis=1)
        )
        errors_by_case["constant torque fitted"].append(
            DIPOLE * np.linalg.norm(every.unmodelled(np.arange(12), FIELD)[:9], axis=1)
        )
        errors_by_case["dipole fitted (sd)"].append(every.sd(np.concatenate([BASE, FIELD]))[:9])
    return {k: np.array(v) for k, v in errors_by_case.items()}


def refitted(pause: float, arguments: np.ndarray) -> np.ndarray:
    """Errors (n, 9) of WLS in noise-free flights with random dipoles: no linearisation."""
    rng, errors = np.random.default_rng(7), []
    effect = MagneticDipole()
    for argument in arguments:
        craft = spacecraft_of(
            TRUTH,
            bias=(0.0, 0.0, 0.0),
            effects=(effect,),
            values={effect.name: {"dipole": DIPOLE * rng.normal(size=3)}},
        )
        flight = fly(
            plan_of(pause, argument),
            Mission(craft, prior_of(SIMULATION.initial)),
            None,
            controller=controller_of(SIMULATION.initial),
        )
        errors.append(estimate(Model(flight.campaign), starts=1, discount=False).theta - TRUTH)
    return np.array(errors)


@style.styled
def stale_picture(offsets: np.ndarray, errors_by_case: dict[str, np.ndarray]) -> Figure:
    """Errors of J and K against the staleness of the bias."""
    figure = Figure(figsize=(style.WIDTH, 3.6), layout="constrained")
    panels = figure.subplots(1, 3)
    hours = offsets / DEG * 3600.0
    groups = (
        (slice(0, 3), "Diagonal elements", 100.0 / TRUTH[:3], "rms error [%]"),
        (slice(3, 6), "Cross terms", 1e3, "rms error [10⁻³ kg m²]"),
        (slice(6, 9), "Scale factors", 100.0, "rms error [%]"),
    )
    for ax, (index, title, scale, label) in zip(panels, groups, strict=True):
        for kind, color, marker in (
            ("trusted", style.VERMILLION, "o"),
            ("fitted", style.BLUE, "s"),
        ):
            each = np.sqrt(np.mean(np.square(errors_by_case[kind][..., index] * scale), axis=2))
            ax.fill_between(hours, each.min(1), each.max(1), color=color, alpha=0.2, lw=0)
            rms = np.sqrt(np.mean(each**2, axis=1))
            name = {"trusted": "snapshot taken as exact", "fitted": "bias fitted along"}[kind]
            ax.plot(hours, rms, color=color, marker=marker, ms=5, lw=1.2, label=name)
        ax.set(
            ylim=(0.0, None), xlabel="bias since the snapshot [deg/h]", ylabel=label, title=title
        )
    panels[0].legend()
    return figure


LOOKS = {
    "not modelled": (style.VERMILLION, "-"),
    "constant torque fitted": (style.ORANGE, (0, (5, 2))),
    "dipole fitted (sd)": (style.BLUE, (0, (1.5, 1.2))),
}


@style.styled
def dipole_picture(
    halves: np.ndarray, errors: list[dict[str, np.ndarray]], checks: dict[float, np.ndarray]
) -> Figure:
    """rms errors against the campaign's length in half orbits."""
    figure = Figure(figsize=(style.WIDTH, 3.9), layout="constrained")
    panels = figure.subplots(1, 2)
    for ax, index, title in (
        (panels[0], slice(0, 3), "Diagonal elements"),
        (panels[1], slice(3, 6), "Cross terms"),
    ):
        for kind, (color, dash) in LOOKS.items():
            values = np.array(
                [np.sqrt(np.mean(np.square(e[kind][:, index]), axis=1)) for e in errors]
            )
            ax.fill_between(halves, values.min(1), values.max(1), color=color, alpha=0.18, lw=0)
            rms = np.sqrt(np.mean(values**2, axis=1))
            ax.plot(halves, rms, color=color, ls=dash, lw=1.8, label=kind)
        _draw_checks(ax, {length: e[:, index] for length, e in checks.items()})
        ax.axvline(1.0, color=style.MUTED, lw=0.8, ls=(0, (4, 3)))
        ax.set(
            yscale="log", xlabel="campaign [half orbits]", ylabel="rms error [kg m²]", title=title
        )
    panels[0].legend(fontsize=8)
    return figure


def _draw_checks(ax, checks: dict[float, np.ndarray]) -> None:
    """One draw of each dipole component where the lines have their rms: chi-square scatter."""
    for length, errors in checks.items():
        value = float(np.sqrt(np.mean(np.square(errors))))
        ax.errorbar(
            length,
            value,
            value / math.sqrt(len(errors)),
            color=style.INK,
            marker="o",
            ms=5,
            capsize=2,
            label="not modelled, refitted (±1 sd)" if length == min(checks) else None,
        )


def bias_claim(rms: dict[str, np.ndarray]) -> Claim:
    """A stale bias snapshot; rms errors (offsets, 9) by how the bias is treated."""
    worst = int(np.argmax(rms["trusted"][-1, 3:6])) + 3
    texts = {}
    for kind, digits in (("trusted", 2), ("fitted", 3)):
        last = rms[kind][-1]
        texts[kind] = (
            f"{100 * np.max(last[:3] / TRUTH[:3]):.{digits}f} %",
            f"{1e3 * last[worst]:.2f}e-3",
            f"{100 * np.max(last[6:]):.{digits}f} %",
        )
    trusted, fitted = texts["trusted"], texts["fitted"]
    return (
        "a stale bias snapshot spoils the estimate",
        f"20 deg/h taken as exact: {trusted[0]} in the diagonal, {trusted[1]} kg m² in "
        f"{NAMES[worst]}, {trusted[2]} in K; "
        f"fitted along: {fitted[0]}, {fitted[1]}, {fitted[2]}",
        "yes if it is taken as exact; **no** once the bias is one of the unknowns: "
        "the readings at rest in every slew are the fresh snapshot",
    )


def dipole_claim(halves: np.ndarray, rms: dict[str, np.ndarray]) -> Claim:
    """A magnetic dipole; rms errors (pauses, 9) by what is fitted."""
    size = np.sqrt(np.mean(rms["not modelled"][:, :6] ** 2, axis=1))
    left = np.sqrt(np.mean(rms["constant torque fitted"][:, :6] ** 2, axis=1)) / size
    sd = np.sqrt(np.mean(rms["dipole fitted (sd)"][:, :6] ** 2))
    verdict = "hardly" if size.max() < 2 * size.min() else "in part"
    instead = (
        "it cannot even at the shortest" if left[0] > 0.5 else "only while the campaign is short"
    )
    return (
        "magnetic torque (half-orbit period) matters where the campaign takes long",
        f"a dipole of {DIPOLE} A m² a component, not modelled: "
        f"rms error of J {1e3 * size.min():.2f}e-3 to {1e3 * size.max():.2f}e-3 kg m² from "
        f"{halves[0]:.1f} to {halves[-1]:.1f} half orbits; "
        f"a fitted constant torque leaves {100 * left[0]:.0f} % of it in the shortest campaign "
        f"and {100 * left[-1]:.0f} % in the longest; the fitted "
        f"dipole costs sd {1e3 * sd:.2f}e-3 kg m²",
        f"**{verdict}**: the torque acts during the slews, whose start states are free; the "
        "waiting between them changes little. "
        "What waiting does change is whether a constant torque can stand in for it: " + instead,
    )


def dipole_table(halves: np.ndarray, rms: dict[str, np.ndarray]) -> Table:
    """rms errors of J by the campaign's length."""
    groups = {"diagonal": slice(0, 3), "cross": slice(3, 6)}
    rows = [
        [
            f"{length:.2f}",
            *(
                f"{1e3 * np.sqrt(np.mean(rms[kind][i, part] ** 2)):.3f}"
                for part in groups.values()
                for kind in rms
            ),
        ]
        for i, length in enumerate(halves)
    ]
    header = ("half orbits", *(f"{part}: {kind}" for part in groups for kind in rms))
    return Table(f"rms error [10⁻³ kg m²] from a dipole of {DIPOLE} A m² a component", header, rows)


FIGURES = (
    (
        "claim_stale_bias.png",
        "Errors when the bias has moved since the snapshot, on all axes (rms over 4 flights; "
        "bands: the flights)",
    ),
    (
        "claim_magnetic.png",
        f"Errors from a dipole of {DIPOLE} A m² a component against the campaign's length; "
        "bands: six places on the orbit to begin; dots: 16 refitted flights",
    ),
)


def analysis(quick: bool = False):
    """Bias and magnetic dipole."""
    drifts = np.array([0.0, 20.0]) if quick else np.array([0.0, 2.0, 5.0, 10.0, 20.0])
    offsets = drifts * DEG / 3600.0
    bias = stale(offsets, 1 if quick else 4)
    bias_rms = {kind: np.sqrt(np.mean(np.square(e), axis=1)) for kind, e in bias.items()}
    pictures = {"claim_stale_bias.png": stale_picture(offsets, bias)}
    numbers = {f"Jxx {kind}": float(rms[-1, 0]) for kind, rms in bias_rms.items()}
    if quick:
        return Result(NAME, "Disturbances", [("", "", "")], (), (), (), numbers), pictures
    pauses = np.array([5.0, 100.0, 300.0, 600.0, 1000.0, 1600.0, 2600.0])
    arguments = np.linspace(0.0, np.pi, 7)[:6]
    errors = [dipole_errors(pause, arguments) for pause in pauses]
    halves = np.array([campaign_time(pause) for pause in pauses]) / HALF_ORBIT
    checks = {
        float(halves[k]): refitted(pauses[k], np.linspace(0.0, np.pi, 17)[:16]) for k in (0, 3, 6)
    }
    pictures["claim_magnetic.png"] = dipole_picture(halves, errors, checks)
    rms = {
        kind: np.array([np.sqrt(np.mean(e[kind] ** 2, axis=0)) for e in errors]) for kind in LOOKS
    }
    return Result(
        NAME,
        "Disturbances: stale bias, magnetic dipole",
        [bias_claim(bias_rms), dipole_claim(halves, rms)],
        [dipole_table(halves, rms)],
        FIGURES,
        (),
        numbers,
    ), pictures


if __name__ == "__main__":
    run(__doc__, analysis)
