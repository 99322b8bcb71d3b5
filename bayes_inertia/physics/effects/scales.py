"""The sizes that default priors are measured in, so that one library serves satellites and thrown test bodies.

With typical rate w, duration T and inertia J of a campaign, J w / T is the torque that would make or
stop the observed motion within one slew: disturbances are stated as fractions of it.
"""

from __future__ import annotations

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.parameters import Parameter, Prior, vector


def torque_scale(campaign: Campaign) -> float:
    """J w / T [N m].

    >>> import numpy as np
    >>> from bayes_inertia.campaign.hardware import RateSensor
    >>> from bayes_inertia.campaign.inertia_prior import InertiaPrior
    >>> from bayes_inertia.campaign.slew import Slew
    >>> slew = Slew("a", 0.0, np.array([0.0, 10.0]), rate=np.array([[0.1, 0.0, 0.0]] * 2))
    >>> round(torque_scale(Campaign("c", InertiaPrior(2.0 * np.eye(3), 0.1, 0.1), (), RateSensor(sigma=1e-5), None, (slew,))), 9)
    0.02
    """
    rate, duration, inertia = campaign.scale_of_motion()
    return inertia * rate / duration


def per_wheel(
    campaign: Campaign, name: str, *, unit: str, prior: Prior, null: float = 0.0
) -> tuple[Parameter, ...]:
    """One parameter with a component a wheel; none for a campaign without wheels (hooks then get an empty `p`)."""
    names = [wheel.name for wheel in campaign.wheels]
    return (vector(name, names, unit=unit, prior=prior, null=null),) if names else ()
