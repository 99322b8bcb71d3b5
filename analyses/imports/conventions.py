"""Is a wrong convention named, and a right campaign never accused?

    python -m analyses.imports.conventions [--delft ../shared/data/delft]
        [--basilisk ../shared/data/basilisk] [--jobs 2] [--only TEXT] [--work FOLDER]

writes `results/imports/conventions.md` and `conventions.json`. What was stopped goes
on in its work folder. With `--only` only tasks with this text in their name run (such as
"right/throws"); their rows take the place of the same cases. Each wrong convention
of `conventions_wrong.py` is put into campaigns of four kinds, flown and thrown by the package's own
simulator, by another one and by hand; then `doctor` judges campaigns of `conventions_right.py`.
All seeds are fixed. Folders that are absent are left out, and the page says so.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import bayes_inertia
from analyses.engine.timed_process import timed_process
from analyses.imports.conventions_cases import THROWS, Base, Wrong
from analyses.imports.conventions_faults import DIRT
from analyses.imports.conventions_folder import RawCampaign, raw_of, read_raw, write_raw
from analyses.imports.conventions_page import merged, stored_rows, write_page
from analyses.imports.conventions_random import random_craft
from analyses.imports.conventions_right import (
    BASILISK_FOLDERS,
    FLOWN_KINDS,
    THROW_FOLDERS,
    Right,
    as_kind,
    groups,
)
from analyses.imports.conventions_spacecraft import (
    THROWN_BODIES,
    Craft,
    ThrownBody,
    crafts,
    flown,
    thrown,
)
from analyses.imports.conventions_wrong import wrong_conventions
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.errors import CampaignError
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.work import Row, Work

ROOT = Path(__file__).parents[2]
EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
# How often each command is timed as a process.
TIMED = 5
COMMANDS = ("check", "doctor")
RANDOM_SEEDS = range(20, 32)
DIRTY_SEED = 100


def makers_of_bases(
    delft: Path | None, basilisk: Path | None
) -> dict[str, Callable[[], Iterator[Base]]]:
    """The right campaigns that are spoilt, by name: flown and thrown, simulated and real.

    Each is made in the kinds that it can have.
    """
    makers: dict[str, Callable[[], Iterator[Base]]] = {}
    for number, (craft, moving) in enumerate(product(crafts(), (False, True))):
        fixes = "in motion" if moving else "at rest"
        name = f"{craft.name}, fixes {fixes}"
        makers[name] = partial(_flown, name, craft, 100 + number, moving)
    for number, seed in enumerate(RANDOM_SEEDS):
        craft, _ = random_craft(seed)
        makers[craft.name] = partial(_random, number, seed)
    for number, dirt in enumerate(DIRT):
        makers[f"dirty, {dirt}"] = partial(_dirty, number, dirt)
    for name in BASILISK_FOLDERS if basilisk else ():
        makers[f"Basilisk {name}"] = partial(_of_basilisk, basilisk / name)
    for body, seed in product(THROWN_BODIES, (200, 201, 202)):
        makers[f"{body.name}, seed {seed}"] = partial(_thrown, body, seed)
    for name in THROW_FOLDERS if delft else ():
        makers[f"real {name}"] = partial(_really_thrown, delft / name)
    return makers


def _flown(name: str, craft: Craft, seed: int, moving: bool) -> Iterator[Base]:
    """Every other spacecraft with fixes in motion has small effects that nobody mentions."""
    strengths = {"rate_sensor_misalignment": 0.3, "wheel_command_lag": 0.1}
    hidden = strengths if seed % 4 == 3 else None
    raw = raw_of(flown(craft, seed, moving_fixes=moving, strengths=hidden))
    limits = craft.mission.spacecraft.wheels[0].max_torque is not None
    for kind in FLOWN_KINDS:
        yield Base(name, kind, as_kind(raw, kind), moving, limits)


def _random(number: int, seed: int) -> Iterator[Base]:
    """A spacecraft drawn at random, to be spoilt by a third of the wrong conventions."""
    (craft, controller), moving = random_craft(seed), bool(seed % 2)
    raw = raw_of(flown(craft, seed, moving_fixes=moving, controller=controller))
    limits = craft.mission.spacecraft.wheels[0].max_torque is not None
    late = 2.0 * craft.plan.telemetry_period
    for k, kind in enumerate(FLOWN_KINDS):
        share = (number + k) % 3
        yield Base(craft.name, kind, as_kind(raw, kind), moving, limits, late=late, share=share)


def _dirty(number: int, dirt: str) -> Iterator[Base]:
    """A spacecraft drawn at random with dirty telemetry; late streams are left out."""
    seed = DIRTY_SEED + number
    (craft, controller), moving = random_craft(seed), bool(seed % 2)
    raw = raw_of(flown(craft, seed, moving_fixes=moving, controller=controller))
    limits = craft.mission.spacecraft.wheels[0].max_torque is not None
    for k, kind in enumerate(FLOWN_KINDS):
        share, rng = (number + k) % 3, np.random.default_rng([seed, 5])
        spoilt = DIRT[dirt](as_kind(raw, kind), rng)
        yield Base(f"dirty, {dirt}", kind, spoilt, moving, limits, late=0.0, share=share)


def _of_basilisk(folder: Path) -> Iterator[Base]:
    for kind in FLOWN_KINDS:
        yield Base(f"Basilisk {folder.name}", kind, as_kind(read_raw(folder), kind))


def _thrown(body: ThrownBody, seed: int) -> Iterator[Base]:
    yield Base(f"{body.name}, seed {seed}", THROWS, raw_of(thrown(body, seed)))


def _really_thrown(folder: Path) -> Iterator[Base]:
    moments_differ = folder.name != "proof_body"
    yield Base(f"real {folder.name}", THROWS, read_raw(folder), moments_differ=moments_differ)


def judged(raw: RawCampaign, folder: Path) -> dict[str, Any]:
    """What the doctor says of a campaign, and the processor time that it took [s]."""
    write_raw(raw, folder)
    begun = time.process_time()
    try:
        answer = check_conventions(folder).json()
    except CampaignError as error:
        answer = {"verdict": "refused", "changes": [], "error": str(error)}
    except Exception as error:
        answer = {"verdict": "crashed", "changes": [], "error": repr(error)}
    return answer | {"seconds": round(time.process_time() - begun, 3)}


def proposed(changes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The changes that belong to the first proposal."""
    return [c for c in changes if c.get("proposal", 1) == changes[0].get("proposal", 1)]


