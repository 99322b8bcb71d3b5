"""Numbers by which a diagnosis decides: `Rules` are for users, `Limits` hold the others.

None is tuned to a campaign: each stands beside its reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayes_inertia.errors import SettingsError, require_kind


@dataclass(frozen=True)
class Rules:
    """The thresholds of the verdict.

    Parameters
    ----------
    false_alarm_probability : float
        Probability of naming anything in a campaign without hidden effect. At 2 % the
        interval of a study of 200 campaigns stays below 5 %.
    max_refits : int
        Rows of the table that are refitted in full, at most.
    max_effects : int
        Effects of a row, at most.
    log_evidence_margin : float
        Log odds by which the best row must beat another to be named alone, and by which a row
        with a shape without a name must beat the names alone.
    larger_set_share : float
        Share of the best set's probability from which a larger set is read in its place. What it
        adds is then listed beside `nothing`. At half, the odds against it are two to one at most.
    imitation_correlation : float
        Canonical correlation above which two effects are listed as alike.
    misfit_p_value : float
        p-value of the final residuals below which the data are not explained.
    prior_sd_at_most : float
        A parameter of an effect that lies further than this from where it does nothing [prior sd]
        is beyond its prior, which is then widened and the effect fitted again. A prior that is
        right is exceeded in one parameter of 16,000.

    Raises
    ------
    SettingsError
        If a threshold is outside its range.

    Examples
    --------
    >>> Rules(max_effects=2).log_evidence_margin
    3.0
    >>> Rules(false_alarm_probability=2.0)
    Traceback (most recent call last):
    ...
    bayes_inertia.errors.SettingsError: false_alarm_probability: 2.0 is outside its range; ...
    """

    false_alarm_probability: float = 0.02
    max_refits: int = 6
    max_effects: int = 4
    log_evidence_margin: float = 3.0
    larger_set_share: float = 0.5
    imitation_correlation: float = 0.6
    misfit_p_value: float = 1e-4
    prior_sd_at_most: float = 4.0

    def __post_init__(self) -> None:
        for name, (is_allowed, advice) in _ranges().items():
            value = getattr(self, name)
            value = value.item() if isinstance(value, np.generic) else value
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not is_allowed(value):
                raise SettingsError(f"{value!r} is outside its range", where=name, advice=advice)
            object.__setattr__(self, name, value)


def rules_of(given: Rules | None) -> Rules:
    """The rules given, or the usual ones; `SettingsError` for what is none."""
    advice = "give Rules, such as Rules(max_effects=2)"
    require_kind(given, Rules | None, "rules", advice, error=SettingsError)
    return given or Rules()


def _ranges() -> dict[str, tuple[Callable[[float], bool], str]]:
    """What each threshold may be, and the advice where it is not."""
    probability = (lambda x: 0.0 < x < 1.0), "give a probability between 0 and 1, such as 0.02"
    odds = (lambda x: 0.0 <= x < float("inf")), "give 0 or more; 3 is evidence of 20 to 1"
    share = (lambda x: 0.0 <= x <= 1.0), "give a share from 0 to 1"
    count = (lambda x: isinstance(x, int) and x >= 1), "give a whole number, 1 or more"
    return {
        "false_alarm_probability": probability,
        "misfit_p_value": probability,
        "max_refits": count,
        "max_effects": count,
        "larger_set_share": share,
        "imitation_correlation": share,
        "log_evidence_margin": odds,
        "prior_sd_at_most": ((lambda x: x > 0.0), "give a positive number of prior sds"),
    }


@dataclass(frozen=True)
class Limits:
    """Limits and numbers of single steps, by what they belong to."""

    # Prior of sets, and sizes of their members
    # Probability beforehand that something is missing: as likely as not.
    missing: float = 0.5
    # Probability of one thing more beside what acts: in one of ten campaigns.
    further: float = 0.1
    # Probability that a stated prior is too narrow: a strong effect pays it once.
    wrong_prior: float = 0.01
    # How many times too narrow a prior is at most: degrees for half a radian.
    widest: float = 100.0
    # Sizes tried beyond a prior: six a decade.
    wider_sizes: int = 12
    # Of these every third is tried where many members are weighed: two a decade.
    fewer: int = 3
    # Smallest size: signal-to-noise amplitude in the clearest direction, which nothing can
    # see.
    invisible: float = 0.3
    # The smallest size is at most this share of the largest, so that a decade is tried.
    largest_start: float = 0.1
    # Largest size of an effect without a fixed shape [prior sd above its median].
    largest_random_size: float = 2.0
    # Sizes tried within its prior of an effect of a fixed shape: evidence to a quarter.
    fixed_sizes: int = 12
    # The same of a random signal, whose evidence is a steeper function of the size.
    random_sizes: int = 16
    # Combinations of sizes less probable than this log factor (a millionth) are left out ...
    negligible_sizes: float = 14.0
    # ... if there are more than so many, to save time.
    many_sizes: int = 100
    # Sets of each size that larger sets are made of: the most probable ones.
    parents: int = 6
    # Rows and their refits
    # Log evidence by which a refit may miss what was foretold; beyond it rows are weighed
    # anew.
    linear: float = 0.5
    # Largest amplitude at the start of a refit [prior sd]: farther out nothing is linear.
    largest_amplitude: float = 10.0
    # Tolerance of the objective of refits that are only compared: a hundredth of a log
    # evidence.
    comparison_tolerance: float = 1e-5
    # So often a prior is widened: one that pulled hides part of the size.
    rounds_of_prior: int = 4
    # So often noise and table are brought to agree ...
    rounds_of_noise: int = 3
    # ... and they do once the level changes by less, as a share: so much an sd is wrong then.
    settled_level: float = 0.02
    # As how many tests all effects without a fixed shape count: their p-values are joint.
    random_tests: int = 1
    # Rows of less probability are one row where J and K are averaged ...
    least_probability: float = 0.02
    # ... and those of still less are left out: they move no 90 % interval.
    negligible_probability: float = 1e-4
    # Draws by which Laplace's approximation of a row is checked: a Pareto k to 0.15, in a second.
    importance_draws: int = 128
    # Sets of effects that are listed: more tell a reader nothing.
    listed: int = 8
    # Largest effect that is thought to hide [prior sd]: 95 % of the prior.
    hidden_amplitude: float = 2.0
    # Share of a formula's power from which an effect that can make it is that formula: the same
    # laws agree to 1e-4, the nearest others (drag with speed, and with its square) to 2e-3.
    same_effect: float = 0.999
    # Spread of an input, as a share of its size, up to which it is stuck: rounding alone.
    stuck: float = 1e-12
    # Terms of a formula, looked for one after the other: a sum of three is no law.
    rounds_of_formulas: int = 2
    # Formulas of each search that are refitted; those listed beside them are as good to first
    # order.
    formulas_refitted: int = 4
    # Dirt or physics
    # A number of a noise's shape costs half the log of so many readings [log evidence].
    readings_a_number: float = 100.0
    # Numbers of a colour: share and time of three axes.
    numbers_of_colour: int = 6
    # Noise remembers so many readings at most; what lasts longer may be an effect.
    readings_of_noise: float = 16.0
    # So often the level of the noise is measured again beside a process without a shape.
    rounds_of_level: int = 4
    # Flexible mode
    # Damping ratio of the modes tried: of bare metal; a fit finds its own.
    damping_ratio: float = 0.005
    # Share of the body's inertia that a mode begins with at most: with all of it nothing is left
    # that turns.
    largest_appendage: float = 0.5
    # Frequencies tried at most, to save time.
    frequencies: int = 320
    # Filters kept: of all frequencies, for four lengths of slews.
    filters: int = 1280
    # Frequencies tried at once, to save memory.
    frequencies_at_a_time: int = 5
    # Around so many of the best frequencies others are tried ...
    refined_frequencies: int = 6
    # ... at these shares of the spacing.
    refinement_offsets: tuple[float, ...] = (-0.5, -0.25, 0.25, 0.5)
    # Directions of the coupling: the nearest is within 4 degrees.
    directions: int = 400
    # Independent trials a frequency tried: simulated maxima ask for 1.0 to 2.0.
    trials_a_frequency: float = 2.0
    # Random signals
    # Correlation times tried [prior sd from the median]: a twentieth of a slew to three ...
    shapes: tuple[float, ...] = (-2.0, -1.0, 0.0, 1.0, 2.0, 4.0)
    # ... of which those up to here end within a slew: nine tenths of one.
    longest_in_slew: float = 2.0
    # Shortest length of a smooth signal, as a share of the knots' spacing ...
    shortest: float = 0.7
    # ... and how many lengths are tried up to the whole slew.
    lengths: int = 6
    # Added to variances, as a share: where a walk is zero its covariance is singular.
    jitter: float = 1e-9
    # Campaigns drawn for a p-value: importance sampling, all of them near the value.
    draws: int = 1000
    # Largest log evidence of all below which nothing random is found ...
    weak: float = 1.5
    # ... and above which Markov's bound of its p-value is enough.
    clear: float = 9.0
    # Effects with more numbers in their columns are left out: 400 MB.
    largest_columns: float = 5e7
    # P-values are not simulated if that takes matrices of more numbers: 400 MB.
    largest_matrices: float = 5e7
    # Where residuals disagree
    # p-value of a window that is shown: in one of twenty campaigns by chance.
    significant: float = 0.05
    # Simulated fits at once, to save memory.
    replicates_at_a_time: int = 50
    # Bins of a slew in its picture: as many as the eye tells.
    bins: int = 60
    # More windows only cost time: the shortest are left out first.
    windows: int = 20_000
    # What has no name: the equivalent signal
    # Knots of a signal in a slew, at most, to save time.
    knots: int = 200
    # Numbers of one basis: 160 MB.
    basis_numbers: float = 2e7
    # Knots simulated at once, to save memory.
    knots_at_a_time: int = 24
    # Lengths tried, from the knots' spacing to two slews.
    length_scales: int = 7
    # Smallest eigenvalue of the prior that is kept, as a share of the largest.
    eigenvalue_floor: float = 1e-7
    # Grid of the log size above the smallest visible: from, to, points.
    log_sizes: tuple[float, float, int] = (-2.0, 18.0, 41)
    # Rounds of that, each around the best of the last: the size to 1e-4.
    rounds_of_size: int = 4
    # p-value of what a torque leaves, above which nothing else is tried.
    sufficient: float = 1e-4
    # Log evidence by which another kind of signal must be better than a torque.
    sensor_margin: float = 10.0
    # Share of the excess of chi^2 above which an insufficient torque still counts.
    least_explained: float = 0.5
    # Share of the misfit from which something known explains it.
    known_share: float = 0.9
    # Effort of the wheels, as a share of the slew's largest, from which they act.
    active_share: float = 0.2
    # Share of the power near its peak from which there is a line; white noise has a tenth.
    line_share: float = 0.3
    # Periodograms are padded to so many lengths of the signal.
    padding: int = 4
    # What has fewer periods in a slew is no ringing ...
    slowest: float = 2.5
    # ... and half the width of a line, in the same unit (Hann window).
    half_width: float = 3.0
    # Log evidence below which two laws are as good.
    tied: float = 3.0


LIMITS = Limits()
