"""Dirt in the telemetry, in words: what was found, and what was done about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.report.formatting import listed

# One sentence a kind and treatment; the number of places and the channel are filled in.
_KINDS = {
    "outliers": "outliers",
    "gap": "gaps",
    "stuck": "stuck readings",
    "saturated": "saturated readings",
    "duplicate": "repeated rows",
    "clock": "wrong time stamps",
    "quantised": "rounding of the readings",
    "coloured": "noise that is correlated in time",
    "noise_level": "noise that is larger than stated",
}
_CHANNELS = {
    "rate": "the rate sensor",
    "attitude": "the star tracker",
    "momentum": "the tachometers",
    "torque": "the torque commands",
    "time": "the time stamps",
}
_TREATED = {"masked": "left out", "modelled": "taken into account", "ignored": "left as it is"}


def dirt_rows(dirt: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Records of dirt, one row a kind, channel and treatment.

    Returns: {kind, channel, treated, rows (how many), slews, notes} of each.

    Examples
    --------
    >>> record = {"kind": "outliers", "channel": "rate", "slew": "a", "rows": [3, 9]}
    >>> dirt_rows([record | {"treated": "masked", "note": "far off"}])[0]["rows"]
    2
    """
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for record in dirt:
        key = (record["kind"], record["channel"], record["treated"])
        groups.setdefault(key, []).append(record)
    return [
        {
            "kind": _KINDS[kind],
            "channel": _CHANNELS[channel],
            "treated": _TREATED[treated],
            "rows": sum(len(record["rows"]) for record in records),
            "slews": [record["slew"] for record in records if record["slew"]],
            "notes": [record["note"] for record in records if record.get("note")],
        }
        for (kind, channel, treated), records in groups.items()
    ]


def dirt_sentences(dirt: Sequence[Mapping[str, Any]]) -> list[str]:
    """Records of dirt as sentences.

    Returns: one a kind, channel and treatment; none where there is no dirt.

    Examples
    --------
    >>> record = {"kind": "outliers", "channel": "rate", "slew": "a", "rows": [3, 9]}
    >>> dirt_sentences([record | {"treated": "masked"}])
    ['Outliers of the rate sensor: 2 rows (a), left out.']
    """
    sentences = []
    for row in dirt_rows(dirt):
        count = f"{row['rows']} row{'s' if row['rows'] != 1 else ''}"
        names = listed(row["slews"]) if len(row["slews"]) <= 3 else f"{len(row['slews'])} slews"
        place = f": {count} ({names})" if row["rows"] else ""
        note = f" ({row['notes'][0]})" if row["notes"] and not row["rows"] else ""
        text = f"{row['kind']} of {row['channel']}{place}{note}, {row['treated']}."
        sentences.append(text[0].upper() + text[1:])
    return sentences
