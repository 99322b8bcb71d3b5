"""Errors of a magnetometer itself: its offset, and the scale of each axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class FieldOffset(RowByRow):
    """A constant field of the spacecraft's own, beyond what the campaign states.

    Parameters
    ----------
    share : float, optional
        Prior sd of each component as a share of the field that the sensor sees; 0.05 is what
        magnets and currents near a magnetometer without a boom make. Ten times a stated
        `offset_sigma` if that is more.

    Examples
    --------
    >>> FieldOffset(device="magnetometer").name
    'offset[magnetometer]'
    """

    name = "field_offset"
    kind = "offset"
    share: float = 0.05

    def parameters(self, campaign):
        seen = [(slew.more or {}).get(self.device) for slew in campaign.slews]
        size = np.concatenate([np.linalg.norm(x, axis=1) for x in seen if x is not None])
        stated = campaign.sensors[self.device].offset_sigma
        sigma = max(self.share * float(np.nanmedian(size)), 10.0 * stated)
        return (vector("offset", "xyz", unit="T", prior=Normal(0.0, sigma)),)

    def direction_output(self, p, slew, trajectory, seen_B):
        return seen_B + p["offset"]


@dataclass(frozen=True)
class FieldScale(RowByRow):
    """Each axis reads 1 + scale times the field along it, beyond what the campaign states.

    Parameters
    ----------
    sigma : float, optional
        Prior sd; 0.03 is the spread of magnetometers that nobody calibrated. Ten times a stated
        `scale_sigma` if that is more.

    Examples
    --------
    >>> FieldScale(device="magnetometer").name
    'scale[magnetometer]'
    """

    name = "field_scale"
    kind = "scale"
    sigma: float = 0.03

    def parameters(self, campaign):
        sigma = max(self.sigma, 10.0 * campaign.sensors[self.device].scale_sigma)
        return (vector("scale", "xyz", unit="", prior=Normal(0.0, sigma)),)

    def direction_output(self, p, slew, trajectory, seen_B):
        return seen_B * (1.0 + p["scale"])
