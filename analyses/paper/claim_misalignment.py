"""Claims about misalignment: its error against the slew angle, and whether K soaks it up.

Run it with `python -m analyses.paper.claim_misalignment` (about two minutes).
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from analyses.paper.ferguson import (
    ARCSEC,
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
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import RateSensorMisalignment
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.pictures import style

TURN = 0.2 * DEG  # of the rate sensor against the star tracker
NAME = "claim_misalignment"
TRUTH = SIMULATION.truth


def by_angle(angles: np.ndarray, seeds: int) -> np.ndarray:
    """Final error (seeds, angles, 3) [rad] of slews about x with the rate sensor turned about y,
    which the controller does not know.
    """
    slews = tuple(PlannedSlew((1.0, 0.0, 0.0), a, duration=265.0) for a in angles)
    plan = Plan("angles", slews, wheel_momentum=paper_like_plan().wheel_momentum)
    effect = RateSensorMisalignment()
    errors = []
    for seed in range(seeds):
        craft = spacecraft_of(
            TRUTH, effects=(effect,), values={effect.name: {"angle": np.array([0.0, TURN, 0.0])}}
        )
        mission = Mission(craft, prior_of(TRUTH))
        flight = fly(plan, mission, seed, controller=controller_of(TRUTH))
        errors.append(flight.final_error_B)
    return np.array(errors)


def turned(angle_B: np.ndarray) -> np.ndarray:
    """C_rate (3, 3) of a sensor that is turned by a small rotation vector [rad], as
    `RateSensorMisalignment` has it.
    """
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(angle_B).as_matrix().T


def soaked(sizes: np.ndarray, direction: np.ndarray, seeds: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of WLS (sizes, seeds, 9) and reduced chi^2 of the rates (sizes, seeds) when a
    misalignment [rad] is not modelled.
    """
    errors, chi2 = [], []
    for size in sizes:
        for seed in range(seeds):
            craft = spacecraft_of(TRUTH)
            craft = replace(
                craft, rate_sensor=replace(craft.rate_sensor, axes=turned(size * direction))
            )
            campaign = with_sensor(
                flown(paper_like_plan(), craft, seed=seed).campaign, axes=np.eye(3)
            )
            fitted = estimate(Model(campaign), starts=1, discount=False)
            errors.append(fitted.theta - TRUTH)
            chi2.append(fitted.tests["rate"].reduced_chi2)
    shape = (len(sizes), seeds)
    return np.array(errors).reshape(*shape, 9), np.array(chi2).reshape(shape)


