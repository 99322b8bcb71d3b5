"""Two effects that five slews cannot tell apart, and slews designed to separate them."""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import replace

import numpy as np
from scipy import linalg

from analyses.design.cases import CRAFT, MISSION, PRIOR, ROOT, plan_for
from bayes_inertia.design.comparison import estimate_at_truth
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.score_test import ScoreTests, score_tests
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.spacecraft import (
    Spacecraft,
)
from bayes_inertia.inference.optimizer import move_to
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import ParameterSpace

# A pair that slews like the paper's show nearly alike.
PAIRS = (("constant_torque", "star_tracker_shift"),)
# A pair that no slew tells apart without tachometers.
HOPELESS = ("wheel_command_lag", "rate_sensor_delay")
# Non-centrality of a hidden effect in five slews like the paper's, everything else fitted.
# An ideal test of three components, at the level of one candidate's share of the false alarms,
# finds it with probability 0.99.
STRENGTH = 30.0


def told_apart(seeds: int) -> dict:
    """Verdicts of `diagnose` where either effect of a pair is hidden.

    The campaigns: slews like the paper's, more of them, and with slews designed for the pair.
    """
    pairs: dict[str, dict] = {}
    for pair in PAIRS:
        plans, scores = _plans_and_scores(pair, CRAFT)
        correlations = {
            label: {"canonical_correlation": scores[label].canonical_correlation(0, 1)}
            for label in plans
        }
        verdicts = [
            _verdict(label, plan, _with_hidden(effect, scores["paper"], seed), effect.name, seed)
            for label, plan in plans.items()
            for effect in by_name(pair)
            for seed in range(seeds)
        ]
        pairs[",".join(pair)] = {"plans": correlations, "verdicts": verdicts}
    _, scores = _plans_and_scores(HOPELESS, without_tachometers())
    hopeless = {label: tests.canonical_correlation(0, 1) for label, tests in scores.items()}
    return {"pairs": pairs, "hopeless": hopeless}


def _with_hidden(effect: Effect, scores: ScoreTests, seed: int) -> Spacecraft:
    return replace(CRAFT, effects=(effect,), values=_hidden(effect, scores, seed))


def _hidden(effect: Effect, scores: ScoreTests, seed: int) -> dict:
    """Values {effect: {parameter: value}} of that strength in the least favourable direction.

    It is the direction that the alternative effect imitates best, by the score tests given.
    """
    k = scores.names.index(effect.name)
    hidden, alternative = scores.indices[k], scores.indices[1 - k]
    information = scores.matrix[np.ix_(hidden, hidden)]
    cross = scores.matrix[np.ix_(hidden, alternative)]
    inverse = np.linalg.pinv(
        scores.matrix[np.ix_(alternative, alternative)], rcond=1e-9, hermitian=True
    )
    imitated = cross @ inverse @ cross.T
    direction = linalg.eigh(imitated, information)[1][:, -1] * (-1.0) ** seed
    campaign = planned_campaign(replace(paper_like_plan(), telemetry_period=0.5), MISSION)
    space = ParameterSpace(tuple((effect.name, p) for p in effect.parameters(campaign)))
    step = direction * np.sqrt(STRENGTH / (direction @ information @ direction)) * space.sd
    values = space.split(step)[effect.name]
    return {effect.name: {name: np.asarray(value) for name, value in values.items()}}


def _plans_and_scores(
    pair: tuple[str, str], craft: Spacecraft
) -> tuple[dict[str, Plan], dict[str, ScoreTests]]:
    """Plans by name, and the score tests of the pair in each.

    The plans: slews like the paper's alone, twice, and with those designed to separate the pair.
    """
    tag = "" if craft is CRAFT else "_deaf"
    paper, designed = paper_like_plan(), plan_for(f"separate:{','.join(pair)}", craft, tag=tag)
    slews_of = {
        "paper": paper.slews,
        "paper twice": paper.slews + paper.slews,
        "paper and designed": paper.slews + designed.slews,
    }
    plans = {
        label: replace(paper, slews=slews, telemetry_period=0.5)
        for label, slews in slews_of.items()
    }
    return plans, {label: _score_tests(plan, craft, pair) for label, plan in plans.items()}


def _score_tests(plan: Plan, craft: Spacecraft, pair: tuple[str, str]) -> ScoreTests:
    """Score tests of two effects in a flight without them."""
    plain = estimate_at_truth(plan, Mission(craft, PRIOR), controller=MISSION.controller())
    both = move_to(plain, Model(plain.model.campaign, by_name(pair)))
    return score_tests(linear_model(both))


def _verdict(label: str, plan: Plan, craft: Spacecraft, hidden: str, seed: int) -> dict:
    """What `diagnose` says of one campaign; kept in a file of its own."""
    identity = repr((plan.slews, hidden, str(craft.values[hidden])))
    digest = hashlib.sha256(identity.encode()).hexdigest()[:8]
    path = ROOT / "run_design" / f"verdict_{label.replace(' ', '_')}_{hidden}_{digest}_{seed}.json"
    if not path.exists():
        diagnosis = diagnose(fly(plan, Mission(craft, PRIOR), 500 + seed).campaign, seed=seed)
        row = {
            "plan": label,
            "hidden": hidden,
            "seed": seed,
            "verdict": diagnosis.verdict,
            "named": diagnosis.named,
            "ambiguous": diagnosis.ambiguous_with,
            "evidence": [(step.added, step.log_bayes_factor) for step in diagnosis.steps],
        }
        path.parent.mkdir(exist_ok=True)
        write_atomically(path, json.dumps(row) + "\n")
        print(row, file=sys.stderr)
    return json.loads(path.read_text())


def without_tachometers() -> Spacecraft:
    """The same spacecraft without tachometers."""
    return replace(CRAFT, wheels=tuple(replace(w, momentum_sigma=None) for w in CRAFT.wheels))
