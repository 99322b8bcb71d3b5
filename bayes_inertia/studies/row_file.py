"""Rows of a study on the disk: a line of JSON for each task, and a seal on every line.

Only the driver writes. It adds a line as a task ends, so a kill costs nothing that was finished; at
the end the file is written anew, in the order of the tasks.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bayes_inertia.errors import OutputError
from bayes_inertia.files import read_bytes, write_atomically
from bayes_inertia.sealing import SEAL_KEY, sealed, sha256_of
from bayes_inertia.studies.work import Row, TaskFailure, WorkResult

NAME = "rows.jsonl"
Outcome = tuple[str, Row] | TaskFailure


class RowFile:
    """Rows of a study so far, in memory and in a folder (None: in memory alone)."""

    def __init__(self, folder: Path | None, study: str) -> None:
        self._path = None if folder is None else folder / NAME
        self._study = study
        self._outcomes: dict[str, Outcome] = {}
        self._lines: dict[str, bytes] = {}
        self.damages: list[str] = []
        if folder is not None:
            for task, row in _rows_of_0_4(folder, study):
                self._take((task, row))
            self._load(folder / NAME)
            # Without lines that are no use; and a folder that cannot be written is told now.
            self.settle(())

    def __contains__(self, task: str) -> bool:
        """Whether a task has a row, or a failure that would come again."""
        return task in self._outcomes

    def add(self, outcome: Outcome) -> None:
        """Take what became of one task, and put it on the disk."""
        line = self._take(outcome)
        if self._path is None:
            return
        try:
            with self._path.open("ab") as file:
                file.write(line)
        except OSError as error:
            raise OutputError(
                f"cannot be written ({error.strerror or error})",
                where=str(self._path),
                advice="check that the folder is writable and has space",
            ) from error

    def settle(self, ids: Sequence[str]) -> WorkResult:
        """Write all, these tasks first and in their order; give what became of these."""
        ordered = dict.fromkeys((*(task for task in ids if task in self), *self._lines))
        content = b"".join(self._lines[task] for task in ordered)
        if self._path is not None and not (
            self._path.exists() and read_bytes(self._path) == content
        ):
            write_atomically(self._path, content)
        found = [self._outcomes[task] for task in ids if task in self]
        rows = ({"task": o[0], **o[1]} for o in found if not isinstance(o, TaskFailure))
        failures = (o for o in found if isinstance(o, TaskFailure))
        return WorkResult(tuple(rows), tuple(failures), tuple(self.damages))

    def _take(self, outcome: Outcome) -> bytes:
        """Keep an outcome, and give its line."""
        content: dict[str, Any] = {"study_sha256": self._study}
        if isinstance(outcome, TaskFailure):
            task = outcome.task
            content["failure"] = asdict(outcome)
        else:
            task, content["row"] = outcome
        self._lines[task] = json.dumps(sealed({"task": task, **content})).encode() + b"\n"
        self._outcomes[task] = outcome
        return self._lines[task]

    def _load(self, path: Path) -> None:
        """Take every line that is whole and of this study; say of the others, and drop them."""
        damaged = foreign = 0
        for line in read_bytes(path).splitlines() if path.exists() else ():
            try:
                content = json.loads(line)
                intact = content.get(SEAL_KEY) == sealed(content)[SEAL_KEY]
            except (ValueError, AttributeError, RecursionError):
                intact = False
            if not intact:
                damaged += 1
            elif content["study_sha256"] != self._study:
                foreign += 1
            elif "row" in content:
                self._take((content["task"], content["row"]))
            elif (failure := TaskFailure(**content["failure"])).final:
                self._take(failure)
        for count, what in ((damaged, "cut short or changed"), (foreign, "of another study")):
            if count:
                self.damages.append(f"{path.name}: {count} lines are {what}; done anew")


def _rows_of_0_4(folder: Path, study: str) -> Iterator[tuple[str, Row]]:
    """Rows in Parquet files of version 0.4, which hold their SHA-256 with zeros in its place."""
    import pyarrow.parquet as pq

    for path in sorted((*folder.glob("*.parquet"), *folder.glob("shards/*.parquet"))):
        data = read_bytes(path)
        for stated in list(re.finditer(rb"bayes-inertia-sha256:([0-9a-f]{64})", data))[-1:]:
            bare = data[: stated.start(1)] + b"0" * 64 + data[stated.end(1) :]
            if sha256_of(bare).encode() == stated[1]:
                table = pq.read_table(io.BytesIO(data))
                if json.loads(table.schema.metadata[b"bayes_inertia"])["study"] == study:
                    yield from ((row.pop("task"), row) for row in table.to_pylist())
