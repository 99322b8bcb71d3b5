"""Streams of several clocks on one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.leap_seconds import SECOND
from bayes_inertia.importing.logged_stream import LoggedStream, held, in_order, joined
from bayes_inertia.importing.mapping_schema import MappingPart
from bayes_inertia.importing.time_stamps import TimeStamps
from bayes_inertia.importing.wheel_reference import relative_to_body
from bayes_inertia.maths.values import array_dataclass

SHARED_ZERO = "campaign"
"""The `epoch` of clocks that share one unknown zero."""
ZERO_OF_FILE = "file"
"""The `epoch` of clocks that start anew in each file."""


@array_dataclass
class Logs:
    """All that was logged, on one clock.

    Parameters
    ----------
    streams : dict of str to LoggedStream
        By what they hold; times in seconds since `epoch_ns`.
    epoch_ns : int
        Zero of the clock: nanoseconds of TAI since 1958 where `absolute`.
    absolute : bool
        Whether the zero is a known date.
    unused : tuple of str
        Files that no stream names.
    """

    streams: dict[str, LoggedStream]
    epoch_ns: int
    absolute: bool
    unused: tuple[str, ...] = ()


@array_dataclass
class FileShare:
    """One file's share of a stream, its stamps not yet on the common clock.

    Parameters
    ----------
    stream : pydantic model
        The `[[streams]]` of the mapping.
    file : str
        The file, as messages name it.
    stamps : TimeStamps
        The stamp of each row.
    values : (rows, width) array
        Readings in SI units and the package's senses; NaN where there is none.
    rounding : tuple of float
        Standard deviation of the rounding in the file, as of `LoggedStream`.
    notes : tuple of str, optional
        What a user should know of the file.
    """

    stream: Any
    file: str
    stamps: TimeStamps
    values: np.ndarray
    rounding: tuple[float, ...]
    notes: tuple[str, ...] = ()


def on_one_clock(
    shares: Sequence[FileShare], mapping: MappingPart, label: str, unused: Sequence[str] = ()
) -> Logs:
    """Streams on a clock that starts with the first reading.

    Parameters
    ----------
    shares : sequence of FileShare
        All files of all streams.
    mapping : MappingPart
        What the streams are.
    label : str
        The mapping, as messages name it.
    unused : sequence of str, optional
        Files that no stream names.

    Returns
    -------
    Logs
        The streams.

    Raises
    ------
    CampaignError
        If clocks with a known date and clocks with an unknown zero are mixed.
    """
    own = [share.stream.time.epoch == ZERO_OF_FILE for share in shares]
    absolute = [share.stamps.absolute for share in shares]
    if len(set(absolute)) > 1 or len(set(own)) > 1:
        raise _different_clocks(shares, label)
    starts = _starts_of_files(shares, mapping, label) if own[0] else {}
    epoch_ns = 0 if own[0] else min(_first_ns(share) for share in shares)
    streams: dict[str, LoggedStream] = {}
    for holds in dict.fromkeys(share.stream.holds for share in shares):
        logged = [
            _logged(share, starts.get(id(share), epoch_ns))
            for share in shares
            if share.stream.holds == holds
        ]
        stream = in_order(joined(logged))
        streams[holds] = held(stream) if holds == "wheel_torque" else stream
    return Logs(relative_to_body(streams, mapping), epoch_ns, absolute[0], tuple(unused))


def _first_ns(share: FileShare) -> int:
    """The true time of the first reading [ns]."""
    return share.stamps.first_ns + round(share.stream.offset_s * SECOND)


def _different_clocks(shares: Sequence[FileShare], label: str) -> CampaignError:
    kinds = {
        share.stream.holds: "a known date"
        if share.stamps.absolute
        else f"a zero called {share.stream.time.epoch!r}"
        for share in shares
    }
    odd = next(share for share in shares if not share.stamps.absolute)
    listed = "; ".join(f"{holds}: {kind}" for holds, kind in kinds.items())
    return CampaignError(
        f"the clocks cannot be brought together ({listed})",
        where=f"{label}, key streams.{odd.stream.holds}.time.epoch",
        advice="write the UTC date at which this clock was zero",
    )


def _starts_of_files(
    shares: Sequence[FileShare], mapping: MappingPart, label: str
) -> dict[int, int]:
    """For each share the stamp [ns] that becomes zero, so that files follow each other.

    The k-th file of each stream belongs to the k-th of the others.
    """
    pause = mapping.cut.between_files_s
    if pause is None:
        raise CampaignError(
            "missing key",
            where=f"{label}, key cut.between_files_s",
            advice="add the seconds that passed between the end of one file and the start of the "
            f'next, as each file has a clock of its own (epoch = "{ZERO_OF_FILE}")',
        )
    by_stream: dict[int, list[FileShare]] = {}
    for share in shares:
        by_stream.setdefault(id(share.stream), []).append(share)
    if len({len(of_stream) for of_stream in by_stream.values()}) > 1:
        counts = ", ".join(f"{v[0].stream.holds}: {len(v)}" for v in by_stream.values())
        raise CampaignError(
            f"streams have different numbers of files ({counts})",
            where=f"{label}, key streams",
            advice="with a clock in each file, every stream needs one file a slew",
        )
    starts, cursor = {}, 0
    for together in zip(*by_stream.values(), strict=True):
        first = min(share.stamps.first_ns for share in together)
        starts.update({id(share): first - cursor for share in together})
        cursor += max(int(share.stamps.ns.max()) for share in together) - first
        cursor += round(pause * SECOND)
    return starts


def _logged(share: FileShare, epoch_ns: int) -> LoggedStream:
    time = share.stamps.seconds_since(epoch_ns)
    time = time + share.stream.offset_s if share.stream.offset_s else time
    keep = np.isfinite(time) & np.isfinite(share.values).any(axis=1)
    file = np.zeros(int(keep.sum()), dtype=int)
    return LoggedStream(
        share.stream.holds,
        time[keep],
        share.values[keep],
        file,
        (share.file,),
        share.notes,
        share.rounding,
    )
