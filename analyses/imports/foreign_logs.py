"""A campaign written as the raw logs of another mission, with the mapping that reads them.

One log goes from the first slew to the last, with rest between them. The gyro writes deg/s against
UTC, the wheels rpm and mN m against GPS seconds, the star tracker a CCSDS AEM 2.0 or a table of
quaternions with the scalar first that map body to inertial. Commands and rates come at every row,
the tachometers at every second, the star tracker at its fixes. Each clock is off by a time of its
own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from analyses.imports.mapping_text import head_of_mapping
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import StarTracker

FIRST_UTC = np.datetime64("2026-03-01T12:00:00", "ns")
FIRST_GPS = 1456401618.0  # The same moment [s]; GPS is ahead of UTC by 18 s.
RPM = 2.0 * np.pi / 60.0  # [rad/s]
_REST_ROWS = 60  # At an end of a slew, by which attitude and rate are known there.
# True time minus stamp of each clock [s].
GYRO_OFFSET, WHEEL_OFFSET, TRACKER_OFFSET = -0.125, 1.5, -0.75


@dataclass(frozen=True)
class ForeignLogs:
    """Raw logs of a campaign."""

    files: tuple[Path, ...]  # the raw files
    mapping: Path  # the mapping that reads them, with the slews stated
    mapping_to_cut: Path  # the same without slews: the log is to be cut at its rests
    native: Campaign  # the campaign with the readings that the logs hold


def write_foreign_logs(
    campaign: Campaign,
    folder: Path,
    *,
    tracker: str = "aem",
    seed: int = 1,
    between_slews: bool = True,
) -> ForeignLogs:
    """Write a campaign as raw logs of another mission.

    `campaign`: with wheels, commands, tachometers and a star tracker. `folder`: where to; made if
    absent. `tracker`: how the star tracker's attitudes are written. `seed`: for the readings at
    rest between the slews. `between_slews`: write readings between the slews too: a slow drift from
    where one slew ended to where the next begins. Returns: what was written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    native = thinned(campaign)
    rng = np.random.default_rng(seed) if between_slews else None
    rows = _continuous(native, rng)
    inertias = campaign.spin_inertias
    files = [
        _csv(
            folder / "gyro.csv",
            {"utc": _utc(rows["time"] - GYRO_OFFSET)}
            | _named(("gx_dps", "gy_dps", "gz_dps"), np.degrees(rows["rate"])),
        ),
        _csv(
            folder / "wheel_commands.csv",
            {"gps_s": FIRST_GPS + rows["time"] - WHEEL_OFFSET}
            | _named(_wheel_names(campaign, "cmd_{}"), -1e3 * rows["torque"]),
        ),
    ]
    read = np.isfinite(rows["momentum"]).all(axis=1)
    files.append(
        _csv(
            folder / "wheel_speeds.csv",
            {"gps_s": FIRST_GPS + rows["time"][read] - WHEEL_OFFSET}
            | _named(_wheel_names(campaign, "speed_{}"), rows["momentum"][read] / inertias / RPM),
        )
    )
    fixed = np.isfinite(rows["attitude"]).all(axis=1)
    stamps, fixes = _utc(rows["time"][fixed] - TRACKER_OFFSET), rows["attitude"][fixed]
    files.append(
        _aem(folder / "tracker.aem", stamps, fixes)
        if tracker == "aem"
        else _csv(
            folder / "tracker.csv",
            {"utc": stamps}
            | _named(("qs", "qx", "qy", "qz"), (fixes * [-1.0, -1.0, -1.0, 1.0])[:, [3, 0, 1, 2]]),
        )
    )
    mapping, to_cut = folder / "mapping.toml", folder / "mapping_to_cut.toml"
    mapping.write_text(_mapping(campaign, tracker) + _slews(native), encoding="utf-8")
    cut = "\n[cut]\nbefore_s = 8.0\nafter_s = 8.0\n" if between_slews else ""
    to_cut.write_text(_mapping(campaign, tracker) + cut, encoding="utf-8")
    return ForeignLogs(tuple(files), mapping, to_cut, native)


def thinned(campaign: Campaign) -> Campaign:
    """The campaign with every second tachometer reading, as the logs hold it."""
    slews = []
    for slew in campaign.slews:
        momentum = np.array(slew.wheel_momentum)
        momentum[1::2] = np.nan
        slews.append(replace(slew, wheel_momentum=momentum, magnetic_field_N=None, position_N=None))
    return replace(campaign, slews=tuple(slews))


