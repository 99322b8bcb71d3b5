"""Readings rounded to a step: known from the readings themselves, before any fit.

Rounding adds an error of step / sqrt(12). Where the noise is small beside the step, readings stay
the same while the truth moves little: their errors are one error, not many, and no test for white
noise applies (Widrow and Kollar 2008, chapter 20: noise of half a step makes errors independent).
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import series_of
from bayes_inertia.faults.quantisation import quantisation_sigma, quantisation_step
from bayes_inertia.inference.limits import LIMITS


def rounding_steps(campaign: Campaign) -> dict[str, np.ndarray]:
    """The steps to which readings in series are rounded.

    Returns (components,): by channel [stated sigma]; 0 where nothing is rounded.
    """
    steps = {}
    for stream in series_of(campaign):
        tables = [x for slew in campaign.slews if (x := stream.of(slew)) is not None]
        steps[stream.name] = np.array(
            [
                (quantisation_step(np.concatenate([x[:, k] for x in tables])) or 0.0) / one
                if one is not None and tables
                else 0.0
                for k, one in enumerate(stream.sigma(campaign))
            ]
        )
    return steps


def factor_of_rounding(steps: np.ndarray) -> float:
    """What rounding adds to the noise of a channel.

    `steps` (components,) [stated sigma]. Returns: factor on the stated sigma, of the coarsest
    component.

    Examples
    --------
    >>> factor_of_rounding(np.array([0.0, 6.0]))
    2.0
    """
    return float(np.hypot(1.0, quantisation_sigma(float(steps.max(initial=0.0)))))


def is_coarse(steps: np.ndarray) -> bool:
    """Whether a channel's noise as stated cannot hold its rounding.

    `steps` (components,) [stated sigma].

    Examples
    --------
    >>> is_coarse(np.array([1.0, 6.0])), is_coarse(np.array([1.0]))
    (True, False)
    """
    return quantisation_sigma(float(steps.max(initial=0.0))) > 1.0


def has_one_error(steps: np.ndarray) -> bool:
    """Whether readings of a channel share rounding errors, so that these are not white.

    `steps` (components,): [sigma of the noise as used, which holds the rounding].
    """
    return bool(
        np.any(steps > LIMITS.coarse_step / np.hypot(1.0, quantisation_sigma(LIMITS.coarse_step)))
    )


def level_of_rounded(measured: float, steps: np.ndarray) -> float:
    """The noise of a rounded channel.

    Errors of coarse rounding are not independent: fast differences measure their level badly.

    `steps` (components,) [stated sigma].

    Examples
    --------
    >>> level_of_rounded(2.3, np.array([6.0])), level_of_rounded(1.1, np.array([1.0]))
    (2.0, 1.1)
    """
    factor = factor_of_rounding(steps)
    trusted = not is_coarse(steps) or measured > LIMITS.louder_than_coarse * factor
    return max(factor, measured) if trusted else factor