def wrong_row(base: Base, wrong: Wrong, answer: dict[str, Any]) -> dict[str, Any]:
    """What became of one wrong convention.

    `named`: the first change is one that mends it, with its value. `alone`: no other key beside
    it, but where the convention is wrong in several.
    """
    changes = proposed(answer["changes"])
    fitting = [mend for mend in wrong.mends if mend.fits(changes)] if changes else []
    return {
        "part": "wrong",
        "convention": wrong.name,
        "kind": base.kind,
        "campaign": base.name,
        "shown": wrong.shown,
        "why": wrong.why,
        "verdict": answer["verdict"],
        "error": answer.get("error", ""),
        "key_named": bool(changes) and any(mend.names(changes) for mend in wrong.mends),
        "named": bool(fitting),
        "alone": any(mend.needs > 1 or len(changes) <= wrong.keys for mend in fitting),
        "changes": [{"key": c["key"], "to": c["to"]} for c in changes],
        "seconds": answer["seconds"],
        "worst_misfit": round(max(answer.get("misfits", {}).values(), default=0.0), 3),
    }


@dataclass(frozen=True)
class JudgedCampaigns:
    """The task: all cases of one campaign, group or command. Ids are "wrong/<campaign>",
    "right/<group>" and "time/<command>".

    `delft` and `basilisk` say where telemetry of others lies; None leaves it out.
    """

    delft: Path | None
    basilisk: Path | None

    def ids(self) -> tuple[str, ...]:
        """All tasks."""
        wrong = makers_of_bases(self.delft, self.basilisk)
        right = groups(self.delft, self.basilisk)
        parts: dict[str, Iterable[str]] = {"wrong": wrong, "right": right, "time": COMMANDS}
        return tuple(f"{part}/{name}" for part, names in parts.items() for name in names)

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Its rows as one; every case has a seed of its own."""
        part, _, name = task_id.partition("/")
        made = {"wrong": self._wrong, "right": self._right, "time": time_rows}[part]
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            rows = list(made(name, Path(folder)))
        rows.append({"part": "cost", "piece": task_id, "seconds": time.process_time() - begun})
        for row in rows:
            _say(row)
        return {"lines": json.dumps([row | {"version": _version()} for row in rows])}

    def _wrong(self, name: str, folder: Path) -> Iterator[dict[str, Any]]:
        """Every wrong convention in a campaign that has what it is about."""
        for number, base in enumerate(makers_of_bases(self.delft, self.basilisk)[name]()):
            rng = np.random.default_rng([zlib.crc32(f"{base.name}, {base.kind}".encode()), 7])
            for k, wrong in enumerate(wrong_conventions(base, rng)):
                yield wrong_row(base, wrong, judged(wrong.raw, folder / f"{number}_{k}"))

    def _right(self, name: str, folder: Path) -> Iterator[dict[str, Any]]:
        """Every right campaign of a group."""
        for number, right in enumerate(groups(self.delft, self.basilisk)[name]()):
            yield right_row(right, judged(right.raw, folder / str(number)))


def right_row(right: Right, answer: dict[str, Any]) -> dict[str, Any]:
    """What the doctor says of a right campaign."""
    changes = proposed(answer["changes"]) if answer["changes"] else []
    return {
        "part": "right",
        "group": right.group,
        "kind": right.kind,
        "campaign": right.name,
        "verdict": answer["verdict"],
        "error": answer.get("error", ""),
        "changes": [{"key": c["key"], "to": c["to"]} for c in changes],
        "seconds": answer["seconds"],
        "worst_misfit": round(max(answer.get("misfits", {}).values(), default=0.0), 3),
    }


def time_rows(command: str, folder: Path) -> Iterator[dict[str, Any]]:
    """Processor time of a command as a process, on the example campaign of five slews."""
    for number in range(TIMED):
        call = f"from bayes_inertia.app.cli import main; main(['{command}', {str(EXAMPLE)!r}])"
        done = timed_process([call])
        yield {
            "part": "time",
            "command": command,
            "number": number,
            "exit": done.exit_code,
            "seconds": done.processor_seconds,
        }


def main() -> None:
    """Run the study, or a piece of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--delft", type=Path, default=ROOT.parent / "shared/data/delft")
    parser.add_argument("--basilisk", type=Path, default=ROOT.parent / "shared/data/basilisk")
    parser.add_argument("--only", default="", help="only tasks with this text in their name")
    parser.add_argument("--jobs", type=int, default=1, help="worker processes")
    parser.add_argument("--work", type=Path, help="folder in which a stopped study goes on")
    given = parser.parse_args()
    delft, basilisk = (p if p.is_dir() else None for p in (given.delft, given.basilisk))
    for path, name in ((delft, "thrown bodies"), (basilisk, "the other simulator")):
        if path is None:
            print(f"no telemetry of {name}: left out", file=sys.stderr)
    task = JudgedCampaigns(delft, basilisk)
    ids = tuple(task_id for task_id in task.ids() if given.only in task_id)
    work = Work("campaigns", task, ids, options={"version": _version()})
    result = Execution(jobs=given.jobs, notice=print).run(work, given.work)
    rows = [row for made in result.rows for row in json.loads(made["lines"])]
    write_page(merged(stored_rows(), rows) if given.only else rows)


def _version() -> str:
    """The commit that is measured; empty where there is none."""
    call = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    return subprocess.run(call, capture_output=True, text=True, check=False).stdout.strip()


def _say(row: dict[str, Any]) -> None:
    """One line a row on standard output; what failed is marked."""
    if row["part"] == "cost":
        return
    if row["part"] == "time":
        print(f"{row['command']}: exit {row['exit']}, {row['seconds']:.2f} s")
        return
    what = row.get("convention", row.get("group"))
    wanted = row["part"] == "wrong" and row["shown"]
    good = row["named"] if wanted else row["verdict"] == "consistent"
    changes = "; ".join(f"{c['key']} -> {c['to']}" for c in row["changes"])
    mark = "ok " if good else "BAD"
    print(
        f"{mark} {what} | {row['kind']} | {row['campaign']} | {row['verdict']} | {changes} | "
        f"misfit {row['worst_misfit']:.2f} | {row['seconds']:.2f} s",
        flush=True,
    )


if __name__ == "__main__":
    main()
