"""One vibration mode of an appendage."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.sensors import reading_step
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import LogNormal, Normal, scalar, vector


@dataclass(frozen=True)
class FlexibleMode(Effect):
    """A vibration mode: coordinate eta, frequency, damping ratio z, coupling vector delta.

    The frequency W = 2 pi frequency is that of the clamped base.

    eta'' + 2 z W eta' + W^2 eta = -delta . w', total momentum J w + G H + delta eta' (Hughes
    1986, section 4.4; J is the tensor of the whole undeformed spacecraft). With p = eta' +
    delta . w as the second state nothing needs w': total momentum = (J - delta delta^T) w + G H
    + delta p, eta' = p - delta . w, p' = -2 z W eta' - W^2 eta. Every slew begins undeformed.
    With the base free the mode rings at W / sqrt(1 - delta^T J_rest^-1 delta), faster than W;
    delta and -delta are one mode. Frequency and damping do nothing at zero coupling, which is
    therefore a stationary point of the posterior: `fit` and `diagnose` begin at the ringing
    that the residuals show best.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd of delta's components [kg^0.5 m]; None takes 10 % of sqrt(J): delta^2 is 1 % of
        J.
    frequency : float or None, optional
        Prior median [Hz]; None takes 30 periods in a slew, or a quarter of the highest
        frequency that the telemetry's sampling resolves, whichever is lower.
    frequency_spread : float, optional
        Sd of its logarithm.
    damping : float, optional
        Prior median of z, which stays below 1; 0.005 is a usual figure for deployed structures.
    damping_spread : float, optional
        Sd of its logarithm.

    Examples
    --------
    >>> [p.name for p in FlexibleMode(sigma=0.1, frequency=0.5).parameters(None)]
    ['coupling', 'frequency', 'damping']
    """

    name = "flexible_mode"
    sigma: float | None = None
    frequency: float | None = None
    frequency_spread: float = 0.6
    damping: float = 0.005
    damping_spread: float = 0.7
    # Steps per period at the prior's upper end (two sd): Runge-Kutta is then wrong by 4e-3 rad of
    # phase a period there, by 1e-4 at the median.
    steps_a_period = 12.0

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            sigma = 0.1 * float(np.sqrt(campaign.scale_of_motion()[2]))
        frequency = self._median_frequency(campaign)
        of_frequency = LogNormal(frequency, self.frequency_spread)
        # Beyond critical damping nothing rings, and what is far beyond is too stiff for the steps.
        of_damping = LogNormal(self.damping, self.damping_spread, upper=1.0)
        return (
            vector("coupling", "xyz", unit="kg^0.5 m", prior=Normal(0.0, sigma)),
            scalar("frequency", unit="Hz", prior=of_frequency, null=frequency),
            scalar("damping", unit="", prior=of_damping, null=self.damping),
        )

    def _median_frequency(self, campaign) -> float:
        if self.frequency is not None:
            return self.frequency
        return min(30.0 / campaign.scale_of_motion()[1], 0.125 / reading_step(campaign))

    def max_step(self, campaign):
        steps = self.steps_a_period * self._median_frequency(campaign)
        return 1.0 / (steps * np.exp(2.0 * self.frequency_spread))

    def inertia(self, p, slew, inertia_B):
        return inertia_B - jnp.outer(p["coupling"], p["coupling"])

    def initial_state(self, p, slew, rate_B):
        return jnp.stack([jnp.zeros_like(p["frequency"]), jnp.sum(p["coupling"] * rate_B)])

    def state_rate(self, p, slew, t, state):
        eta, momentum = state.effect_states
        W = 2.0 * jnp.pi * p["frequency"]
        speed = momentum - jnp.sum(p["coupling"] * state.rate_B)
        return jnp.stack([speed, -2.0 * p["damping"] * W * speed - W**2 * eta])

    def internal_momentum(self, p, slew, effect_states):
        return p["coupling"] * effect_states[1]
