"""The candidate effects: which of a library can be tried in a campaign, and how each scores."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.flexible_mode_search import best_flexible_mode
from bayes_inertia.diagnosis.result import Candidate
from bayes_inertia.diagnosis.score_test import ScoreTests, score_tests, unfitted
from bayes_inertia.diagnosis.torque_response import TorqueResponse, torque_response
from bayes_inertia.errors import EffectError
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import FlexibleMode

FLEXIBLE_MODE = "flexible_mode"


@dataclass(frozen=True)
class CandidateEffects:
    """The effects of a library that a campaign's columns allow.

    Parameters
    ----------
    linear : tuple of Effect
        Effects whose signal is of first order in their parameters. One model holds them all.
    flexible_mode : FlexibleMode or None
        Its signal is of second order in its coupling: it is searched by itself.
    skipped : tuple of (str, str)
        Names of effects that cannot be tried, and why.
    """

    linear: tuple[Effect, ...]
    flexible_mode: FlexibleMode | None
    skipped: tuple[tuple[str, str], ...]


def candidate_effects(campaign: Campaign, library: Sequence[Effect]) -> CandidateEffects:
    """Sort a library into what a campaign allows and what it does not.

    `campaign`: what was flown. An effect needs its columns in every slew.
    """
    _check_names(library)
    missing = {
        effect.name: [
            column
            for column in effect.needs
            if any(_is_empty(getattr(slew, column)) for slew in campaign.slews)
        ]
        for effect in library
    }
    skipped = tuple(
        (name, f"needs {', '.join(columns)} in every slew")
        for name, columns in missing.items()
        if columns
    )
    usable = [effect for effect in library if not missing[effect.name]]
    return CandidateEffects(
        tuple(effect for effect in usable if not isinstance(effect, FlexibleMode)),
        next((effect for effect in usable if isinstance(effect, FlexibleMode)), None),
        skipped,
    )


def _check_names(library: Sequence[Effect]) -> None:
    for name, times in Counter(effect.name for effect in library).items():
        if times > 1:
            raise EffectError(
                f"{times} candidates have this name",
                where=name,
                advice="give them names of their own, or diagnose with one at a time",
            )
    for effect in library:
        if effect.name == FLEXIBLE_MODE and not isinstance(effect, FlexibleMode):
            raise EffectError(
                "only one mode shared by all slews can be a candidate",
                where=FLEXIBLE_MODE,
                advice="give a FlexibleMode itself",
            )


def _is_empty(column: np.ndarray | None) -> bool:
    return column is None or not np.isfinite(column).all(axis=-1).any()


def score_candidates(
    estimate: Estimate,
    flexible_mode: FlexibleMode | None = None,
    fit: LinearisedFit | None = None,
    response: TorqueResponse | None = None,
) -> ScoreTests:
    """Score everything that is not fitted yet.

    `estimate`: A fit whose model holds the linear candidates at their null. `flexible_mode`: A
    further candidate, unless the model holds a mode already.
    """
    waiting = unfitted(estimate)
    held = any(effect.name == FLEXIBLE_MODE for effect in estimate.model.effects)
    if flexible_mode is None or held:
        return score_tests(estimate, waiting, fit=fit)
    coupling_sd = flexible_mode.parameters(estimate.model.campaign)[0].priors[0].sd
    fit, response = fit or estimate.linearised(), response or torque_response(estimate)
    mode = best_flexible_mode(FLEXIBLE_MODE, response, fit, coupling_sd**2)
    return score_tests(estimate, waiting, (mode,), fit)


def ranked_candidates(tests: ScoreTests) -> tuple[Candidate, ...]:
    """List all candidates, best evidence first."""
    scores = [float(tests.score(k)) for k in range(len(tests.names))]
    rows = [
        Candidate(
            effect=name,
            dof=tests.dof(k),
            score=score,
            p_value=float(tests.p_value(k, np.asarray(score))),
            log_bayes_factor=tests.log_bayes_factor(k),
        )
        for k, (name, score) in enumerate(zip(tests.names, scores, strict=True))
    ]
    return tuple(sorted(rows, key=lambda row: -row.log_bayes_factor))
