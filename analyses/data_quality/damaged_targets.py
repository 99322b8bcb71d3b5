"""The sound files that the fault study damages, and the commands that read them.

The corpus is made from the example campaign: two slews of a hundred rows in each format, and the
folder that `diagnose` writes of them. The same commit makes the same corpus.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import pickle
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np

import bayes_inertia
from analyses.data_quality.damage import (
    KINDS,
    Random,
    mutated_bytes,
    mutated_columns,
    mutated_header,
    mutated_json,
    mutated_lines,
    mutated_tokens,
)
from analyses.data_quality.damaged_formats import WRITERS, csv_bytes
from bayes_inertia.app.cli import main
from bayes_inertia.campaign.reader import read_unmasked
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.sealing import SEAL_KEY
from bayes_inertia.tables import isolated

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
SLEWS, ROWS = 2, 100
TABLES = ("csv", "toml", "parquet", "hdf5", "mat", "mat 7.3")
RUN_FILES = ("run.json", "chain", "posterior.nc", "diagnosis.json", "plan.toml")
_SUFFIXES = {"parquet": ".parquet", "hdf5": ".h5", "mat": ".mat", "mat 7.3": ".73.mat"}
# Of binary files, one in so many goes through the child process itself and not through a fork.
_TRUE_CHILDREN = 100
# Of files of a run that are accepted, one in so many is made a whole report or flight.
_WHOLE_COMMANDS = 100


@dataclass(frozen=True)
class Case:
    """One damaged file: what it is, and how it was damaged."""

    target: str
    kind: str
    content: bytes


def make_campaign(folder: Path) -> None:
    """Write the sound campaign, once."""
    if not (folder / "campaign").exists():
        flown = read_unmasked(EXAMPLE)
        slews = tuple(_first_rows(slew) for slew in flown.slews[:SLEWS])
        write_campaign(replace(flown, slews=slews, dirt=()), folder / "campaign")


def make_corpus(folder: Path) -> None:
    """Write the sound campaign and its run, once; the run takes a minute or two."""
    campaign = folder / "campaign"
    make_campaign(folder)
    if not (folder / "run" / "report.html").exists():
        with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
            main(["diagnose", str(campaign), "-o", str(folder / "run"), "--anyway"])
    if not (folder / "plan.toml").exists():
        from bayes_inertia.flight.plan import paper_like_plan
        from bayes_inertia.flight.plan_file import write_plan

        write_plan(paper_like_plan(), folder / "plan.toml")


def _first_rows(slew):
    names = ("time", "rate", "attitude", "wheel_torque", "wheel_momentum", "magnetic_field_N")
    names += ("position_N",)
    values = {name: getattr(slew, name, None) for name in names}
    return replace(slew, **{name: v[:ROWS] for name, v in values.items() if v is not None})


def draw_case(corpus: Path, targets: tuple[str, ...], random: Random) -> Case:
    """A damaged file of one of these targets."""
    target, kind = str(random.choice(targets)), str(random.choice(KINDS))
    if target in _SUFFIXES:
        return Case(target, kind, _binary_table(corpus, target, kind, random))
    data = _sound_text(corpus, target, random)
    if target in ("chain", "posterior.nc"):
        content = mutated_bytes(data, random) if kind == "bytes" else mutated_header(data, random)
    elif kind == "bytes":
        content = mutated_bytes(data, random)
    elif kind == "tokens":
        content = mutated_tokens(data, random)
    elif target == "csv" and random.random() < 0.5:
        content = mutated_columns(data, random)
    elif target.endswith(".json"):
        content = mutated_json(data, random)
    else:
        content = mutated_lines(data, random)
    return Case(target, kind, content)


def _sound_text(corpus: Path, target: str, random: Random) -> bytes:
    """The content of a sound file; of half the files of a run without its seal."""
    run = corpus / "run"
    places = {
        "csv": corpus / "campaign" / "slew_01.csv",
        "toml": corpus / "campaign" / "campaign.toml",
        "plan.toml": corpus / "plan.toml",
        "chain": run / "chains" / "ensemble_0.h5",
    }
    data = places.get(target, run / target).read_bytes()
    if target in ("chain", "posterior.nc") and random.random() < 0.5:
        return data[: data.rindex(b"\nbayes-inertia sha256")]
    if target.endswith(".json") and random.random() < 0.5:
        document = json.loads(data)
        document.pop(SEAL_KEY)
        return json.dumps(document).encode()
    return data


def _binary_table(corpus: Path, target: str, kind: str, random: Random) -> bytes:
    write, columns = WRITERS[_SUFFIXES[target]], sound_columns(corpus)
    if kind == "structure":
        made = write(columns, random)
        return mutated_bytes(made, random) if random.random() < 0.2 else made
    sound = write(columns)
    return mutated_bytes(sound, random) if kind == "bytes" else mutated_header(sound, random)


def sound_columns(corpus: Path) -> dict[str, np.ndarray]:
    """The columns of the first slew's table."""
    header, *lines = (corpus / "campaign" / "slew_01.csv").read_text().splitlines()
    rows = [[float(cell or "nan") for cell in line.split(",")] for line in lines]
    return dict(zip(header.split(","), np.array(rows).T, strict=True))


