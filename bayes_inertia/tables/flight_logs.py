"""Logs of flight software as arrays: ULog of PX4; bags of ROS 1 and 2; MCAP files of ROS messages.

Their libraries are the extra `logs`. A topic is a table, a field of its messages a column.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.errors import CampaignError, library_of_extra
from bayes_inertia.tables.array_files import FileArrays
from bayes_inertia.tables.limits import LIMITS


def ulog_arrays(path: Path) -> FileArrays:
    """Topics of a ULog; time stamps in microseconds since boot."""
    core = library_of_extra("pyulog.core", "logs", where=str(path), otherwise="run ulog2csv on it")
    held = FileArrays()
    try:
        with path.open("rb") as file:
            topics = core.ULog(file).data_list
    except Exception as error:  # pyulog raises whatever it stumbles over.
        raise _damaged(error, "a ULog of PX4", path) from error
    for topic in topics:
        name = topic.name if topic.multi_id == 0 else f"{topic.name}_{topic.multi_id}"
        for field, values in topic.data.items():
            held.add(f"{name}/{field}", values, "us" if field.startswith("timestamp") else "")
    return held


def bag_arrays(path: Path) -> FileArrays:
    """Topics of a ROS bag or an MCAP file; `received` is when a message was logged [ns]."""
    highlevel = library_of_extra("rosbags.highlevel", "logs", where=str(path))
    columns: dict[str, dict[str, list[Any]]] = {}
    held = FileArrays()
    try:
        with highlevel.AnyReader([path], default_typestore=_messages_of_ros()) as bag:
            for connection, received, data in bag.messages():
                topic = columns.setdefault(connection.topic.strip("/"), {"received": []})
                try:
                    message = bag.deserialize(data, connection.msgtype)
                except Exception:  # A message of an unknown type closes its topic, not the bag.
                    held.closed[connection.topic] = f"messages of type {connection.msgtype}"
                    continue
                topic["received"].append(received)
                for field, value in _fields(message, ""):
                    topic.setdefault(field, []).append(value)
    except Exception as error:  # rosbags raises whatever it stumbles over.
        raise _damaged(error, "a ROS bag", path) from error
    for name, fields in columns.items():
        rows = len(fields["received"])
        for field, values in fields.items():
            if len(values) == rows:
                unit = "ns" if field == "received" else ""
                held.add(f"{name.replace('/', '_')}/{field}", np.array(values), unit)
    return held


def _fields(message: Any, prefix: str) -> Iterator[tuple[str, float | int | str]]:
    """Numbers and texts of a message, with the names of inner messages joined with dots."""
    for name in message.__dataclass_fields__:
        if name.startswith("__"):
            continue
        value, inner = getattr(message, name), f"{prefix}{name}"
        if hasattr(value, "__dataclass_fields__"):
            yield from _fields(value, f"{inner}.")
        elif isinstance(value, int | float | str):
            yield inner, value
        elif _is_vector(value):
            yield from ((f"{inner}[{k}]", number) for k, number in enumerate(value.tolist()))


def _is_vector(value: Any) -> bool:
    """Whether a field is an array of numbers, and no picture."""
    is_array = isinstance(value, np.ndarray) and value.size <= LIMITS.most_columns
    return is_array and value.dtype.kind in "iufb"


def _messages_of_ros() -> Any:
    """Standard messages, for bags that do not hold their own definitions."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.LATEST)


def _damaged(error: Exception, what: str, path: Path) -> CampaignError:
    reason = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
    return CampaignError(
        f"cannot be read as {what} ({reason})", where=str(path), advice="download it again"
    )
