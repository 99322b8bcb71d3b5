"""Rows and failures of a study: in memory, and in a folder where there is one."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from time import monotonic
from typing import Any

from bayes_inertia.files import make_folder, read_bytes, write_atomically
from bayes_inertia.studies.shard_file import ShardDamageError, as_stored, shard_bytes, shard_rows
from bayes_inertia.studies.work import Row, TaskFailure, Work, WorkResult

LEDGER = "failures.json"
_LEDGER_FORMAT = "bayes-inertia-failures/1"
# Unfinished shards are written at most this often [s]: what a kill may cost.
_SAVE_EVERY = 5.0


class Store:
    """What a study has so far. Only the driver writes it, a shard at a time, each file whole.

    Parameters
    ----------
    work : Work
        The tasks.
    folder : Path or None
        Where shards and the ledger of failures are; None keeps everything in memory.
    """

    def __init__(self, work: Work, folder: Path | None) -> None:
        self._work, self._folder = work, folder
        self._shards = work.shards()
        self._rows: dict[str, dict[str, Row]] = {name: {} for name in self._shards}
        self._failures: dict[str, TaskFailure] = {}
        self._unsaved: set[str] = set()
        self._open = {name: set(tasks) for name, tasks in self._shards.items()}
        self._ledger_unsaved = False
        self._saved_at = monotonic()
        self._damages: list[str] = []
        if folder is not None:
            make_folder(folder)
            self._load(folder)

    @property
    def damages(self) -> tuple[str, ...]:
        """What was wrong with files that were there, in words."""
        return tuple(self._damages)

    def open_tasks(self) -> list[str]:
        """Tasks that have neither a row nor a final failure.

        Returns
        -------
        list of str
            In the order of the work.
        """
        return [task for task in self._work.ids if task in self._open[self._work.shard_of(task)]]

    def add(self, outcome: tuple[str, Row] | TaskFailure) -> None:
        """Take what became of one task.

        Parameters
        ----------
        outcome : (str, mapping) or TaskFailure
            The task with its row, or why it has none.
        """
        if isinstance(outcome, TaskFailure):
            self._failures[outcome.task] = outcome
            self._open[self._work.shard_of(outcome.task)].discard(outcome.task)
            self._ledger_unsaved = True
            return
        task, row = outcome
        name = self._work.shard_of(task)
        self._rows[name][task] = row
        self._open[name].discard(task)
        self._unsaved.add(name)

    def save_due(self) -> None:
        """Write finished shards, and every few seconds the unfinished ones too."""
        if monotonic() - self._saved_at >= _SAVE_EVERY:
            self.save()
            return
        for name in [name for name in self._unsaved if not self._open[name]]:
            self._write(name)

    def save(self) -> None:
        """Write everything that is not on the disk yet."""
        for name in sorted(self._unsaved):
            self._write(name)
        if self._ledger_unsaved and self._folder is not None:
            write_atomically(self._folder / LEDGER, self._ledger())
            self._ledger_unsaved = False
        self._saved_at = monotonic()

    def result(self) -> WorkResult:
        """All rows and failures, in the order of the tasks.

        Returns
        -------
        WorkResult
            What the work gave so far.
        """
        rows: dict[str, dict[str, Any]] = {}
        for content in self._rows.values():
            rows |= {row["task"]: row for row in as_stored(content)}
        return WorkResult(
            tuple(rows[task] for task in self._work.ids if task in rows),
            tuple(self._failures[t] for t in self._work.ids if t in self._failures),
            self.damages,
        )

    def _write(self, name: str) -> None:
        self._unsaved.discard(name)
        if self._folder is not None:
            ordered = dict(sorted(self._rows[name].items(), key=lambda item: _natural(item[0])))
            data = shard_bytes(ordered, study=self._work.digest, name=name)
            write_atomically(self._folder / f"{name}.parquet", data)

    def _ledger(self) -> str:
        failures = [asdict(self._failures[t]) for t in sorted(self._failures, key=_natural)]
        content = {
            "format": _LEDGER_FORMAT,
            "study": self._work.digest,
            "failures": failures,
        }
        return json.dumps(content, indent=1) + "\n"

    def _load(self, folder: Path) -> None:
        for name in self._shards:
            path = folder / f"{name}.parquet"
            if not path.exists():
                continue
            try:
                self._rows[name] = self._checked(name, read_bytes(path))
            except ShardDamageError as damage:
                self._damages.append(f"{path.name} {damage}; its {self._work.name} are done anew")
        if (folder / LEDGER).exists():
            self._load_ledger(folder / LEDGER)
        for name, tasks in self._open.items():
            tasks -= self._rows[name].keys() | self._failures.keys()

    def _checked(self, name: str, data: bytes) -> dict[str, Row]:
        rows: dict[str, Row] = dict(shard_rows(data, study=self._work.digest, name=name))
        if any(self._work.shard_of(task) != name for task in rows):
            raise ShardDamageError("holds tasks of other shards")
        return rows

    def _load_ledger(self, path: Path) -> None:
        """Failures that would come again; the others are tried anew."""
        try:
            content = json.loads(read_bytes(path))
            if content["format"] != _LEDGER_FORMAT or content["study"] != self._work.digest:
                raise ValueError("of another study")
            failures = [TaskFailure(**entry) for entry in content["failures"]]
        except (ValueError, KeyError, TypeError) as error:
            self._damages.append(
                f"{path.name} cannot be used ({error}); failed tasks are tried anew"
            )
            self._ledger_unsaved = True
            return
        wanted = set(self._work.ids)
        self._failures = {f.task: f for f in failures if f.final and f.task in wanted}
        self._ledger_unsaved = len(self._failures) < len(failures)


def _natural(task: str) -> tuple[str, int, str]:
    """Sorts numbered tasks by their numbers, whatever other tasks were asked for with them."""
    group, _, number = task.rpartition("/")
    return (group, len(number), number) if number.isdecimal() else (task, 0, "")
