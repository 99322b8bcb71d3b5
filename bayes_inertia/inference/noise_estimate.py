"""The maximum of a posterior with Student-t noise, or with noise of sampled scale.

It begins at the maximum with Gaussian noise of the stated sigma. Student-t descents begin with the
scale that the residuals have there, so that outliers far off lose their pull step by step.

Does the model explain the data, where the noise is not Gaussian of the stated sigma?

Residuals are judged by their own distribution. The size of a channel's residuals is the sum of
their weighted squares w y^2 (for Gaussian noise, of their squares). Fitting lowers it by
(nu + 2)/(nu + 5) for each parameter that the channel pays for, and it scatters like chi^2 with
(nu + 3)/nu degrees of freedom a number. It is the score of the scale: where the scale is sampled
it tells nothing, and the scale is held against its own prior instead. Whether residuals are white
is asked of their normal scores: the standard normal numbers of the same probability.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import stats

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.descent import minimum_from
from bayes_inertia.inference.hat_matrix import hat_traces
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood import Information
from bayes_inertia.inference.noise_information import NoiseTask, information, objective
from bayes_inertia.inference.noise_model import discounted, whitening
from bayes_inertia.inference.noise_parameters import channel_rules, noise_values
from bayes_inertia.inference.objective import normal_equations
from bayes_inertia.inference.point import Point
from bayes_inertia.inference.residual_series import residual_series
from bayes_inertia.inference.residual_tests import ChannelTest, chi2_test, whiteness
from bayes_inertia.inference.rounding import has_one_error, rounding_steps
from bayes_inertia.inference.student_t import WeightedSquares, normal_scores
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.maths.robust_scale import SD_OVER_MAD
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model

# A descent with inflated scales need not be exact: its end is only a beginning.
_ROUGH = {"steps": 12, "tolerance": 1e-2}
# Scale that residuals show beyond what is stated before a descent begins with it.
_INFLATED = 1.3
# Rounds in which the noise follows J (measured drive) and the numbers that fitting took away.
_ROUNDS = 3


@array_dataclass
class NoiseEstimate(Estimate):
    """An estimate with Student-t noise, or with noise of sampled scale.

    Parameters
    ----------
    model, point, stated, white, discount, information, hessian, objective, starts
        As `Estimate`. `discount` is the information of a reading over that of Gaussian noise of
        the stated sigma, and `white` the Gaussian noise of that information.
    """

    @property
    def discounted(self) -> bool:
        """Never: the noise is what was asked for."""
        return False

    @cached_property
    def effective_parameters(self) -> np.ndarray:
        """How many parameters of location each channel pays for (3,)."""
        return _effective_parameters(self.model, self.point, self.information, self.hessian)

    @cached_property
    def tests(self) -> dict[str, ChannelTest]:
        """Residuals judged by their own distribution, see `noise_estimate`."""
        return noise_tests(
            self.model,
            self.theta,
            self.tested_residuals.series,
            self.information.n_data.sum(0),
            self.effective_parameters,
        )


def with_noise_model(fitted: Estimate) -> Estimate:
    """The estimate with the noise that its model was asked for.

    Returns: the very object where the noise is as stated.
    """
    model = fitted.model
    if model.noise.is_stated:
        return fitted
    point, free = _at_noise_of_residuals(fitted), fitted.free
    lost = np.zeros(len(CHANNELS))
    task = NoiseTask(model, whitening(model, point.theta), lost, _inflation(fitted, point))
    if np.any(task.inflation > 1.0):
        point, _ = _descend(task, point, free, **_ROUGH)
    for _ in range(_ROUNDS):
        stated = whitening(model, point.theta)
        task = NoiseTask(model, stated, lost, np.ones(len(CHANNELS)))
        point, value = _descend(task, point, free)
        blocks, factor = information(task, point, free)
        hessian, _ = normal_equations(model, point, blocks)
        lost = _lost(model, point, blocks, hessian)
    return NoiseEstimate(
        model,
        point,
        stated,
        discounted(stated, factor),
        factor,
        blocks,
        hessian,
        value,
        fitted.starts,
    )


def _descend(task: NoiseTask, point: Point, free: np.ndarray, **stop) -> tuple[Point, float]:
    """The minimum that a descent from a point reaches, and its objective."""
    return minimum_from(
        task.model,
        point,
        free,
        lambda x: objective(task, x),
        lambda x: information(task, x, free)[0],
        **stop,
    )


def _spread(fitted: Estimate) -> np.ndarray:
    """Standard deviation (3,) that the middle of each channel's residuals has."""
    series = residual_series(fitted.model, fitted.point, fitted.stated)
    spread = np.ones(len(CHANNELS))
    for c, channel in enumerate(CHANNELS):
        numbers = np.concatenate(
            [np.zeros(0), *(slew[np.isfinite(slew)] for slew in series[channel])]
        )
        if len(numbers):
            spread[c] = max(SD_OVER_MAD * float(np.median(np.abs(numbers))), 1e-3)
    return spread


def _at_noise_of_residuals(fitted: Estimate) -> Point:
    """The point with sampled scales near those that the residuals have."""
    theta, spread = fitted.theta.copy(), _spread(fitted)
    for c, rule in enumerate(channel_rules(fitted.model)):
        if rule.scale_at is not None and rule.scale_at in fitted.free:
            width = 3.0 * fitted.model.noise.of(CHANNELS[c]).scale_spread
            theta[rule.scale_at] = np.clip(spread[c], np.exp(-width), np.exp(width))
    return replace(fitted.point, theta=theta)


def _inflation(fitted: Estimate, point: Point) -> np.ndarray:
    """Factors (3,) on the scales of heavy channels with which a descent should begin."""
    rules = channel_rules(fitted.model)
    scales, _ = noise_values(rules, point.theta)
    ratio = _spread(fitted) / np.array(scales, float)
    heavy = np.array([rule.heavy for rule in rules])
    return np.where(heavy & (ratio > _INFLATED), ratio, 1.0)


def _lost(model: Model, point: Point, blocks: Information, hessian: np.ndarray) -> np.ndarray:
    """By how much fitting lowers each channel's weighted squares (3,)."""
    _, degrees = noise_values(channel_rules(model), point.theta)
    shares = np.array([WeightedSquares(float(nu)).per_parameter for nu in degrees])
    return shares * _effective_parameters(model, point, blocks, hessian)


def _effective_parameters(
    model: Model, point: Point, blocks: Information, hessian: np.ndarray
) -> np.ndarray:
    """Trace of the hat matrix over each channel's rows (3,), noise parameters left out."""
    names = model.noise.names
    located = np.array([model.space.names[i] not in names for i in blocks.free], bool)
    return hat_traces(blocks, point.n_local, inverse(hessian), located)


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

    `theta` (d,); `numbers` (3,); `parameters` (3,). `series` (rows, components): residuals in
    stated sigmas by channel and slew, NaN where nothing was measured.
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
