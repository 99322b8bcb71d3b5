"""A mission: the spacecraft that flies, and what was known of its inertia tensor before flight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior
from bayes_inertia.flight.follow_on import prior_mean, spacecraft_at
from bayes_inertia.flight.spacecraft import (
    Controller,
    Spacecraft,
    most_like_prior,
    most_like_spacecraft,
    spin_tensor,
    without_spin,
)
from bayes_inertia.maths import inertia_tensor


@dataclass(frozen=True)
class Mission:
    """A spacecraft, and what was known of its inertia tensor before flight.

    Parameters
    ----------
    spacecraft : Spacecraft
        The spacecraft as it is: J, K, hardware, and what else acts.
    prior : InertiaPrior
        The inertia tensor as the campaign states it: what was known before flight, and how well.

    Examples
    --------
    >>> mission = Mission(most_like_spacecraft(), most_like_prior())
    >>> mission.theta[3].item()
    -0.0119
    """

    spacecraft: Spacecraft
    prior: InertiaPrior

    @classmethod
    def of(cls, campaign: Campaign) -> Mission:
        """The mission that a campaign's hardware and prior describe.

        Parameters
        ----------
        campaign : Campaign
            What was flown.

        Returns
        -------
        Mission
            Its spacecraft has J and K at the mean of their prior, and no effects.

        Examples
        --------
        >>> from bayes_inertia.physics.small_campaign import small_campaign
        >>> Mission.of(small_campaign()).spacecraft.scale_factor
        (1.0, 1.0, 1.0)
        """
        return cls(spacecraft_at(campaign, prior_mean(campaign)), campaign.inertia)

    @property
    def theta(self) -> np.ndarray:
        """Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K (6 + axes,) as a fit of the campaign names them.

        J is J_locked where the prior's tensor includes the wheels' spin.
        """
        craft = self.spacecraft
        spin = spin_tensor(craft.wheels) if self.prior.includes_wheel_spin else 0.0
        return np.array([*inertia_tensor.elements(craft.inertia_B + spin), *craft.scale_factor])

    def at_prior_mean(self) -> Mission:
        """The mission if what was known before flight were exactly right, and nothing else acted.

        Returns
        -------
        Mission
            With J and K at the mean of their prior, and without effects.

        Examples
        --------
        >>> most_like_mission().at_prior_mean().spacecraft.scale_factor
        (1.0, 1.0, 1.0)
        """
        craft, prior = self.spacecraft, self.prior
        mean = replace(
            craft,
            inertia_B=without_spin(prior.tensor, prior.includes_wheel_spin, craft.wheels),
            scale_factor=craft.rate_sensor.scale_factor if craft.rate_sensor else (),
            effects=(),
            values={},
        )
        return replace(self, spacecraft=mean)

    def without_effects(self) -> Mission:
        """The mission if nothing acted beside the wheels.

        Returns
        -------
        Mission
            The same J, K and hardware.
        """
        return replace(self, spacecraft=replace(self.spacecraft, effects=(), values={}))

    def controller(self, **settings: Any) -> Controller:
        """A controller that believes what was known before flight.

        Parameters
        ----------
        **settings : float
            Further fields of `Controller`, such as `bandwidth`.

        Returns
        -------
        Controller
            With J and K at the mean of their prior.

        Examples
        --------
        >>> most_like_mission().controller(bandwidth=0.1).bandwidth
        0.1
        """
        craft = self.spacecraft
        return Controller.from_prior(self.prior, craft.rate_sensor, craft.wheels, **settings)


def most_like_mission() -> Mission:
    """A microsatellite like MOST in Ferguson's simulations (his Table 1), J known to 2 to 4 %.

    Examples
    --------
    >>> most_like_mission().spacecraft.scale_factor
    (1.01, 1.02, 0.98)
    """
    return Mission(most_like_spacecraft(), most_like_prior())
