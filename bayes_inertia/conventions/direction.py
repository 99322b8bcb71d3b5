"""Law of direction sensors: what they see, turned back by the integrated rate, is where it is said.

In the axes of a slew's first moment a vector that a Sun sensor, magnetometer or horizon sensor sees
is R0 times the inertial vector that it looks at, with one rotation R0 for the whole slew and all
sensors. R0 is that of the star tracker's fixes; where there are none it is the one that brings all
vectors of the slew together (Wahba).

A direction counts as unit vector, a field as share of its size, be it the one read or the one
looked at.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew_parts import INPUTS, MORE
from bayes_inertia.conventions.law_data import (
    LawData,
    Told,
    deviation,
    integrated_noise,
    uncertain_path,
)
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.motion import (
    SampledSlews,
    composed,
    matrix_to_start,
    nearest_rotation,
    turned_back,
)
from bayes_inertia.conventions.reading import FIELD, direction_sensors


def direction(told: Told) -> LawData | None:
    """Vectors seen against vectors looked at, each component in sds."""
    if not direction_sensors(told.campaign):
        return None
    known = _known(told.slews)
    if not known.any():
        return None
    to_start, fixes = told.motion.to_start, told.slews.fixes
    seen_B, there_N, sizes = _in_one_size(told, known)
    seen = np.einsum("snij,sndj->sndi", to_start, seen_B)
    there = np.einsum("sij,sndj->sndi", _first_rotation(told, seen, there_N), there_N)
    expected_B = np.einsum("snji,sndj->sndi", to_start, there)
    share = _weights(told, known, (seen_B, expected_B), sizes, integrated_noise(told))
    path = uncertain_path(told)
    if fixes.any():
        # The rotations of the fixes tell R0, errors of the path up to them included.
        weight = fixes / np.maximum(fixes.sum(axis=1, keepdims=True), 1)
        path = path - np.einsum("sn,snip->sip", weight, path)[:, None]
    turns = np.concatenate([path, np.broadcast_to(np.eye(3), (*path.shape[:3], 3))], axis=-1)
    turned = _flat(np.cross(turns[:, :, None], there[..., None], axis=3), share)
    data = _flat((seen - there)[..., None], share)[..., 0]
    own = _flat(_own_errors(told, to_start, seen_B, sizes), share)
    return LawData(
        data,
        np.concatenate([turned[..., :-3], own], -1),
        turned[..., -3:] * ~fixes.any(axis=1)[:, None, None, None],
        np.ones(len(data)),
        known.any(axis=2),
        bias_from=9,
    )


def angles(told: Told) -> LawData | None:
    """Angles between vectors, and their sizes: the attitude of each moment is the best one.

    No rates are needed. What turns all vectors of a moment together is projected off.
    """
    known = (np.linalg.norm(told.slews.vectors_B, axis=-1) > 0.0) & told.slews.valid[..., None]
    if not known.any():
        return None
    seen_B, there_N, sizes = _in_one_size(told, known)
    to_N = nearest_rotation(np.einsum("sndi,sndj->snij", there_N, seen_B))
    expected_B = np.einsum("snji,sndj->sndi", to_N, there_N)
    share = _weights(told, known, (seen_B, expected_B), sizes, np.zeros(len(known)))
    left = np.einsum("snij,sndj->sndi", to_N, seen_B)[..., None] - there_N[..., None]
    errors = np.concatenate([left, _own_errors(told, to_N, seen_B, sizes)], axis=-1)
    errors = _flat(errors, share)
    turned = _flat(np.cross(np.eye(3)[None, None, None], there_N[..., None], axis=3), share)
    # One vector leaves the turn about itself untold.
    errors = errors - turned @ (np.linalg.pinv(turned, rcond=1e-9) @ errors)
    data = errors[..., 0]
    return LawData(
        data,
        errors[..., 1:],
        np.zeros((*data.shape, 0)),
        np.ones(len(data)),
        known.any(axis=2),
    )


def _weights(
    told: Told,
    known: np.ndarray,
    both_B: tuple[np.ndarray, np.ndarray],
    sizes: np.ndarray,
    turned: np.ndarray,
) -> np.ndarray:
    """Weights (S, N, sensors) of vectors: over what noise and undisclosed physics leave of them.

    `both_B`: as seen and as expected; `turned`: angle (S,) that noise of the rates adds up to.
    """
    square = turned[:, None] ** 2 + np.full(sizes.shape, LIMITS.vector_share**2)
    for d, (name, _) in enumerate(direction_sensors(told.campaign)):
        both = (deviation(vectors[:, :, d], known[..., d]) for vectors in both_B)
        noise = told.reading.of(f"{MORE}{name}", np.diag(told.noise[name])) / sizes[d]
        square[:, d] += (LIMITS.physical_share * np.maximum(*both)) ** 2 + np.sum(noise**2)
    # Each sensor counts by the moments at which it sees, however few they are.
    counts = np.maximum(known.sum(axis=1), 1)
    share = np.sqrt(known.any(axis=2).sum(axis=1)[:, None] / counts)
    return known * (share / np.sqrt(square))[:, None]


def _flat(values: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(S, N, sensors, 3, P) in sds, as (S, N, 3 sensors, P)."""
    values = values * share[..., None, None]
    return values.reshape(*share.shape[:2], -1, values.shape[-1])


