"""The sizes that default priors are measured in.

One library serves satellites and thrown test bodies. With typical rate w, duration T and inertia J
of a campaign, J w / T is the torque that would make or stop the observed motion within one slew:
disturbances are stated as fractions of it.
"""

from __future__ import annotations

from collections.abc import Sequence

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor, axis_names
from bayes_inertia.physics.parameters import LogNormal, Parameter, Prior, scalar, vector


def torque_scale(campaign: Campaign) -> float:
    """The torque J w / T that would make or stop the observed motion within one slew.

    `campaign`: the campaign that tells typical rate w, duration T and inertia J. Returns [N m].

    Examples
    --------
    >>> import numpy as np
    >>> from bayes_inertia.campaign.hardware import RateSensor
    >>> from bayes_inertia.campaign.hardware import InertiaPrior
    >>> from bayes_inertia.campaign.slew import Slew
    >>> slew = Slew("a", 0.0, np.array([0.0, 10.0]), rate=np.array([[0.1, 0.0, 0.0]] * 2))
    >>> prior = InertiaPrior(2.0 * np.eye(3), 0.1, 0.1)
    >>> campaign = Campaign("c", prior, (), RateSensor(sigma=1e-5), None, (slew,))
    >>> round(torque_scale(campaign), 9)
    0.02
    """
    rate, duration, inertia = campaign.scale_of_motion()
    return inertia * rate / duration


def gyro_of(campaign: Campaign, device: str) -> RateSensor:
    """The rate sensor that an effect acts on: the first where it names none."""
    return campaign.sensors[device] if device else campaign.gyro


def rate_axes(campaign: Campaign | None, device: str = "") -> Sequence[str]:
    """Names of a rate sensor's axes: x, y and z of three, else 1 to n; none without one.

    Examples
    --------
    >>> rate_axes(None)
    ('x', 'y', 'z')
    """
    if campaign is None:
        return tuple("xyz")
    return axis_names(campaign.sensors[device] if device else campaign.rate_sensor)


def per_wheel(
    campaign: Campaign, name: str, *, unit: str, prior: Prior, null: float = 0.0
) -> tuple[Parameter, ...]:
    """One parameter with a component a wheel.

    `campaign`: the campaign whose wheels give the components their names. Returns: one parameter;
    none for a campaign without wheels (hooks then get an empty `p`).

    Examples
    --------
    >>> from bayes_inertia.physics.parameters import Normal
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> per_wheel(small_campaign(), "gain", unit="", prior=Normal(1.0, 0.03))[0].names
    ('gain_x', 'gain_y', 'gain_z')
    """
    names = [wheel.name for wheel in campaign.wheels]
    return (vector(name, names, unit=unit, prior=prior, null=null),) if names else ()


def sd_and_time(
    campaign: Campaign, unit: str, sd: float, time: float | None, factor_sd: float
) -> tuple[Parameter, Parameter]:
    """Size and correlation time of a random process, with log-normal priors.

    `time`: median of its correlation time [s]; None takes a fifth of a slew. `factor_sd`: sd of the
    logarithm of the sd. The time is known to a factor of 2. Returns: "sd" and "time"; nothing acts
    where the sd is zero.
    """
    time = time or 0.2 * campaign.scale_of_motion()[1]
    return (
        scalar("sd", unit=unit, prior=LogNormal(sd, factor_sd)),
        scalar("time", unit="s", prior=LogNormal(time, 0.7), null=time),
    )
