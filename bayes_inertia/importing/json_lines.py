"""JSON lines: one object a line, nested keys joined with dots, lists as name[0], name[1], ..."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.files import read_bytes
from bayes_inertia.importing.raw_table import RawColumn, RawTable
from bayes_inertia.importing.text_cells import decoded

_MAX_DEPTH = 12  # Of objects and lists inside each other.
_MAX_COLUMNS = 2000


def read_json_lines(path: Path) -> RawTable:
    """The columns of a file of JSON objects.

    Parameters
    ----------
    path : Path
        One object a line, or one list of objects.

    Returns
    -------
    RawTable
        Its columns; a key that a line lacks is an empty cell.

    Raises
    ------
    CampaignError
        If a line is no JSON object; the error names it.
    """
    return parse_json_lines(decoded(read_bytes(path), str(path)), str(path))


def parse_json_lines(text: str, label: str) -> RawTable:
    """The columns of text of JSON objects.

    Parameters
    ----------
    text : str
        The file's content.
    label : str
        The file, as messages name it.

    Returns
    -------
    RawTable
        Its columns.

    Raises
    ------
    CampaignError
        If a line is no JSON object.

    Examples
    --------
    >>> table = parse_json_lines('{"t": 1, "gyro": {"w": [0.1, null]}}', "a.jsonl")
    >>> {name: column.values.tolist() for name, column in table.columns.items()}
    {'t': [1], 'gyro.w[0]': [0.1], 'gyro.w[1]': [nan]}
    """
    records, lines = _records(text, label)
    cells: dict[str, list[Any]] = {}
    for index, (record, line) in enumerate(zip(records, lines, strict=True)):
        flat: dict[str, Any] = {}
        _flatten(record, "", flat, 0, f"{label}, line {line}")
        for name, value in flat.items():
            column = cells.setdefault(name, [])
            column.extend([None] * (index - len(column)))
            column.append(value)
        if len(cells) > _MAX_COLUMNS:
            raise CampaignError(
                f"more than {_MAX_COLUMNS} different keys",
                where=f"{label}, line {line}",
                advice="give every line the same keys",
            )
    if not cells:
        raise CampaignError("the file is empty", where=label, advice="give rows of telemetry")
    columns = {
        name: _column(values + [None] * (len(records) - len(values)))
        for name, values in cells.items()
    }
    return RawTable(label, columns, np.array(lines, dtype=int))


def _records(text: str, label: str) -> tuple[list[dict[str, Any]], list[int]]:
    """The objects and the lines where they begin."""
    if text.lstrip().startswith("["):
        listed = _parsed(text, f"{label}")
        if not all(isinstance(record, dict) for record in listed):
            raise CampaignError("a list of other things than objects", where=label, advice=_ADVICE)
        return listed, list(range(1, len(listed) + 1))
    records, lines = [], []
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        where = f"{label}, line {number}"
        record = _parsed(line, where)
        if not isinstance(record, dict):
            raise CampaignError("no JSON object", where=where, advice=_ADVICE)
        records.append(record)
        lines.append(number)
    return records, lines


_ADVICE = 'write one object a line, such as {"t": 0.25, "w": [0.1, 0.2, 0.3]}'


def _parsed(text: str, where: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = error.msg if isinstance(error, json.JSONDecodeError) else type(error).__name__
        raise CampaignError(f"no JSON ({reason})", where=where, advice=_ADVICE) from error


def _flatten(value: Any, name: str, flat: dict[str, Any], depth: int, where: str) -> None:
    if depth > _MAX_DEPTH:
        raise CampaignError("nested too deeply", where=where, advice=_ADVICE)
    if isinstance(value, dict):
        for key, item in value.items():
            _flatten(item, f"{name}.{key}" if name else key, flat, depth + 1, where)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _flatten(item, f"{name}[{index}]", flat, depth + 1, where)
    elif name in flat:
        raise CampaignError(f"two values are named {name}", where=where, advice=_ADVICE)
    else:
        flat[name] = value


def _column(values: list[Any]) -> RawColumn:
    """Integers where all are, floats where all are numbers or missing, else texts."""
    if all(type(value) is int and abs(value) < 2**63 for value in values):
        return RawColumn(np.array(values, dtype=np.int64))
    if all(value is None or isinstance(value, int | float) for value in values):
        return RawColumn(np.array([_float(value) for value in values]))
    texts = ["" if value is None else str(value) for value in values]
    return RawColumn(np.array(texts, dtype=np.dtypes.StringDType()))


def _float(value: float | None) -> float:
    if value is None:
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf
