"""How well the diagnosis names hidden effects: every campaign simulated and diagnosed.

    python -m analyses.naming.fixed_shape --kind clean --count 200 [--jobs 2]

Every campaign has its own J, K, bias, start attitude, angles and senses of its slews, and wheel
momenta, drawn from the prior, and is flown in closed loop with the hidden effect. The amplitude is
set by the ideal test: the non-centrality of the hidden effect's score, from its sensitivities
projected off everything that is fitted, in the same campaign without it. The kind `strong` flies
each effect at 3, 10 and 30 times that amplitude; what is not physical there (`physical_limits`) is
skipped, and its row says why. Results are one line a
campaign, in the order of the campaigns; until all are there they are kept in `--work`, and a
killed study goes on where it was.
`fixed_shape_page.py` makes the page of them.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from analyses import results_of
from analyses.naming.fixed_shape_campaigns import (
    LARGEST_AMPLITUDE,
    amplitude_for,
    degrees_of_freedom,
    direction,
    draw,
    ideal_powers,
    noncentrality,
    scaled,
    template_campaign,
    unit_step,
    without_tachometers,
)
from analyses.naming.physical_limits import why_not_flown, why_not_physical
from analyses.naming.second_simulator import (
    Deadband,
    Disturbance,
    Leak,
    RateSquared,
    Ripple,
    Swirl,
    Wander,
    replayed,
)
from bayes_inertia.diagnosis.limits import Rules
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.diagnosis.residuals import held_out_chi2
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.work import Row, Work

FOLDER = results_of(__file__)
RULES = Rules()
# Effects without a trace in these campaigns: fixes are taken at rest, their time does not matter.
INVISIBLE = ("star_tracker_time_offset",)
NAMES = tuple(e.name for e in LIBRARY if e.name not in INVISIBLE)


# Disturbances outside the library, flown by another simulator, at sizes that leave chi^2 some
# hundreds too large.
KINDS = ("clean", "single", "strong", "outside", "pair", "triple")
# Kinds with several effects at once.
TOGETHER = {"pair": 2, "triple": 3}
# Of the kind `strong`: times the amplitude that is easily found.
FACTORS = (3, 10, 30)
# Between an effect's name and its factor, in the label of a strong one.
_TIMES = "*"

OUTSIDE: dict[str, Disturbance] = {
    "outside_swirl": Swirl(2e-6),
    "outside_leak": Leak(4e-6),
    "outside_rate_squared": RateSquared(3e-7),
    "outside_ripple": Ripple(1e-5),
    "outside_deadband": Deadband(1e-5),
    "outside_wander": Wander(4e-4),
}


@dataclass(frozen=True)
class Case:
    """One campaign to be simulated: its kind, label, number and hidden effects."""

    kind: str
    label: str
    index: int
    effects: tuple[Effect, ...]
    tachometers: bool

    @property
    def seed(self) -> np.random.SeedSequence:
        """A fresh seed: one that has been drawn from gives other children."""
        key = (hash_of(self.kind + self.label), self.index, int(self.tachometers))
        if self.kind == "strong":
            # Names that end alike, as "wheel_misalignment" does, have one hash.
            key = (*key, NAMES.index(self.effects[0].name))
        return np.random.SeedSequence(20260, spawn_key=key)

    @property
    def factor(self) -> float:
        """Times the amplitude at the ideal test's power."""
        return float(self.label.partition(_TIMES)[2] or 1.0)

    @property
    def hidden(self) -> list[str]:
        """Names of what acts."""
        return [self.label] if self.label in OUTSIDE else [e.name for e in self.effects]


def run_one(case: Case, power: float, level: float) -> dict:
    """Simulate and diagnose one campaign."""
    hidden = hidden_in(case, power, level)
    row = {
        "kind": case.kind,
        "label": case.label,
        "index": case.index,
        "tachometers": case.tachometers,
        "hidden": case.hidden,
        "sizes": hidden.sizes,
    }
    if case.kind == "strong":
        row |= {"factor": case.factor, "prior_sds": hidden.prior_sds}
        reason = why_skipped(case, hidden)
        if reason:
            return row | {"skipped": reason}
    flight = draw(case.seed, case.effects, hidden.values, case.tachometers)
    campaign = flight.campaign
    if case.kind == "strong" and why_not_flown(flight):
        return row | {"skipped": why_not_flown(flight)}
    if case.label in OUTSIDE:
        campaign = replayed(flight, OUTSIDE[case.label], hidden.rng)
        campaign = campaign if case.tachometers else without_tachometers(campaign)
    began = time.perf_counter()
    diagnosis = diagnose(campaign, rules=RULES, seed=case.index)
    seconds = time.perf_counter() - began
    powers = None
    if len(case.effects) > 1:
        powers = ideal_powers(
            case.effects, hidden.directions, hidden.wanted, case.seed, case.tachometers, level
        )
    return row | {
        "ideal_powers": powers,
        **_summary(diagnosis, truth_of(flight)),
        "seconds": seconds,
    }


@dataclass(frozen=True)
class Hidden:
    """What acts in a campaign.

    `sizes` are multiples of `directions`, whose steps are about one prior sd; `prior_sds` is the
    largest distance of a parameter from its null in the template's prior sds. `wanted` are the
    non-centralities at the ideal test's power.
    """

    directions: dict
    wanted: list[float]
    sizes: dict[str, float]
    values: dict
    prior_sds: dict[str, float]
    rng: np.random.Generator


def hidden_in(case: Case, power: float, level: float) -> Hidden:
    """Draw directions and amplitudes of the hidden effects of a campaign."""
    # Not a child of the seed: the flight draws from those, and the effect's direction must not
    # follow its noise.
    rng = np.random.default_rng(np.random.SeedSequence(20261, spawn_key=case.seed.spawn_key))
    template = template_campaign()
    directions = {e.name: direction(e, rng, template) for e in case.effects}
    wanted = [noncentrality(power, degrees_of_freedom(e, template), level) for e in case.effects]
    sizes = {
        e.name: case.factor
        * amplitude_for(e, directions[e.name], of_test, case.seed, case.tachometers)
        for e, of_test in zip(case.effects, wanted, strict=True)
    }
    values = {name: scaled(directions[name], size) for name, size in sizes.items()}
    prior_sds = {
        e.name: sizes[e.name] * float(np.abs(unit_step(e, directions[e.name], template)).max())
        for e in case.effects
    }
    return Hidden(directions, wanted, sizes, values, prior_sds, rng)


def why_skipped(case: Case, hidden: Hidden) -> str:
    """Why a strong effect is not flown; empty if it is."""
    (effect,) = case.effects
    if hidden.sizes[effect.name] >= case.factor * LARGEST_AMPLITUDE:
        return f"{effect.name}: these slews hardly show it at any size"
    still = draw(case.seed, (), {}, case.tachometers)
    return why_not_physical(hidden.values, still.spacecraft.inertia_B)


def _summary(diagnosis: Diagnosis, truth: np.ndarray) -> dict:
    """What the diagnosis says, and how far J and K are from the truth."""
    z = (diagnosis.final.theta[:9] - truth) / diagnosis.final.sd[:9]
    return {
        "verdict": diagnosis.verdict,
        "why_unknown": diagnosis.why_unknown,
        "nameless_lead": diagnosis.nameless_lead if diagnosis.steps else None,
        "named": list(diagnosis.named),
        "ambiguous_with": [list(names) for names in diagnosis.ambiguous_with],
        "beyond_prior": [asdict(row) for row in diagnosis.beyond_prior],
        "hypotheses": [asdict(row) for row in diagnosis.hypotheses],
        "steps": [step.added for step in diagnosis.steps],
        "best": diagnosis.candidates[0].effect,
        "p_best": min(c.p_value for c in diagnosis.candidates),
        "limit": diagnosis.threshold,
        "max_abs_z": float(np.abs(z).max()),
        "max_abs_z_averaged": float(np.abs(quoted_z(diagnosis, truth)).max()),
        "chi2_inside": {
            channel: bool(test.interval[0] <= test.reduced_chi2 <= test.interval[1])
            for channel, test in diagnosis.tests.items()
            if test.reduced_chi2 is not None and test.interval is not None
        },
        "held_out": [held_out_chi2(diagnosis.base), held_out_chi2(diagnosis.final)],
    }


