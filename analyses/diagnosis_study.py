"""How well the diagnosis names hidden effects: confusion matrix, power against the ideal test,
false alarms.

Every campaign has its own J, K, bias, start attitude, angles and senses of its slews, and wheel
momenta, drawn from the prior,
flown in closed loop with the hidden effect. The amplitude is set by the ideal test: the
non-centrality of the hidden
effect's score, from its sensitivities projected off everything that is fitted, in the same campaign
without it. Results are one line a
campaign in a file that is replaced atomically: a killed study goes on where it was.

    python analyses/diagnosis_study.py --kind clean --count 200
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from independent import Deadband, Disturbance, Leak, RateSquared, Ripple, Swirl, Wander, replayed
from scipy import optimize, stats

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.cross_validation import held_out_chi2
from bayes_inertia.diagnosis.model_averaging import alternative_parameters
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.score_test import score_tests
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate, move_to
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.forward_model import Model

HERE = Path(__file__).parent
FOLDER = HERE / "results"
RULES = Rules()
# Effects without a trace in these campaigns: fixes are taken at rest, so that their time stamps do
# not matter.
INVISIBLE = ("star_tracker_time_offset",)
NAMES = tuple(e.name for e in LIBRARY if e.name not in INVISIBLE)


# Disturbances outside the library, flown by another simulator, at sizes that leave chi^2 some
# hundreds too large.
OUTSIDE: dict[str, Disturbance] = {
    "outside_swirl": Swirl(2e-6),
    "outside_leak": Leak(4e-6),
    "outside_rate_squared": RateSquared(3e-7),
    "outside_ripple": Ripple(1e-5),
    "outside_deadband": Deadband(1e-5),
    "outside_wander": Wander(4e-4),
}


def plan() -> Plan:
    """Five slews like the paper's, at 2 Hz to keep the study short."""
    return replace(paper_like_plan(), telemetry_period=0.5)


def template_campaign():
    """The planned campaign: hardware, prior, and the scale of default priors."""
    return planned_campaign(plan(), most_like_mission())


def draw(
    seed: np.random.SeedSequence, effects: tuple[Effect, ...], values: dict, tachometers: bool
):
    """One campaign and its truth."""
    flight = draw_flight(template_campaign(), plan(), seed, effects=effects, values=values)
    return flight.campaign if tachometers else deaf(flight.campaign), flight


def deaf(campaign: Campaign) -> Campaign:
    """The campaign without tachometers."""
    wheels = tuple(replace(w, momentum_sigma=None) for w in campaign.wheels)
    return replace(
        campaign,
        wheels=wheels,
        slews=tuple(replace(s, wheel_momentum=None) for s in campaign.slews),
    )


def noncentrality(power: float, dof: int, level: float) -> float:
    """Non-centrality at which an ideal chi^2 test of this level has this power.

    >>> round(noncentrality(0.99, 1, 0.05), 1)
    18.4
    """
    limit = stats.chi2.isf(level, dof)
    return float(optimize.brentq(lambda nc: stats.ncx2.sf(limit, dof, nc) - power, 1e-3, 1e4))


def degrees_of_freedom(effect: Effect) -> int:
    """Of the ideal test of an effect: its parameters but those that only give it its shape."""
    return sum(
        len(p.names) for p in effect.parameters(template_campaign()) if not p.priors[0].logarithmic
    )


def direction(effect: Effect, rng: np.random.Generator) -> dict:
    """Values of an effect's parameters one prior sd from null in a random direction, shape
    parameters at their null.
    """
    parameters = effect.parameters(template_campaign())
    values = {}
    for p in parameters:
        step = rng.normal(size=len(p.names))
        if p.priors[0].lower == p.null:
            step = np.abs(step)
        if p.priors[0].logarithmic:
            step = np.zeros(len(p.names))
        values[p.name] = (p.null, step * np.array([q.sd for q in p.priors]), p.components)
    return values


def scaled(values: dict, size: float) -> dict:
    return {
        k: null + size * step if components else float(null + size * step[0])
        for k, (null, step, components) in values.items()
    }


def plain_fit(campaign: Campaign) -> Estimate:
    """The fit without effects, from as many starts as a user's: in a local optimum the
    sensitivities are others.
    """
    return estimate(Model(campaign), discount=False)


def amplitude_for(effect: Effect, values: dict, wanted: float, seed, tachometers: bool) -> float:
    """Multiple of `values` at which the projected signal has the wanted non-centrality."""
    without, _ = draw(seed, (), {}, tachometers)
    first = plain_fit(without)
    if effect.name == "flexible_mode":
        return mode_amplitude(effect, values, wanted, seed, first, tachometers)
    marks, step = (
        score_tests(move_to(first, Model(without, (effect,))), (effect.name,)),
        unit_step(effect, values, without),
    )
    return float(
        np.clip(np.sqrt(wanted / max(float(step @ marks.matrix @ step), 1e-12)), 1e-9, 30.0)
    )


