"""Which parts of a log are slews: rest, motion, rest; and what is left out, with the reason."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import PurePath

import numpy as np

from bayes_inertia.campaign.schema import Vector3
from bayes_inertia.errors import CampaignError, require
from bayes_inertia.faults.motion_scan import MotionScan, scan_motion
from bayes_inertia.importing.common_clock import Logs
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.log_reader import utc_ns
from bayes_inertia.importing.mapping_schema import CutPart, MappedSlew, MappingPart
from bayes_inertia.tables.stamp_parts import SECOND


@dataclass(frozen=True)
class SlewWindow:
    """One slew of a log.

    Parameters
    ----------
    name : str
        The slew, as printed.
    start, end : float
        The part of the log that becomes the slew [s].
    motion : tuple of float, optional
        Start and end of the motion in it [s].
    turned : float, optional
        Angle that the rates add up to [rad].
    fixes : tuple of int, optional
        Star-tracker fixes before and after the motion.
    axis : list of float, optional
        Commanded axis in body axes.
    angle_deg : float, optional
        Commanded angle [deg].
    """

    name: str
    start: float
    end: float
    motion: tuple[float, float] | None = None
    turned: float | None = None
    fixes: tuple[int, int] | None = None
    axis: Vector3 | None = None
    angle_deg: float | None = None


@dataclass(frozen=True)
class DroppedPart:
    """A part of a log that becomes no slew.

    Parameters
    ----------
    start, end : float
        From when to when [s].
    reason : str
        Why.
    """

    start: float
    end: float
    reason: str


@dataclass(frozen=True)
class SlewCut:
    """Record of how a log was cut.

    Parameters
    ----------
    windows : tuple of SlewWindow
        The slews, in the order of time.
    dropped : tuple of DroppedPart
        What is left out.
    scan : MotionScan or None
        The rates that decided; None where they show no motion and need not.
    by : str
        What decided: "rest", "files", "gaps" or "slews" (stated in the mapping).
    """

    windows: tuple[SlewWindow, ...]
    dropped: tuple[DroppedPart, ...]
    scan: MotionScan | None
    by: str


def cut_into_slews(logs: Logs, mapping: MappingPart, label: str) -> SlewCut:
    """Cut logs into slews.

    Stated `[[slews]]` are taken as they are; of several files with rates each is one slew; one
    file, or files that overlap, is cut where the body rests, as far as `[cut]` does not say
    otherwise. A spacecraft that never rests is cut at the gaps between sessions.
    """
    rate, cut = logs.streams["rate"], mapping.cut
    pause = cut.gap_s or max(LIMITS.pause_s, LIMITS.pause_steps * rate.step)
    by = cut.by or ("files" if len(rate.files) > 1 and not rate.overlap else "rest")
    if mapping.slews or by in ("files", "gaps"):
        if mapping.slews:
            stated = [_stated(slew, logs, label) for slew in mapping.slews]
            advice = "end one before the other, as no reading may count twice"
            windows = _one_by_one(stated, advice)
        else:
            windows = _of_files(logs) if by == "files" else _sessions(logs, cut, pause)
        scan = None
        with contextlib.suppress(CampaignError):  # Stated slews need no motion that stands out.
            scan = _scan(logs, cut, pause)
        if by != "gaps":  # A session is all motion.
            windows = [_with_motion(window, scan, _fixes(logs)) for window in windows]
        dropped = _left_over(windows, scan, "no slew is stated here") if mapping.slews else []
        return SlewCut(tuple(windows), tuple(dropped), scan, "slews" if mapping.slews else by)
    scan = _scan(logs, cut, pause)
    windows, dropped = _at_rests(scan, logs, cut)
    reasons = "; ".join(f"{d.start:.0f} to {d.end:.0f} s, {d.reason}" for d in dropped[:4])
    what = f"no slew from rest to rest is in the log ({reasons or 'no motion'})"
    advice = 'lower min_rest_s, raise rest_rate, write by = "gaps" for a spacecraft that never '
    advice += "rests, or state [[slews]] with start and end"
    require(bool(windows), f"{label}, key cut", what, advice)
    return SlewCut(tuple(windows), tuple(dropped), scan, "rest")


def _scan(logs: Logs, cut: CutPart, pause: float) -> MotionScan:
    rate = logs.streams["rate"]
    files = ", ".join(rate.files)
    return scan_motion(rate.time, rate.values, files, threshold=cut.rest_rate, pause=pause)


def _stated(slew: MappedSlew, logs: Logs, label: str) -> SlewWindow:
    """A window that the mapping states."""
    where = f"{label}, key slews.{slew.name}"
    start, end = (_moment(getattr(slew, key), logs, f"{where}.{key}") for key in ("start", "end"))
    rate = logs.streams["rate"]
    require(start < end, where, "the end is not after the start", "swap them")
    span = f"from {rate.time[0]:.1f} s to {rate.time[-1]:.1f} s after the first reading"
    advice = f"the rates reach {span}; check the date and the clock"
    require(len(rate.between(start, end).time) > 0, where, "no rate was logged then", advice)
    return SlewWindow(slew.name, start, end, axis=slew.axis, angle_deg=slew.angle_deg)


def _moment(value: str | float, logs: Logs, where: str) -> float:
    """A stated time on the clock of the logs [s]."""
    kind = "UTC dates, such as" if logs.absolute else "seconds on the clock of the streams, not"
    what = f"{value!r} does not fit the clock of the streams"
    advice = f'write {kind} "2026-03-01T12:00:00Z"'
    require(isinstance(value, str) == logs.absolute, where, what, advice)
    if isinstance(value, str):
        return (utc_ns(value, where) - logs.epoch_ns) / SECOND
    return value - logs.epoch_ns / SECOND


def _of_files(logs: Logs) -> list[SlewWindow]:
    rate = logs.streams["rate"]
    times = [(PurePath(file).stem, rate.time[rate.file == k]) for k, file in enumerate(rate.files)]
    windows = [SlewWindow(name, float(t[0]), float(t[-1])) for name, t in times if len(t)]
    advice = 'write by = "rest" in [cut] if the files are no slews, or epoch = "file" if each file '
    return _one_by_one(windows, f"{advice}has a clock of its own")


def _sessions(logs: Logs, cut: CutPart, pause: float) -> list[SlewWindow]:
    """Runs of rates without a gap, those longer than `longest_s` in equal parts."""
    time = logs.streams["rate"].time
    runs = np.split(time, np.flatnonzero(np.diff(time) > pause) + 1)
    windows: list[SlewWindow] = []
    for run in runs:
        if len(run) < LIMITS.fewest_rates:
            continue
        parts = 1 if cut.longest_s is None else int(np.ceil((run[-1] - run[0]) / cut.longest_s))
        for part in np.array_split(run, max(parts, 1)):
            windows.append(SlewWindow(f"slew {len(windows) + 1}", float(part[0]), float(part[-1])))
    return windows


def _one_by_one(windows: list[SlewWindow], advice: str) -> list[SlewWindow]:
    """Slews in the order of time; an error if two of them share readings."""
    ordered = sorted(windows, key=lambda window: window.start)
    for before, after in pairwise(ordered):
        what = f"the times of {before.name} and {after.name} overlap"
        require(after.start > before.end, "slews", what, advice)
    return ordered


def _with_motion(window: SlewWindow, scan: MotionScan | None, fixes: np.ndarray) -> SlewWindow:
    """A window, the motion in it, and the fixes on either side."""
    if scan is None:
        return window
    inside = [m for m in scan.motions if m[0] < window.end and m[1] > window.start]
    if not inside:
        return window
    start, end = float(inside[0][0]), float(inside[-1][1])
    before = int(((fixes >= window.start) & (fixes < start)).sum())
    after = int(((fixes > end) & (fixes <= window.end)).sum())
    turned = _turned(scan, start, end)
    return replace(window, motion=(start, end), turned=turned, fixes=(before, after))


def _from_first_command(window: SlewWindow, logs: Logs) -> SlewWindow:
    """A window without the moments before the wheels' log begins, or goes on after a pause."""
    torque = logs.streams.get("wheel_torque")
    if torque is None or window.motion is None:
        return window
    in_force = (torque.time > window.start - 2.0 * torque.step) & (torque.time <= window.start)
    later = torque.time[torque.time > window.start]
    latest = window.start + LIMITS.rest_without_command * (window.motion[0] - window.start)
    if in_force.any() or not len(later) or later[0] > latest:
        return window
    return replace(window, start=float(later[0]))


