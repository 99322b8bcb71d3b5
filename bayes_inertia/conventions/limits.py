"""The thresholds by which the laws of the conventions check decide, with the reason for each.

Numbers of a single step (rounds, rarities, what counts as at rest) stand in the file that takes it.
None is tuned to a campaign: they follow from what the effects of the library do (`physics.effects`
states its priors as fractions of the motion) and from how far apart two conventions lie. A wrong
unit, sign or order leaves 100 % or 200 % of the motion unexplained; a physical effect leaves a few
per cent. The limits stand between, nearer to the wrong convention.
"""

from __future__ import annotations

PHYSICAL_SHARE = 0.10
"""Share of the motion that physics which nobody told may leave unexplained, one sd.

The library's disturbance torques have a prior sd of 3 % of J w / T, friction 10 %, an oscillating
mode 1 %, misalignments 0.3 %, gains 3 %: 10 % is three of the usual sds.
"""

IDLE_SHARE = 0.03
"""Share of the campaign's largest motion that disturbs a slew or a wheel that hardly moves."""

FRAME_SHARE = 0.01
"""Relative error of angles that no parameter here explains: coning, nonlinearity, delays."""

INERTIA_SD = 0.20
"""Sd of the logarithm of the stated moments of inertia, at least.

30 % wrong is 1.8 sds, a factor of 100 is 23.
"""

SCALE_SD = 0.05
"""Sd of K, at least: 5 % is an ordinary rate sensor, a wrong unit 19 sds and more."""

MISALIGNMENT_SD = 0.05
"""Sd of the misalignment of a sensor's axes [rad]: degrees are physical, 90 degrees never."""

TORQUE_SHARE = 0.10
"""Sd of a constant body torque, as a share of the motion's momentum over the slew's duration."""

UNSEEN_FRICTION_SHARE = 0.30
"""The same where no tachometer sees what friction takes from the wheels."""

BIAS_SHARE = 0.02
"""Sd of a rate bias as a share of the campaign's rms rate, at least: a stale bias is physical."""

GAIN_SD = 0.10
"""Sd of a wheel's torque gain: three times the library's."""

IMPOSSIBLE = 3.0
"""Misfit [sd] above which stated conventions are impossible.

30 % of a slew's motion stays unexplained after J, K, misalignment, bias and torques have had their
say. A flipped sign leaves 20 sds, a swapped pair 14, a wrong unit 10.
"""

ORDINARY = 2.0
"""Misfit [sd] below which conventions agree with the data: 20 % of a slew's motion."""

IMPROVEMENT = 3.0
"""A change must bring the misfit down by this factor at least to be proposed."""

PAIR_IMPOSSIBLE, PAIR_ORDINARY = 5.0, 1.0
"""The same for two mistakes at once.

There are a thousand pairs, so that a pair must mend more: to 10 % of the motion.
"""

HOPELESS = 8.0
"""Misfit [sd] above which data are called impossible although no change mends them.

A body whose inertia is stated 2.2 times too large or small comes to this, and so does a torque as
large as the wheels' that the telemetry does not tell.
"""

EQUAL_FACTOR, EQUAL_MISFIT = 2.0, 0.15
"""Two changes mend alike if their misfits differ by less than the factor, or than this many sds.

0.15 sd is 1.5 % of the motion, less than what undisclosed physics may hide.
"""

CLEARLY = 0.8
"""A free factor is named beside a wrong unit if it leaves a fifth less than the unit does."""

SUSPICIOUS, SURE_IMPROVEMENT = 1.0, 4.0
"""Between a misfit of one sd and `IMPOSSIBLE` data are possible as stated, but a change is proposed
that brings the misfit down by four.

Hidden effects leave as much as that; but no change of convention imitates an effect so well.
"""

CLEAR = 0.5
"""Misfit [sd] below which a change explains so well that no stale bias is tried beside it."""

FACTOR = 1.5
"""Factor between commands and tachometers beyond which they contradict each other.

Five of `GAIN_SD`, and sixteen sds of the gain in the library."""

FAR_BEYOND = 3.0
"""A hardware limit that readings exceed this many times is wrong, or their unit is.

A wheel overspeeds by a tenth, a controller that saturates asks for twice; the smallest wrong unit
is a factor of 9.5 (rpm)."""

COPIED, NOISY = 0.05, 0.2
"""Two columns are one if their difference is below 5 % of the noise of either, which independent
noise never is; they are judged only if they hold a fifth of the noise that is stated."""

LATE_SHARE = 1.0 / 1000.0
"""Prior sd of a sensor's lateness in the library, as a share of the slew's duration."""

LAG_SHARE = 1.0 / 300.0
"""The same for the lag of a wheel behind its torque command."""

SHARP = 0.1
"""Clocks are compared where everything else agrees: residuals are then judged at 1 % of the motion
rather than 10 %."""

LATE_SDS = 5.0
"""Lateness beyond this many sds of the library's prior is a wrong clock, no exposure time."""

LEAST_LATE_SDS, LONGEST_LATENESS = 3.0, 0.9
"""Three of these sds are enough beyond 0.9 s: exposure, filters and processing of a sensor
together do not take a second, however slowly the spacecraft turns."""

LATE_CHI2 = 100.0
"""chi^2 must fall by this much with one offset: ten sds."""

LATE_STEPS = 0.7
"""A wrong clock is off by this many rows at least: half a row is a matter of what a stamp means."""

IN_MOTION = 0.2
"""A star-tracker fix is taken in motion if the rate is this share of the slew's largest."""

NOTABLE = 0.3
"""Residual in hundredths of the motion below which no clock is looked into."""

NOISE_RATIO = 2.0
"""Noise seen in smooth rows that differs from the stated one by this factor is reported."""

BELIEVABLE_SHARE = 0.97
"""Where fewer readings of a channel than this are believable, its unit may be wrong."""

NOISE_BELIEVED = 3.0
"""A noise that is stated larger than this many times the one seen is not believed."""

ONE_UNIT = 4.0
"""A stated noise that is within this factor of the one seen was written in the readings' unit."""

GRID_INTERVALS = 64
"""Moments at which a slew is looked at: rotations between them stay well below a radian."""

FIXES_PER_SLEW = 32
"""Star-tracker fixes of a slew that are looked at."""

STALE_SHARE, STALEST_SHARE = 0.3, 1.0
"""Sd and largest size of a stale rate bias, as shares of the campaign's rms rate.

MEMS gyros are switched on with biases of the size of a slew's rate; one that is larger than the
motion would be seen by anybody."""

STALE_IMPROVEMENT = 2.0
"""A stale bias must bring the misfit down by this factor at least to be reported."""