def unit_step(effect: Effect, values: dict, campaign: Campaign) -> np.ndarray:
    """The step of `direction` in units of a campaign's prior sd, which may follow its rates."""
    sd = np.concatenate([[q.sd for q in p.priors] for p in effect.parameters(campaign)])
    return np.concatenate([step for _, step, _ in values.values()]) / sd


def mode_amplitude(
    effect: Effect, values: dict, wanted: float, seed, first: Estimate, tachometers: bool
) -> float:
    """As `amplitude_for`, for a flexible mode, whose signal is of second order in its coupling: by
    simulation.
    """
    size = 0.5
    for _ in range(3):
        with_it, _ = draw(seed, (effect,), {effect.name: scaled(values, size)}, tachometers)
        size *= (wanted / max(projected_difference(with_it, first), 1e-12)) ** 0.25
        size = float(np.clip(size, 1e-9, 4.0))
    return size


def ideal_powers(
    effects: tuple[Effect, ...],
    values: dict,
    wanted: list[float],
    seed,
    tachometers: bool,
    level: float,
) -> list[float]:
    """Power of an ideal test for each of two effects once the other is fitted too, if alone each
    has the wanted non-centrality.

    Of a flexible mode, whose signal is of second order, nothing is taken off: its power is an upper
    bound.
    """
    without, _ = draw(seed, (), {}, tachometers)
    first = plain_fit(without)
    marks = score_tests(
        move_to(first, Model(without, effects)),
        tuple(e.name for e in effects if e.name != "flexible_mode"),
    )
    steps, kept = [], []
    for effect, nc in zip(effects, wanted, strict=True):
        steps.append(unit_step(effect, values[effect.name], without))
        kept.append(nc)
    if len(marks.names) == 2:
        for i, j in ((0, 1), (1, 0)):
            own, other = marks.indices[i], marks.indices[j]
            alone = marks.matrix[np.ix_(own, own)]
            cross = marks.matrix[np.ix_(own, other)]
            apart = (
                alone
                - cross
                @ np.linalg.pinv(marks.matrix[np.ix_(other, other)], rcond=1e-9, hermitian=True)
                @ cross.T
            )
            kept[i] = (
                wanted[i] * float(steps[i] @ apart @ steps[i]) / float(steps[i] @ alone @ steps[i])
            )
    dofs = [degrees_of_freedom(e) for e in effects]
    return [
        float(stats.ncx2.sf(stats.chi2.isf(level, dof), dof, max(nc, 0.0)))
        for dof, nc in zip(dofs, kept, strict=True)
    ]


def projected_difference(with_it, first: Estimate) -> float:
    """|P (y1 - y0)|^2 for two campaigns with equal noise: what is left of their difference after
    fitting J, K, bias and starts.
    """
    second = plain_fit(with_it)
    # Both hold the same noise e: their residuals are P e and P (e + s).
    gaps = [
        np.concatenate(
            [np.nan_to_num(x).ravel() for slews in at.residual_series.values() for x in slews]
        )
        for at in (first, second)
    ]
    return float(np.sum((gaps[1] - gaps[0]) ** 2))


def _truth(flight) -> np.ndarray:
    J = flight.spacecraft.inertia_B
    return np.array(
        [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *flight.spacecraft.scale_factor]
    )


def averaged_z(found: Diagnosis, truth: np.ndarray) -> np.ndarray:
    """Distance of J and K from the truth [sd], averaged over the effects of an ambiguous set."""
    others = alternative_parameters(found)
    weights = np.array(
        [1.0 - sum(o.probability for o in others), *(o.probability for o in others)]
    )[:, None]
    means = np.array([found.final.theta[:9], *(o.mean for o in others)])
    variances = np.array([found.final.sd[:9] ** 2, *(o.sd**2 for o in others)])
    mean = (weights * means).sum(0)
    return (mean - truth) / np.sqrt((weights * (variances + (means - mean) ** 2)).sum(0))


