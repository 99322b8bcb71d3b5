"""Files of attitude ephemeris messages (AEM): keywords and values (KVN), and XML.

Blocks of attitudes in a comprehensive message (ACM, 504.0-B-2) are read as those of an AEM 2.0.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.files import read_bytes, vocabulary
from bayes_inertia.tables.aem import AemSegment, joined_segments, segment_table
from bayes_inertia.tables.stamp_parts import SECOND, tai_to_utc, utc_to_tai
from bayes_inertia.tables.table import Table
from bayes_inertia.tables.text_cells import decoded
from bayes_inertia.tables.time_texts import text_to_ns

_PAIR = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]*)\s*=\s*(.*?)\s*")
_UNIT = re.compile(r"\s*\[[^\]]*\]\s*$")
_BLOCK = re.compile(r"([A-Z]+)_(START|STOP)")
# Keywords of a block of an ACM that do not change what a number means, or stand under other names.
_OF_BLOCK = frozenset(
    "ATT_ID ATT_PREV_ID ATT_BASIS ATT_BASIS_ID ATT_TYPE RATE_TYPE NUMBER_STATES".split()  # noqa: SIM905
)
_RATES = MappingProxyType(
    {"NONE": "", "ANGVEL": "/ANGVEL", "Q_DOT": "/DERIVATIVE", "EULER_RATE": "/DERIVATIVE"}
)
_ZERO = np.datetime64("1958-01-01", "ns")
_ADVICE = "export the message again"
_MESSAGE = re.compile(rb"""(?:^|\n|id\s*=\s*["'])\s*CCSDS_([A-Z]{3})_VERS\s*["'=]""")
_AS_AEM = "export the attitudes as an attitude ephemeris message (AEM), or as CSV"
_AS_CSV = "it holds no attitudes: give AEM or CSV of these; positions are read from CSV"
_FROM_STK = (
    "let STK export an attitude ephemeris message (AEM), or save the rows below "
    "AttitudeTimeQuaternions as CSV with the names t,q1,q2,q3,q4 (the scalar is q4)"
)
_MESSAGES = MappingProxyType(vocabulary("tables")["ccsds_messages"])


def is_aem(head: bytes) -> bool:
    """Whether a file with these first bytes is an AEM, KVN or XML, or an ACM."""
    return re.search(rb"CCSDS_A[EC]M_VERS", head.replace(b"\0", b"")) is not None


def refuse_other_messages(head: bytes, path: Path) -> None:
    """Raise an error for a message of CCSDS that is no AEM, and for a file of STK."""
    plain = head.replace(b"\0", b"").removeprefix(codecs.BOM_UTF8).lstrip()
    if plain.lower().startswith(b"stk.v."):
        begin = re.search(rb"\bBEGIN\s+(\w+)", plain, re.IGNORECASE)
        what = begin[1].decode().lower() if begin else "data"
        advice = _AS_CSV if what == "ephemeris" else _FROM_STK
        raise CampaignError(f"is an STK {what} file", where=str(path), advice=advice)
    match = _MESSAGE.search(plain)
    kind = match[1].decode() if match else "AEM"
    if kind != "AEM":
        what = _MESSAGES.get(kind, "message of CCSDS")
        advice = _AS_CSV if kind in _MESSAGES and not what.startswith("attitude") else _AS_AEM
        raise CampaignError(f"is an {kind} ({what})", where=str(path), advice=advice)


def read_aem(path: Path, table: str = "") -> Table:
    """The attitudes of a message; `table` is "segment 1" and so on, or "" for all together."""
    segments = _segments(path)
    names = _names(len(segments))
    if table and table not in names:
        raise CampaignError(
            f"no table {table!r}", where=str(path), advice=f"the file has {', '.join(names)}"
        )
    chosen = [
        segment_table(replace(segment, label=f"{path}, {name}" if len(segments) > 1 else str(path)))
        for name, segment in zip(names, segments, strict=True)
        if table in ("", name)
    ]
    return joined_segments(chosen)


def aem_segments(path: Path) -> list[str]:
    """Names of the segments of a message; one empty name where there is one segment."""
    count = len(_segments(path))
    return [""] if count == 1 else _names(count)


def _names(count: int) -> list[str]:
    return [f"segment {number}" for number in range(1, count + 1)]


def _segments(path: Path) -> list[AemSegment]:
    text = decoded(read_bytes(path), str(path))
    read = _from_acm if "CCSDS_ACM_VERS" in text else _from_kvn
    if text.lstrip().startswith("<"):
        read = _from_xml
    segments = read(text, str(path))
    if not segments:
        raise CampaignError("holds no segment of attitudes", where=str(path), advice=_ADVICE)
    return segments


def _from_kvn(text: str, label: str) -> list[AemSegment]:
    """Segments of keywords and values."""
    version, part = "", "header"
    segments: list[AemSegment] = []
    meta: dict[str, str] = {}
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []
    for number, line in _lines(text):
        where = f"{label}, line {number}"
        if line in ("META_START", "META_STOP", "DATA_START", "DATA_STOP"):
            part = _next_part(part, line, where)
            if line == "META_START":
                meta, rows, lines = {}, [], []
            elif line == "DATA_STOP":
                segments.append(AemSegment(version, meta, tuple(rows), tuple(lines)))
        elif part == "data":
            rows.append(tuple(line.split()))
            lines.append(number)
        else:
            key, value = _pair(line, where)
            if key == "CCSDS_AEM_VERS":
                version = value
            elif part == "meta":
                _add(meta, key, value, where)
    if part not in ("between", "header"):
        raise CampaignError("ends within a segment", where=label, advice=_ADVICE)
    return segments


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines that say something, with their numbers."""
    for number, raw in enumerate(re.split("\r\n|\n|\r", text), start=1):
        line = raw.strip()
        if line and not line.startswith("COMMENT"):
            yield number, line


def _from_acm(text: str, label: str) -> list[AemSegment]:
    """Blocks of attitudes of a comprehensive message; other blocks are passed over."""
    part = ""
    segments: list[AemSegment] = []
    meta: dict[str, str] = {}
    block: dict[str, str] = {}
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []
    for number, line in _lines(text):
        where = f"{label}, line {number}"
        mark = _BLOCK.fullmatch(line)
        if mark:
            if part != (mark[1] if mark[2] == "STOP" else ""):
                raise CampaignError(f"{line} does not belong here", where=where, advice=_ADVICE)
            part = mark[1] if mark[2] == "START" else ""
            if line == "ATT_START":
                block, rows, lines = {}, [], []
            elif line == "ATT_STOP":
                stated, stamped = _as_aem(meta, block, rows, label)
                segments.append(AemSegment("2.0", stated, stamped, tuple(lines)))
        elif part in ("META", "ATT") and "=" in line:
            _add(meta if part == "META" else block, *_pair(line, where), where)
        elif part == "ATT":
            rows.append(tuple(line.split()))
            lines.append(number)
    if part:
        raise CampaignError("ends within a segment", where=label, advice=_ADVICE)
    return segments


def _as_aem(
    meta: Mapping[str, str], block: Mapping[str, str], rows: list[tuple[str, ...]], label: str
) -> tuple[dict[str, str], tuple[tuple[str, ...], ...]]:
    """Metadata and rows of a block as an AEM has them: its times count from EPOCH_TZERO [s]."""
    system = meta.get("TIME_SYSTEM", "")
    stated = {key: value for key, value in block.items() if key not in _OF_BLOCK}
    kind = block.get("ATT_TYPE", "").upper()
    rate = block.get("RATE_TYPE", "NONE").upper()
    stated["ATTITUDE_TYPE"] = kind.replace("EULER_ANGLES", "EULER_ANGLE") + _RATES.get(
        rate, f"/{rate}"
    )
    stated["TIME_SYSTEM"] = system
    utc = system.upper() == "UTC"
    zero = text_to_ns(meta.get("EPOCH_TZERO", ""), utc=utc, place=lambda: f"{label}, EPOCH_TZERO")
    if zero is None:
        raise CampaignError(
            "the metadata lack EPOCH_TZERO", where=label, advice="add the line EPOCH_TZERO = ..."
        )
    tai = int(utc_to_tai(np.array(zero[0]))) if utc else zero[0]

    def stamp(cell: str) -> str:
        try:
            ns = tai + round(float(cell) * SECOND)
        except ValueError:
            return cell  # A date.
        return str(_ZERO + np.timedelta64(tai_to_utc(ns) if utc else ns, "ns"))

    return stated, tuple((stamp(row[0]), *row[1:]) for row in rows)


def _next_part(part: str, mark: str, where: str) -> str:
    """The part of the message after a mark."""
    allowed = {
        ("header", "META_START"): "meta",
        ("between", "META_START"): "meta",
        ("meta", "META_STOP"): "after meta",
        ("after meta", "DATA_START"): "data",
        ("data", "DATA_STOP"): "between",
    }
    if (part, mark) not in allowed:
        raise CampaignError(f"{mark} does not belong here", where=where, advice=_ADVICE)
    return allowed[part, mark]


def _pair(line: str, where: str) -> tuple[str, str]:
    match = _PAIR.fullmatch(line)
    if match is None:
        raise CampaignError(
            f"{line[:40]!r} is no KEYWORD = value", where=where, advice="mend or remove the line"
        )
    return match[1].upper(), _UNIT.sub("", match[2])


def _add(meta: dict[str, str], key: str, value: str, where: str) -> None:
    if key in meta:
        raise CampaignError(f"{key} is given twice", where=where, advice="remove one line")
    meta[key] = value


def _from_xml(text: str, label: str) -> list[AemSegment]:
    """Segments of XML, where every number has a name of its own."""
    # Neither is part of the standard, and both can make a small file large.
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise CampaignError("declares entities", where=label, advice="remove <!DOCTYPE ...>")
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
    except ElementTree.ParseError as error:
        raise CampaignError(f"is no XML ({error})", where=label, advice=_ADVICE) from error
    found = [node for node in root.iter() if _tag(node).lower() == "aem"]
    segments = []
    for aem in found:
        for node in (node for node in aem.iter() if _tag(node) == "segment"):
            segments.append(_xml_segment(node, aem.get("version", ""), label))
    return segments


def _tag(node: ElementTree.Element) -> str:
    return node.tag.rsplit("}", 1)[-1] if isinstance(node.tag, str) else ""


def _xml_segment(node: ElementTree.Element, version: str, label: str) -> AemSegment:
    meta: dict[str, str] = {}
    for part in (part for part in node if _tag(part) == "metadata"):
        for leaf in part:
            if _tag(leaf) != "COMMENT":
                _add(meta, _tag(leaf), (leaf.text or "").strip(), label)
    rows: list[tuple[str, ...]] = []
    names: tuple[str, ...] = ()
    for index, state in enumerate(s for s in node.iter() if _tag(s) == "attitudeState"):
        cells = _xml_cells(state, f"{label}, attitude {index + 1}")
        own = tuple(name for name in cells if name != "EPOCH")
        names = names or own
        if own != names or "EPOCH" not in cells:
            raise CampaignError(
                "an attitude has other components than the first, or no EPOCH",
                where=f"{label}, attitude {index + 1}",
                advice=_ADVICE,
            )
        rows.append((cells["EPOCH"], *(cells[name] for name in names)))
    return AemSegment(version, meta, tuple(rows), (), names)


def _xml_cells(state: ElementTree.Element, where: str) -> dict[str, str]:
    """The numbers of one attitude by name."""
    cells: dict[str, str] = {}
    for leaf in state.iter():
        if len(leaf) or _tag(leaf) == "COMMENT":
            continue
        # Version 1.0 writes <rotation1 angle="X_ANGLE" units="deg">.
        name = leaf.get("angle") or leaf.get("rate") or _tag(leaf)
        unit = leaf.get("units", "")
        if unit and unit.lower() not in ("deg", "deg/s", "1/s"):
            raise CampaignError(
                f"{name} is in {unit}", where=where, advice="the standard allows deg and deg/s"
            )
        _add(cells, name.upper(), (leaf.text or "").strip(), where)
    return cells