def place_case(case: Case, corpus: Path, folder: Path) -> Path:
    """Write a damaged campaign, or a damaged file of a run; what the command is given."""
    if case.target not in TABLES:
        path = folder / ("chain.h5" if case.target == "chain" else case.target)
        path.write_bytes(case.content)
        return path
    toml = (corpus / "campaign" / "campaign.toml").read_text()
    table, suffix = "slew_01.csv", _SUFFIXES.get(case.target)
    if suffix is not None:
        table = f"slew_01.{suffix.rsplit('.', 1)[1]}"
        toml = toml.replace("slew_01.csv", table)
    is_toml = case.target == "toml"
    (folder / "campaign.toml").write_bytes(case.content if is_toml else toml.encode())
    sound = csv_bytes(sound_columns(corpus))
    (folder / table).write_bytes(sound if is_toml else case.content)
    second = (corpus / "campaign" / "slew_02.csv").read_bytes()
    (folder / "slew_02.csv").write_bytes(second)
    return folder


def command_of(case: Case, given: Path, corpus: Path, random: Random) -> Callable[[], None]:
    """What reads the file, as a command; it ends with SystemExit."""
    whole = random.random() < 1.0 / _WHOLE_COMMANDS
    if case.target in TABLES:
        # Holding conventions against physics takes ten times longer than reading.
        words = (["check", "--anyway"], ["check"], ["doctor", "--json"])
        chosen = words[int(random.choice(3, p=[0.7, 0.2, 0.1]))]
        return lambda: main([*chosen, str(given)])
    if case.target == "plan.toml" and whole:
        return lambda: main(["simulate", "--plan", str(given), "-o", str(given.parent / "flown")])
    if case.target in ("posterior.nc", "diagnosis.json") and whole:
        posterior = given.parent / "posterior.nc"
        if case.target == "diagnosis.json":
            posterior.write_bytes((corpus / "run" / "posterior.nc").read_bytes())
        return lambda: main(["report", str(given.parent)])
    return lambda: _as_command(case.target, given)


def _as_command(target: str, path: Path) -> None:
    """Read a file of a run as its command does first, and end as the command would."""
    from bayes_inertia.app import cli

    def read() -> None:
        _READERS[target](path)

    # The command line's own handling of errors.
    before = cli.COMMANDS["demo"]
    cli.COMMANDS["demo"] = read
    try:
        main(["demo"])
    finally:
        cli.COMMANDS["demo"] = before


def _read_run(path: Path) -> None:
    from bayes_inertia.app.run_folder import effects_of_run, read_run

    run = read_run(path.parent)
    effects_of_run(path.parent, run)
    run.owner(path.parent).holds_this_work()


def _read_chain(path: Path) -> None:
    from bayes_inertia.inference.sampler import load_chain

    load_chain(path, 64, 9)


def _read_posterior(path: Path) -> None:
    from bayes_inertia.inference.posterior import Posterior

    Posterior.load(path).summary()


def _read_diagnosis(path: Path) -> None:
    from bayes_inertia.app.commands.runs import show_diagnosis
    from bayes_inertia.app.diagnosis_json import blaming_diagnosis, next_fit_from, read_diagnosis

    content = read_diagnosis(path.parent) or {}
    with blaming_diagnosis(path.parent, content):
        next_fit_from(content)
        show_diagnosis(content)


def _read_plan(path: Path) -> None:
    from bayes_inertia.flight.plan_file import read_plan

    read_plan(path)


_READERS = {
    "run.json": _read_run,
    "chain": _read_chain,
    "posterior.nc": _read_posterior,
    "diagnosis.json": _read_diagnosis,
    "plan.toml": _read_plan,
}


class ForkedChildren:
    """Stands for `subprocess` where arrays are read: the child is a fork, with the same limits."""

    TimeoutExpired = subprocess.TimeoutExpired

    def __init__(self) -> None:
        self.count = 0

    def run(self, command: list[str], **options) -> subprocess.CompletedProcess:
        """Run the reader of arrays in a fork, or now and then in a process of its own."""
        self.count += 1
        if self.count % _TRUE_CHILDREN == 0:
            return subprocess.run(command, **options)
        words = command[command.index("-m") + 2 :]
        with tempfile.TemporaryFile() as said:
            child = os.fork()
            if child == 0:
                _end_as_child(words, said)
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            said.seek(0)
            return subprocess.CompletedProcess(command, status, said.read(), b"")


def _end_as_child(words: list[str], output: IO[bytes]) -> None:
    code = 1
    with contextlib.suppress(BaseException):
        pickle.dump(isolated.answer(*words), output)
        output.flush()
        code = 0
    os._exit(code)


@contextlib.contextmanager
def forked_children() -> Iterator[None]:
    """Read arrays in forks: their libraries are loaded once for all cases."""
    for kind in ("hdf5", "netcdf", "mat", "check", "check_tree"):
        isolated.load_libraries(kind)
    before = isolated.subprocess
    isolated.subprocess = ForkedChildren()
    try:
        yield
    finally:
        isolated.subprocess = before
