"""Rows of a table as time orders them: sent twice, out of order, or with a stamp that is wrong.

Rows that only came late are put in their place. A row that was sent twice, or in parts, becomes
one. A single stamp that fits nowhere is left out. What needs knowledge of the clock is refused.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple, NoReturn

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.faults.fault import Dirt, DirtKind, Treatment
from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.faults.stamps import regular_stamps
from bayes_inertia.tables.table import Table

_LEFT_OUT = "with a wrong stamp left out"


def set_back_row(stamps: np.ndarray, contents: np.ndarray) -> int | None:
    """The row (from 0) at which a clock was set back and ran on from there; None where none was.

    Rows that only came late fill a hole among the others, or were sent again with the same content.
    A few rows (three) out of order are no clock that was set back.

    >>> late, again = np.array([0.0, 1, 4, 5, 2, 3, 6]), np.r_[0:30, 0.1:30.1]
    >>> set_back_row(late, np.zeros((7, 1))), set_back_row(again, np.zeros((60, 1)))
    (None, 30)
    """
    if not np.any(np.diff(stamps) < 0.0):
        return None
    late = late_rows(stamps)
    # Of the rows in order: two sessions together have steps that none of them has.
    steps = np.diff(np.unique(np.delete(stamps, late)))
    step = float(np.median(steps)) if len(steps) else 0.0
    strange = ~_explained(stamps, late, contents, step)
    for run in np.split(np.arange(len(late)), np.flatnonzero(np.diff(late) > 1) + 1):
        if strange[run].sum() <= LIMITS.late_row_farthest:
            continue
        # The clock went back at the run's start, or where the rows after it go on.
        first, last = max(int(late[run[0]]), 1), min(int(late[run[-1]]) + 2, len(stamps))
        row = first + int(np.argmin(np.diff(stamps[first - 1 : last])))
        near = LIMITS.rows_in_order
        beside = stamps[max(row - near, 0) : row], stamps[row : row + near]
        astray = sum(int((np.diff(rows) < 0.0).sum()) for rows in beside)
        if astray <= 1 and stamps[row - 1] - stamps[row] > LIMITS.late_row_farthest * step:
            return row
    return None


def _explained(
    stamps: np.ndarray, late: np.ndarray, contents: np.ndarray, step: float
) -> np.ndarray:
    """Which late rows (m,) fill a hole among the others, or repeat one of them, cell by cell."""
    others = np.delete(np.arange(len(stamps)), late)
    kept = stamps[others]  # Never goes back.
    at = np.searchsorted(kept, stamps[late])
    same = others[np.minimum(at, len(kept) - 1)]
    own, other = contents[late], contents[same]
    alike = (own == other) | np.isnan(own) | np.isnan(other)
    again = (stamps[same] == stamps[late]) & alike.all(axis=1)
    bounds = np.concatenate([[-np.inf], kept, [np.inf]])
    new = np.flatnonzero(~again)
    new = new[np.lexsort((stamps[late[new]], at[new]))]
    # Each hole's late rows in order: the first and the last are a step away from its edges.
    hole, starts, counts = np.unique(at[new], return_index=True, return_counts=True)
    times = stamps[late[new]]
    fits = np.ones(len(hole), dtype=bool)
    low, high = LIMITS.late_row_nearest * step, LIMITS.late_row_farthest * step
    before, after = times[starts] - bounds[hole], bounds[hole + 1] - times[starts + counts - 1]
    for edge in (before, after):
        # At an end of the log one side is open.
        fits &= np.isinf(edge) | ((edge >= low) & (edge <= high))
    fills = np.zeros(len(late), dtype=bool)
    fills[new] = np.repeat(fits, counts)
    return again | fills


def ordered_rows(table: Table, time: str, names: Sequence[str]) -> tuple[Table, list[Dirt]]:
    """The rows of a table in the order of their strictly increasing times, and what was done."""
    stamps = table.numbers(time)
    _refuse_empty_times(table, time)
    with np.errstate(over="ignore"):
        steps = np.diff(stamps)
    _refuse_coarse_times(table, time, steps)
    records: list[Dirt] = []
    if not np.all(steps > 0.0):
        table, records = _in_order(table, time, names)
    far = _far_off_rows(table, time)
    if not len(far):
        return table, records
    table = table.taking(np.delete(np.arange(table.rows), far))
    return table, [_dirt("clock", far, table.rows, "masked", _LEFT_OUT), *records]


def _in_order(table: Table, time: str, names: Sequence[str]) -> tuple[Table, list[Dirt]]:
    """Rows whose times go back somewhere, in order; and what was done."""
    row = set_back_row(table.numbers(time), table.stack(names))
    if row is not None:
        _refuse_jump(table, time, row)
    stamps, kept, wrong, single = mended_stamps(table.numbers(time))
    if len(wrong) and not single:
        _refuse_jump(table, time, int(wrong[0]))
    table = table.changed({time: stamps}) if len(wrong) else table
    late = kept[late_rows(stamps[kept])]
    late = late[~np.isin(stamps[late], np.delete(stamps, late))]  # others were only sent again
    order = kept[np.argsort(stamps[kept], kind="stable")]
    joined, doubled = _joined(table.taking(order), time, names)
    times = joined.numbers(time)
    mended = np.intersect1d(wrong, kept)
    lost = np.setdiff1d(wrong, kept)
    before_lost = stamps[np.maximum(lost - 1, 0)]
    records: list[tuple[DirtKind, np.ndarray, Treatment, str]] = [
        ("clock", stamps[mended], "modelled", "with a wrong stamp given that between neighbours"),
        ("clock", before_lost, "masked", _LEFT_OUT),
        ("clock", stamps[late], "ignored", "out of order put in place"),
        ("duplicate", times[doubled], "masked", "with the time of another joined with it"),
    ]
    return joined, [
        _dirt(kind, np.searchsorted(times, at), len(times), treated, note)
        for kind, at, treated, note in records
        if len(at)
    ]


def _dirt(kind: DirtKind, rows: np.ndarray, length: int, treated: Treatment, note: str) -> Dirt:
    clipped = np.unique(np.clip(rows, 0, length - 1))
    text = f"{len(rows)} row{'s' * (len(rows) != 1)} {note}"
    return Dirt(kind, "time", "", tuple(clipped.tolist()), treated, text)


def _refuse_empty_times(table: Table, time: str) -> None:
    empty = np.isnan(table.numbers(time))
    advice = "every row needs its time: remove or repair the row"
    whole = f"{table.label}, column {time}"
    require(not len(empty) or not empty.all(), whole, "every cell is empty", advice)
    table.refuse(empty, time, "the cell is empty", advice)


def _refuse_coarse_times(table: Table, time: str, steps: np.ndarray) -> None:
    if not table.columns[time].single or not len(steps):
        return
    resolution = float(np.spacing(np.float32(np.abs(table.numbers(time)).max())))
    if resolution <= LIMITS.coarse_stamp * abs(float(np.median(steps))):
        return
    # A regular clock may be known better than its stamps.
    _, record = regular_stamps(table.numbers(time)) if np.all(steps > 0.0) else (None, None)
    known = record is not None and record.treated == "modelled"
    what = "times stored with 32 bits are too coarse for their spacing"
    advice = "store time with 64 bits, or count it from the start of the slew"
    require(known, f"{table.label}, column {time}", what, advice)


def _far_off_rows(table: Table, time: str) -> np.ndarray:
    """Rows whose stamps lie so far from the others that no slew is meant; few, or refused."""
    stamps = table.numbers(time)
    steps = np.diff(np.unique(stamps))
    if len(steps) < 2:
        return np.zeros(0, dtype=int)
    durations = LIMITS.far_off_durations * len(stamps) * float(np.median(steps))
    limit = max(durations, LIMITS.longest_break)
    with np.errstate(over="ignore"):
        distance = np.abs(stamps - np.median(stamps))
    far = np.flatnonzero(distance > limit)
    if len(far) > LIMITS.most_glitches * len(stamps):
        first, usual = float(stamps[far[0]]), float(np.median(stamps))
        what = f"the time {first!r} is far from most others, which lie around {usual:.6g}"
        advice = "remove the rows with wrong times, or give each slew a file of its own"
        raise CampaignError(what, where=table.place(int(far[0]), time), advice=advice)
    return far


def late_rows(stamps: np.ndarray) -> np.ndarray:
    """The fewest rows without which times never go back; they came late or carry wrong stamps.

    >>> late_rows(np.array([0.0, 1, 9, 2, 3])).tolist()
    [2]
    """
    if not np.any(np.diff(stamps) < 0.0):
        return np.zeros(0, dtype=int)
    tails: list[float] = []
    length = np.empty(len(stamps), dtype=int)
    for i, stamp in enumerate(stamps.tolist()):
        # The longest non-decreasing subsequence; equal times are another matter.
        length[i] = at = bisect_right(tails, stamp)
        tails[at : at + 1] = [stamp]
    in_order = np.zeros(len(stamps), dtype=bool)
    wanted, bound = len(tails) - 1, np.inf
    for i in range(len(stamps) - 1, -1, -1):
        if length[i] == wanted and stamps[i] <= bound:
            in_order[i] = True
            wanted, bound = wanted - 1, stamps[i]
    return np.flatnonzero(~in_order)


class MendedStamps(NamedTuple):
    """Stamps in which single wrong ones are mended."""

    stamps: np.ndarray  # (n,)
    kept: np.ndarray  # (m,) of int: the rows whose stamps are known
    wrong: np.ndarray  # (k,) of int: the rows whose stamps were wrong, mended or not
    single: bool  # Whether they are few, and none follows another


def mended_stamps(stamps: np.ndarray) -> MendedStamps:
    """Stamps (n,) that go back somewhere, without those that fit nowhere.

    Between neighbours two steps apart a regular clock leaves one place; else the row is lost.

    >>> mended_stamps(np.array([0.0, 1.0, 2.0, 7.3, 4.0, 5.0, 6.0, 7.0])).stamps.tolist()
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    """
    rows, late = np.arange(len(stamps)), late_rows(stamps)
    steps = np.diff(np.unique(stamps))
    step = float(np.median(steps)) if len(steps) else 0.0
    wrong = late[~_fits(stamps, late, step)] if len(late) else late
    few = len(wrong) <= LIMITS.most_glitches * len(stamps)
    inner = wrong[(wrong > 0) & (wrong < len(stamps) - 1)]
    hole = stamps[inner + 1] - stamps[inner - 1]
    regular = inner[np.abs(hole - 2.0 * step) <= LIMITS.glitch_tolerance * step]
    mended = stamps.copy()
    mended[regular] = 0.5 * (stamps[regular - 1] + stamps[regular + 1])
    kept = np.setdiff1d(rows, np.setdiff1d(wrong, regular))
    return MendedStamps(mended, kept, wrong, few and not np.any(np.diff(wrong) == 1))


def _fits(stamps: np.ndarray, late: np.ndarray, step: float) -> np.ndarray:
    """Which late rows fill a hole among the others, or repeat the time of one of them."""
    others = np.delete(stamps, late)
    low, high = LIMITS.late_row_nearest * step, LIMITS.late_row_farthest * step
    inside = (stamps[late] >= others.min() - high) & (stamps[late] <= others.max() + high)
    bounds = np.concatenate([[-np.inf], np.unique(stamps), [np.inf]])
    at = np.searchsorted(bounds, stamps[late])
    nearest = np.minimum(stamps[late] - bounds[at - 1], bounds[at + 1] - stamps[late])
    fills = inside & (nearest >= low) & (nearest <= high)
    return fills | np.isin(stamps[late], others)


def _refuse_jump(table: Table, time: str, row: int) -> NoReturn:
    stamps = table.numbers(time)
    row = row if row and stamps[row] < stamps[row - 1] else int(np.argmax(np.diff(stamps) < 0)) + 1
    now, before = float(stamps[row]), float(stamps[row - 1])
    raise CampaignError(
        f"the time goes back from {before!r} to {now!r} (after {table.row(row - 1)})",
        where=table.place(row, time),
        advice=f"if the clock was set back by {before - now:.6g}, add that to the times from this "
        "row on; else remove the rows with wrong times",
    )


def _joined(table: Table, time: str, names: Sequence[str]) -> tuple[Table, np.ndarray]:
    """One row a time: rows of one time are joined if no cell is given twice with two values."""
    stamps = table.numbers(time)
    is_new = np.concatenate([[True], np.diff(stamps) > 0.0])
    if is_new.all():
        return table, np.zeros(0, dtype=int)
    values, _, lost = joined_rows(table.stack(names), ~is_new)
    row = int(np.argmax(lost))
    what = f"the time {float(stamps[row])!r} is repeated with another content "
    what += f"(after {table.row(row - 1)})"
    advice = "remove the row that is wrong, or mend its time"
    require(not lost.any(), table.place(row, time), what, advice)
    columns = dict(zip(names, values[is_new].T, strict=True))
    return table.taking(is_new).changed(columns), np.cumsum(is_new)[~is_new] - 1


def joined_rows(values: np.ndarray, repeated: np.ndarray) -> tuple[np.ndarray, int, np.ndarray]:
    """Values (n, k) filled up from rows of one time, how many repeat, and which (n,) differ."""
    values = values.copy()
    first = np.maximum.accumulate(np.where(repeated, 0, np.arange(len(values))))
    again, lost = 0, np.zeros(len(values), dtype=bool)
    for row in np.flatnonzero(repeated):
        target = values[first[row]]
        empty = np.isnan(target)
        both = ~np.isnan(values[row]) & ~empty
        lost[row] = bool((both & (values[row] != target)).any())
        again += bool(both.any() and not lost[row])
        target[empty] = values[row][empty]
    return values, again, lost
