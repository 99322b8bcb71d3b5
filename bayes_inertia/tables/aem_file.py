"""Files of attitude ephemeris messages: keywords and values (KVN), and XML."""

from __future__ import annotations

import codecs
import re
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

from bayes_inertia.errors import CampaignError
from bayes_inertia.files import read_bytes, vocabulary
from bayes_inertia.tables.aem import AemSegment, joined_segments, segment_table
from bayes_inertia.tables.raw_table import RawTable
from bayes_inertia.tables.text_cells import decoded

_PAIR = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]*)\s*=\s*(.*?)\s*")
_UNIT = re.compile(r"\s*\[[^\]]*\]\s*$")
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
    """Whether a file with these first bytes is an AEM, KVN or XML."""
    return b"CCSDS_AEM_VERS" in head.replace(b"\0", b"")


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


def read_aem(path: Path, table: str = "") -> RawTable:
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
    segments = (
        _from_xml(text, str(path)) if text.lstrip().startswith("<") else _from_kvn(text, str(path))
    )
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
    for number, raw in enumerate(re.split("\r\n|\n|\r", text), start=1):
        line = raw.strip()
        if not line or line.startswith("COMMENT"):
            continue
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
