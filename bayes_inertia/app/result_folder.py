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

from bayes_inertia.errors import CampaignError, OutputError, require
from bayes_inertia.files import check_folder, make_folder, write_atomically
from bayes_inertia.folder_lock import LOCK_FILE
from bayes_inertia.sealing import read_sealed_json, sealed
from bayes_inertia.version import __version__

if TYPE_CHECKING:
    from bayes_inertia.inference.posterior import Posterior
    from bayes_inertia.report.section import Section

# What to do where a run is damaged.
NEW_RUN = "start a new run in another folder"
# What to do where a folder holds no run.
GIVE_A_RUN = "give the folder that `fit -o` or `diagnose -o` wrote"
_ADVICE = "choose another folder; nothing was overwritten"


def write_json(path: Path, content: Mapping[str, Any]) -> Path:
    """Write a JSON document of results, atomically."""
    return write_atomically(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def origin(*sources: Path) -> dict[str, str]:
    """When a result is made, and of which folders: what its page says of its origin."""
    places = [source.resolve() for source in sources]
    names = [place.parent.name if place.is_file() else place.name for place in places]
    return {"date": datetime.now(UTC).date().isoformat(), "data": ", ".join(names)}


def finished_posterior(folder: Path) -> Posterior:
    """The posterior of a finished run."""
    from bayes_inertia.inference.posterior import Posterior

    stored = folder / "posterior.nc"
    what = "no run here: there is neither run.json nor posterior.nc"
    advice = GIVE_A_RUN
    if (folder / "run.json").is_file():
        what = "the run is not finished: it has no posterior.nc"
        advice = f"finish it with `bayes-inertia resume {folder}`"
    require(stored.is_file(), str(folder), what, advice)
    return Posterior.load(stored)


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
        wanted, usual = (json.loads(json.dumps(x)) for x in (self.options, self.defaults))
        stated = usual | options
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

    def write(
        self,
        content: Mapping[str, Any],
        title: str,
        sections: Sequence[Section],
        *sources: Path,
        mission: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Write a result: the claim with its content, its first picture, its page.

        `sources`: folders of the data, named in the page's head with `mission` [mission].
        """
        from bayes_inertia.report.page import page_facts, render_page
        from bayes_inertia.report.pictures.figure_file import write_png

        self.claim(content)
        document = self.path / self.claim_file
        if (png := document.with_suffix(".png")).name in self.results:
            write_png(sections[0].pictures[0].figure, png)
        facts = page_facts(
            dict(mission), sha256=self.campaign_sha256, version=__version__, origin=origin(*sources)
        )
        page = render_page(title, sections, facts)
        write_atomically(document.with_suffix(".html"), page)

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
