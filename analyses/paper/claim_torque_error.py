"""Claims about torque errors: gain, command lag, and the switch to a backup wheel.

Run it with `python -m analyses.paper.claim_torque_error` (about three minutes).
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from analyses.paper.ferguson import (
    ARCSEC,
    DEG,
    NAMES,
    SIMULATION,
    Claim,
    Result,
    Table,
    controller_of,
    prior_of,
    run,
    spacecraft_of,
    with_wheels,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight, fly
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import WheelCommandLag, WheelTorqueGain
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.pictures import style

NAME = "claim_torque_error"
TRUTH = SIMULATION.truth
AT_REST = replace(paper_like_plan(), wheel_momentum=())
GAIN, LAG = WheelTorqueGain(), WheelCommandLag(sigma=0.1)


def flight_with(effect, values: dict, seed: int, plan=None, believed=None) -> Flight:
    """The five slews (or another plan) flown with an effect that the controller does not know."""
    craft = spacecraft_of(TRUTH, effects=(effect,), values={effect.name: values})
    plan = plan or paper_like_plan()
    return fly(
        plan,
        Mission(craft, prior_of(SIMULATION.initial)),
        seed,
        controller=controller_of(SIMULATION.initial if believed is None else believed),
    )


def gain_of(x: float) -> dict:
    """Wheel x delivers (1 + x) times its command, the others are right."""
    return {"gain": np.array([1.0 + x, 1.0, 1.0])}


def wls(campaign: Campaign, drive: str = "commanded") -> Estimate:
    """The paper's estimator: the stated noise whatever the residuals say. Begun at the truth, so
    that only the torque error acts.
    """
    return estimate(Model(campaign, (), drive), start=TRUTH, discount=False)


def known(campaign: Campaign, effect, values: np.ndarray) -> Estimate:
    """J and K with the effect's parameters held at known values."""
    model = Model(campaign, (effect,))
    return estimate(
        model,
        starts=1,
        start=np.concatenate([model.space.mean[:9], values]),
        free=np.arange(9),
        discount=False,
    )


def gain_errors(gains: np.ndarray, seeds: int, quick: bool) -> dict[str, np.ndarray]:
    """Relative errors of J and K (gains, seeds, 9) by how the telemetry is used."""
    kinds = ["no tachometers, wheels start at rest", "with tachometers"] if quick else list(_LOOKS)
    errors_by_case = {kind: [] for kind in kinds}
    for g in gains:
        for seed in range(seeds):
            campaign = flight_with(GAIN, gain_of(g), seed).campaign
            rest = flight_with(GAIN, gain_of(g), seed, AT_REST).campaign
            estimates = {
                "no tachometers, wheels start at rest": lambda c=rest: wls(
                    with_wheels(c, momentum_sigma=None)
                )
            }
            estimates |= {
                "without tachometers": lambda c=campaign: wls(with_wheels(c, momentum_sigma=None)),
                "with tachometers": lambda c=campaign: wls(c),
            }
            estimates |= {
                "tachometers as input": lambda c=campaign: wls(c, "measured"),
                "gain fitted": lambda c=campaign: estimate(Model(c, (GAIN,)), starts=1),
            }
            for kind in kinds:
                errors_by_case[kind].append((estimates[kind]().theta[:9] - TRUTH) / np.abs(TRUTH))
    return {k: np.array(v).reshape(len(gains), seeds, 9) for k, v in errors_by_case.items()}


def lag_errors(lags: np.ndarray, seeds: int) -> dict[str, np.ndarray]:
    """Errors of J and K (lags, seeds, 9): lag not modelled, known, fitted; and the reduced chi^2
    (lags, seeds) of the first.
    """
    errors_by_case = {"not modelled": [], "known": [], "fitted": [], "chi2": []}
    for tau in lags:
        for seed in range(seeds):
            campaign = flight_with(LAG, {"tau": tau}, seed).campaign
            plain = wls(campaign)
            errors_by_case["not modelled"].append(plain.theta - TRUTH)
            errors_by_case["chi2"].append(plain.tests["total"].reduced_chi2)
            errors_by_case["known"].append(known(campaign, LAG, np.array([tau])).theta[:9] - TRUTH)
            errors_by_case["fitted"].append(
                estimate(Model(campaign, (LAG,)), starts=1).theta[:9] - TRUTH
            )
    return {k: np.array(v).reshape(len(lags), seeds, -1) for k, v in errors_by_case.items()}


