"""A hundred random distortions of raw logs: what import, doctor and fit make of them.

    python analyses/import_distortions.py [--seed 41] [--count 100] [--out FILE.jsonl]
    python analyses/import_distortions.py --page

Each case distorts the raw logs of the example campaign once or twice, at random. Then the commands
run as a user runs them: `import RAW --start` with its questions answered, or `import --using` with
the mapping that a user writes, who may not know of the distortion; then `doctor`; then what `fit`
does, without sampling. Each case is a line of `results/import_distortions.jsonl`; cases that have
one are not run again. --page writes `results/import_distortions.md`.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import io
import json
import re
import signal
import tempfile
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from dirt_pipeline import NAMES, PERFECT
from import_distortions_files import CLOCKS, FILES
from import_distortions_log import RawLog, answered, example_log, mapping_text
from import_distortions_page import write_page
from import_distortions_readings import READINGS
from import_formats import EXAMPLE

from bayes_inertia.app.cli import main as command
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import clean_fit
from bayes_inertia.inference.gates import check_gates
from bayes_inertia.physics.forward_model import Model

RESULTS = Path(__file__).parent / "results" / "import_distortions.jsonl"
KINDS = READINGS | CLOCKS | FILES
_SECOND = 0.35  # Share of the cases with two distortions.
_STARTED = 0.5  # Share of those with other clocks and files whose mapping `--start` proposes.
_NOT_STARTED = ("no time column", "wrong clock")
_LIMIT_S = 120  # For one case.
_COLUMNS = (
    {
        "rate": ("wx_radps", "wy_radps", "wz_radps"),
        "wheel_torque": ("u1_Nm", "u2_Nm", "u3_Nm"),
        "wheel_momentum": ("h1_Nms", "h2_Nms", "h3_Nms"),
        "attitude": ("q1", "q2", "q3", "q4"),
    },
    {
        "rate": ("gyro_x", "gyro_y", "gyro_z"),
        "wheel_torque": ("rw1_torque", "rw2_torque", "rw3_torque"),
        "wheel_momentum": ("rw1_momentum", "rw2_momentum", "rw3_momentum"),
        "attitude": ("q_x", "q_y", "q_z", "q_w"),
    },
    {
        "rate": ("omega_x", "omega_y", "omega_z"),
        "wheel_torque": ("wheel_torque_x", "wheel_torque_y", "wheel_torque_z"),
        "wheel_momentum": ("wheel_momentum_x", "wheel_momentum_y", "wheel_momentum_z"),
        "attitude": ("quat_x", "quat_y", "quat_z", "quat_w"),
    },
)


@dataclass(frozen=True)
class Ran:
    """What a command did: exit code (1 with a traceback), and what it printed."""

    code: int
    said: str
    error: str


def distorted(seed: int, case: int) -> tuple[RawLog, list[str], list[str]]:
    """The log of a case, its kinds of distortion, and their parameters."""
    turn, place = divmod(case, len(KINDS))
    names = np.random.default_rng([seed, turn]).permutation(list(KINDS)).tolist()
    rng = np.random.default_rng([seed, turn, place])
    first, kinds = names[place], [names[place]]
    if rng.random() < _SECOND:
        others = [name for name in READINGS if name != first]
        kinds.insert(0, others[int(rng.integers(len(others)))])
    log, words = example_log(), []
    alone = len(kinds) == 1
    if first not in READINGS and first not in _NOT_STARTED and rng.random() < _STARTED:
        columns = _COLUMNS[int(rng.integers(0 if alone else 1, len(_COLUMNS)))]
        for holds, called in columns.items():
            log = log.changed(holds, names=called)
        log = replace(log, started=True)
    for kind in kinds:
        log, parameters = KINDS[kind](log, rng)
        words.append(parameters)
    return log, kinds, words


def run(*words: str | Path) -> Ran:
    """A command in this process."""
    said, error = io.StringIO(), io.StringIO()
    code = 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(error):
        try:
            command([str(word) for word in words])
        except SystemExit as ended:
            code = int(ended.code or 0)
        except Exception:
            code = 1
            traceback.print_exc()
    return Ran(code, said.getvalue(), error.getvalue())


@contextlib.contextmanager
def held_by_writer(files: list[Path], held: bool) -> Iterator[None]:
    """Files that their writer has locked, as HDF5 does."""
    with contextlib.ExitStack() as stack:
        for file in files if held else ():
            fcntl.flock(stack.enter_context(file.open("rb")), fcntl.LOCK_EX)
        yield


def row_of(seed: int, case: int, clean: dict[str, float]) -> dict[str, Any]:
    """What becomes of a case."""
    log, kinds, words = distorted(seed, case)
    row: dict[str, Any] = {"case": case, "kinds": kinds, "parameters": words}
    row["started"] = log.started
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "raw"
        folder.mkdir()
        files, entries = log.write(log, folder)
        with held_by_writer(files, log.locked):
            row |= _imported(log, files, entries, folder)
        if row["status"] == "imported":
            row |= _lost(log, folder / "C", clean, row.pop("said"))
            row |= _judged(folder / "C")
    return json.loads(json.dumps(row).replace(f"{folder}/", ""))


def _imported(log: RawLog, files: list[Path], entries: dict, folder: Path) -> dict[str, Any]:
    """By `import`, its mapping proposed or written."""
    mapping = folder / "mapping.toml"
    if log.started:
        started = run("import", *files, "--start", mapping)
        if started.code:
            return _refused("start", started)
        text = mapping.read_text(encoding="utf-8")
        missing = [s.names[0] for s in log.streams.values() if f'"{s.names[0]}"' not in text]
        if missing:
            message = f"not recognised: {', '.join(missing)}"
            return {"status": "not recognised", "message": message, "traceback": False}
        mapping.write_text(answered(text, log, entries), encoding="utf-8")
    else:
        mapping.write_text(mapping_text(log, entries), encoding="utf-8")
    done = run("import", *files, "--using", mapping, "-o", folder / "C")
    if done.code:
        return _refused("import", done)
    return {"status": "imported", "message": "", "traceback": False, "said": done.said}


def _refused(by: str, ran: Ran) -> dict[str, Any]:
    message = " ".join(ran.error.strip().splitlines()[-1:] if ran.code == 1 else ran.error.split())
    return {"status": f"refused by {by}", "message": message, "traceback": ran.code == 1}


def rows_in(folder: Path) -> dict[str, int]:
    """Rows with a reading in the tables of an imported campaign, by stream."""
    suffixes = {"rate": "rate", "torque": "wheel_torque", "momentum": "wheel_momentum"}
    suffixes |= {"speed": "wheel_momentum", "tracker": "attitude"}
    rows: dict[str, int] = {}
    for file in folder.glob("slew_*.csv"):
        lines = file.read_text(encoding="utf-8").splitlines()[1:]
        holds = suffixes[file.stem.rpartition("_")[2]]
        full = sum(any(line.split(",")[1:]) for line in lines)
        rows[holds] = rows.get(holds, 0) + full
    return rows


def _lost(log: RawLog, folder: Path, clean: dict[str, float], said: str) -> dict[str, Any]:
    """Share of the readings of each stream that the campaign lacks, and what the import says."""
    rows = rows_in(folder)
    lost = {
        holds: round(1.0 - rows.get(holds, 0) / max(stream.readings, 1) / clean.get(holds, 1.0), 3)
        for holds, stream in log.streams.items()
    }
    lines = [line for line in said.splitlines() if line and line[0] not in "┏┃┡│└"]
    skipped = ("times count", "written", "next", "  rate_sensor.", "  wheels.", "  star_tracker.")
    notes = [line.strip() for line in lines if not line.startswith(skipped)]
    notes = [note for note in notes if not note[0].isdigit()]
    return {"lost": lost, "notes": notes}


def _judged(folder: Path) -> dict[str, Any]:
    """By `doctor`, and by what `fit` does."""
    doctor = run("doctor", folder)
    words = {0: "agrees", 3: "doubtful", 2: "wrong"}
    row: dict[str, Any] = {
        "doctor": words.get(doctor.code, "failed"),
        "traceback": doctor.code == 1,
    }
    said = re.split(r"telemetry:|this campaign cannot show|the folder was imported", doctor.said)[0]
    row["message"] = " ".join((said or doctor.error).split())
    if doctor.code not in (0, 3):
        return row
    try:
        return row | _fitted(folder)
    except BayesInertiaError as error:
        return row | {"fit": "refused", "gates": [str(error)]}
    except Exception as error:
        return row | {"fit": "failed", "traceback": True, "gates": [repr(error)]}


def _fitted(folder: Path) -> dict[str, Any]:
    """By the Laplace estimate with all gates but that of the chains."""
    estimate = clean_fit(optimizer.estimate(Model(read_campaign(folder)))).estimate
    failed = [gate["says"] for gate in check_gates(estimate, PERFECT) if not gate["passed"]]
    quoted = quoted_parameters(estimate)
    off = (np.asarray(quoted.mean) - truth()) / np.asarray(quoted.sd)
    worst = int(np.argmax(np.abs(off)))
    said = {"fit": "not trusted" if failed else "trusted", "gates": failed}
    return said | {"parameter": NAMES[worst], "off": round(float(abs(off[worst])), 2)}


def truth() -> np.ndarray:
    """J and K (9,) of the example."""
    told = json.loads((EXAMPLE / "truth.json").read_text(encoding="utf-8"))
    J = np.array(told["J_kgm2"])
    return np.concatenate([np.diag(J), J[[0, 0, 1], [1, 2, 2]], told["K"]])


def clean_shares() -> dict[str, float]:
    """Share of the readings of each stream that an import of the undistorted log keeps."""
    log = example_log()
    with tempfile.TemporaryDirectory() as name:
        files, entries = log.write(log, Path(name))
        said = _imported(log, files, entries, Path(name))
        if said["status"] != "imported":
            raise RuntimeError(said["message"])
        rows = rows_in(Path(name) / "C")
    return {holds: rows[holds] / stream.readings for holds, stream in log.streams.items()}


def _limited(seed: int, case: int, clean: dict[str, float]) -> dict[str, Any]:
    """A case, ended after the limit."""

    def end(*_: Any) -> None:
        raise TimeoutError(f"no end after {_LIMIT_S} s")

    signal.signal(signal.SIGALRM, end)
    signal.alarm(_LIMIT_S)
    try:
        return row_of(seed, case, clean)
    except TimeoutError as error:
        _, kinds, words = distorted(seed, case)
        told = {"case": case, "kinds": kinds, "parameters": words, "started": False}
        return told | {"status": "no end", "message": str(error), "traceback": True}
    finally:
        signal.alarm(0)


def main() -> None:
    """Run the cases that have no line yet, or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int, default=41)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--only", type=int, nargs="*", help="these cases, shown and not kept")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--page", action="store_true")
    given = parser.parse_args()
    if given.page:
        write_page(given.out, given.seed)
        return
    clean = clean_shares()
    if given.only:
        for case in given.only:
            print(json.dumps(_limited(given.seed, case, clean), indent=1))
        return
    lines = given.out.read_text(encoding="utf-8").splitlines() if given.out.exists() else []
    done = {json.loads(line)["case"] for line in lines}
    for case in range(given.count):
        if case in done:
            continue
        row = _limited(given.seed, case, clean)
        with given.out.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")
        print(case, row["kinds"], row["status"], row.get("doctor"), row.get("fit"), flush=True)


if __name__ == "__main__":
    main()