def _turned(scan: MotionScan, start: float, end: float) -> float:
    rows = (scan.time >= start) & (scan.time <= end)
    return float(np.trapezoid(scan.speed[rows], scan.time[rows]))


def _at_rests(
    scan: MotionScan, logs: Logs, cut: CutPart
) -> tuple[list[SlewWindow], list[DroppedPart]]:
    """Windows around the motions that have a rest on either side."""
    fixes = _fixes(logs)
    step = float(np.median(np.diff(fixes))) if len(fixes) > 1 else 0.0
    told = LIMITS.fewest_rates * logs.streams["rate"].step, LIMITS.fixes_in_rest * step
    shortest = cut.min_rest_s or max(LIMITS.shortest_rest_s, *told)
    motions = _merged(scan, shortest)
    turned = [_turned(scan, *motion) for motion in motions]
    wanted = _wanted_rests(motions, fixes, cut, shortest)
    windows: list[SlewWindow] = []
    dropped: list[DroppedPart] = []
    for k, (start, end) in enumerate(motions):
        rest_before, rest_after = _rests_of(k, motions, scan, wanted)
        reason = _why_not(turned[k], max(turned), rest_before, rest_after, shortest)
        if reason:
            dropped.append(DroppedPart(start, end, reason))
            continue
        begin = start - rest_before
        if windows and windows[-1].end >= begin:
            windows[-1] = replace(windows[-1], end=float(np.nextafter(begin, -np.inf)))
        window = SlewWindow(f"slew {len(windows) + 1}", begin, end + rest_after)
        window = _from_first_command(_with_motion(window, scan, fixes), logs)
        windows.append(_with_motion(window, scan, fixes))
    spare = _left_over([*windows, *dropped], scan, "rest that no slew needs")
    return windows, sorted([*dropped, *spare], key=lambda part: part.start)


