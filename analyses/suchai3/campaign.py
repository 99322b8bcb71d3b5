"""SUCHAI-3 from its packets to a campaign: import, magnetometer, orbit and field.

A 3U CubeSat in free rotation, without wheels or control: gyro and magnetometer at 1 Hz, two-line
elements. `data/README.md` says where the telemetry comes from; its licence stands beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import bayes_inertia as bi
from bayes_inertia import Campaign, InertiaPrior
from bayes_inertia.campaign.hardware import DirectionSensor
from bayes_inertia.importing.import_logs import import_logs
from bayes_inertia.tables.raw_files import read_raw

HERE = Path(__file__).parent
TELEMETRY = HERE / "data" / "telemetry.csv"
ELEMENTS = HERE / "data" / "orbit.tle"
MAPPING = HERE / "mapping.toml"
GAUSS = 1e-4  # [T]
DEGREE = np.pi / 180.0
# The builders' CAD [kg m^2]; another line of the same program has 37540.678 and 38550.678 kg mm^2.
CAD = np.diag([38478.678, 38528.678, 6873.717]) * 1e-6


@dataclass(frozen=True)
class Setup:
    """What the fit starts from and what it takes as known, each with its reason."""

    # Noise of a reading [T]: 15 mG is what a fit leaves. The builders state 2.8 mG; but packets
    # are stamped in whole seconds, and at 50 deg/s a tenth of a second is 20 mG.
    magnetometer_sigma: float = 1.5e-6
    # Of nutation to spin: a line in the spectrum of the x rate in every session. It sets where
    # Jyy - Jxx starts, not its prior's width.
    nutation_ratio: float = 0.135
    # Prior of the tensor: CAD to 3 % of each moment; products [kg m^2] as large as a turn of 4
    # degrees makes them.
    relative_sigma: float = 0.03
    product_sigma: float = 0.002
    # Prior sd of K2 around the ratio of the spins that magnetometer and gyro see.
    gyro_y_sigma: float = 0.002
    mounting_sigma: float = 0.05  # of the magnetometer's axes against the gyro's [rad]
    # Slews of one session at most, evenly chosen: neighbours tell the same, and one session of 90
    # minutes would weigh as much as all others together.
    most: int = 3
    fewest: int = 150  # readings of a slew: fewer see less than a turn of the nutation


def campaign(setup: Setup | None = None) -> Campaign:
    """The sessions since 2023 as slews of at most 300 s, with magnetometer and field.

    The session of 2022 is left out: its z rate stands at the end of the gyro's range.
    """
    setup = setup or Setup()
    with TemporaryDirectory() as folder:
        imported = import_logs([TELEMETRY], MAPPING, Path(folder) / "campaign")
        whole = imported.campaign
    epoch = np.datetime64("1970-01-01") + np.timedelta64(int(_first_stamp()), "s")
    whole = whole.subset([k for k, slew in enumerate(whole.slews) if not _saturated(slew)])
    whole = whole.subset(_thinned(whole, setup))
    field_S, offset_S = _magnetometer(whole)
    slews = [
        replace(slew, more={"magnetometer": values - offset_S})
        for slew, values in zip(whole.slews, field_S, strict=True)
    ]
    sensor = DirectionSensor(
        (setup.magnetometer_sigma,) * 3,
        unit="T",
        offset_sigma=0.1 * GAUSS,
        scale_sigma=0.1,
        soft_iron_sigma=0.05,
        mounting_sigma=setup.mounting_sigma,
    )
    known = replace(
        whole,
        slews=tuple(slews),
        more_sensors=(("magnetometer", sensor),),
        inertia=InertiaPrior(started(setup), setup.relative_sigma, setup.product_sigma),
    )
    ratio, _ = spin_ratio(known)
    gyro = replace(
        known.gyro,
        scale_factor=(1.0, ratio, 1.0),
        scale_factor_sigma=(0.03, setup.gyro_y_sigma, 0.03),
    )
    return bi.with_orbit(replace(known, rate_sensor=gyro), ELEMENTS, str(epoch))


def started(setup: Setup) -> np.ndarray:
    """The CAD tensor (3, 3) [kg m^2], with Jyy - Jxx as the line of the nutation asks for."""
    Jxx, Jyy, Jzz = np.diag(CAD)
    more = setup.nutation_ratio**2 * Jxx * Jzz / (Jyy - Jzz)
    return np.diag([Jxx, Jxx + more, Jzz])


def spin_ratio(campaign: Campaign) -> tuple[float, float]:
    """Slope and offset [rad/s] of the spin that the magnetometer sees over the gyro's y rate.

    The field turns slowly itself, one way and the other: over sessions that averages out.
    """
    gyro, seen = [], []
    for slew in campaign.slews:
        rate, time = float(np.nanmean(np.asarray(slew.rate)[:, 1])), slew.time
        field = (slew.more or {})["magnetometer"][:, [0, 2]]
        known = np.isfinite(field).all(axis=1)
        wave = field[known] - field[known].mean(axis=0)
        tried = np.abs(rate) * np.linspace(0.95, 1.05, 2001)
        power = np.abs(np.exp(-1j * np.outer(tried, time[known])) @ wave)
        gyro.append(rate)
        seen.append(np.sign(rate) * tried[np.argmax(np.sum(power**2, axis=1))])
    slope, offset = np.polyfit(gyro, seen, 1)
    return float(slope), float(offset)


def _first_stamp() -> float:
    return float(np.min(read_raw(TELEMETRY).columns["unix_utc_s"].values))


def _saturated(slew: bi.Slew) -> bool:
    """Whether an axis stands still at a reading."""
    return bool(np.any(np.ptp(np.asarray(slew.rate), axis=0) == 0.0))


def _thinned(campaign: Campaign, setup: Setup) -> list[int]:
    """Slews that are long enough, so many of a session."""
    starts = np.array([slew.start for slew in campaign.slews])
    session = np.append(0, np.cumsum(np.diff(starts) > 3600.0))
    long = np.array([len(slew.time) >= setup.fewest for slew in campaign.slews])
    kept: list[int] = []
    for number in np.unique(session):
        slews = np.flatnonzero((session == number) & long)
        chosen = np.linspace(0, len(slews) - 1, min(setup.most, len(slews))).round().astype(int)
        kept += slews[chosen].tolist()
    return kept


def _magnetometer(campaign: Campaign) -> tuple[list[np.ndarray], np.ndarray]:
    """Readings (n, 3) [T] on the rows of each slew, and the middle of all (3,)."""
    table = read_raw(TELEMETRY)
    stamps = table.columns["unix_utc_s"].values.astype(float)
    field = table.stack([f"mag_{axis}_mG" for axis in "xyz"]) * 1e-3 * GAUSS
    stamps, first = np.unique(stamps, return_index=True)
    field, zero = field[first], stamps[0]
    readings = []
    for slew in campaign.slews:
        row = np.searchsorted(stamps, np.round(zero + slew.start + slew.time))
        readings.append(field[row])
    every = np.concatenate(readings)
    return readings, 0.5 * (every.min(axis=0) + every.max(axis=0))
