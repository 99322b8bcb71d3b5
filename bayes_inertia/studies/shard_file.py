"""One shard as a Parquet file that knows what it holds and proves that it is whole.

The footer's metadata hold the study's digest, the shard's name and the SHA-256 of the whole file
(computed with zeros in its own place). So a file that was cut, changed by a bit, replaced by
another shard or left by another study is told before any of its content is used.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Mapping
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

FORMAT = "bayes-inertia-shard/1"
_DESCRIPTION = "bayes_inertia"
_CHECKSUM = "sha256"
_LABEL = "bayes-inertia-sha256:"
_STATED = re.compile(_LABEL.encode() + b"([0-9a-f]{64})")
_ZEROS = b"0" * 64

Rows = Mapping[str, Mapping[str, Any]]


class ShardDamageError(ValueError):
    """Why the content of a shard is not used: the end of a sentence that begins with its name."""


def shard_bytes(rows: Rows, *, study: str, name: str) -> bytes:
    """A shard as the bytes of its file.

    Parameters
    ----------
    rows : mapping of str to mapping
        {task: row}, in the order in which they are written.
    study : str
        Digest of the work.
    name : str
        Of the shard.

    Returns
    -------
    bytes
        The same for the same rows.

    Examples
    --------
    >>> data = shard_bytes({"0": {"x": 0.5}}, study="ab", name="tasks_00000")
    >>> shard_rows(data, study="ab", name="tasks_00000")
    {'0': {'x': 0.5}}
    >>> shard_rows(data[:-9], study="ab", name="tasks_00000")
    Traceback (most recent call last):
    bayes_inertia.studies.shard_file.ShardDamageError: was cut short or changed since it was written
    """
    table, sink = _table(rows), io.BytesIO()
    description = json.dumps({"format": FORMAT, "study": study, "shard": name})
    with pq.ParquetWriter(sink, table.schema, store_schema=False) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata(
            {_DESCRIPTION: description, _CHECKSUM: _LABEL + _ZEROS.decode()}
        )
    data = sink.getvalue()
    place = data.rindex(_LABEL.encode()) + len(_LABEL)
    digest = hashlib.sha256(data).hexdigest().encode()
    return data[:place] + digest + data[place + len(digest) :]


def shard_rows(data: bytes, *, study: str, name: str) -> dict[str, dict[str, Any]]:
    """The rows of a shard's file, if it is that shard, whole and unchanged.

    Parameters
    ----------
    data : bytes
        Of the file.
    study : str
        Digest of the work.
    name : str
        Of the shard.

    Returns
    -------
    dict of str to dict
        {task: row}.

    Raises
    ------
    ShardDamageError
        Otherwise; it says what is wrong.
    """
    stated = list(_STATED.finditer(data))
    if not stated:
        raise ShardDamageError("is no shard, or half of one")
    start, end = stated[-1].span(1)
    if hashlib.sha256(data[:start] + _ZEROS + data[end:]).hexdigest().encode() != data[start:end]:
        raise ShardDamageError("was cut short or changed since it was written")
    # What passed the checksum was written by this module, and can be parsed without fear.
    table = pq.read_table(io.BytesIO(data))
    description = json.loads(table.schema.metadata[_DESCRIPTION.encode()])
    if description["study"] != study:
        raise ShardDamageError("is of another study")
    if description["shard"] != name:
        raise ShardDamageError(f"is a copy of {description['shard']}")
    rows = table.to_pylist()
    return {row.pop("task"): row for row in rows}


def as_stored(rows: Rows) -> list[dict[str, Any]]:
    """Rows as they come back from a file: numbers of one column have one kind.

    Parameters
    ----------
    rows : mapping of str to mapping
        {task: row}.

    Returns
    -------
    list of dict
        With the key `task`.
    """
    return _table(rows).to_pylist()


def _table(rows: Rows) -> pa.Table:
    keys = dict.fromkeys(key for row in rows.values() for key in row)
    columns: dict[str, list] = {"task": list(rows)}
    columns |= {key: [row.get(key) for row in rows.values()] for key in keys}
    return pa.table(columns)
