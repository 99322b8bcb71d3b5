"""JSON: one object a line or one list of objects, or one document of arrays by name.

Of objects, nested keys are joined with dots, lists become name[0], name[1], ... A document of
arrays is a tree of arrays like an HDF5 file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.tables.limits import LIMITS
from bayes_inertia.tables.table import Column, Table, joined_values
from bayes_inertia.tables.text_cells import content, whole_lines
from bayes_inertia.tables.time_stamps import time_names


def read_json_lines(path: Path) -> Table:
    """The columns of a file of JSON objects; a key that one lacks is an empty cell."""
    label = str(path)
    text, cut = whole_lines(content(path), label)
    records, lines, broken = _records(text, label)
    columns = _columns(records, lines, label)
    return Table(label, columns, np.array(lines, dtype=int), notes=(*cut, *broken))


def _columns(records: Sequence[Any], lines: Sequence[int], label: str) -> dict[str, Column]:
    """A column for each key of the objects; a key that one lacks is an empty cell."""
    cells: dict[str, list[Any]] = {}
    for index, (record, line) in enumerate(zip(records, lines, strict=True)):
        where = f"{label}, line {line}"
        for name, value in _flattened(record, "", 0, where):
            column = cells.setdefault(name, [])
            if len(column) > index:
                raise CampaignError(f"two values are named {name}", where=where, advice=_ADVICE)
            column.extend([None] * (index - len(column)))
            column.append(value)
        few = len(cells) <= LIMITS.most_columns_of_json
        what = f"more than {LIMITS.most_columns_of_json} different keys"
        require(few, where, what, "give every line the same keys")
    require(bool(cells), label, "the file is empty", "give rows of telemetry")
    n = len(records)
    return {name: _column(given + [None] * (n - len(given))) for name, given in cells.items()}


def json_arrays(path: Path) -> dict[str, np.ndarray] | None:
    """Arrays of a JSON document of arrays or lists of objects, by path; else None."""
    label = str(path)
    text, _ = whole_lines(content(path), label)
    try:
        whole = json.loads(text)
        documents = whole if isinstance(whole, list) and len(whole) == 1 else [whole]
    except (ValueError, RecursionError):
        first = text.lstrip().partition("\n")[0]
        if (
            not first.startswith("{")
            or _arrays_of(_parsed(first, f"{label}, line 1"), label) is None
        ):
            return None
        documents = _records(text, label)[0]  # Each line a part of the history.
    parts = [_arrays_of(document, label) for document in documents]
    named = [part for part in parts if part is not None]
    forms = [{name: array.shape[1:] for name, array in part.items()} for part in named]
    if len(named) < len(parts) or any(form != forms[0] for form in forms):
        return None
    return {name: joined_values([part[name] for part in named]) for name in named[0]}


def _arrays_of(document: Any, label: str) -> dict[str, np.ndarray] | None:
    """The arrays of one document by path; None for an object that is one row, and other things."""
    if not isinstance(document, dict):
        return None
    inside = dict(_collected(document, "", label))
    found = {name: x for name, x in inside.items() if x is not None and len(x) > 1}
    stamp = Table("", {name: Column(np.zeros(1)) for name, x in inside.items() if x is None})
    longest = max((len(array) for array in found.values()), default=0)
    if not found or (longest <= LIMITS.longest_vector and time_names(stamp)):
        return None
    while all("/" in name for name in found) and len({n.partition("/")[0] for n in found}) == 1:
        found = {name.partition("/")[2]: array for name, array in found.items()}
    if any("/" not in name for name in found):  # Times beside groups are those of the groups.
        found = {name.replace("/", "."): array for name, array in found.items()}
    return found


def _collected(value: Any, path: str, label: str) -> Iterator[tuple[str, np.ndarray | None]]:
    """The arrays below a value of a document with their paths, and its numbers with None."""
    below = f"{path}/" if path else ""
    if isinstance(value, dict) and value and all(key.isdigit() for key in value):
        value = list(value.values())  # {"0": ..., "1": ...} is a list with its index.
    if isinstance(value, dict):
        for key, inner in _by_name(value).items():
            yield from _collected(inner, f"{below}{key}", label)
    elif _are_objects(value) and (len(value) == 1 or "columns" in value[0]):
        for index, row in enumerate(value):  # Series, each a table of its own.
            name = f"{below}{row.get('name', index)}" if len(value) > 1 else path
            yield from _collected(row, name, label)
    elif _are_objects(value):
        columns = _columns(value, range(1, len(value) + 1), f"{label}, key {path}")
        yield from ((f"{below}{name}", column.values) for name, column in columns.items())
    elif isinstance(value, list):
        yield path, _array(value, f"{label}, key {path}")
    elif isinstance(value, int | float):
        yield path, None


def _are_objects(value: Any) -> bool:
    """Whether a value is a list of objects."""
    return isinstance(value, list) and bool(value) and all(isinstance(v, dict) for v in value)


def _by_name(value: dict[str, Any]) -> dict[str, Any]:
    """An object with its rows as columns where it is a table as pandas and InfluxDB write it."""
    names = value.get("columns")
    rows = next((value[key] for key in ("data", "values", "rows") if key in value), None)
    if not isinstance(names, list) or not isinstance(rows, list) or not rows:
        return value
    if not all(isinstance(row, list) and len(row) == len(names) for row in rows):
        return value
    return dict(zip(map(str, names), map(list, zip(*rows, strict=True)), strict=True))


def _array(values: list[Any], where: str) -> np.ndarray:
    """A list of numbers, texts or rows as an array; NaN, or rows of NaN, for null."""
    row = next((inner for inner in values if isinstance(inner, list)), None)
    if row is None:
        return _column(values).values
    empty = [None] * len(row)
    rows = [empty if inner is None else inner for inner in values]
    try:
        return np.array(rows, dtype=float)
    except (ValueError, TypeError) as error:
        what = "its rows differ in length, or hold other things than numbers"
        advice = f"give each row {len(row)} numbers"
        raise CampaignError(what, where=where, advice=advice) from error


def _records(text: str, label: str) -> tuple[list[dict[str, Any]], list[int], tuple[str, ...]]:
    """The objects, the lines where they begin, and what was left out."""
    if text.lstrip().startswith("["):
        listed = _parsed(text, f"{label}")
        objects = all(isinstance(record, dict) for record in listed)
        require(objects, label, "a list of other things than objects", _ADVICE)
        return listed, list(range(1, len(listed) + 1)), ()
    records: list[dict[str, Any]] = []
    lines: list[int] = []
    written = text.split("\n")
    for number, line in enumerate(written, start=1):
        if not line.strip():
            continue
        where = f"{label}, line {number}"
        try:
            record = _parsed(line, where)
        except CampaignError:
            if number < len(written) or len(records) < LIMITS.few_objects:
                raise
            return records, lines, (f"line {number}, the last, breaks off and was left out",)
        require(isinstance(record, dict), where, "no JSON object", _ADVICE)
        records.append(record)
        lines.append(number)
    return records, lines, ()


_ADVICE = (
    'write one object a line, such as {"t": 0.25, "w": [0.1, 0.2, 0.3]}, or one document of arrays '
    'by name, such as {"t": [0.25, ...], "w": [[0.1, 0.2, 0.3], ...]}'
)


def _parsed(text: str, where: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = error.msg if isinstance(error, json.JSONDecodeError) else type(error).__name__
        raise CampaignError(f"no JSON ({reason})", where=where, advice=_ADVICE) from error


def _flattened(value: Any, name: str, depth: int, where: str) -> Iterator[tuple[str, Any]]:
    """The values inside of objects and lists, with their names."""
    require(depth <= LIMITS.deepest, where, "nested too deeply", _ADVICE)
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flattened(item, f"{name}.{key}" if name else key, depth + 1, where)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _flattened(item, f"{name}[{index}]", depth + 1, where)
    else:
        yield name, value


def _column(values: list[Any]) -> Column:
    """Integers where all are, floats where all are numbers or missing, else texts."""
    if all(type(value) is int and abs(value) < 2**63 for value in values):
        return Column(np.array(values, dtype=np.int64))
    if all(value is None or isinstance(value, int | float) for value in values):
        return Column(np.array([_float(value) for value in values]))
    texts = ["" if value is None else str(value) for value in values]
    return Column(np.array(texts, dtype=np.dtypes.StringDType()))


def _float(value: float | None) -> float:
    if value is None:
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf
