"""Damage to files, drawn from a seed: bytes, tokens and structure.

Bytes: flips, cuts, blocks of zeros, doubled and moved parts. Tokens: a word or number of a text
replaced by one that breaks programs. Structure: lines, columns, keys, types and shapes.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

KINDS = ("bytes", "tokens", "structure")
_TOKEN = re.compile(rb'"[^"\n]*"|[A-Za-z_][A-Za-z_0-9]*|[-+]?\d[\d.eE+-]*|[\[\]{}=,]')
_NASTY = (
    b"",
    b"nan",
    b"-inf",
    b"1e400",
    b"-1e31",
    b"1e31",
    b"1e308",
    b"1e-320",
    b"0",
    b"-0.0",
    b"9" * 400,
    b"9" * 5000,
    b"1e9",
    b"true",
    b"null",
    b'"\\u0000"',
    b'"../../../outside.csv"',
    b'"/etc/passwd"',
    b'"a.csv/../../b"',
    b'"CON"',
    b'"' + b"x" * 5000 + b'"',
    b'"\xff\xfe"',
    b'""',
    b"[]",
    b"[[[[[[[[]]]]]]]]",
    b"[" * 3000,
    b"{}",
    b"1_000",
    b"0x1F",
    b"2024-01-01T00:00:00Z",
    b"\xef\xbb\xbf",
    "é \U0001f680 ‮".encode(),
    b"\r",
    b"\x00",
    b"rate",
    b"attitude",
    b"'",
    b'"""',
    b"#",
)
_VALUES: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    1e308,
    10**30,
    "",
    "\x00",
    "../../outside",
    "x" * 5000,
    [],
    {},
    [[]],
    [None],
    {"a": {"b": []}},
    float("nan"),
    float("-inf"),
)

Random = np.random.Generator


def mutated_bytes(data: bytes, random: Random) -> bytes:
    """The bytes with one to four places changed, cut out, doubled, zeroed or moved."""
    made = bytearray(data)
    for _ in range(int(random.integers(1, 5))):
        if not made:
            break
        start, size = int(random.integers(len(made))), int(2 ** random.uniform(0, 7))
        kind = int(random.integers(8))
        if kind <= 1:
            made[start] ^= 1 << int(random.integers(8))
        elif kind == 2:
            made[start : start + size] = b""
        elif kind == 3:
            made[start:start] = made[start : start + size]
        elif kind == 4:
            made[start : start + size] = random.bytes(size)
        elif kind == 5:
            made[start : start + size] = bytes([int(random.choice([0, 255]))]) * size
        elif kind == 6:
            part = made[start : start + size]
            place = int(random.integers(len(made)))
            made[place : place + len(part)] = part
        elif random.random() < 0.3:
            made[start:] = b""
    return bytes(made)


def mutated_header(data: bytes, random: Random) -> bytes:
    """Bits flipped where a binary format keeps its structure: its first and last bytes."""
    made = bytearray(data)
    for _ in range(int(random.integers(1, 4))):
        place = int(random.integers(min(len(made), 2048)))
        if random.random() < 0.3:
            place = len(made) - 1 - place
        made[place] = int(random.integers(256)) if random.random() < 0.5 else made[place] ^ 0xFF
    return bytes(made)


def mutated_tokens(data: bytes, random: Random) -> bytes:
    """One to three tokens of a text replaced, doubled or exchanged."""
    for _ in range(int(random.integers(1, 4))):
        tokens = [m.span() for m in _TOKEN.finditer(data)]
        if not tokens:
            break
        start, stop = tokens[int(random.integers(len(tokens)))]
        new = _NASTY[int(random.integers(len(_NASTY)))]
        if random.random() < 0.25:
            other, end = tokens[int(random.integers(len(tokens)))]
            new = data[other:end]
        data = data[:start] + new + data[stop:]
    return data