def _fixes(logs: Logs) -> np.ndarray:
    """Times of the star-tracker fixes [s]."""
    stream = logs.streams.get("attitude")
    return np.zeros(0) if stream is None else stream.time


def _wanted_rests(
    motions: list[tuple[float, float]], fixes: np.ndarray, cut: CutPart, shortest: float
) -> tuple[list[float], list[float]]:
    """Seconds of rest wanted before and after each motion, so that fixes lie in both."""
    stated = (cut.before_s, cut.after_s)
    wanted: tuple[list[float], list[float]] = ([], [])
    for start, end in motions:
        # The fixes nearest to the motion first; those in other motions do not matter here.
        sides = (start - fixes[fixes < start][::-1], fixes[fixes > end] - end)
        for away, seconds, side in zip(sides, stated, wanted, strict=True):
            count = LIMITS.fixes_kept if seconds is None else LIMITS.fixes_in_rest
            least = float(away[min(count, len(away)) - 1]) if len(away) else 0.0
            # A tracker that comes back much later is no part of this slew.
            least = least if least <= LIMITS.longest_wait_s else 0.0
            usual = max(LIMITS.rest_kept_s, end - start) if seconds is None else seconds
            side.append(max(usual, least, shortest))
    return wanted


def _rests_of(
    k: int, motions: list[tuple[float, float]], scan: MotionScan, wanted: tuple[list[float], ...]
) -> tuple[float, float]:
    """Seconds of rest that a slew gets before and after; slews share the rest between them."""
    before, after = wanted
    (start, end), span = motions[k], scan.segment_span(motions[k][0])
    earlier = (motions[k - 1][1], after[k - 1]) if k else (-np.inf, 0.0)
    later = (motions[k + 1][0], before[k + 1]) if k + 1 < len(motions) else (np.inf, 0.0)
    return (
        _share(start, span[0], earlier[0], before[k], earlier[1]),
        _share(-end, -span[1], -later[0], after[k], later[1]),
    )


def _share(edge: float, end: float, other: float, wanted: float, wanted_by_other: float) -> float:
    """Seconds of rest that a slew gets on one side, times counted so that it lies before `edge`."""
    if other <= end:  # A pause or the end of the log comes first.
        return min(wanted, edge - end)
    rest = edge - other
    both = wanted + wanted_by_other
    return wanted if both <= rest else rest * wanted / both


def _merged(scan: MotionScan, shortest: float) -> list[tuple[float, float]]:
    """Motions; those with too short a rest between them are one."""
    merged: list[tuple[float, float]] = []
    for start, end in scan.motions:
        last = merged[-1][1] if merged else -np.inf
        if start - last < shortest and scan.segment_span(start) == scan.segment_span(last):
            merged[-1] = (merged[-1][0], float(end))
        else:
            merged.append((float(start), float(end)))
    return merged


def _why_not(turned: float, largest: float, before: float, after: float, shortest: float) -> str:
    """Why a motion is no slew; "" if it is."""
    if turned < LIMITS.small_turn * largest:
        return f"turns {np.degrees(turned):.2g} deg only"
    # The rest between two slews is shared, and half of it may be shorter than a whole rest.
    for rest, side, edge in ((before, "before", "begins"), (after, "after", "ends")):
        if rest < 0.5 * shortest:
            return f"no rest {side} it: the log {edge} in the motion"
    return ""


def _left_over(
    taken: Sequence[SlewWindow | DroppedPart], scan: MotionScan | None, reason: str
) -> list[DroppedPart]:
    """Parts of the log that nothing of this covers."""
    if scan is None:
        return []
    runs = (scan.time[scan.segment == k] for k in np.unique(scan.segment))
    spans = [(float(time[0]), float(time[-1])) for time in runs]
    for part in taken:
        pieces = [((a, min(b, part.start)), (max(a, part.end), b)) for a, b in spans]
        spans = [(a, b) for pair in pieces for a, b in pair if b > a]
    return [DroppedPart(a, b, reason) for a, b in spans]
