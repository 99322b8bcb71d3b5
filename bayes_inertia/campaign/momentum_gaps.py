"""Gaps of the tachometers where measured momentum drives the model.

A straight line bridges them, unless the torque changed so much that the star tracker or the rates
could tell the difference: then the slew is cut, each part with a start of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.sensors import STREAMS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import located, parts_of, without_intervals
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.gaps import gap_note, missing_rows

_CHANNELS = (*(stream.field for stream in STREAMS), "magnetic_field_N", "position_N")


@dataclass(frozen=True)
class _Limits:
    """Errors that do not matter, of momentum [N m s] and of its integral over time [N m s^2]."""

    momentum: float
    angular_impulse: float


def with_known_momentum(campaign: Campaign) -> Campaign:
    """The campaign with slews cut where the momentum that drives the model is unknown.

    Returns: the same if commands drive it, or if straight lines bridge all gaps of the tachometers.
    """
    if campaign.has_commands or not campaign.wheels or not campaign.has_tachometers:
        return campaign
    inertia = float(np.linalg.eigvalsh(campaign.inertia.tensor)[0])
    tracker = campaign.star_tracker
    limits = _Limits(
        momentum=LIMITS.momentum_line_of_rate_noise * inertia * min(campaign.rate_sensor.sigma),
        angular_impulse=np.inf
        if tracker is None
        else LIMITS.momentum_line_of_attitude_noise * inertia * tracker.sigma_cross,
    )
    slews: list[Slew] = []
    dirt: list[Dirt] = []
    for slew in campaign.slews:
        own = [(record, slew.time[list(record.rows)]) for record in campaign.dirt_of(slew.name)]
        given = {name: getattr(slew, name) for name in ("time", *_CHANNELS)}
        channels = {name: values for name, values in given.items() if values is not None}
        cuts = _unknown_momentum(channels, limits)
        parts = parts_of(slew, without_intervals(channels, cuts)) if cuts else [slew]
        if cuts:
            note = gap_note(len(cuts), max(b - a for a, b in cuts))
            record = Dirt("gap", "momentum", "", (), "masked", f"{note}; the slew is cut there")
            own.append((record, np.array(cuts).ravel()))
        slews += parts
        dirt += located(own, parts)
    everywhere = campaign.dirt_of("")
    return replace(campaign, slews=tuple(slews), dirt=(*dirt, *everywhere))


def _unknown_momentum(
    channels: dict[str, np.ndarray], limits: _Limits
) -> list[tuple[float, float]]:
    """Gaps of the tachometers in which a straight line may be visibly wrong."""
    momentum, time = channels["wheel_momentum"], channels["time"]
    rows = np.flatnonzero(np.isfinite(momentum).all(axis=1))
    at = time[rows]
    fixes = _fix_times(channels)
    rated = time[np.isfinite(channels["rate"]).any(axis=1)]
    found = []
    for k in missing_rows(at)[0]:
        begin, end = float(at[k]), float(at[k + 1])
        bend, sag = _bend(at, momentum[rows], int(k))
        spanned = bool(len(fixes)) and fixes[0] < end and fixes[-1] > begin
        rates_inside = bool(np.any((rated > begin) & (rated < end)))
        if (spanned and bend > limits.angular_impulse) or (rates_inside and sag > limits.momentum):
            found.append((begin, end))
    return found


def _fix_times(channels: dict[str, np.ndarray]) -> np.ndarray:
    attitude = channels.get("attitude")
    if attitude is None:
        return np.zeros(0)
    return channels["time"][np.isfinite(attitude).all(axis=1)]


def _bend(at: np.ndarray, momentum: np.ndarray, k: int) -> tuple[float, float]:
    """Largest deviation of momentum from a straight line in the gap after reading k.

    Returns the integral over the gap [N m s^2] and the largest distance [N m s] of a torque that
    changes steadily from what it was before to what it was after, and of what it then lacks to
    the change of momentum that was measured.
    """
    length = at[k + 1] - at[k]
    n = LIMITS.readings_for_slope
    slopes = []
    for rows in (slice(max(0, k + 1 - n), k + 1), slice(k + 1, k + 1 + n)):
        t, h = at[rows], momentum[rows]
        enough = len(t) > 1
        slopes.append(np.polyfit(t - t[0], h, 1)[0] if enough else np.zeros(momentum.shape[1]))
    mean = (momentum[k + 1] - momentum[k]) / length
    change = np.abs(slopes[1] - slopes[0])
    lack = np.abs(mean - 0.5 * (slopes[0] + slopes[1]))
    # After a wild stamp the gap is endless.
    with np.errstate(over="ignore"):
        bend = float((change / 12.0 + lack / 4.0).max() * length**2)
        sag = float((change / 8.0 + lack / 2.0).max() * length)
    return bend, sag