def mutated_lines(data: bytes, random: Random) -> bytes:
    """Lines of a text left out, doubled, exchanged, joined, or a block of them repeated."""
    lines = data.split(b"\n")
    for _ in range(int(random.integers(1, 4))):
        i, j = (int(k) for k in random.integers(len(lines), size=2))
        kind = int(random.integers(6))
        if kind == 0:
            lines[i : i + int(random.integers(1, 20))] = []
        elif kind == 1:
            lines.insert(j, lines[i])
        elif kind == 2:
            lines[i], lines[j] = lines[j], lines[i]
        elif kind == 3:
            lines[i : i + 2] = [b"".join(lines[i : i + 2])]
        elif kind == 4:
            lines[i:i] = lines[i : i + 5] * 50
        else:
            cells = lines[i].split(b",")
            del cells[int(random.integers(len(cells)))]
            lines[i] = b",".join(cells)
        lines = lines or [b""]
    return b"\n".join(lines)


def mutated_columns(data: bytes, random: Random) -> bytes:
    """A column of a CSV file left out, doubled, exchanged, scaled or filled with one value."""
    rows = [line.split(b",") for line in data.split(b"\n")]
    i, j = (int(k) for k in random.integers(len(rows[0]), size=2))
    kind = int(random.integers(5))
    new = _NASTY[int(random.integers(len(_NASTY)))]
    for row in rows[1 if random.random() < 0.8 else 0 :]:
        if max(i, j) >= len(row):
            continue
        if kind == 0:
            del row[i]
        elif kind == 1:
            row.insert(j, row[i])
        elif kind == 2:
            row[i], row[j] = row[j], row[i]
        elif kind == 3:
            row[i] = new
        else:
            row[i] = row[i] + b"e%d" % int(random.integers(-330, 330))
    return b"\n".join(b",".join(row) for row in rows)


def mutated_json(data: bytes, random: Random) -> bytes:
    """One to three values of a JSON document replaced, left out or wrapped."""
    document = json.loads(data)
    for _ in range(int(random.integers(1, 4))):
        places = list(_places(document))
        if not places:
            break
        holder, key = places[int(random.integers(len(places)))]
        kind = int(random.integers(4))
        if kind == 0:
            del holder[key]
        elif kind == 1:
            holder[key] = [holder[key]]
        elif kind == 2:
            holder[key] = {"x": holder[key]}
        else:
            holder[key] = _VALUES[int(random.integers(len(_VALUES)))]
    return json.dumps(document).encode()


def _places(node: Any) -> Any:
    """All (holder, key) of a document."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in list(items):
        yield node, key
        if isinstance(value, dict | list):
            yield from _places(value)


Columns = Mapping[str, np.ndarray]


def mutated_array(values: np.ndarray, random: Random) -> Any:
    """A column in another type or shape."""
    n = len(values)
    makers: tuple[Callable[[], Any], ...] = (
        lambda: values.astype(np.float32),
        lambda: values.astype(np.int64),
        lambda: values > 0,
        lambda: values[: n // 2],
        lambda: values[:0],
        lambda: values[:, None],
        lambda: values[None, :],
        lambda: np.stack([values, values], axis=1),
        lambda: np.zeros((3, 4, 5)),
        lambda: np.float64(values[0]),
        lambda: np.full(n, np.inf),
        lambda: np.full(n, np.nan),
        lambda: values * 1e300,
        lambda: np.array([f"{v:.3f}" for v in values]),
        lambda: values + 1j,
        lambda: values[::-1].copy(),
        lambda: np.where(np.arange(n) == n // 2, -1e31, values),
        lambda: np.full(n, 2**63, dtype=np.uint64),
        lambda: values.astype(">f8"),
        lambda: values.astype(np.float16),
    )
    return makers[int(random.integers(len(makers)))]()


def changed_columns(columns: Columns, random: Random) -> dict[str, Any]:
    """The columns with one to three left out, renamed, or of another type or shape."""
    made: dict[str, Any] = dict(columns)
    for _ in range(int(random.integers(1, 4))):
        name = str(random.choice(list(columns)))
        kind = random.random()
        if kind < 0.1:
            made.pop(name, None)
        elif kind < 0.2:
            made[f"{name} ".upper()] = made.pop(name, columns[name])
        else:
            with np.errstate(all="ignore"):
                made[name] = mutated_array(np.nan_to_num(columns[name]), random)
    return made


def as_bytes(write: Callable[[io.BytesIO], Any]) -> bytes:
    """What a function writes to a file."""
    file = io.BytesIO()
    write(file)
    return file.getvalue()
