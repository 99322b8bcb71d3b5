"""The low-frequency error of a star tracker: another offset at every group of fixes."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.sensors import stream_of_device
from bayes_inertia.campaign.slew import between_fix_groups
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.parameters import LogNormal, scalar
from bayes_inertia.physics.random_basis import independent
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class StarTrackerLowFrequency(RowByRow, StochasticEffect):
    """All fixes of a group are turned by one small rotation, each group by another.

    A group is a run of fixes without a gap: usually one before and one after each slew. The stars
    in view, their places in the catalogue, and the warmth of the baffle change from one attitude to
    the next and not within seconds. Each component of the rotation (body axes) is normal with sd
    star_tracker_low_frequency.sd.

    Parameters
    ----------
    median : float or None, optional
        Median of the prior of the sd [rad]; None takes what the campaign states, or else the
        tracker's sigma_cross.
    factor_sd : float, optional
        Sd of the logarithm of the sd.
    known : bool, optional
        Whether the sd is what the campaign states, and nothing is estimated.

    References
    ----------
    ECSS-E-ST-60-20C, section 3 (low frequency error of star sensors).

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> StarTrackerLowFrequency().coefficient_count(small_campaign())
    3
    """

    name = "star_tracker_low_frequency"
    kind = "low_frequency"
    median: float | None = None
    factor_sd: float = 1.5
    known: bool = False

    def parameters(self, campaign):
        if self.known:
            return ()
        tracker = campaign.sensors.get(self.device or campaign.names[1])
        sigma = (tracker.low_frequency_sigma or tracker.sigma_cross) if tracker else 2.5e-5
        prior = LogNormal(self.median or sigma, self.factor_sd)
        return (scalar("sd", unit="rad", prior=prior),)

    def coefficient_count(self, campaign):
        stream = stream_of_device(self.device or campaign.names[1], campaign)
        known = ((s, stream.of(s)) for s in campaign.slews)
        fixed = ((s, np.isfinite(fixes).all(axis=1)) for s, fixes in known if fixes is not None)
        gaps = (between_fix_groups(slew, rows) for slew, rows in fixed)
        return 3 * (1 + max(map(len, gaps), default=0))

    def coefficient_root(self, p, slew, count):
        return independent(jnp.asarray(self.median) if self.known else p["sd"], count)

    def attitude_output(self, p, slew, trajectory, attitude):
        if slew.fix_group is None:
            return attitude
        offsets = p["coefficients"].reshape(-1, 3)
        return quaternion.turned(attitude, offsets[slew.fix_group])
