"""What the fit of a campaign knows about where the next one begins."""

from __future__ import annotations

import numpy as np

from bayes_inertia.flight.follow_on import following_plan
from bayes_inertia.flight.plan import Plan
from bayes_inertia.inference.laplace import Estimate


def plan_after(estimate: Estimate) -> Plan:
    """A plan of one slew, yet to be chosen, that begins where the fitted campaign ended.

    Parameters
    ----------
    estimate : Estimate
        The fit of that campaign. It tells the wheel momentum where no tachometer does.

    Returns
    -------
    Plan
        See `following_plan`.
    """
    return following_plan(estimate.model.campaign, final_wheel_momentum(estimate))


def final_wheel_momentum(estimate: Estimate) -> np.ndarray:
    """Wheel momentum at the end of a fitted campaign.

    The fit holds the momentum at the first row of each slew. The torque commands since then change
    it: H' = u, with the body at rest at both ends of the slew (Ferguson's equation 6).

    Parameters
    ----------
    estimate : Estimate
        The fit of the campaign.

    Returns
    -------
    (wheels,) array
        Momentum relative to the body [N m s]. With the measured drive, which needs tachometers,
        that of the last slew's first row.
    """
    model = estimate.model
    slew, wheels = model.campaign.slews[-1], len(model.campaign.wheels)
    start = np.asarray(model.data.arrays.reference.wheel_momentum)[-1].copy()
    if model.structure.drive == "measured" or slew.wheel_torque is None:
        return start
    scale = np.asarray(model.data.scale.local)[6 : 6 + wheels]
    start += estimate.point.local[-1, 6 : 6 + wheels] * scale
    return start + np.diff(slew.time) @ slew.wheel_torque[:-1]
