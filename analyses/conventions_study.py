"""Is a wrong convention named, and a right campaign never accused?

    python analyses/conventions_study.py [--delft ../shared/data/delft]
        [--basilisk ../shared/data/basilisk] [--part wrong|right|time] [--only TEXT]

writes `analyses/results/conventions_study.md` and `conventions_study.json`. Each wrong convention
of `conventions_wrong.py` is put into campaigns of four kinds, flown and thrown by the package's own
simulator, by another one and by hand; then `doctor` judges campaigns of `conventions_right.py`.
All seeds are fixed. Folders that are absent are left out, and the page says so.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from conventions_cases import THROWS, Base, Wrong
from conventions_folder import RawCampaign, raw_of, read_raw, write_raw
from conventions_page import page
from conventions_right import (
    BASILISK_FOLDERS,
    FLOWN_KINDS,
    THROW_FOLDERS,
    as_kind,
    right_campaigns,
)
from conventions_spacecraft import THROWN_BODIES, crafts, flown, thrown
from conventions_wrong import wrong_conventions

import bayes_inertia
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.errors import CampaignError
from bayes_inertia.files import write_atomically

HERE = Path(__file__).parent
EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
# How often each command is timed as a process.
TIMED = 5


def bases(delft: Path | None, basilisk: Path | None) -> Iterator[Base]:
    """The right campaigns that are spoilt: of each kind, flown and thrown, simulated and real."""
    for number, (craft, moving) in enumerate(product(crafts(), (False, True))):
        strengths = {"rate_sensor_misalignment": 0.3, "wheel_command_lag": 0.1}
        hidden = strengths if number % 4 == 3 else None
        campaign = flown(craft, 100 + number, moving_fixes=moving, strengths=hidden)
        limits = craft.mission.spacecraft.wheels[0].max_torque is not None
        for kind in FLOWN_KINDS:
            raw = as_kind(raw_of(campaign), kind)
            fixes = "in motion" if moving else "at rest"
            yield Base(f"{craft.name}, fixes {fixes}", kind, raw, moving, limits)
    for name, kind in product(BASILISK_FOLDERS if basilisk else (), FLOWN_KINDS):
        yield Base(f"Basilisk {name}", kind, as_kind(read_raw(basilisk / name), kind))
    for body, seed in product(THROWN_BODIES, (200, 201, 202)):
        yield Base(f"{body.name}, seed {seed}", THROWS, raw_of(thrown(body, seed)))
    for name in THROW_FOLDERS if delft else ():
        moments_differ = name != "proof_body"
        raw = read_raw(delft / name)
        yield Base(f"real {name}", THROWS, raw, moments_differ=moments_differ)


def judged(raw: RawCampaign, folder: Path) -> dict[str, Any]:
    """What the doctor says of a campaign, and the processor time that it took [s]."""
    write_raw(raw, folder)
    begun = time.process_time()
    try:
        answer = check_conventions(folder).json()
    except CampaignError as error:
        answer = {"verdict": "refused", "changes": [], "sentence": str(error)}
    except Exception as error:
        answer = {"verdict": "crashed", "changes": [], "sentence": repr(error)}
    return answer | {"seconds": time.process_time() - begun}


def proposed(changes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The changes that belong to the first proposal."""
    return [c for c in changes if c.get("proposal", 1) == changes[0].get("proposal", 1)]


def wrong_row(base: Base, wrong: Wrong, answer: dict[str, Any]) -> dict[str, Any]:
    """What became of one wrong convention.

    `named`: the first change is one that mends it, with its value. `alone`: no other beside it,
    where one is enough.
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
        "key_named": bool(changes) and any(mend.names(changes) for mend in wrong.mends),
        "named": bool(fitting),
        "alone": any(mend.needs > 1 or len(changes) == 1 for mend in fitting),
        "changes": [{"key": c["key"], "to": c["to"]} for c in changes],
        "seconds": answer["seconds"],
        "sentence": answer.get("sentence", ""),
    }


@dataclass(frozen=True)
class Options:
    """Where data of others lie, what is to be done, and where folders are written for a moment."""

    delft: Path | None
    basilisk: Path | None
    only: str
    folder: Path


def wrong_rows(options: Options) -> Iterator[dict[str, Any]]:
    """Every wrong convention in every campaign that has what it is about."""
    for number, base in enumerate(bases(options.delft, options.basilisk)):
        rng = np.random.default_rng([number, 7])
        for k, wrong in enumerate(wrong_conventions(base, rng)):
            if options.only not in f"{wrong.name} | {base.kind} | {base.name}":
                continue
            answer = judged(wrong.raw, options.folder / f"wrong_{number}_{k}")
            yield wrong_row(base, wrong, answer)


def right_rows(options: Options) -> Iterator[dict[str, Any]]:
    """Every right campaign."""
    for number, right in enumerate(right_campaigns(options.delft, options.basilisk)):
        if options.only not in f"{right.group} | {right.kind} | {right.name}":
            continue
        answer = judged(right.raw, options.folder / f"right_{number}")
        changes = proposed(answer["changes"]) if answer["changes"] else []
        yield {
            "part": "right",
            "group": right.group,
            "kind": right.kind,
            "campaign": right.name,
            "verdict": answer["verdict"],
            "changes": [{"key": c["key"], "to": c["to"]} for c in changes],
            "seconds": answer["seconds"],
            "sentence": answer.get("sentence", ""),
        }


def time_rows(options: Options) -> Iterator[dict[str, Any]]:
    """Processor time of the commands as processes, on the example campaign of five slews."""
    for command in ("check", "doctor"):
        for _ in range(TIMED):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            call = f"from bayes_inertia.app.cli import main; main(['{command}', {str(EXAMPLE)!r}])"
            done = subprocess.run([sys.executable, "-c", call], capture_output=True, check=False)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            yield {
                "part": "time",
                "command": command,
                "exit": done.returncode,
                "seconds": seconds,
            }


PARTS = {"wrong": wrong_rows, "right": right_rows, "time": time_rows}


def main() -> None:
    """Run the study, or one part of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--delft", type=Path, default=HERE.parent.parent / "shared/data/delft")
    parser.add_argument(
        "--basilisk", type=Path, default=HERE.parent.parent / "shared/data/basilisk"
    )
    parser.add_argument("--part", choices=PARTS, help="only this part; nothing is written")
    parser.add_argument("--only", default="", help="only rows that contain this text")
    parser.add_argument("--keep", type=Path, help="keep the campaign folders here")
    given = parser.parse_args()
    delft, basilisk = (p if p.is_dir() else None for p in (given.delft, given.basilisk))
    for path, name in ((delft, "thrown bodies"), (basilisk, "the other simulator")):
        if path is None:
            print(f"no telemetry of {name}: left out", file=sys.stderr)
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        options = Options(delft, basilisk, given.only, given.keep or Path(temporary))
        for part in [given.part] if given.part else PARTS:
            for row in PARTS[part](options):
                rows.append(row)
                _say(row)
    if given.part or given.only:
        return
    missing = [name for name, path in (("delft", delft), ("basilisk", basilisk)) if path is None]
    results = HERE / "results"
    text = "".join(json.dumps(row) + "\n" for row in rows)
    write_atomically(results / "conventions_study.json", f"[{',\n'.join(text.splitlines())}]\n")
    write_atomically(results / "conventions_study.md", page(rows, missing, time.process_time()))


def _say(row: dict[str, Any]) -> None:
    """One line a row on standard output; what failed is marked."""
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
        f"{row['seconds']:.2f} s",
        flush=True,
    )


if __name__ == "__main__":
    main()