@style.styled
def angle_picture(angles: np.ndarray, errors: np.ndarray) -> Figure:
    """Error against slew angle by component, with the sine of the claim."""
    figure = Figure(figsize=(style.WIDTH, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    _draw_components(left, angles / DEG, errors)
    _draw_sizes(right, angles / DEG, np.linalg.norm(errors, axis=-1) / ARCSEC)
    left.set(ylabel="final error [arcsec]", title="Two components: sine, and one minus cosine")
    right.set(ylabel="correction slew [arcsec]", title="The whole error is largest at 180°")
    for ax in (left, right):
        ax.set(xlabel="slew angle [deg]", xlim=(0, 180), xticks=range(0, 181, 30))
        ax.legend(loc="upper left")
    return figure


def _draw_components(ax, degrees: np.ndarray, errors: np.ndarray) -> None:
    """Errors across and along the misalignment axis a; n is the slew axis."""
    fine = np.linspace(0.0, np.pi, 181)
    sign = np.sign(np.mean(errors[..., 2]))
    parts = (
        ("across, n × a", sign * errors[..., 2], np.sin(fine), style.BLUE),
        (
            "along a",
            errors[..., 1] * np.sign(np.mean(errors[..., 1])),
            1.0 - np.cos(fine),
            style.ORANGE,
        ),
    )
    for label, values, theory, color in parts:
        middle, spread = values.mean(0) / ARCSEC, values.std(0, ddof=1) / ARCSEC
        ax.fill_between(
            degrees, middle - 2 * spread, middle + 2 * spread, color=color, alpha=0.25, lw=0
        )
        label = f"{label} (simulated, ±2 sd)"
        ax.plot(degrees, middle, ls="", marker="o", ms=4, color=color, label=label)
        ax.plot(fine / DEG, TURN / ARCSEC * theory, color=color, lw=1.2)


def _draw_sizes(ax, degrees: np.ndarray, sizes: np.ndarray) -> None:
    """The whole error (seeds, angles) [arcsec], with both formulas."""
    fine = np.linspace(0.0, np.pi, 181)
    low, high = np.quantile(sizes, (0.025, 0.975), axis=0)
    ax.fill_between(degrees, low, high, color=style.GREEN, alpha=0.25, lw=0)
    ax.plot(
        degrees,
        np.median(sizes, axis=0),
        ls="",
        marker="o",
        ms=4,
        color=style.GREEN,
        label="simulated (95 %)",
    )
    for theory, look in (
        (
            TURN / ARCSEC * 2.0 * np.sin(fine / 2),
            {"color": style.GREEN, "lw": 1.2, "label": "2 sin(angle/2) |n × a|"},
        ),
        (
            TURN / ARCSEC * np.sin(fine),
            {
                "color": style.VERMILLION,
                "lw": 1.5,
                "ls": (0, (5, 2)),
                "label": "the claim: sin(angle) |n × a|",
            },
        ),
    ):
        ax.plot(fine / DEG, theory, **look)


@style.styled
def soak_picture(
    sizes: np.ndarray, errors: np.ndarray, slopes: np.ndarray, chi2: np.ndarray, sd: np.ndarray
) -> Figure:
    """What K and J make of an unmodelled misalignment, and what the residuals say."""
    figure = Figure(figsize=(style.WIDTH, 3.6), layout="constrained")
    panels = figure.subplots(1, 3)
    degrees = sizes / DEG
    for ax, index, scale, unit in (
        (panels[0], (6, 7, 8), 100.0, "K [%]"),
        (panels[1], (3, 4, 5), 1e3, "products [10⁻³ kg m²]"),
    ):
        for j, i in enumerate(index):
            values = scale * errors[..., i]
            ax.errorbar(
                degrees,
                values.mean(1),
                scale * 2 * sd[i],
                color=style.color(j),
                marker=style.MARKERS[j],
                ms=4,
                ls="",
                capsize=2,
                label=NAMES[i],
            )
            ax.plot(
                degrees, scale * slopes[i] * sizes, color=style.color(j), ls=style.DASHES[j], lw=1.0
            )
        ax.axhline(0.0, color=style.MUTED, lw=0.6, zorder=0)
        ax.set(xlabel="misalignment about (1, 1, 1) [deg]", ylabel=f"error of {unit}")
        ax.legend()
    panels[0].set_title("K (lines: first order)")
    panels[1].set_title("Products of inertia")
    panels[2].plot(degrees, chi2.mean(1), color=style.BLUE, marker="o", ms=4)
    panels[2].axhline(1.0, color=style.MUTED, lw=0.8, ls=(0, (4, 3)))
    panels[2].set(
        ylim=(0.0, None),
        xlabel="misalignment about (1, 1, 1) [deg]",
        ylabel="reduced χ² of the rates",
        title="The residuals do not let it pass",
    )
    return figure


def angle_claim(angles: np.ndarray, errors: np.ndarray) -> tuple[Claim, dict[str, float]]:
    """The claim about the slew angle, and its numbers; errors (seeds, angles, 3) [rad]."""
    sizes = np.median(np.linalg.norm(errors, axis=-1) / ARCSEC, axis=0)
    at_180, expected = float(sizes[-1]), 2 * TURN / ARCSEC
    rms = float(np.sqrt(np.mean((sizes - expected * np.sin(angles / 2)) ** 2)))
    across = errors[..., 2].mean(0) / ARCSEC
    claim = (
        "misalignment error goes with the sine of the slew angle, none at 180 degrees",
        f'{np.max(np.abs(across)):.0f}" across at 90 deg and {abs(across[-1]):.0f}" at 180 '
        "deg, but along the misalignment axis 1 − cos(angle): the whole is 2 sin(angle/2), "
        f'{at_180:.0f}" at 180 deg for {TURN / DEG} deg (closed loop, agrees with the formula '
        f'to {rms:.0f}")',
        "**no**: true of one component of two. The correction slew is LARGEST at 180 degrees, "
        "twice the misalignment",
    )
    return claim, {
        "at_180_arcsec": at_180,
        "expected_180_arcsec": expected,
        "across_180_arcsec": float(abs(across[-1])),
    }


FIGURES = (
    (
        "claim_misalignment_angle.png",
        f"Final error of closed-loop slews about x, rate sensor turned {TURN / DEG} deg about "
        "y; points simulated with noise, lines closed form",
    ),
    (
        "claim_misalignment_soaked.png",
        "What J and K make of a rate sensor turned about (1, 1, 1) that is not modelled; "
        "bars ±2 sd of the model",
    ),
)
NOTE = (
    "A turned sensor couples axes, K only scales them. "
    "What K can soak up is the part that the five slews' axes cannot tell from a scale: "
    "on a slew about a diagonal, the reading that another axis adds."
)


def analysis(quick: bool = False):
    """Error against angle, and what J and K soak up."""
    angles = np.linspace(5.0, 180.0, 6 if quick else 36) * DEG
    errors = by_angle(angles, 4 if quick else 40)
    claim, numbers = angle_claim(angles, errors)
    pictures = {"claim_misalignment_angle.png": angle_picture(angles, errors)}
    if quick:
        return Result(NAME, "Misalignment", [claim], (), FIGURES[:1], (), numbers), pictures
    soaking = soaking_up()
    sizes, direction = np.linspace(0.0, 0.5, 6) * DEG, np.ones(3) / np.sqrt(3.0)
    soaked_errors, chi2 = soaked(sizes, direction, 6)
    pictures["claim_misalignment_soaked.png"] = soak_picture(
        sizes, soaked_errors, soaking.jacobian @ direction, chi2, soaking.held.sd[:9]
    )
    claims = [claim, soaking_claim(soaking, float(chi2[-1].mean()))]
    table = soaking_table(soaking)
    return Result(NAME, "Misalignment", claims, [table], FIGURES, [NOTE], numbers), pictures


@dataclass(frozen=True)
class Soaking:
    """What an unmodelled misalignment does to the fit."""

    held: Estimate  # J and K fitted, the misalignment held at zero, which is the truth
    fitted: Estimate  # all fitted to a campaign with 0.5 deg about (1, 1, 1)
    jacobian: np.ndarray  # (9, 3) error of J and K for each radian that is not modelled
    taken: dict[str, float]  # part of the squared misfit that K, J or both take away


def soaking_up() -> Soaking:
    """The fit with and without the effect, and the first-order error without it."""
    direction = np.ones(3) / np.sqrt(3.0)
    effect = RateSensorMisalignment(sigma=0.5 * DEG)
    craft = spacecraft_of(TRUTH)
    axes_B = turned(0.5 * DEG * direction)
    craft = replace(craft, rate_sensor=replace(craft.rate_sensor, axes=axes_B))
    campaign = with_sensor(flown(paper_like_plan(), craft, seed=1).campaign, axes=np.eye(3))
    fitted = estimate(Model(campaign, (effect,)), starts=1)
    quiet = flown(paper_like_plan(), spacecraft_of(TRUTH), seed=1).campaign
    held = estimate(
        Model(quiet, (effect,)),
        starts=1,
        start=np.concatenate([TRUTH, np.zeros(3)]),
        free=np.arange(9),
    )
    every, angles = Everything.of(held), np.arange(9, 12)
    sets = {"nuisances": np.arange(0), "K": np.arange(6, 9), "J": np.arange(6), "all": np.arange(9)}
    # The prior of the misalignment itself is in the Hessian's diagonal and no residual.
    prior = np.sum(np.square(DEG * np.ones(3) / np.sqrt(3.0)) / effect.sigma**2)
    left = {key: every.left(index, angles, DEG * direction) - prior for key, index in sets.items()}
    taken = {key: 1.0 - value / left["nuisances"] for key, value in left.items()}
    return Soaking(held, fitted, every.unmodelled(np.arange(9), angles), taken)


def soaking_table(soaking: Soaking) -> Table:
    """Errors of each parameter, not modelled and fitted along."""
    rows = []
    for i, name in enumerate(NAMES):
        unit = "%" if i in (0, 1, 2, 6, 7, 8) else "10⁻³ kg m²"
        scale = 100.0 / TRUTH[i] if unit == "%" else 1e3
        rest = soaking.fitted.theta[i] - TRUTH[i]
        rows.append(
            [
                f"{name} [{unit}]",
                *(f"{scale * x * DEG:+.3f}" for x in soaking.jacobian[i]),
                f"{abs(scale) * soaking.held.sd[i]:.4f}",
                f"{scale * rest:+.4f} ± {abs(scale) * soaking.fitted.sd[i]:.4f}",
            ]
        )
    return Table(
        "Error for each degree of misalignment about x, y, z that is not modelled; sd; "
        "and what is left at 0.5 deg when it is fitted",
        ("", "x", "y", "z", "sd", "fitted along"),
        rows,
    )


def soaking_claim(soaking: Soaking, chi2: float) -> Claim:
    """The claim that K soaks up misalignment; `chi2` is the rates' reduced one at 0.5 deg."""
    jacobian, fitted, taken = soaking.jacobian, soaking.fitted, soaking.taken
    worst = 100.0 * np.max(np.linalg.norm(jacobian[6:], axis=1)) * DEG
    most = np.max(np.abs(fitted.theta[:9] - TRUTH) / fitted.sd[:9])
    in_sd = np.abs(jacobian) / soaking.held.sd[:9, None]
    agrees = "yes" if taken["K"] > 0.5 else "in part" if taken["K"] > 0.1 else "hardly"
    return (
        "K soaks up misalignment",
        "of the squared misfit that start states and bias leave, K alone takes "
        f"{100 * taken['K']:.0f} %, J alone {100 * taken['J']:.0f} %, both "
        f"{100 * taken['all']:.0f} %. "
        f"K errs by up to {worst:.2f} % for each degree, products of inertia by "
        f"{1e3 * np.max(np.abs(jacobian[3:6])) * DEG:.1f}e-3 kg m²; "
        f"the rates' reduced χ² rises to {chi2:.1f} at 0.5 deg. "
        f"Fitted along, the errors are at most {most:.1f} sd",
        f"**{agrees}**: K is the parameter that errs most in its own sd "
        f"({np.max(in_sd[6:]) * DEG:.0f} sd for a degree; "
        f"J {np.max(in_sd[:6]) * DEG:.0f}), but "
        f"{100 * (1 - taken['all']):.0f} % of the misfit stays to be seen",
    )


if __name__ == "__main__":
    run(__doc__, analysis)