def tracking(flight: Flight) -> tuple[float, float]:
    """Largest deviation from the planned attitude during the slew and the final one [arcsec]."""
    plan, truth = flight.plan, flight.truth[0]
    from bayes_inertia.flight.plan import angle_and_rate

    slew = plan.slews[0]
    angle = np.asarray(
        angle_and_rate(
            slew.angle, slew.rate, slew.acceleration, False, truth.time - plan.rest_before
        )[0]
    )
    planned = Rotation.from_quat(plan.attitudes[0]) * Rotation.from_rotvec(
        angle[:, None] * np.array(slew.axis_B)
    )
    off = (planned.inv() * Rotation.from_quat(truth.attitude)).magnitude()
    return float(off.max()) / ARCSEC, float(np.linalg.norm(flight.final_error_B[0])) / ARCSEC


def backup(error: float, seeds: int) -> list[list[str]]:
    """A 30 deg slew about x with the wheel whose gain the estimate absorbed, and with a right one
    in its place.
    """
    absorbed = wls(
        with_wheels(flight_with(GAIN, gain_of(error), 0, AT_REST).campaign, momentum_sigma=None)
    ).theta
    plan = replace(AT_REST, slews=(PlannedSlew((1.0, 0.0, 0.0), 30.0 * DEG),))
    cases = (
        ("initial estimate, the same wheel", SIMULATION.initial, error),
        ("new estimate (gain absorbed), the same wheel", absorbed, error),
        ("new estimate (gain absorbed), backup wheel", absorbed, 0.0),
        ("true J and K, backup wheel", TRUTH, 0.0),
    )
    rows = []
    for label, believed, gain in cases:
        errors = np.array(
            [
                tracking(flight_with(GAIN, gain_of(gain), 100 + s, plan, believed))
                for s in range(seeds)
            ]
        )
        rows.append(
            [
                label,
                f"{100 * (believed[0] / TRUTH[0] - 1):+.2f} %",
                *(
                    f"{m:.0f} ± {s:.0f}"
                    for m, s in zip(errors.mean(0), errors.std(0, ddof=1), strict=True)
                ),
            ]
        )
    return rows


_LOOKS = {
    "no tachometers, wheels start at rest": (style.ORANGE, "v"),
    "without tachometers": (style.VERMILLION, "o"),
    "with tachometers": (style.BLUE, "s"),
    "tachometers as input": (style.GREEN, "^"),
    "gain fitted": (style.PURPLE, "D"),
}