def truth_of(flight: Flight) -> np.ndarray:
    """J (six elements) and K of a flight."""
    J = flight.spacecraft.inertia_B
    return np.array(
        [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *flight.spacecraft.scale_factor]
    )


def quoted_z(diagnosis: Diagnosis, truth: np.ndarray) -> np.ndarray:
    """Distance of J and K from the truth [sd], with the uncertainty that is quoted for them."""
    quoted = quoted_parameters(diagnosis)
    return (quoted.mean - truth) / quoted.sd


def hash_of(text: str) -> int:
    """A number that does not depend on the interpreter's hash seed.

    >>> hash_of("a")
    97
    """
    return int.from_bytes(text.encode(), "big") % (2**31)


def tasks(kind: str, count: int) -> list[tuple[str, int, tuple[Effect, ...]]]:
    """(label, index, effects) of all campaigns of a kind."""
    library = {e.name: e for e in LIBRARY}
    if kind == "clean":
        return [("clean", i, ()) for i in range(count)]
    if kind == "single":
        return [(name, i, (library[name],)) for i in range(count) for name in NAMES]
    if kind == "strong":
        return [
            (f"{name}{_TIMES}{factor}", i, (library[name],))
            for i in range(count)
            for factor in FACTORS
            for name in NAMES
        ]
    if kind == "outside":
        return [(name, i, ()) for i in range(count) for name in OUTSIDE]
    rng = np.random.default_rng(5)
    sets = [rng.choice(len(NAMES), TOGETHER[kind], replace=False) for _ in range(count)]
    return [(kind, i, tuple(library[NAMES[k]] for k in chosen)) for i, chosen in enumerate(sets)]


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kind", choices=KINDS, required=True)
    parser.add_argument(
        "--count",
        type=int,
        required=True,
        help="campaigns (clean, pair, triple), or of each effect (single, strong, outside)",
    )
    parser.add_argument("--power", type=float, default=0.99)
    parser.add_argument(
        "--level",
        type=float,
        default=RULES.false_alarm_probability / len(NAMES),
        help="level of the ideal test",
    )
    parser.add_argument("--without-tachometers", action="store_true")
    parser.add_argument("--jobs", type=int, default=1, help="worker processes")
    parser.add_argument(
        "--work", type=Path, default=Path("run_diagnosis"), help="keeps rows of a killed study"
    )
    return parser.parse_args()


@dataclass(frozen=True)
class DiagnosedCase:
    """The task: one campaign simulated and diagnosed; its row is a line of JSON.

    The tasks of all kinds have ids "label/index".
    """

    kind: str
    tachometers: bool
    power: float
    level: float

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """The row. A case has its own seed, older than those of the engine."""
        label, _, number = task_id.partition("/")
        index = int(number)
        (effects,) = (
            e for name, i, e in tasks(self.kind, index + 1) if (name, i) == (label, index)
        )
        case = Case(self.kind, label, index, effects, self.tachometers)
        return {"line": json.dumps(_row(case, self.power, self.level))}


def main() -> None:
    """Simulate and diagnose what is missing."""
    options = arguments()
    tachometers = not options.without_tachometers
    measured = "tacho" if tachometers else "notacho"
    name = f"diagnosis_{options.kind}_{options.power:g}_{measured}"
    path = FOLDER / f"{name}.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    done = {(row["label"], row["index"]) for row in map(json.loads, lines)}
    wanted = [task[:2] for task in tasks(options.kind, options.count)]
    ids = tuple(f"{label}/{index}" for label, index in wanted if (label, index) not in done)
    if not ids:
        return
    task = DiagnosedCase(options.kind, tachometers, options.power, options.level)
    work = Work("campaigns", task, ids, options=asdict(task))
    execution = Execution(
        jobs=options.jobs, progress=lambda *told: print(*told, flush=True), notice=print
    )
    result = execution.run(work, options.work / name)
    lines += [row["line"] for row in result.rows]
    write_atomically(path, "".join(f"{line}\n" for line in lines))


def _row(case: Case, power: float, level: float) -> dict:
    try:
        return run_one(case, power, level)
    except BayesInertiaError as error:
        return {
            "kind": case.kind,
            "label": case.label,
            "index": case.index,
            "hidden": [e.name for e in case.effects],
            "error": str(error),
        }


if __name__ == "__main__":
    main()
