"""From the text of `campaign.toml`, of either format, to what it says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bayes_inertia.campaign.checked_toml import checked_document, toml_document
from bayes_inertia.campaign.described_devices import described
from bayes_inertia.campaign.description import (
    FIELDS,
    Description,
    Entry,
    SlewTables,
    built,
    common,
)
from bayes_inertia.campaign.format_2 import Campaign2Part
from bayes_inertia.campaign.hardware import RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.schema import (
    FORMAT_2,
    CampaignPart,
    SlewPart,
    check_consistency,
    refuse,
)


def parse_description(text: str, label: str) -> Description:
    """The content of a `campaign.toml` of either format, every key checked.

    >>> parse_description('format = "bayes-inertia-campaign/1"\\nnmae = "x"', "campaign.toml")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: campaign.toml, key nmae: unknown key; did you mean "name"?
    """
    document = toml_document(text, label)
    if document.get("format") == FORMAT_2:
        description = described(checked_document(document, label, Campaign2Part), label)
    else:
        parsed = checked_document(document, label, CampaignPart)
        check_consistency(parsed, label)
        description = upgrade(parsed, label)
    for slew in description.slews:
        _check_names(slew, description, label)
    return description


def upgrade(parsed: CampaignPart, label: str) -> Description:
    """The description that a file of format 1 is."""
    entries = tuple(
        Entry(key, FIELDS.get(key, key), columns, (f"columns.{key}",))
        for key, columns in parsed.columns.given().items()
        if key != "time"
    )
    tracker = parsed.star_tracker
    return Description(
        name=parsed.name,
        time=parsed.columns.time,
        entries=entries,
        slews=tuple(_tables_of(part, entries) for part in parsed.slews),
        **common(parsed.inertia, parsed.mission, parsed.prior, label),
        wheels=tuple(built(Wheel, part, label) for part in parsed.wheels),
        rate_sensor=built(RateSensor, parsed.rate_sensor, label),
        star_tracker=None if tracker is None else built(StarTracker, tracker, label),
    )


def _tables_of(part: SlewPart, entries: Sequence[Entry]) -> SlewTables:
    files = {entry.path: part.file_of(entry.key) for entry in entries}
    given = {path: file for path, file in files.items() if file is not None}
    key = "file" if part.files is None else "files"
    return SlewTables(part.name, part.start, part.axis, part.angle_deg, key, given)


def _check_names(slew: SlewTables, description: Description, label: str) -> None:
    """In one table each column has one meaning; only columns of time may be shared."""
    used: dict[tuple[str | None, str], str] = {}
    times: dict[tuple[str | None, str], str] = {}
    for entry in description.entries:
        file = slew.file_of(entry)
        own = entry.columns.time is not None
        times[file, description.clock(entry).names[0]] = f"{entry.path}.time" if own else "time"
        for path, name in _names(entry):
            if (file, name) in used:
                _refuse_twice(label, path, name, used[file, name])
            used[file, name] = path
    for place, path in times.items():
        if place in used:
            _refuse_twice(label, used[place], place[1], path)


def _names(entry: Entry) -> Iterator[tuple[str, str]]:
    """The path of each column of an entry, and its name."""
    for k, name in enumerate(entry.columns.names):
        yield entry.paths[min(k, len(entry.paths) - 1)], name


def _refuse_twice(label: str, path: str, name: str, other: str) -> None:
    what = f"the column {name!r} is already used by {other.removeprefix('columns.')}"
    refuse(label, f"{path}.names", what, "name each column once")
