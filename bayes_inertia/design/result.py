"""Result of `design_plan`: the plan, and what to expect of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from bayes_inertia.design.goals import Goal
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import Margin, broken_limits
from bayes_inertia.flight.plan import Plan, slews_card
from bayes_inertia.maths.printed import Card, counted, exponent, number, shown_as, unit_text


def _card(design: Design) -> Card:
    """The slews to fly, and what they gain."""
    plan, limits = design.plan, "kept" if design.kept else "broken"
    power = exponent(design.value, 0.0)
    value = f"{number(design.value, design.value, power)} {unit_text(design.goal.unit, power)}"
    gain, better = design.gain, "better" if design.gain >= 1.0 else "worse"
    lines = (
        f"Design of {counted(len(plan.slews), 'slew')} for {design.goal}: {value}, limits {limits}",
        f"{max(gain, 1.0 / gain):.2g} times {better} than slews like the paper's in the same time",
    )
    return replace(slews_card(plan), lines=lines)


@shown_as(_card)
@dataclass(frozen=True)
class Design:
    """A designed plan and what to expect of it.

    Parameters
    ----------
    plan : Plan
        To be flown.
    goal : Goal
        What it was designed for.
    limits : Limits
        What it had to respect.
    seed : int
        Of the search.
    reference : Plan
        Slews like the paper's in the same time and limits.
    value : float
        The goal's number for the plan, geometric mean over draws of J and K, in the goal's unit.
    reference_value : float
        The same for `reference`.
    best_random : float
        The smallest number among the feasible random plans; NaN if there was none.
    random_plans : int
        How many of the random plans were feasible.
    sd : dict of str to float
        {parameter: expected sd} of the motion as planned, root mean square over draws of J and K.
        Of parameters that hardly any slew shows, real flights tell more, see `expected_sd`.
    reference_sd : dict of str to float
        The same for `reference`.
    sd_before : dict of str to float
        {parameter: sd} before the plan is flown: of the prior, or of the campaign that counts.
    units : dict of str to str
        {parameter: unit of its sds}.
    margins : tuple of Margin
        What the planned motion leaves of every limit.
    flown : tuple of Margin
        The tightest of flights with noise, truths drawn from what is known.
    active : tuple of str
        Limits that hold the design back.
    history : tuple of tuple of float
        The (smooth) number during each descent.
    seconds : float
        Wall time of the design [s].
    """

    plan: Plan
    goal: Goal
    limits: Limits
    seed: int
    reference: Plan
    value: float
    reference_value: float
    best_random: float
    random_plans: int
    sd: dict[str, float]
    reference_sd: dict[str, float]
    sd_before: dict[str, float]
    units: dict[str, str]
    margins: tuple[Margin, ...]
    flown: tuple[Margin, ...]
    active: tuple[str, ...]
    history: tuple[tuple[float, ...], ...]
    seconds: float

    @property
    def gain(self) -> float:
        """Gain over slews like the paper's, in the goal's number."""
        return self.reference_value / self.value

    @property
    def kept(self) -> bool:
        """Whether every limit was kept, planned and in every flight."""
        return not broken_limits((*self.margins, *self.flown))
