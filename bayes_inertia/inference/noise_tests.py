"""Does the model explain the data, where the noise is not Gaussian of the stated sigma?

Residuals are judged by their own distribution. The size of a channel's residuals is the sum of
their weighted squares w y^2 (for Gaussian noise, of their squares). Fitting lowers it by
(nu + 2)/(nu + 5) for each parameter that the channel pays for, and it scatters like chi^2 with
(nu + 3)/nu degrees of freedom a number. It is the score of the scale: where the scale is sampled
it tells nothing, and the scale is held against its own prior instead. Whether residuals are white
is asked of their normal scores: the standard normal numbers of the same probability.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.noise_parameters import channel_rules, noise_values
from bayes_inertia.inference.residual_tests import ChannelTest, chi2_test, whiteness
from bayes_inertia.inference.rounding import has_one_error, rounding_steps
from bayes_inertia.inference.student_t import WeightedSquares, normal_scores
from bayes_inertia.physics.forward_model import Model

# Normal quantile of the central 99 %.
_CENTRAL_99 = float(stats.norm.isf(0.005))


def noise_tests(
    model: Model,
    theta: np.ndarray,
    series: dict[str, list[np.ndarray]],
    numbers: np.ndarray,
    parameters: np.ndarray,
) -> dict[str, ChannelTest]:
    """Test every channel, and the total.

    Parameters
    ----------
    model : Model
        Its noise says how the residuals are distributed.
    theta : (d,) array
        Where; noise parameters among it.
    series : dict of list of (rows, components) arrays
        Residuals in stated sigmas by channel and slew, NaN where nothing was measured.
    numbers : (3,) array
        How many were measured, by channel.
    parameters : (3,) array
        How many parameters each channel pays for.

    Returns
    -------
    dict of ChannelTest
        By channel, and "total".
    """
    tests, total, unordered = {}, np.zeros(2), _without_test_of_whiteness(model)
    rules = channel_rules(model)
    for c, (rule, scale, nu) in enumerate(zip(rules, *noise_values(rules, theta), strict=True)):
        channel, degrees = CHANNELS[c], float(nu)
        y = [slew / scale for slew in series[channel]]
        p_white = None if channel in unordered else _whiteness(y, degrees)
        weighted = WeightedSquares(degrees)
        squares, worth = sum(map(weighted.sum, y)), weighted.worth
        dof = numbers[c] - weighted.per_parameter * parameters[c]
        test = chi2_test(worth * squares, worth * dof, p_white)
        if test.reduced_chi2 is not None:
            total += worth * np.array([squares, dof])
            if rule.scale_at is not None:
                spread = model.noise.of(channel).scale_spread
                test = _scale_test(float(scale), spread, test)
        tests[channel] = test
    tests["total"] = chi2_test(float(total[0]), float(total[1]))
    return tests


def _without_test_of_whiteness(model: Model) -> set[str]:
    """Channels whose residuals are no series of independent numbers by right.

    Star-tracker fixes come in a few bursts, and errors of coarse rounding are not white. Where the
    noise of a rounded channel is not as stated, whiteness is the last test left: it is kept.
    """
    rounded = {
        channel
        for channel, steps in rounding_steps(model.campaign).items()
        if has_one_error(steps) and model.noise.of(channel).is_stated
    }
    return {"attitude"} | rounded


def _whiteness(y: list[np.ndarray], degrees: float) -> float | None:
    return whiteness([normal_scores(slew, degrees) for slew in y])


def _scale_test(scale: float, spread: float, test: ChannelTest) -> ChannelTest:
    """The test of a channel whose scale is sampled: against the prior of the scale.

    The squares are counted in stated sigmas, and so is the interval.
    """
    p_scale = float(2.0 * stats.norm.sf(abs(np.log(scale)) / spread))
    reduced = None if test.reduced_chi2 is None else scale**2 * test.reduced_chi2
    ends = np.exp(2.0 * spread * _CENTRAL_99 * np.array([-1.0, 1.0]))
    return ChannelTest(reduced, (float(ends[0]), float(ends[1])), p_scale, test.p_white)
