"""Who owns a folder of results: one command, one campaign, one set of options.

Every command that writes a folder claims it first. The claim is a JSON file of the command's own
(`run.json`, `design.json`, ...), written before anything else: whoever finds a half-written
folder after a kill can tell whose it is. The same work may go on there. Other work is refused,
and nothing is overwritten.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.files import check_folder, make_folder, write_atomically
from bayes_inertia.folder_lock import LOCK_FILE
from bayes_inertia.sealing import read_sealed_json, sealed
from bayes_inertia.version import __version__

if TYPE_CHECKING:
    from bayes_inertia.report.section import Section

_ADVICE = "choose another folder; nothing was overwritten"


def write_json(path: Path, content: Mapping[str, Any]) -> Path:
    """Write a JSON document of results, atomically."""
    return write_atomically(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def origin(campaign: Path) -> dict[str, str]:
    """When a result is made, and of which folder: what its page says of its origin."""
    place = campaign.resolve()
    name = place.parent.name if place.is_file() else place.name
    return {"date": datetime.now(UTC).date().isoformat(), "data": name}


def write_page(
    path: Path,
    title: str,
    mission: Sequence[tuple[str, str]],
    campaign: Path,
    sections: Sequence[Section],
    sha256: str,
) -> Path:
    """Write the page of a result, with its origin in the head."""
    from bayes_inertia.report.page import page_facts, render_page

    facts = page_facts(dict(mission), sha256=sha256, version=__version__, origin=origin(campaign))
    return write_atomically(path, render_page(title, sections, facts))


@dataclass(frozen=True)
class ResultFolder:
    """A folder, and the work that wants to write in it.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as path:
    ...     folder = ResultFolder(Path(path), "design", "design.json", "format/1", "ab")
    ...     before = folder.holds_this_work()
    ...     folder.claim()
    ...     before, folder.holds_this_work()
    (False, True)
    """

    path: Path  # need not exist
    work: str  # what the folder would hold, as messages call it ("design")
    claim_file: str  # name of the JSON file that says whose the folder is
    format: str  # value of the key `format` in that file
    campaign_sha256: str
    # What else makes it this work and no other, as JSON values.
    options: Mapping[str, Any] = field(default_factory=dict)
    # Other files that the command writes: without a claim they are somebody else's. Empty: all are.
    results: tuple[str, ...] = ()
    flat: bool = False  # whether the claim states its options at the top, not under `options`
    # Options that older versions left out of the claim; any other left out counts as equal.
    defaults: Mapping[str, Any] = field(default_factory=dict)

    def holds_this_work(self) -> bool:
        """Whether the folder holds this very work; False if it is free. Writes nothing."""
        check_folder(self.path)
        if not (self.path / self.claim_file).exists():
            self._free_or_error()
            return False
        claim = self._read_claim()
        if claim["campaign_sha256"] != self.campaign_sha256:
            raise self._refused(f"holds a {self.work} of other data")
        options = claim if self.flat else claim.get("options", {})
        if not isinstance(options, dict):
            raise self._refused(f"{self.claim_file} there was not written by this command")
        stated = {**self.defaults, **options}
        wanted = json.loads(json.dumps(self.options))
        differs = [
            key for key, value in wanted.items() if not _agrees(stated.get(key, value), value)
        ]
        if differs:
            raise self._refused(f"holds a {self.work} with other {', '.join(differs)}")
        return True

    def claim(self, content: Mapping[str, Any] | None = None) -> None:
        """Make the folder if need be, and say in it whose it is."""
        self.holds_this_work()
        make_folder(self.path)
        options = self.options if self.flat else {"options": self.options}
        owner = {"format": self.format, "campaign_sha256": self.campaign_sha256}
        claim = sealed({**owner, **(content or {}), **options})
        write_json(self.path / self.claim_file, claim)

    def _free_or_error(self) -> None:
        names = list(self.results)
        if not names and self.path.is_dir():
            # What a kill left of an unfinished claim is nobody's.
            nobodys = (f".{self.claim_file}.", LOCK_FILE)
            names = sorted(p.name for p in self.path.iterdir() if not p.name.startswith(nobodys))
        for name in names:
            if (self.path / name).exists():
                raise self._refused(f"{name} is there already, without {self.claim_file}")

    def _read_claim(self) -> dict[str, Any]:
        try:
            claim = read_sealed_json(self.path / self.claim_file, _ADVICE)
        except CampaignError as error:
            raise self._refused(
                f"{self.claim_file} there was not written by this command, or is damaged "
                f"({error.what})"
            ) from error
        if claim.get("format") != self.format or "campaign_sha256" not in claim:
            raise self._refused(f"{self.claim_file} there was not written by this command")
        return claim

    def _refused(self, what: str) -> OutputError:
        return OutputError(what, where=str(self.path), advice=_ADVICE)


def _agrees(stated: Any, wanted: Any) -> bool:
    """Whether two JSON values are equal in every key that both have."""
    if isinstance(stated, dict) and isinstance(wanted, dict):
        return all(_agrees(stated.get(key, value), value) for key, value in wanted.items())
    return stated == wanted
