"""Limits that no plan can keep, found before any search."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from bayes_inertia.design.feasible_region import FeasibleRegion
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import Margin, broken_limits, planned_margins
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.errors import BayesInertiaError, DesignError
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.spacecraft import Spacecraft


def require_feasible(
    spacecraft: Spacecraft, base: Plan, region: FeasibleRegion, limits: Limits, n_slews: int
) -> None:
    """Raise for what no plan can keep."""
    require_three_axes(spacecraft, DesignError)
    smallest = PlannedSlew((1.0, 0.0, 0.0), region.angles[0], region.rate, region.acceleration)
    _require_time(replace(base, slews=(smallest,) * n_slews), limits)
    still = replace(smallest, angle=NUMERICS.negligible_angle)
    at_start = replace(base, slews=(still,))
    margins = planned_margins(at_start, spacecraft, limits)
    what = "broken before the first slew"
    advice = "start in another attitude, or with slower wheels"
    _require_rest(margins, ("keep-out", "momentum", "reach"), what, "start", advice)
    if limits.end_attitude is not None:
        at_end = replace(at_start, start_attitude=limits.end_attitude)
        what, advice = "the end attitude itself breaks a limit", "end in another attitude"
        margins = planned_margins(at_end, spacecraft, limits)
        _require_rest(margins, ("keep-out",), what, "limit end attitude", advice)


def require_three_axes(spacecraft: Spacecraft, error: type[BayesInertiaError]) -> None:
    """Raise where nothing turns the spacecraft about all axes."""
    axes, device = spacecraft.axes_of_control, spacecraft.device
    if axes < 3:
        turns = f"{device.record.name} turns" if device else "the wheels turn"
        raise error(
            f"{turns} the spacecraft about {axes} of three axes",
            where=device.record.name if device else "wheels",
            advice="slews are designed for three",
        )


def _require_time(shortest: Plan, limits: Limits) -> None:
    """An error where even the shortest plan lasts too long."""
    n, needed = len(shortest.slews), shortest.starts[-1] + shortest.durations[-1]
    allowed = limits.total_time
    if allowed is None or needed <= allowed + 1e-9:
        return
    short = math.ceil(needed - allowed)
    what = f"{n} slew{'s' if n > 1 else ''} need at least {math.ceil(needed)} s"
    raise DesignError(
        f"{what}, {allowed:.6g} s allowed ({short} s too few)",
        where="limit total time",
        advice="allow more time, or fewer slews",
    )


def _require_rest(
    margins: Sequence[Margin], kinds: tuple[str, ...], what: str, where: str, advice: str
) -> None:
    """An error where a rest itself breaks a limit of one of these kinds."""
    for margin in broken_limits([m for m in margins if m.limit.startswith(kinds)]):
        raise DesignError(f"{what}: {margin.says}", where=where, advice=advice)