def run_one(
    kind: str,
    label: str,
    index: int,
    effects: tuple[Effect, ...],
    tachometers: bool,
    power: float,
    level: float,
) -> dict:
    """Simulate and diagnose one campaign."""
    seed = np.random.SeedSequence(20260, spawn_key=(hash_of(kind + label), index, int(tachometers)))
    # Not a child of `seed`: the flight draws from those, and the effect's direction must not follow
    # its noise.
    rng = np.random.default_rng(np.random.SeedSequence(20261, spawn_key=seed.spawn_key))
    values, sizes, wanted, drawn = {}, {}, [], {}

    def fresh() -> np.random.SeedSequence:
        return np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key)

    for effect in effects:
        drawn[effect.name] = direction(effect, rng)
        wanted.append(noncentrality(power, degrees_of_freedom(effect), level))
        sizes[effect.name] = amplitude_for(
            effect, drawn[effect.name], wanted[-1], fresh(), tachometers
        )
        values[effect.name] = scaled(drawn[effect.name], sizes[effect.name])
    campaign, flight = draw(fresh(), effects, values, tachometers)
    if label in OUTSIDE:
        campaign = replayed(flight, OUTSIDE[label], rng)
        campaign = campaign if tachometers else deaf(campaign)
    began = time.perf_counter()
    found = diagnose(campaign, rules=RULES, seed=index)
    seconds = time.perf_counter() - began
    z = (found.final.theta[:9] - _truth(flight)) / found.final.sd[:9]
    return {
        "kind": kind,
        "label": label,
        "index": index,
        "tachometers": tachometers,
        "hidden": [label] if label in OUTSIDE else [e.name for e in effects],
        "sizes": sizes,
        "ideal_powers": ideal_powers(effects, drawn, wanted, fresh(), tachometers, level)
        if kind == "pair"
        else None,
        "verdict": found.verdict,
        "why_unknown": found.why_unknown,
        "nameless_lead": found.nameless_lead if found.steps else None,
        "named": list(found.named),
        "ambiguous_with": [list(s) for s in found.ambiguous_with],
        "steps": [s.added for s in found.steps],
        "best": found.candidates[0].effect,
        "p_best": min(c.p_value for c in found.candidates),
        "limit": found.threshold,
        "max_abs_z": float(np.abs(z).max()),
        "max_abs_z_averaged": float(np.abs(averaged_z(found, _truth(flight))).max()),
        "chi2_inside": {
            c: bool(t.interval[0] <= t.reduced_chi2 <= t.interval[1])
            for c, t in found.tests.items()
            if t.reduced_chi2 is not None
        },
        "held_out": [held_out_chi2(found.base), held_out_chi2(found.final)],
        "seconds": seconds,
    }


def hash_of(text: str) -> int:
    """A number that does not depend on the interpreter's hash seed.

    >>> hash_of("a")
    97
    """
    return int.from_bytes(text.encode(), "big") % (2**31)


def tasks(kind: str, count: int):
    """(label, index, effects) of all campaigns of a kind."""
    library = {e.name: e for e in LIBRARY}
    if kind == "clean":
        return [("clean", i, ()) for i in range(count)]
    if kind == "single":
        return [(name, i, (library[name],)) for i in range(count) for name in NAMES]
    if kind == "outside":
        return [(name, i, ()) for i in range(count) for name in OUTSIDE]
    rng = np.random.default_rng(5)
    pairs = [tuple(rng.choice(len(NAMES), 2, replace=False)) for _ in range(count)]
    return [("pair", i, tuple(library[NAMES[k]] for k in pair)) for i, pair in enumerate(pairs)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kind", choices=["clean", "single", "outside", "pair"], required=True)
    parser.add_argument(
        "--count",
        type=int,
        required=True,
        help="campaigns (clean, pair) or campaigns of each effect (single, outside)",
    )
    parser.add_argument("--power", type=float, default=0.99)
    parser.add_argument(
        "--level",
        type=float,
        default=RULES.false_alarm_probability / len(NAMES),
        help="level of the ideal test",
    )
    parser.add_argument("--without-tachometers", action="store_true")
    parser.add_argument("--minutes", type=float, default=60.0, help="stop after this time")
    arguments = parser.parse_args()
    tachometers = not arguments.without_tachometers
    measured = "tacho" if tachometers else "notacho"
    path = FOLDER / f"diagnosis_{arguments.kind}_{arguments.power:g}_{measured}.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {(row["label"], row["index"]) for row in rows}
    end = time.time() + 60.0 * arguments.minutes
    for label, index, effects in tasks(arguments.kind, arguments.count):
        if (label, index) in done:
            continue
        if time.time() > end:
            print("time is up; run again to go on")
            break
        try:
            row = run_one(
                arguments.kind, label, index, effects, tachometers, arguments.power, arguments.level
            )
        except BayesInertiaError as error:
            row = {
                "kind": arguments.kind,
                "label": label,
                "index": index,
                "hidden": [e.name for e in effects],
                "error": str(error),
            }
        rows.append(row)
        write_atomically(path, "".join(json.dumps(r) + "\n" for r in rows))
        print(
            label,
            index,
            row.get("verdict"),
            row.get("named"),
            row.get("ambiguous_with"),
            f"{row.get('seconds', 0):.1f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