def parts_of_directions(campaign: Campaign) -> list[str]:
    """Which parts of a reading directions depend on, besides the motion."""
    names = [name for name, _ in direction_sensors(campaign)]
    return [part for name in names for part in (f"{MORE}{name}", _looked_at(campaign, name))]


def _looked_at(campaign: Campaign, name: str) -> str:
    """Which field of `Slew` has what a direction sensor looks at; none where that is constant."""
    if dict(direction_sensors(campaign))[name].reference_N is not None:
        return f"{MORE}{name}.reference_N"
    own = any(name in (slew.inputs or {}) for slew in campaign.slews)
    return f"{INPUTS}{name}" if own else FIELD


def _known(slews: SampledSlews) -> np.ndarray:
    """Which moments (S, N, sensors) count: scale factors and bias leave the turn known so far.

    Where the rates are in another unit than stated, the vectors tell that the turn is small.
    """
    length = np.linalg.norm(slews.vectors_B, axis=-1)
    known = (length > 0.0) & slews.valid[..., None]
    units = slews.vectors_B / np.where(known, length, 1.0)[..., None]
    steps = np.fmax.reduce(np.linalg.norm(np.diff(units, axis=1), axis=-1), axis=2)
    steps = np.where(np.isnan(steps), np.inf, steps * (steps > LIMITS.vector_share))
    # A vector shows but a part of a turn.
    by_vectors = 2.0 * np.cumsum(steps, axis=1)
    by_rates = np.cumsum(np.linalg.norm(np.diff(slews.turn, axis=1), axis=-1), axis=1)
    known[:, 1:] &= (np.minimum(by_rates, by_vectors) < LIMITS.known_turn)[..., None]
    enough = known.any(axis=2).sum(axis=1) >= LIMITS.rows_of_piece
    return known & enough[:, None, None]


def _in_one_size(told: Told, known: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vectors seen and looked at (S, N, sensors, 3), zero where unknown, and their sizes."""
    there_N = np.where(known[..., None], told.slews.vectors_N, 0.0)
    seen_B = np.where(known[..., None], told.slews.vectors_B, 0.0)
    sizes, reading = np.ones(known.shape[2]), told.reading
    for d, (name, sensor) in enumerate(direction_sensors(told.campaign)):
        seen_B[:, :, d] = reading.of(f"{MORE}{name}", seen_B[:, :, d])
        there_N[:, :, d] = reading.of(_looked_at(told.campaign, name), there_N[:, :, d])
        lengths = np.linalg.norm(seen_B[:, :, d], axis=-1)
        if not sensor.is_field:
            seen_B[:, :, d] /= np.where(known[..., d], lengths, 1.0)[..., None]
        elif known[..., d].any():
            both = (lengths, np.linalg.norm(there_N[:, :, d], axis=-1))
            sizes[d] = max(np.median(length[known[..., d]]) for length in both)
    return seen_B / sizes[:, None], there_N / sizes[:, None], sizes


def _first_rotation(told: Told, seen: np.ndarray, there_N: np.ndarray) -> np.ndarray:
    """R0 (S, 3, 3): from inertial axes to those of each slew's first moment."""
    fixes = told.slews.fixes
    attitude = np.where(fixes[..., None], told.slews.seen(told.reading), [0.0, 0.0, 0.0, 1.0])
    starts = matrix_to_start(composed(attitude, turned_back(told.motion.path)))
    by_fixes = np.einsum("sn,snij->sji", fixes, starts)
    by_vectors = np.einsum("sndi,sndj->sij", seen, there_N)
    return nearest_rotation(np.where(fixes.any(axis=1)[:, None, None], by_fixes, by_vectors))


def _own_errors(
    told: Told, to_start: np.ndarray, seen_B: np.ndarray, sizes: np.ndarray
) -> np.ndarray:
    """Changes (S, N, sensors, 3, 12 sensors) by each sensor's mounting, scale and offset."""
    sds, same = np.zeros((len(sizes), 12)), np.eye(3, dtype=bool)
    for d, (_, sensor) in enumerate(direction_sensors(told.campaign)):
        mounting, scale, offset = (max(LIMITS.misalignment_sd, sensor.mounting_sigma or 0.0),) * 3
        if sensor.is_field:
            mounting = np.hypot(mounting, sensor.soft_iron_sigma)
            scale = max(LIMITS.field_scale_sd, sensor.scale_sigma)
            offset = max(LIMITS.field_offset_share, min(1.0, sensor.offset_sigma / sizes[d]))
        sds[d, :9] = np.where(same, scale, mounting).ravel()
        sds[d, 9:] = offset
    by_matrix = np.einsum("snia,sndb->sndiab", to_start, seen_B)
    by_matrix = by_matrix.reshape(*seen_B.shape, 9)
    by_offset = np.broadcast_to(to_start[:, :, None], (*seen_B.shape, 3))
    errors = np.concatenate([by_matrix, by_offset], axis=-1) * sds[:, None]
    errors = np.einsum("sndip,de->sndiep", errors, np.eye(len(sizes)))
    return errors.reshape(*seen_B.shape, -1)
