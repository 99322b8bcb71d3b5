"""Limits by which the conventions check decides, each with its reason.

None is tuned to a campaign: they follow from what the effects of the library do (`physics.effects`
states its priors as fractions of the motion) and from how far apart two conventions lie. A wrong
unit, sign or order leaves 100 % or 200 % of the motion unexplained; a physical effect leaves a few
per cent. The limits stand between, nearer to the wrong convention.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits of the laws, and numbers of single steps by the file that takes them."""

    # The laws
    # Share of the motion that physics which nobody told may leave unexplained, one sd. The
    # library's disturbance torques have a prior sd of 3 % of J w / T, friction 10 %, an oscillating
    # mode 1 %, misalignments 0.3 %, gains 3 %: 10 % is three of the usual sds.
    physical_share: float = 0.10
    # Share of the campaign's largest motion that disturbs a slew or a wheel that hardly moves.
    idle_share: float = 0.03
    # Relative error of angles that no parameter here explains: coning, nonlinearity, delays.
    frame_share: float = 0.01
    # Sd of the logarithm of the stated moments of inertia, at least. 30 % wrong is 1.8 sds, a
    # factor of 100 is 23.
    inertia_sd: float = 0.20
    # Sd of K, at least: 5 % is an ordinary rate sensor, a wrong unit 19 sds and more.
    scale_sd: float = 0.05
    # Sd of the misalignment of a sensor's axes [rad]: degrees are physical, 90 degrees never.
    misalignment_sd: float = 0.05
    # Sd of a constant body torque, as a share of the motion's momentum over the slew's duration.
    torque_share: float = 0.10
    # The same where no tachometer sees what friction takes from the wheels.
    unseen_friction_share: float = 0.30
    # Sd of a rate bias as a share of the campaign's rms rate, at least: a stale bias is physical.
    bias_share: float = 0.02
    # Sd of a wheel's torque gain: three times the library's.
    gain_sd: float = 0.10
    # Share of a vector, one sd, by which albedo, currents and glints may turn or change it beside
    # what is fitted: three degrees. A wrong sign or order leaves the whole vector and more.
    vector_share: float = 0.05
    # Sds of a magnetometer's scale factors and offset (as a share of the field), at least: an
    # uncalibrated one in a cubesat is off by a tenth, and by a quarter of the field. A wrong unit
    # is a factor of ten or more, nine sds.
    field_scale_sd: float = 0.10
    field_offset_share: float = 0.30
    # A vector between two readings that is shorter than this share of them lies between directions
    # 36 degrees apart.
    chord: float = 0.95
    # Turn since a slew's first moment [rad] up to which vectors are turned back: `SCALE_SD` leaves
    # 0.3 rad of it open, as much as a linear law bears.
    known_turn: float = 6.0
    # Sizes between which the Earth's field lies where spacecraft fly [T]: a third of that in a
    # geostationary orbit, and three times that at the poles. Outside it is the unit that is wrong.
    weakest_field: float = 3e-8
    strongest_field: float = 2e-4
    # Misfit [sd] above which stated conventions are impossible. 30 % of a slew's motion stays
    # unexplained after J, K, misalignment, bias and torques have had their say. A flipped sign
    # leaves 20 sds, a swapped pair 14, a wrong unit 10.
    impossible: float = 3.0
    # Misfit [sd] below which conventions agree with the data: 20 % of a slew's motion.
    ordinary: float = 2.0
    # A change must bring the misfit down by this factor at least to be proposed.
    improvement: float = 3.0
    # The same for two mistakes at once. There are a thousand pairs, so that a pair must mend more:
    # to 10 % of the motion.
    pair_impossible: float = 5.0
    pair_ordinary: float = 1.0
    # Misfit [sd] above which data are called impossible although no change mends them. A body whose
    # inertia is stated 2.2 times too large or small comes to this, and so does a torque as large as
    # the wheels' that the telemetry does not tell.
    hopeless: float = 8.0
    # Two changes mend alike if their misfits differ by less than the factor, or than this many sds.
    # 0.15 sd is 1.5 % of the motion, less than what undisclosed physics may hide.
    equal_factor: float = 2.0
    equal_misfit: float = 0.15
    # Between a misfit of one sd and `IMPOSSIBLE` data are possible as stated, but a change is
    # proposed that brings the misfit down by four. Hidden effects leave as much as that; but no
    # change of convention imitates an effect so well.
    suspicious: float = 1.0
    sure_improvement: float = 4.0
    # Misfit [sd] below which a change explains so well that no stale bias is tried beside it.
    clear: float = 0.5
    # Factor between commands and tachometers beyond which they contradict each other. Five of
    # `GAIN_SD`, and sixteen sds of the gain in the library.
    factor: float = 1.5
    # A hardware limit that readings exceed this many times is wrong, or their unit is. A wheel
    # overspeeds by a tenth, a controller that saturates asks for twice; the smallest wrong unit is
    # a factor of 9.5 (rpm).
    far_beyond: float = 3.0
    # Two columns are one if their difference is below 5 % of the noise of either, which independent
    # noise never is; they are judged only if they hold a fifth of the noise that is stated.
    copied: float = 0.05
    noisy: float = 0.2
    # Prior sd of a sensor's lateness in the library, as a share of the slew's duration.
    late_share: float = 1.0 / 1000.0
    # The same for the lag of a wheel behind its torque command.
    lag_share: float = 1.0 / 300.0
    # Clocks are compared where everything else agrees: residuals are then judged at 1 % of the
    # motion rather than 10 %.
    sharp: float = 0.1
    # Lateness beyond this many sds of the library's prior is a wrong clock, no exposure time.
    late_sds: float = 5.0
    # Three of these sds are enough beyond 0.9 s: exposure, filters and processing of a sensor
    # together do not take a second, however slowly the spacecraft turns.
    least_late_sds: float = 3.0
    longest_lateness: float = 0.9
    # chi^2 must fall by this much with one offset: ten sds.
    late_chi2: float = 100.0
    # A wrong clock is off by this many rows at least: half a row is a matter of what a stamp means.
    late_steps: float = 0.7
    # Residual in hundredths of the motion below which no clock is looked into.
    notable: float = 0.3
    # Noise seen in smooth rows that differs from the stated one by this factor is reported.
    noise_ratio: float = 2.0
    # Where fewer readings of a channel than this are believable, its unit may be wrong.
    believable_share: float = 0.97
    # A noise that is stated larger than this many times the one seen is not believed.
    noise_believed: float = 3.0
    # A stated noise that is within this factor of the one seen was written in the readings' unit.
    one_unit: float = 4.0
    # Moments at which a slew is looked at: rotations between them stay well below a radian.
    grid_intervals: int = 64
    # Star-tracker fixes of a slew that are looked at.
    fixes_per_slew: int = 32
    # Sd and largest size of a stale rate bias, as shares of the campaign's rms rate. MEMS gyros are
    # switched on with biases of the size of a slew's rate; one that is larger than the motion would
    # be seen by anybody.
    stale_share: float = 0.3
    stalest_share: float = 1.0
    # A stale bias must bring the misfit down by this factor at least to be reported.
    stale_improvement: float = 2.0

    # `candidates.py`
    # More wheels than this have only pairs exchanged: all orders would be too many.
    most_wheels_in_any_order: int = 4

    # `check.py`
    # Numbers beyond this mark missing values, in whatever unit.
    largest_number: float = 1e10

    # `clocks.py`
    clock_rarity: int = 2
    # Two latenesses are one if they differ by less than this share.
    same_lateness: float = 0.25
    # This share of the readings must lie beside the rates with an offset that is proposed.
    share_beside_rates: float = 0.8
    # And this share of the motion must be left to be judged: streams overlap less once they are
    # moved.
    motion_left: float = 0.5
    # A lateness beyond this [s] is no delay of a sensor, but perhaps a known offset.
    longest_delay_s: float = 5.0
    # A known offset that leaves at most this much more is meant: fixes at rest tell a range.
    as_good_offset: float = 1.1
    clock_rounds: int = 6
    # A shift that changes by less than this share of itself has converged.
    shift_converged: float = 0.02
    # Degree in time up to which a momentum that drifts in a slew tells no clock: the impulse of a
    # torque that comes and goes is one of three. A clock shows in each turn of the body.
    slow_drift: int = 3
    # Sd of the prior of a lateness [s]: it only keeps the fit finite.
    lateness_prior_s: float = 1e3

    # `columns.py`
    # A tachometer moves where its readings spread by so many times what each differs from those
    # beside it: of noise alone once.
    moves_beyond_noise: float = 2.0
    # More wheels than this leave momentum free that the body does not feel.
    wheels_felt: int = 3
    column_rarity: int = 5
    # A star tracker that turns by this much [rad] while all rates stand still.
    turned_at_rest: float = 0.02

    # `doubts.py`
    # A bias is stale if it is this many of its stated sds off, and this many of its own.
    stale_bias_sds: float = 5.0
    factor_rarity: int = 3
    # A wheel that moves less than this share of the one that moves most tells no factor.
    idle_wheel: float = 0.1
    # The farthest that units lie apart.
    largest_factor: float = 1e10
    # Factors closer than this share are one, or the whole number that is meant; 60 / (2 pi) is not
    # 10.
    one_factor: float = 0.03

    # `laws.py`
    # Moments further off than this many times what most of their slew are off are trusted less.
    # Most: a motion that fills a sixth of the slew must not count as an outlier of its rests.
    far_moment: float = 2.0
    far_moment_quantile: float = 0.85

    # `motion.py`
    # A hole in a channel is a gap if it is this many usual steps long and this share of the slew.
    gap_steps: float = 6.0
    gap_share: float = 0.04
    # Pieces between gaps that are shorter than this share of the slew, or have fewer rows, tell
    # little.
    short_piece: float = 0.1
    rows_of_piece: int = 12

    # `search.py`
    # Two mistakes that are together rarer than this are not tried.
    rarest_pair: int = 4
    # Two directions of rotation are told apart if the smaller holds this share of the larger's.
    second_direction: float = 0.15
    # Decimals of axes as they are proposed: a hundredth of a degree is better than they are known.
    axis_decimals: int = 4
    # A rotation this close to a signed permutation [rad] is one, and a misaligned sensor.
    misaligned_axes: float = 0.15
    sensor_rounds: int = 6
    sensor_rarity: int = 5
    stale_bias_rounds: int = 4
    # A step shorter than this share of the bias's sd has converged.
    bias_converged: float = 0.05


LIMITS = Limits()
