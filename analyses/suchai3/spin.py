"""The spin over months, and which torques explain it: drag, a constant torque, damping."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from analyses.suchai3.campaign import CAD, DEGREE, ELEMENTS, TELEMETRY
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.tables.raw_files import read_raw

_DAY = 86_400.0  # [s]
# Sessions of one day, and what a gyro's bias moves by between sessions, blur a mean spin.
SPIN_SIGMA = 0.15  # [deg/s]
# Another pass of the same day tells nothing new of months.
_APART = 3_600.0  # [s]


@dataclass(frozen=True)
class Spin:
    """Mean spin of each session, and the orbit's mean motion then."""

    day: np.ndarray  # (n,) since the first session
    # (n,) about the axis of the largest moment [deg/s], by the gyro with its K and bias.
    spin: np.ndarray
    mean_motion: np.ndarray  # (n,) turns a day; it grows as drag takes the orbit down

    def json(self) -> dict[str, list[float]]:
        """As it stands in tumble.json."""
        return {name: getattr(self, name).round(6).tolist() for name in self.__dataclass_fields__}


@dataclass(frozen=True)
class History:
    """One explanation of the spin."""

    torques: tuple[str, ...]  # what acts
    torque_N_m: tuple[float, ...]  # mean size of each over the months, in the CAD's scale [N m]
    rms: float  # of what is left [deg/s]
    bic: float  # bayesian information criterion, with `SPIN_SIGMA`
    modelled: np.ndarray  # (n,) spin [deg/s]

    def json(self) -> dict[str, Any]:
        """As it stands in tumble.json."""
        return {
            "torques": list(self.torques),
            "torque_N_m": list(self.torque_N_m),
            "rms": self.rms,
            "bic": self.bic,
            "modelled": self.modelled.round(4).tolist(),
        }


def spin_history(flown: Campaign, parameters: dict[str, dict[str, float]]) -> Spin:
    """Spins of the sessions, by the gyro's y axis."""
    K = parameters["K2"]["mean"]
    time: list[float] = []
    spin: list[float] = []
    for slew in flown.slews:
        if not time or slew.start - time[-1] > _APART:
            time.append(slew.start)
            spin.append(K * float(np.nanmean(np.asarray(slew.rate)[:, 1])) / DEGREE)
    stamp = float(np.min(read_raw(TELEMETRY).columns["unix_utc_s"].values))
    day = np.array(time) / _DAY
    epoch, motion = _mean_motion()
    at = np.interp(day, epoch - stamp / _DAY, motion)
    return Spin(day - day[0], np.array(spin), at)


def _mean_motion() -> tuple[np.ndarray, np.ndarray]:
    """Days since 1970 and turns a day, of all two-line elements."""
    from sgp4.api import Satrec

    lines = ELEMENTS.read_text().splitlines()
    orbits = [Satrec.twoline2rv(*pair) for pair in zip(lines[::2], lines[1::2], strict=True)]
    days = [orbit.jdsatepoch + orbit.jdsatepochF - 2_440_587.5 for orbit in orbits]
    return np.array(days), np.array([orbit.no_kozai * 1440.0 / (2.0 * np.pi) for orbit in orbits])


def histories(spin: Spin) -> list[History]:
    """All sets of the torques that a body without wheels meets, best first."""
    step = np.diff(spin.day)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (spin.spin[1:] + spin.spin[:-1]) * step)])
    causes = {
        "drag on a body that is no mirror image": spin.mean_motion - spin.mean_motion[0],
        "a constant torque (sunlight)": spin.day,
        "damping (eddy currents)": -turned,
    }
    found = []
    for size in range(1, len(causes) + 1):
        for names in combinations(causes, size):
            columns = np.stack([np.ones_like(spin.day), *(causes[n] for n in names)], axis=1)
            fitted, *_ = np.linalg.lstsq(columns, spin.spin, rcond=None)
            left = spin.spin - columns @ fitted
            misfit = float(np.sum((left / SPIN_SIGMA) ** 2))
            of_each = fitted[1:] * columns[-1, 1:] / spin.day[-1]  # [deg/s a day]
            torque = CAD[1, 1] * of_each * DEGREE / _DAY
            found.append(
                History(
                    names,
                    tuple(torque.tolist()),
                    float(np.sqrt(np.mean(left**2))),
                    misfit + (1 + size) * float(np.log(len(left))),
                    columns @ fitted,
                )
            )
    return sorted(found, key=lambda history: history.bic)
