"""Noise of every stream from the parts of a log at which the body rests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.inputs import held_integral
from bayes_inertia.faults.motion_scan import MotionScan
from bayes_inertia.faults.noise import NoiseFit, fit_noise
from bayes_inertia.faults.outliers import outliers_at_rest
from bayes_inertia.faults.quantisation import quantisation_sigma
from bayes_inertia.faults.stuck import stuck_fixes
from bayes_inertia.importing.common_clock import Logs
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.mapping_schema import MappingPart


@dataclass(frozen=True)
class RestNoise:
    """The noise of one key of the description.

    Parameters
    ----------
    key : str
        The key, such as "rate_sensor.sigma" or "wheels.wheel_x.momentum_sigma".
    unit : str
        Its unit.
    fits : tuple of NoiseFit
        One for each axis that was looked at.
    stated : tuple of float or None
        What the mapping states for each.
    """

    key: str
    unit: str
    fits: tuple[NoiseFit, ...]
    stated: tuple[float, ...] | None

    @property
    def seen(self) -> tuple[float, ...]:
        """White noise per sample of each axis, to two digits and not below the rounding."""
        seen = []
        for fit in self.fits:
            rounded = Decimal(f"{fit.white:.1e}")
            if float(rounded) < quantisation_sigma(fit.quantisation):
                rounded += Decimal(1).scaleb(int(rounded.as_tuple().exponent))
            seen.append(float(rounded))
        return tuple(seen)

    @property
    def step(self) -> float:
        """The step of the readings where their noise is that of its rounding; 0 where it is not."""
        fits = [f for f in self.fits if f.white <= quantisation_sigma(f.quantisation)]
        return max((fit.quantisation for fit in fits), default=0.0)

    @property
    def differs(self) -> bool:
        """Whether the stated noise is another one than the seen."""
        if self.stated is None:
            return False
        return any(
            abs(np.log(fit.white / stated)) > np.log(LIMITS.noise_differs) + 3.0 * fit.white_error
            for fit, stated in zip(self.fits, self.stated, strict=True)
            if fit.white > 0.0
        )

    def toml(self) -> str:
        """The line of the description that states the seen noise.

        Returns
        -------
        str
            TOML.
        """
        name = self.key.rpartition(".")[2]
        numbers = [f"{value:.2g}" for value in self.seen]
        value = numbers[0] if len(set(numbers)) == 1 else f"[{', '.join(numbers)}]"
        return f"{name} = {value}"


def rest_noise(logs: Logs, scan: MotionScan | None, mapping: MappingPart) -> list[RestNoise]:
    """The noise of rates, star tracker and tachometers at rest; none without known motions."""
    if scan is None:
        return []
    each = (noises(logs, scan, mapping) for noises in (_rates, _momenta, _attitudes))
    return [noise for noises in each for noise in noises]


def _rates(logs: Logs, scan: MotionScan, mapping: MappingPart) -> Iterator[RestNoise]:
    rate = logs.streams["rate"]
    both = zip(rate.values.T, np.broadcast_to(rate.rounding, 3), strict=True)
    fits = [_fit(rate.time, axis, scan, rounding) for axis, rounding in both]
    yield from _noise("rate_sensor.sigma", "rad/s", fits, mapping.rate_sensor.sigma)


def _noise(
    key: str, unit: str, fits: Sequence[NoiseFit | None], stated: Sequence[float | None] | None
) -> Iterator[RestNoise]:
    """The noise of a key if all its axes show one; what is stated of them."""
    seen = tuple(fit for fit in fits if fit is not None)
    given = tuple(x for x in stated or () if x is not None)
    if len(seen) == len(fits):
        yield RestNoise(key, unit, seen, given or None)


def _momenta(logs: Logs, scan: MotionScan, mapping: MappingPart) -> Iterator[RestNoise]:
    """Tachometers, less what the commanded torques change."""
    speed = "wheel_speed" in logs.streams
    stream = logs.streams.get("wheel_speed" if speed else "wheel_momentum")
    if stream is None:
        return
    torque = logs.streams.get("wheel_torque")
    commanded = np.zeros_like(stream.values)
    if torque is not None:
        commanded = held_integral(torque.time, torque.values, stream.time)
    roundings = np.broadcast_to(stream.rounding, len(mapping.wheels))
    for k, wheel in enumerate(mapping.wheels):
        size = wheel.spin_inertia if speed else 1.0
        if roundings[k] == 0.0 and len(np.unique(stream.values[:, k], equal_nan=True)) < 3:
            continue  # A reading that never changes shows the noise of the commands only.
        momentum = stream.values[:, k] * size
        fit = _fit(stream.time, momentum - commanded[:, k], scan, roundings[k] * size)
        key = f"wheels.{wheel.name}.momentum_sigma"
        yield from _noise(key, "N m s", [fit], [wheel.momentum_sigma])


def _attitudes(logs: Logs, scan: MotionScan, mapping: MappingPart) -> Iterator[RestNoise]:
    """Errors across and about the boresight."""
    stream, tracker = logs.streams.get("attitude"), mapping.star_tracker
    if stream is None or tracker is None:
        return
    boresight = np.array(tracker.boresight) / np.linalg.norm(tracker.boresight)
    across = np.linalg.svd(boresight[None, :])[2][1:]
    turns: dict[str, list[np.ndarray]] = {"sigma_cross": [], "sigma_roll": []}
    given = np.isfinite(stream.values).all(axis=1)
    # Fixes that rounding makes alike are stuck too, but then all at rest are.
    others = _series(stream.time, given & ~stuck_fixes(stream.values), scan)
    for rows in others or _series(stream.time, given, scan):
        attitude = Rotation.from_quat(stream.values[rows])
        # A small rotation in body axes stands on the right of a quaternion.
        errors = (attitude[0].inv() * attitude).as_rotvec()
        turns["sigma_cross"] += list((errors @ across.T).T)
        turns["sigma_roll"].append(errors @ boresight)
    for name, series in turns.items():
        fit = fit_noise(series, stream.rounding[0])
        yield from _noise(f"star_tracker.{name}", "rad", [fit], [getattr(tracker, name)])


def _fit(
    time: np.ndarray, values: np.ndarray, scan: MotionScan, rounding: float = 0.0
) -> NoiseFit | None:
    given = np.isfinite(values)
    # A few outliers would look like noise.
    given[given] = ~outliers_at_rest(values[given])
    rows = _series(time, given, scan)
    return fit_noise([values[r] for r in rows], float(rounding))


def _series(time: np.ndarray, given: np.ndarray, scan: MotionScan) -> list[np.ndarray]:
    """Rows of each uninterrupted series of evenly spaced readings at rest."""
    rest = given.copy()
    for start, end in scan.motions:
        rest &= (time < start) | (time > end)
    rows = np.flatnonzero(rest)
    if len(rows) < 2:
        return []
    steps = np.diff(time[rows])
    even = np.abs(steps - np.median(steps)) <= LIMITS.even_steps * np.median(steps)
    return np.split(rows, np.flatnonzero(~even) + 1)
