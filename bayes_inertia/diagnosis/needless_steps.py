"""Effects of a search that are not needed before one without a fixed shape.

Where the misfit is large a fit without any effect is far from the truth, and evidence to first
order around it is rough. So the effect without a fixed shape is fitted in full without the steps
before it, and fits are compared by evidence around themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import batched
from typing import NamedTuple

from bayes_inertia.diagnosis.evidence import log_evidence_of_fit
from bayes_inertia.diagnosis.prior_of_sets import cost_of_further
from bayes_inertia.diagnosis.random_refits import without_effects
from bayes_inertia.diagnosis.result import Step
from bayes_inertia.diagnosis.stochastic_candidates import StochasticCandidate
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths.at_once import at_once

# Log evidence that a fit loses without the last step beyond which it would lose it without more
# steps, too: these explain no more, and their fewer parameters gain tens at most.
_HOPELESS = 100.0


class _Refit(NamedTuple):
    """A fit with a step's effect but without the steps from `first` on.

    `gain` is its log evidence against that with them, `lead` what is left with what they cost.
    """

    first: int
    after: Estimate
    gain: float
    lead: float


def without_needless_steps(
    before: Sequence[Step],
    step: Step,
    weighed: Sequence[Sequence[StochasticCandidate]],
    members: int,
) -> tuple[int, Step]:
    """Leave out the steps that one without a fixed shape makes needless.

    A refit stays if it loses less than the steps that it leaves out cost. If one step less is far
    too much already, less than that is not tried. Refits are made two at a time.

    `weighed`: at the fit before each step of the search and after the last. `members`: how many
    effects there were to choose from; "no name" is one of them. Returns `kept`: how many of the
    steps before are needed; `step`: the step after these. The shapes without a name that stand
    beside it are not changed.
    """
    if step.alternatives or not before:
        return len(before), step
    last = len(before) - 1
    same = {k: c for k in range(len(before)) for c in weighed[k] if c.effect == step.added}

    def without_steps_from(k: int) -> _Refit:
        after, gain = _refit_without(before[k:], step, same[k])
        return _Refit(k, after, gain, gain + cost_of_further(k + 1, len(before) - k, members))

    tried = [without_steps_from(last)] if last in same else []
    if tried and tried[0].lead < -_HOPELESS:
        return len(before), step
    for pair in batched((k for k in same if k < last), 2):
        tried += at_once([partial(without_steps_from, k) for k in pair])
        if any(refit.lead > 0.0 for refit in tried[-len(pair) :]):
            break
    least = min((r for r in tried if r.lead > 0.0), key=lambda r: r.first, default=None)
    if least is None:
        return len(before), step
    return least.first, _in_place(least, before[least.first :], step)


def _in_place(refit: _Refit, left_out: Sequence[Step], step: Step) -> Step:
    """The step with a refit; it claims what the steps that it leaves out did, too."""
    return replace(
        step,
        before=left_out[0].before,
        after=refit.after,
        log_bayes_factor=sum(s.log_bayes_factor for s in (*left_out, step)) + refit.gain,
    )


def _refit_without(
    left_out: Sequence[Step], step: Step, same: StochasticCandidate
) -> tuple[Estimate, float]:
    """A fit with a step's effect without the steps before it, and what it gains by that."""
    fitted = without_effects(
        step.after, {s.added for s in left_out}, left_out[0].before, {step.added: same.start}
    )
    return fitted, log_evidence_of_fit(fitted) - log_evidence_of_fit(step.after)