@style.styled
def gain_picture(gains: np.ndarray, errors_by_case: dict[str, np.ndarray]) -> Figure:
    """Error of Jxx against the torque error of wheel x."""
    figure = Figure(figsize=(style.WIDTH, 3.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    percent = 100 * gains
    for kind, errors in errors_by_case.items():
        color, marker = _LOOKS[kind]
        look = {"color": color, "marker": marker, "ms": 5, "lw": 1.2, "capsize": 2, "label": kind}
        for ax, i in ((left, 0), (right, 6)):
            values = 100.0 * errors[..., i]
            spread = 2 * values.std(1, ddof=1) if values.shape[1] > 1 else np.zeros(len(gains))
            ax.errorbar(percent, values.mean(1), spread, **look)
    inverse = 100 * (1 / (1 + gains) - 1)
    left.plot(
        percent,
        inverse,
        color=style.INK,
        lw=0.9,
        ls=(0, (4, 3)),
        label="J / (1 + torque error)",
    )
    for ax, label, title in (
        (left, "error of Jxx [%]", "Inertia about the wheel's axis"),
        (right, "error of K1 [%]", "Scale factor about the same axis"),
    ):
        ax.set(xlabel="torque error of wheel x [%]", ylabel=label, title=title)
        ax.axhline(0.0, color=style.MUTED, lw=0.6, zorder=0)
    left.legend(loc="best", fontsize=8)
    return figure


@style.styled
def lag_picture(lags: np.ndarray, errors_by_case: dict[str, np.ndarray]) -> Figure:
    """Errors against the lag: not modelled, known and fitted."""
    figure = Figure(figsize=(style.WIDTH, 3.7), layout="constrained")
    panels = figure.subplots(1, 3)
    looks = {
        "not modelled": (style.VERMILLION, "o"),
        "known": (style.GREEN, "^"),
        "fitted": (style.BLUE, "s"),
    }
    for kind, (color, marker) in looks.items():
        errors = errors_by_case[kind]
        dot = {"ms": 10, "mfc": "none", "mew": 1.4} if kind == "known" else {"ms": 5}
        for ax, index in ((panels[0], slice(0, 3)), (panels[1], slice(3, 6))):
            each = np.sqrt(np.mean(np.square(errors[..., index]), axis=2))
            ax.fill_between(lags, each.min(1), each.max(1), color=color, alpha=0.2, lw=0)
            rms = np.sqrt(np.mean(each**2, axis=1))
            ax.plot(lags, rms, color=color, marker=marker, lw=1.2, label=kind, **dot)
    for ax, title in ((panels[0], "Diagonal elements"), (panels[1], "Cross terms")):
        ax.set(yscale="log", xlabel="command lag [s]", ylabel="rms error [kg m²]", title=title)
    panels[0].legend()
    panels[2].plot(
        lags,
        errors_by_case["chi2"][..., 0].mean(1),
        color=style.VERMILLION,
        marker="o",
        ms=5,
        lw=1.2,
    )
    panels[2].axhline(1.0, color=style.MUTED, lw=0.8, ls=(0, (4, 3)))
    panels[2].set(
        yscale="log", xlabel="command lag [s]", ylabel="reduced χ²", title="Fit without the lag"
    )
    return figure


def gain_claim(slope: dict[str, float]) -> Claim:
    """A torque error of a wheel; errors of Jxx for each per cent, by how the telemetry is used."""
    at_rest = slope["no tachometers, wheels start at rest"]
    return (
        "a torque error of a wheel becomes the same error of the inertia about its axis",
        "wheels at rest before the campaign, no tachometers: "
        f"{at_rest:+.2f} % for each per cent; with 30 to "
        "70e-3 N m s stored "
        f"in them {slope['without tachometers']:+.2f} %; "
        f"with tachometers fitted {slope['with tachometers']:+.2f} %; "
        f"tachometers as input {slope['tachometers as input']:+.3f} %; "
        f"gain fitted along {slope['gain fitted']:+.3f} %",
        f"**{'yes' if abs(at_rest + 1.0) < 0.1 else 'nearly'}** for wheels at rest "
        "(with the sign turned round: J is too small where the torque is too large). "
        "Stored momentum brings in the gyric torque of other slews. "
        "Tachometers as mere further data do not cure it; "
        "as the input, or with the gain fitted, they do",
    )


def lag_claim(rms: dict[str, np.ndarray], chi2: np.ndarray, k: int) -> Claim:
    """A command lag, number k of those flown; rms errors (lags, 9), reduced chi^2 (lags, seeds)."""
    ratio = np.sqrt(np.mean(rms["known"][1:, :6] ** 2) / np.mean(rms["known"][0, :6] ** 2))
    missed, known = rms["not modelled"][k], rms["known"][k]
    return (
        "a command lag that is not modelled spoils the estimate; known, it does not",
        "0.1 s not modelled: "
        f"up to {100 * np.max(missed[:3] / TRUTH[:3]):.2f} % in the diagonal, "
        f"{1e3 * np.max(missed[3:6]):.2f}e-3 kg m² in the cross terms, "
        f"reduced χ² {chi2[k].mean():.1f}; "
        f"known: {100 * np.max(known[:3] / TRUTH[:3]):.3f} %, "
        f"{1e3 * np.max(known[3:6]):.2f}e-3 kg m² ({ratio:.1f} times the error without lag)",
        "yes; and it need not be known beforehand, fitted it costs nothing visible",
    )


def backup_claim(rows: list[list[str]]) -> Claim:
    """A switch to the backup wheel, from the rows of `backup`."""
    return (
        "after a switch to a backup wheel an estimate that absorbed a torque error is wrong",
        f'largest tracking error in a 30 deg slew {rows[1][2]}" with the old wheel, '
        f'{rows[2][2]}" with the backup, {rows[3][2]}" with the true J; '
        f'final error {rows[1][3]}", {rows[2][3]}", {rows[3][3]}"',
        "yes during the slew, **no** at its end: "
        "feedback removes the torque error, the correction slew does not know which wheel was used",
    )


def tables(rms: dict[str, np.ndarray], k: int, rows: list[list[str]]) -> list[Table]:
    """Errors with lag number k, and the slews with either wheel."""
    return [
        Table(
            "Error of each parameter with 0.1 s lag (rms over flights; J in kg m²)",
            ("", "not modelled", "known", "fitted"),
            [[n, *(f"{rms[kind][k, i]:.2e}" for kind in rms)] for i, n in enumerate(NAMES)],
        ),
        Table(
            "A 30 degree slew about x; wheel x delivers 3 % too much, its backup what it should "
            "(mean ± sd of 12 flights)",
            (
                "controller believes",
                "error of its Jxx",
                "largest tracking error [arcsec]",
                "final error [arcsec]",
            ),
            rows,
        ),
    ]


FIGURES = [
    (
        "claim_torque_gain.png",
        "Error of J and K about the axis of a wheel that delivers more or less than commanded "
        "(mean and ±2 sd over 3 flights)",
    ),
    (
        "claim_torque_lag.png",
        "A first-order lag of all wheel commands: errors (rms over 3 flights; bands: "
        "the flights) and misfit",
    ),
]
NOTES = [
    "Without tachometers the wheels' momentum is known only from the slews, and a fit that "
    "must imitate a torque error larger than about 3 % "
    "finds it cheaper to change the momenta, K and J together: "
    "at -5 % the error of Jxx jumps to about three times the torque error. "
    "The slopes are taken "
    "within 3 %.",
]


def analysis(quick: bool = False):
    """Gain, lag, backup wheel."""
    gains = np.array([0.0, 0.03]) if quick else np.array([-0.05, -0.025, 0.0, 0.025, 0.05])
    errors = gain_errors(gains, 1 if quick else 3, quick)
    small = np.abs(gains) < 0.04  # a tangent, not a chord
    slope = {
        kind: float(np.polyfit(gains[small], e[small, :, 0].mean(1), 1)[0])
        for kind, e in errors.items()
    }
    numbers = {f"slope {kind}": value for kind, value in slope.items()}
    pictures = {"claim_torque_gain.png": gain_picture(gains, errors)}
    if quick:
        return Result(NAME, "Torque errors", [("", "", "")], (), (), (), numbers), pictures
    lags = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.4])
    lagged = lag_errors(lags, 3)
    pictures["claim_torque_lag.png"] = lag_picture(lags, lagged)
    rows = backup(0.03, 12)
    rms = {
        kind: np.sqrt(np.mean(np.square(lagged[kind]), axis=1))
        for kind in ("not modelled", "known", "fitted")
    }
    k = int(np.flatnonzero(lags == 0.1)[0])
    return Result(
        NAME,
        "Torque errors: gain, lag, backup wheel",
        [gain_claim(slope), lag_claim(rms, lagged["chi2"], k), backup_claim(rows)],
        tables(rms, k, rows),
        FIGURES,
        NOTES,
        numbers,
    ), pictures


if __name__ == "__main__":
    run(__doc__, analysis)
