"""Limits by which fits, samples and noise are judged, each with its reason.

`criteria` are those that stand beside every result. The others decide how a fit goes about it:
none is tuned to a campaign, and where two decisions ask the same question they share a number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Limits:
    """Limits of the inference, by what they decide."""

    # Gates
    # Nested R-hat of converged ensembles is below this (Margossian et al. 2024).
    nested_rhat_below: float = 1.01
    # Effective samples, bulk and tail, of the worst parameter.
    ess_at_least: float = 400.0
    # Draws of every walker, in autocorrelation times.
    autocorrelation_times: float = 20.0
    # p-value below which noise is no explanation: of residuals, of outliers anywhere in a channel,
    # of noise that is alike in all slews, of outliers that gather at switches. False alarms on
    # perfect data: three channels, two tests each, in all about six per mille.
    reject_below: float = 1e-3
    # J and K that lie further than this from their prior means [prior sd] are no result.
    prior_sd_at_most: float = 5.0
    # p-value of all of J and K together, were the truth a draw of the prior; below it neither.
    prior_p_value_above: float = 1e-6
    # The data have told something of a parameter once they have halved the prior variance: no gate,
    # but said beside it.
    observable_above: float = 0.5
    # J and K this near to a wrong unit's factor (share of it) have that unit as explanation.
    near_a_factor: float = 0.2

    # Descents
    # Weight of the data's information in the first, gentle descent of every start.
    gentle_weight: float = 1e-4
    # Where a gentle descent may stop: its end is only a beginning.
    gentle_steps: int = 60
    gentle_tolerance: float = 1e-3
    # Residuals of rates beyond this [sigma] tell nothing of an input's noise: they are outliers, or
    # something is missing.
    believed_residual: float = 5.0
    # What a free body's momentum may seem to gain by noise and bias of its rates, as a share of it.
    balance: float = 0.01
    # Reduced chi^2 above which a gentle descent has lost its way; starts that are tried at most
    # until one has not.
    lost_reduced_chi2: float = 1e3
    most_starts: int = 12
    # So often a beginning without finite telemetry is brought half way back to where it has one.
    halvings: int = 20
    # Ends of gentle descents nearer than this [prior sd] are one; those whose objective is this
    # much above the best are not followed.
    same_place_sd: float = 0.1
    most_objective_excess: float = 1.0
    # Squares that exceed what noise predicts by so many sds are worth another descent.
    surplus_sd: float = 3.0
    # Discounts (as a share) and sizes [prior sd] have settled once they change by less; rounds at
    # most.
    settled: float = 0.02
    most_rounds_of_discount: int = 10
    # Noise that follows J or sizes has settled once it changes by less, as a share: that moves
    # nothing by a hundredth of its sd.
    settled_noise: float = 1e-4
    most_rounds_of_sizes: int = 8
    # Descents with processes that are filtered between their knots: each with the sizes before it.
    rounds_between_knots: int = 2
    # Tolerance of the objective on the way to the discount, and while sizes or noise are learnt; a
    # descent as asked for follows.
    tolerance_of_discount: float = 1e-4
    tolerance_of_rounds: float = 1e-3
    # Second moment over trace: no step comes closer to a body without thickness. Beyond, rounding
    # rules.
    smallest_second_moment: float = 1e-7
    # Steps keep this distance [prior sd] from the end of a prior's support.
    support_margin: float = 1e-9

    # Densities
    # Scale that residuals show beyond what is stated before a descent begins with it; that descent
    # need not be exact.
    inflated: float = 1.3
    rough_steps: int = 12
    rough_tolerance: float = 1e-2
    # Rounds in which the noise follows J (measured drive) and the numbers that fitting took away.
    rounds_of_densities: int = 3
    # Quasi-Newton steps towards the nuisances' best values; Gaussian noise needs none.
    nuisance_steps: int = 4
    # A channel's mean curvature is taken for no less than this share of what its density lets
    # expect: a matrix of outliers alone is no matrix to descend by.
    least_curvature: float = 0.3

    # Sizes of processes
    # So many prior sds from its centre a size may move.
    farthest_sd: float = 8.0
    # Step of the differences of the evidence [prior sd].
    size_step: float = 0.02
    # Least curvature along every direction [prior sd^-2]: a fourth of the prior's. Most where
    # differences are too rough to tell: a posterior sd of a fiftieth of the prior's.
    least_evidence_curvature: float = 0.25
    least_sd_of_size: float = 0.02

    # Shares of the slews
    # Directions of a slew in which others leave less than this share of its information untested:
    # rounding, not disagreement, is what it would show there.
    untested: float = 1e-9
    # Slews are said to disagree where noise makes so much disagreement once in a hundred campaigns.
    # At once in twenty, or widened always, intervals are wider and hold no more often.
    disagree_below: float = 0.01
    # A direction that data narrow by less than this share of the prior's precision is not told by
    # them: what stands there is rounding of the difference of two precisions.
    told_share: float = 1e-6
    # Lags [rows] over which correlation is tested.
    lags: int = 10
    # Of the draw of nuisances at which residuals are tested where momentum is free.
    seed_of_drawn_residuals: int = 20261

    # Outliers of series
    # Readings on either side that a reading is compared with: runs of two are in the minority.
    neighbours: int = 5
    # The scale around a reading is taken from so many readings on either side, of which some must
    # lie beyond their neighbours at all.
    readings_around: int = 12
    fewest_around: int = 5
    # MAD times 1.4826 of those distances in white unit noise that are not zero; their tail is
    # normal.
    scale_of_white: float = 0.94
    # More outliers than this share of a channel's readings are no outliers but its noise.
    most_outliers: float = 0.03
    # Rounded readings may lie beyond their neighbours by as many steps.
    steps_beyond: float = 1.6
    # A change of torque by this share of the slew's largest torque is a switch; rows beside it in
    # which nothing is taken for an outlier, if outliers gather there.
    switch: float = 0.2
    rows_at_switch: int = 3
    # Outliers hide each other; so often they are looked for again.
    rounds_of_masks: int = 3

    # Outliers among star-tracker fixes
    # More than this share of all fixes are no outliers but their noise. Fewer fixes tell nothing.
    most_outlying_fixes: float = 0.15
    fewest_fixes: int = 3
    # What two or a few others let expect scatters itself: distances count by so much less.
    scatter_of_median: float = 1.25
    scatter_of_line: float = 1.5
    # Rates are smoothed over so many readings before they are integrated.
    smoothed_over: int = 9
    # Fixes further apart than so many of their usual spacings belong to different bursts.
    gap_in_spacings: float = 3.0

    # Level of the noise
    # A level differs from what is stated beyond so many sds.
    significant_sigmas: float = 4.0
    # Squared differences that a level needs: of fewer the median is no start.
    fewest_differences: int = 12
    # Share of a component's largest reading above which readings are large: the upper half.
    large_readings: float = 0.5
    # Rounding that adds less to the noise than this factor is left alone.
    rounding_that_counts: float = 1.005
    # Steps beyond so many sigmas leave errors that are not independent.
    coarse_step: float = 2.5
    # Harmonics of a rounding error that count; those beyond hold a fiftieth of its variance.
    harmonics_of_rounding: int = 32
    # Coarsely rounded readings are louder than their rounding where they are so by this factor.
    louder_than_coarse: float = 1.5
    # Noise beyond what is stated and rounded by this factor has another cause.
    more_than_rounding: float = 1.15

    # Correlated noise
    # Readings that noise may remember. Slower residuals look like a constant torque, and are none.
    longest_colour: float = 25.0
    # Components of a longer period than this [readings, and share of a series] are left to the
    # model; and where effects compete with noise.
    longest_fast: tuple[float, float] = (100.0, 1.0 / 3.0)
    longest_slow: tuple[float, float] = (1000.0, 1.0)
    # Spectra are averaged over so many bins of frequency.
    bins: int = 128
    # Stretches of fewer readings tell nothing; groups of fewer components are not compared.
    fewest_readings: int = 24
    fewest_components: int = 60
    # By how much the log likelihood must prefer correlated noise to white, in the clearest axis and
    # in every other.
    clear_lead: float = 12.0
    least_lead: float = 4.0
    # Correlation over one reading beyond which noise is a random walk for all that a slew can tell.
    most_correlation: float = 0.9985
    # Logits of share and correlation from which the noise is looked for: short and long memory.
    colour_starts: tuple[tuple[float, float], ...] = (
        (4.0, 0.5),
        (4.0, 2.5),
        (-1.0, 2.0),
        (-1.0, 5.0),
    )
    # Norm of the rates, as a share of the slew's largest, below which the body rests.
    rests_below: float = 0.05

    # Proposals
    # Below this expected acceptance the Laplace approximation is too poor to propose from.
    poor_acceptance: float = 0.35
    # Degrees of freedom among which the tails of a proposal are chosen. The heaviest tails cost
    # most proposals where the posterior is nearly normal; none are lighter than the last, whose
    # density still falls off less steeply than a normal one.
    tails: tuple[float, ...] = (8.0, 20.0, 60.0, 200.0)
    # Draws by which a proposal's acceptance is judged, and pilots at most until one is good enough.
    judged_draws: int = 256
    most_pilots: int = 4
    pilot_steps: int = 400
    pilot_warm_up: int = 200
    pilot_walkers: int = 64
    # The independence move gets as large a share of the steps as it would be accepted, within
    # these: walkers that sit where the proposal is too thin are rejected again and again, and the
    # other move frees them.
    least_share: float = 0.5
    largest_share: float = 0.95
    # Starts are spread this many times wider than the proposal; rounds of draws at most until all
    # have a finite density.
    over_dispersion: float = 2.0
    most_draws: int = 200
    # The ensemble that explores the evidence of sizes, and the rounds and draws of importance
    # sampling after it: two rounds make four fifths of the draws effective where it left a quarter.
    size_walkers: int = 64
    size_steps: int = 60
    size_warm_up: int = 20
    size_rounds: int = 2
    size_draws: int = 512
    # A round of which fewer draws a size are effective tells less than the ensemble did.
    effective_draws_a_size: float = 4.0
    # Sizes evaluated at once, and numbers of their equations that fit the processor's cache.
    sizes_at_once: int = 16
    cached_numbers: float = 5e5
    # Sizes are proposed from what was explored, and at times more widely: no walker stays where the
    # exploration was thin.
    wide_share: float = 0.2
    wide_degrees: float = 5.0
    # Steps of the sizes by their evidence in each proposal, and from draws of the exploration.
    steps_of_proposal: int = 2
    steps_of_draws: int = 6

    # Chains and what is kept of them
    # Where nearly every proposal is taken: five autocorrelation times, and one step more.
    least_warm_up_steps: int = 6
    # Taken at least at a time, and between saves.
    least_further_steps: int = 8
    # This many times more draws than seem enough are taken.
    steps_margin: float = 1.1
    # Rows of a batch, of the slews evaluated at once, whose trajectories fit the processor's cache.
    cached_rows: int = 150_000
    # Draws of the prior in a result, and of each ensemble for telemetry-sized groups.
    prior_draws: int = 2000
    telemetry_draws: int = 16
    # Instants of each slew at which a signal is kept.
    instants: int = 101

    # Compiled code
    # Programs that run at once.
    threads: int = 2
    # Sensitivities are taken so many columns at a time at most, as many as a fit of a pair of
    # effects has, and a multiple of what a processor works on at once: time grows with the columns,
    # padding included.
    columns_at_once: int = 32
    lanes: int = 8
    # Fewer, where they have more numbers on the integration grid: 1 GB in all.
    numbers_of_columns: int = 250_000

    @property
    def gentle_stop(self) -> dict[str, Any]:
        """Where a gentle descent may stop."""
        return {"steps": self.gentle_steps, "tolerance": self.gentle_tolerance}

    @property
    def rough_stop(self) -> dict[str, Any]:
        """Where a descent with inflated scales may stop."""
        return {"steps": self.rough_steps, "tolerance": self.rough_tolerance}


LIMITS = Limits()


def criteria() -> dict[str, float]:
    """The gates' limits, as they are kept with every result.

    Examples
    --------
    >>> criteria()["nested_rhat_below"]
    1.01
    """
    return {
        "nested_rhat_below": LIMITS.nested_rhat_below,
        "effective_samples": LIMITS.ess_at_least,
        "autocorrelation_times": LIMITS.autocorrelation_times,
        "rejected_below": LIMITS.reject_below,
        "prior_sd_at_most": LIMITS.prior_sd_at_most,
        "prior_p_value_above": LIMITS.prior_p_value_above,
        "observable_above": LIMITS.observable_above,
    }
