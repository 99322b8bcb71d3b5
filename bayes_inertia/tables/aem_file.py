"""Files of attitude ephemeris messages (AEM): keywords and values (KVN), and XML.

Blocks of attitudes in a comprehensive message (ACM, 504.0-B-2) are read as those of an AEM 2.0.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from bayes_inertia.errors import CampaignError, require, with_article
from bayes_inertia.files import vocabulary
from bayes_inertia.tables.aem import AemSegment, joined_segments, segment_table
from bayes_inertia.tables.stamp_parts import SECOND, tai_to_utc, utc_to_tai
from bayes_inertia.tables.table import Table
from bayes_inertia.tables.text_cells import CellRow, content, decoded, lines_in
from bayes_inertia.tables.time_texts import text_to_ns

_PAIR = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]*)\s*=\s*(.*?)\s*(?:\[([^\]]*)\]\s*)?")
_BLOCK = re.compile(r"([A-Z]+)_(START|STOP)")
_OF_BLOCK = frozenset(vocabulary("tables")["acm_keywords"]["dropped"].split())
_RATES = {"NONE": "", "ANGVEL": "/ANGVEL", "Q_DOT": "/DERIVATIVE", "EULER_RATE": "/DERIVATIVE"}
_ZERO = np.datetime64("1958-01-01", "ns")
_ADVICE = "export the message again"
_MESSAGE = re.compile(rb"""(?:^|\n|id\s*=\s*["'])\s*CCSDS_([A-Z]{3})_VERS\s*["'=]""")
_AS_AEM = "export the attitudes as an attitude ephemeris message (AEM), or as CSV"
_AS_CSV = "it holds no attitudes: give AEM or CSV of these; positions are read from CSV"
_FROM_STK = (
    "let STK export an attitude ephemeris message (AEM), or save the rows below "
    "AttitudeTimeQuaternions as CSV with the names t,q1,q2,q3,q4 (the scalar is q4)"
)
_MESSAGES = vocabulary("tables")["ccsds_messages"]


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
        raise CampaignError(f"is {with_article(kind)} ({what})", where=str(path), advice=advice)


def read_aem(path: Path, table: str = "") -> Table:
    """The attitudes of a message; `table` is "segment 1" and so on, or "" for all together."""
    segments = _segments(path)
    advice = f"the file has {', '.join(segments)}"
    require(table in ("", *segments), str(path), f"no table {table!r}", advice)
    chosen = [segment_table(segments[name]) for name in segments if table in ("", name)]
    # Lines and rows of segments together are those of the file.
    return chosen[0] if len(chosen) == 1 else replace(joined_segments(chosen), label=str(path))


def aem_segments(path: Path) -> list[str]:
    """Names of the segments of a message; one empty name where they make one table."""
    segments = _segments(path)
    try:
        joined_segments([segment_table(segment) for segment in segments.values()])
    except CampaignError:  # Each may be read by itself.
        return list(segments)
    return [""]


def _segments(path: Path) -> dict[str, AemSegment]:
    """The segments of a message by name."""
    text, label = decoded(content(path), str(path)), str(path)
    if text.lstrip().startswith("<"):
        segments = _from_xml(text, label)
    else:
        segments = _from_acm(text, label) if "CCSDS_ACM_VERS" in text else _from_kvn(text, label)
    require(bool(segments), label, "holds no segment of attitudes", _ADVICE)
    if len(segments) == 1:
        return {"segment 1": replace(segments[0], label=label)}
    names = [f"segment {k}" for k in range(1, len(segments) + 1)]
    both = zip(names, segments, strict=True)
    return {name: replace(segment, label=f"{label}, {name}") for name, segment in both}


@dataclass(frozen=True)
class MessageBlock:
    """What stands between NAME_START and NAME_STOP, or outside of all blocks ("")."""

    name: str
    where: str
    pairs: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)  # by keyword, without brackets
    comments: list[str] = field(default_factory=list)
    rows: list[CellRow] = field(default_factory=list)


def message_blocks(text: str, label: str, read: Mapping[str, bool]) -> list[MessageBlock]:
    """Blocks of a message, what is outside first; `read`: names, and whether they hold rows.

    Of all other blocks the comments alone.
    """
    block = outside = MessageBlock("", label)
    blocks = [outside]
    for number, raw in enumerate(lines_in(text), start=1):
        line, where = raw.strip(), f"{label}, line {number}"
        mark = _BLOCK.fullmatch(line)
        if mark:
            fits = block.name == (mark[1] if mark[2] == "STOP" else "")
            require(fits, where, f"{line} does not belong here", _ADVICE)
            block = MessageBlock(mark[1], where) if mark[2] == "START" else outside
            blocks += [] if block is outside else [block]
        elif line.startswith("COMMENT"):
            block.comments.append(line.removeprefix("COMMENT").strip())
        elif not line or block.name not in read:
            continue
        elif read[block.name] and (block.name == "DATA" or "=" not in line):
            block.rows.append(CellRow(number, tuple(line.split())))
        else:
            key, value, unit = _pair(line, where)
            _add(block.pairs, key, value, where)
            block.units[key] = unit
    require(block is outside, label, "ends within a segment", _ADVICE)
    return blocks


def _from_kvn(text: str, label: str) -> list[AemSegment]:
    """Segments of keywords and values: metadata and data by turns."""
    header, *blocks = message_blocks(text, label, {"": False, "META": False, "DATA": True})
    for k, block in enumerate(blocks):
        what = f"{block.name}_START does not belong here"
        require(block.name == ("META", "DATA")[k % 2], block.where, what, _ADVICE)
    require(len(blocks) % 2 == 0, label, "ends within a segment", _ADVICE)
    version = header.pairs.get("CCSDS_AEM_VERS", "")
    both = zip(blocks[::2], blocks[1::2], strict=True)
    return [AemSegment(version, a.pairs, tuple(b.rows)) for a, b in both]


def _from_acm(text: str, label: str) -> list[AemSegment]:
    """Blocks of attitudes of a comprehensive message; other blocks are passed over."""
    segments: list[AemSegment] = []
    meta: dict[str, str] = {}
    for block in message_blocks(text, label, {"META": False, "ATT": True}):
        if block.name == "META":
            meta |= block.pairs
        elif block.name == "ATT":
            segments.append(_as_aem(meta, block, label))
    return segments


def _as_aem(meta: Mapping[str, str], block: MessageBlock, label: str) -> AemSegment:
    """A block as an AEM has it: its times count from EPOCH_TZERO [s]."""
    system = meta.get("TIME_SYSTEM", "")
    stated = {key: value for key, value in block.pairs.items() if key not in _OF_BLOCK}
    kind = block.pairs.get("ATT_TYPE", "").upper()
    rate = block.pairs.get("RATE_TYPE", "NONE").upper()
    is_read = kind in ("QUATERNION", "EULER_ANGLES")
    advice = "export QUATERNION or EULER_ANGLES"
    require(is_read, block.where, f"ATT_TYPE = {kind} is not read", advice)
    kind = kind.replace("EULER_ANGLES", "EULER_ANGLE")
    stated["ATTITUDE_TYPE"] = kind + _RATES.get(rate, f"/{rate}")
    stated["TIME_SYSTEM"] = system
    utc = system.upper() == "UTC"
    zero = text_to_ns(meta.get("EPOCH_TZERO", ""), utc=utc, place=lambda: f"{label}, EPOCH_TZERO")
    if zero is None:
        what, advice = "the metadata lack EPOCH_TZERO", "add the line EPOCH_TZERO = ..."
        raise CampaignError(what, where=label, advice=advice)
    tai = int(utc_to_tai(np.array(zero[0]))) if utc else zero[0]

    def stamp(cell: str) -> str:
        try:
            ns = tai + round(float(cell) * SECOND)
        except ValueError:
            return cell  # A date.
        return str(_ZERO + np.timedelta64(tai_to_utc(ns) if utc else ns, "ns"))

    rows = [CellRow(line, (stamp(first), *rest)) for line, (first, *rest) in block.rows]
    return AemSegment("2.0", stated, tuple(rows))


def _pair(line: str, where: str) -> tuple[str, str, str]:
    """Keyword, value and unit of a line."""
    match = _PAIR.fullmatch(line)
    if match is None:
        what = f"{line[:40]!r} is no KEYWORD = value"
        raise CampaignError(what, where=where, advice="mend or remove the line")
    return match[1].upper(), match[2], match[3] or ""


def _add(meta: dict[str, str], key: str, value: str, where: str) -> None:
    require(key not in meta, where, f"{key} is given twice", "remove one line")
    meta[key] = value


def _from_xml(text: str, label: str) -> list[AemSegment]:
    """Segments of XML, where every number has a name of its own."""
    # Neither is part of the standard, and both can make a small file large.
    plain = "<!DOCTYPE" not in text and "<!ENTITY" not in text
    require(plain, label, "declares entities", "remove <!DOCTYPE ...>")
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
    except ElementTree.ParseError as error:
        raise CampaignError(f"is no XML ({error})", where=label, advice=_ADVICE) from error
    return [
        _xml_segment(node, aem.get("version", ""), label)
        for aem in root.iter()
        if _tag(aem).lower() == "aem"
        for node in aem.iter()
        if _tag(node) == "segment"
    ]


def _tag(node: ElementTree.Element) -> str:
    return node.tag.rsplit("}", 1)[-1] if isinstance(node.tag, str) else ""


def _xml_segment(node: ElementTree.Element, version: str, label: str) -> AemSegment:
    meta: dict[str, str] = {}
    for part in (part for part in node if _tag(part) == "metadata"):
        for leaf in part:
            if _tag(leaf) != "COMMENT":
                _add(meta, _tag(leaf), (leaf.text or "").strip(), label)
    rows: list[CellRow] = []
    names: tuple[str, ...] = ()
    for index, state in enumerate(s for s in node.iter() if _tag(s) == "attitudeState"):
        cells = _xml_cells(state, f"{label}, attitude {index + 1}")
        own = tuple(name for name in cells if name != "EPOCH")
        names = names or own
        what = "an attitude has other components than the first, or no EPOCH"
        require(own == names and "EPOCH" in cells, f"{label}, attitude {index + 1}", what, _ADVICE)
        rows.append(CellRow(0, (cells["EPOCH"], *(cells[name] for name in names))))
    return AemSegment(version, meta, tuple(rows), names)


def _xml_cells(state: ElementTree.Element, where: str) -> dict[str, str]:
    """The numbers of one attitude by name."""
    cells: dict[str, str] = {}
    for leaf in state.iter():
        if len(leaf) or _tag(leaf) == "COMMENT":
            continue
        # Version 1.0 writes <rotation1 angle="X_ANGLE" units="deg">.
        name = leaf.get("angle") or leaf.get("rate") or _tag(leaf)
        unit = leaf.get("units", "")
        known = unit.lower() in ("", "deg", "deg/s", "1/s")
        require(known, where, f"{name} is in {unit}", "the standard allows deg and deg/s")
        _add(cells, name.upper(), (leaf.text or "").strip(), where)
    return cells
