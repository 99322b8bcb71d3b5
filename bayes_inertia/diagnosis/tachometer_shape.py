"""An error of the tachometers of free shape: no effect of the library has knots there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.physics.effects.scales import sd_and_time
from bayes_inertia.physics.random_basis import (
    hat_functions,
    on_axes,
    on_each_axis,
    ornstein_uhlenbeck_root,
    slew_duration,
    slew_fraction,
)
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class TachometerShape(StochasticEffect):
    """An error of the tachometers on knots: the shape without a name where no effect has knots."""

    name: ClassVar[str] = "tachometer_shape"
    knots: int = 17

    def parameters(self, campaign):
        sigma = [wheel.momentum_sigma for wheel in campaign.wheels if wheel.momentum_sigma]
        return sd_and_time(campaign, "N m s", max(sigma), None, 1.5) if sigma else ()

    def coefficient_count(self, campaign):
        return len(campaign.wheels) * self.knots if self.parameters(campaign) else 0

    def coefficient_root(self, p, slew, count):
        spacing = slew_duration(slew) / (self.knots - 1)
        root = ornstein_uhlenbeck_root(p["sd"], p["time"], spacing, self.knots)
        return on_each_axis(root, count // self.knots)

    def momentum_output(self, p, slew, trajectory, momentum):
        hats = hat_functions(slew_fraction(slew, slew.time), self.knots)
        return momentum + on_axes(hats, p["coefficients"], momentum.shape[1])