def _continuous(campaign: Campaign, rng: np.random.Generator | None) -> dict[str, np.ndarray]:
    """All channels from the first slew to the last, with rest between the slews if drawn."""
    slews = [
        {
            "time": slew.start + slew.time,
            "rate": slew.rate,
            "torque": slew.wheel_torque,
            "momentum": slew.wheel_momentum,
            "attitude": slew.attitude,
        }
        for slew in campaign.slews
    ]
    pieces: dict[str, list[np.ndarray]] = {key: [] for key in slews[0]}
    for k, channels in enumerate(slews):
        parts = [channels]
        if rng is not None and k + 1 < len(slews):
            parts.append(_rest(channels, slews[k + 1], campaign, rng))
        for key in pieces:
            pieces[key] += [np.asarray(part[key]) for part in parts]
    return {key: np.concatenate(values) for key, values in pieces.items()}


def _rest(
    before: Mapping[str, np.ndarray],
    after: Mapping[str, np.ndarray],
    campaign: Campaign,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    """Readings of a body that drifts from where one slew ended to where the next begins.

    Momentum is conserved but for what the environment did meanwhile: angles and rates are cubic in
    time, the wheels take what the body has not. The rate where it begins is known to 3e-6 rad/s
    only, so that a minute of it contradicts the slew's dynamics by several sds of the star tracker.
    """
    step = float(np.median(np.diff(before["time"])))
    first, last = before["time"][-1] + step, after["time"][0]
    time = np.arange(first, last - 0.5 * step, step)
    start, rate_0 = _resting(before, slice(-_REST_ROWS, None), before["time"][-1])
    end, rate_1 = _resting(after, slice(0, _REST_ROWS), last)
    spline = CubicHermiteSpline(
        [before["time"][-1], last],
        [np.zeros(3), (start.inv() * end).as_rotvec()],
        [rate_0, rate_1],
    )
    turned, rate = start * Rotation.from_rotvec(spline(time)), spline(time, 1)
    wheels = np.array([wheel.axis_B for wheel in campaign.wheels]).T
    locked = campaign.inertia.tensor + (wheels * campaign.spin_inertias) @ wheels.T
    ends = [
        attitude.apply(locked @ spin + wheels @ np.nanmean(channels["momentum"][rows], axis=0))
        for channels, rows, attitude, spin in (
            (before, slice(-_REST_ROWS, None), start, rate_0),
            (after, slice(0, _REST_ROWS), end, rate_1),
        )
    ]
    share = ((time - first) / (last - first))[:, None]
    body = turned.inv().apply((1.0 - share) * ends[0] + share * ends[1]) - rate @ locked
    momentum = body @ np.linalg.pinv(wheels).T
    spun = momentum + campaign.spin_inertias * (rate @ wheels)
    return _read(time, turned, rate, momentum, np.gradient(spun, step, axis=0), campaign, rng)


def _resting(
    channels: Mapping[str, np.ndarray], rows: slice, at: float
) -> tuple[Rotation, np.ndarray]:
    """Attitude at a time, and rate [rad/s], of a body that rests but for a slow drift."""
    rate = channels["rate"][rows].mean(axis=0)
    time, fixes = channels["time"][rows], channels["attitude"][rows]
    fixed = np.isfinite(fixes).all(axis=1)
    turns = Rotation.from_rotvec((at - time[fixed])[:, None] * rate)
    return (Rotation.from_quat(fixes[fixed]) * turns).mean(), rate


def _read(
    time: np.ndarray,
    attitude: Rotation,
    rate: np.ndarray,
    momentum: np.ndarray,
    torque: np.ndarray,
    campaign: Campaign,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    """What the sensors read of a motion, with their noise."""
    n, step = len(time), float(np.median(np.diff(time)))
    sigma = [wheel.momentum_sigma or 0.0 for wheel in campaign.wheels]
    momentum = momentum + rng.normal(size=momentum.shape) * sigma
    momentum[1::2] = np.nan
    fixes = np.full((n, 4), np.nan)
    rows = np.arange(0, n, max(1, round(1.0 / step)))
    star = campaign.star_tracker
    assert star is not None
    fixes[rows] = noisy_fixes(attitude[rows].as_quat(), star, rng)
    return {
        "time": time,
        "rate": rate + rng.normal(size=(n, 3)) * campaign.rate_sensor.sigma,
        "torque": torque,
        "momentum": momentum,
        "attitude": fixes,
    }


def noisy_fixes(quaternions: np.ndarray, star: StarTracker, rng: np.random.Generator) -> np.ndarray:
    """Fixes of attitudes, with the star tracker's noise in body axes.

    `quaternions` (rows, 4): true attitudes, scalar last. `star`: the star tracker. `rng`: of the
    noise. Returns (rows, 4): of the same sense as the attitudes.
    """
    boresight = np.array(star.boresight_B)
    rows = len(quaternions)
    errors = rng.normal(size=(rows, 3)) * star.sigma_cross
    about = rng.normal(size=rows) * star.sigma_roll
    errors += np.outer(about - errors @ boresight, boresight)
    turned = Rotation.from_quat(quaternions) * Rotation.from_rotvec(errors)
    fixes = turned.as_quat()
    return np.where(np.sum(fixes * quaternions, axis=1)[:, None] < 0.0, -fixes, fixes)


def _utc(seconds: np.ndarray) -> np.ndarray:
    """Dates with microseconds, as texts."""
    stamps = FIRST_UTC + np.rint(seconds * 1e6).astype("timedelta64[us]")
    return np.array([f"{text}Z" for text in np.datetime_as_string(stamps, unit="us")])


def _named(names: Sequence[str], values: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(names, values.T, strict=True))


def _wheel_names(campaign: Campaign, form: str) -> list[str]:
    return [form.format(wheel.name) for wheel in campaign.wheels]


def _csv(path: Path, columns: Mapping[str, np.ndarray]) -> Path:
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _aem(path: Path, stamps: np.ndarray, quaternions: np.ndarray) -> Path:
    head = f"""\
CCSDS_AEM_VERS = 2.0
CREATION_DATE = 2026-03-02T00:00:00
ORIGINATOR = TEST

META_START
OBJECT_NAME = MOST-LIKE
OBJECT_ID = 2026-001A
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
TIME_SYSTEM = UTC
START_TIME = {stamps[0][:-1]}
STOP_TIME = {stamps[-1][:-1]}
ATTITUDE_TYPE = QUATERNION
META_STOP

DATA_START
"""
    rows = [
        f"{stamp[:-1]} {' '.join(repr(float(cell)) for cell in quaternion)}"
        for stamp, quaternion in zip(stamps, quaternions, strict=True)
    ]
    path.write_text(head + "\n".join(rows) + "\nDATA_STOP\n", encoding="utf-8")
    return path


def _mapping(campaign: Campaign, tracker: str) -> str:
    """The mapping without slews."""
    commands = _wheel_names(campaign, "cmd_{}")
    speeds = _wheel_names(campaign, "speed_{}")
    stars = (
        'files = ["tracker.aem"]'
        if tracker == "aem"
        else """files = ["tracker.csv"]
time = { names = ["utc"], kind = "utc" }
form = "quaternion"
names = ["qs", "qx", "qy", "qz"]
scalar = "first"
maps = "body_to_inertial"
frame = "body\""""
    )
    streams = f"""
[[streams]]
holds = "rate"
files = ["gyro.csv"]
time = {{ names = ["utc"], kind = "utc" }}
offset_s = {GYRO_OFFSET}
names = ["gx_dps", "gy_dps", "gz_dps"]
unit = "deg/s"
frame = "body"

[[streams]]
holds = "wheel_torque"
files = ["wheel_commands.csv"]
time = {{ names = ["gps_s"], kind = "gps_s" }}
offset_s = {WHEEL_OFFSET}
names = {commands}
unit = "mN m"
acts_on = "body"

[[streams]]
holds = "wheel_speed"
files = ["wheel_speeds.csv"]
time = {{ names = ["gps_s"], kind = "gps_s" }}
offset_s = {WHEEL_OFFSET}
names = {speeds}
unit = "rpm"
relative_to = "body"

[[streams]]
holds = "attitude"
{stars}
offset_s = {TRACKER_OFFSET}
"""
    return head_of_mapping(campaign) + streams


def _slews(campaign: Campaign) -> str:
    """The slews of a campaign as a mapping states them."""
    texts = []
    for slew in campaign.slews:
        ends = np.array([slew.start + slew.time[0], slew.start + slew.time[-1]])
        start, end = _utc(ends)
        axis = "" if slew.axis_B is None else f"axis = {list(slew.axis_B)}\n"
        angle = "" if slew.angle is None else f"angle_deg = {np.degrees(slew.angle):.15g}\n"
        texts.append(
            f'\n[[slews]]\nname = "{slew.name}"\nstart = "{start}"\nend = "{end}"\n{axis}{angle}'
        )
    return "".join(texts)
