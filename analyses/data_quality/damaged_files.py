"""Damaged files: does any end a command in a traceback, a hang, or worse?

    python -m analyses.data_quality.damaged_files --cases 100000 --work FOLDER [--seed 0]
        [--minutes 20]

Each case damages one file of a sound campaign or run (bytes, tokens or structure; see
`fault_mutations`), and gives it to a command that reads it. Wanted is a result, or one message
that names the file. A case is drawn from the seed and its own number. Blocks of 250 cases run in
a process of their own and are kept in the work folder: a study that was ended goes on there. It
writes results/data_quality/damaged_files.json, with the digests of all sound files, and its page.
The processor time of a case is 5 to 30 ms.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from importlib import import_module
from pathlib import Path

import numpy as np

from analyses import results_of
from analyses.data_quality.damaged_targets import (
    RUN_FILES,
    TABLES,
    Case,
    command_of,
    draw_case,
    forked_children,
    make_corpus,
    place_case,
)
from bayes_inertia.app import cli
from bayes_inertia.files import write_atomically
from bayes_inertia.version import __version__

RESULTS = results_of(__file__)
BLOCK = 250  # Cases.
_RUN_BLOCKS = 5  # One block in so many holds files of runs, the others campaigns.
_SECONDS = 10.0  # Of processor time that a case may take.
_PATIENCE = 120.0  # [s] on the clock after which a process that does not answer is ended.
# [bytes] of addresses that a case may take beyond what the libraries take. Threads reserve more
# than they use: what is resident at most is told at the end of a block.
_MEMORY = 3 * 2**30
GOOD = ("accepted", "refused")


class Hang(BaseException):
    """A case takes longer than it may."""


def _too_long(*_) -> None:
    raise Hang


def run_case(number: int, seed: int, corpus: Path) -> dict:
    """Draw a case, let its command read it, and judge what came out."""
    random = np.random.default_rng([seed, number])
    block = number // BLOCK
    targets = RUN_FILES if block % _RUN_BLOCKS == 1 else TABLES
    # What draws the damage may warn of the numbers that it makes.
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("ignore")
        case = draw_case(corpus, targets, random)
        given = place_case(case, corpus, Path(folder))
        began = processor_seconds()
        outcome, detail = _outcome(case, given, corpus, random)
        seconds = processor_seconds() - began
    return {
        "case": number,
        "target": case.target,
        "kind": case.kind,
        "outcome": outcome,
        "detail": detail,
        "seconds": round(seconds, 3),
    }


def processor_seconds() -> float:
    """Of this process and the children that ended."""
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(usage.ru_utime + usage.ru_stime for usage in map(resource.getrusage, kinds))


def _outcome(case: Case, given: Path, corpus: Path, random) -> tuple[str, str]:
    said, printed = io.StringIO(), io.StringIO()
    command = command_of(case, given, corpus, random)
    signal.setitimer(signal.ITIMER_PROF, _SECONDS)
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
            warnings.simplefilter("default")
            # Of this study: the readers of binary files are forks.
            warnings.filterwarnings("ignore", message=".*use of fork", category=DeprecationWarning)
            warnings.filterwarnings("ignore", message=".*os.fork", category=RuntimeWarning)
            command()
        return "bad message", "no exit code"
    except SystemExit as ended:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        return _judged(ended.code, said.getvalue(), printed.getvalue(), given)
    except Hang:
        return "hang", "".join(traceback.format_exc(limit=-3))
    except BaseException:
        return "traceback", traceback.format_exc(limit=-4)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _judged(code, said: str, printed: str, given: Path) -> tuple[str, str]:
    """Whether an exit code and the messages beside it are as they should be."""
    if "out of memory" in said:
        return "memory", said
    folder = given if given.is_dir() else given.parent
    strangers = [p.name for p in Path.cwd().iterdir()]
    if strangers:
        return "stray file", ", ".join(strangers)
    if code == 0 or (code == 2 and '"verdict": "wrong"' in printed):
        return ("accepted", "") if not said else ("bad message", said[:2000])
    # What contradicts physics is told in a few lines: the change that would mend it.
    one_line = said.count("\n") == 1 or "data are impossible" in said
    if code == 2 and said.startswith("error: ") and one_line and str(folder) in said:
        return "refused", ""
    return "bad message", f"exit {code}: {said[:2000]}"


def run_block(block: int, seed: int, work: Path, first: int) -> None:
    """The cases of a block from one on, each written as it ends."""
    corpus, rows = (work / "corpus").resolve(), (work / f"block_{block:04d}.jsonl").resolve()
    signal.signal(signal.SIGPROF, _too_long)
    with tempfile.TemporaryDirectory() as empty, rows.open("a") as file, forked_children():
        os.chdir(empty)
        # The command line is built anew for each case, and fourteen commands take their time.
        for name in set(cli.COMMANDS) - {"check", "doctor", "demo", "report", "simulate"}:
            del cli.COMMANDS[name]
        if block % _RUN_BLOCKS == 1:
            import_module("bayes_inertia.app.run_folder")
            import_module("bayes_inertia.flight.simulated_campaigns")
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (taken + _MEMORY, resource.RLIM_INFINITY))
        for number in range(max(first, block * BLOCK), (block + 1) * BLOCK):
            file.write(json.dumps({"case": number, "outcome": "begun"}) + "\n")
            file.flush()
            file.write(json.dumps(run_case(number, seed, corpus)) + "\n")
            file.flush()
        # The system's own peak counts what started this process too: the study, with its corpus.
        status = Path("/proc/self/status").read_text().split()
        peak = int(status[status.index("VmHWM:") + 1])
        children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        end = {"peak_kb": peak, "peak_child_kb": children}
        end["processor_seconds"] = processor_seconds()
        file.write(json.dumps({"end": end}) + "\n")
        os.chdir("/")


def block_rows(path: Path) -> tuple[dict[int, dict], dict | None]:
    """The cases that a block holds, and what it says at its end."""
    rows: dict[int, dict] = {}
    end = None
    for line in path.read_text().splitlines() if path.exists() else ():
        with contextlib.suppress(ValueError):
            row = json.loads(line)
            if "end" in row:
                end = row["end"]
            else:
                rows[row["case"]] = row
    return rows, end


def finish_block(block: int, seed: int, work: Path) -> None:
    """Bring a block to its end; a case that ends its process is written down as a crash."""
    path = work / f"block_{block:04d}.jsonl"
    while block_rows(path)[1] is None:
        rows = block_rows(path)[0]
        lost = [row for row in rows.values() if row["outcome"] == "begun"]
        with path.open("a") as file:
            for row in lost:
                again = {**row, "target": "?", "kind": "?", "outcome": "crash", "detail": ""}
                file.write(json.dumps({**again, "seconds": 0.0}) + "\n")
        first = max(rows, default=block * BLOCK - 1) + 1
        words = [sys.executable, "-m", __spec__.name, "--work", str(work), "--seed", str(seed)]
        one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        process = subprocess.Popen(
            [*words, "--block", str(block), "--first", str(first)], env={**os.environ, **one_thread}
        )
        _wait(process, path)


def _wait(process: subprocess.Popen, path: Path) -> None:
    """Until a process ends; one that writes nothing any more is ended."""
    last, since = -1, time.monotonic()
    while process.poll() is None:
        time.sleep(0.5)
        size = path.stat().st_size if path.exists() else 0
        if size != last:
            last, since = size, time.monotonic()
        elif time.monotonic() - since > _PATIENCE:
            process.kill()


def summary(work: Path, seed: int) -> dict:
    """Counts of all cases that ended."""
    counts: Counter = Counter()
    faults, slowest, ends, seconds = [], {}, [], 0.0
    for path in sorted(work.glob("block_*.jsonl")):
        rows, end = block_rows(path)
        ends += [] if end is None else [end]
        for row in rows.values():
            if row["outcome"] == "begun":
                continue
            seconds += row["seconds"]
            counts[row["target"], row["kind"], row["outcome"]] += 1
            slowest[row["target"]] = max(slowest.get(row["target"], 0.0), row["seconds"])
            if row["outcome"] not in GOOD:
                faults.append(row)
    table = [dict(zip(("target", "kind", "outcome"), k, strict=True)) | {"cases": n}
             for k, n in sorted(counts.items())]  # fmt: skip
    return {
        "version": __version__,
        "seed": seed,
        "cases": sum(counts.values()),
        "corpus": corpus_digests(work / "corpus"),
        "counts": table,
        "slowest_seconds": slowest,
        "peak_MB": max((e["peak_kb"] for e in ends if "peak_kb" in e), default=0) / 1024,
        "blocks": len(ends),
        "blocks_with_peak": sum("peak_kb" in e for e in ends),
        "peak_child_MB": max((e["peak_child_kb"] for e in ends), default=0) / 1024,
        "processor_seconds": seconds,
        "faults": faults[:50],
    }


def corpus_digests(corpus: Path) -> dict[str, str]:
    """SHA-256 of every sound file: damage of a number and seed is the same for the same files."""
    files = sorted(path for path in corpus.rglob("*") if path.is_file())
    return {
        path.relative_to(corpus).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def page(result: dict) -> str:
    """The result in words and one table."""
    outcomes = sorted({row["outcome"] for row in result["counts"]} | set(GOOD))
    lines = [
        "# Damaged files",
        "",
        f"{result['cases']:,} damaged files, drawn from seed {result['seed']} by "
        "`analyses/data_quality/damaged_files.py`, version " + result["version"] + ".",
        "Each is one file of a sound campaign or run with bytes, tokens or structure changed, "
        "given to the command that reads it.",
        "The sound files are made from the example campaign; their digests stand in "
        "`damaged_files.json`.",
        "Accepted: the damage does not show, or makes another valid file. Refused: exit code 2 and "
        "one line that names the file.",
        "",
        f"Largest memory of a process of {BLOCK} cases {result['peak_MB']:.0f} MB (measured in "
        f"{result['blocks_with_peak']} of {result['blocks']} processes), of a reader of binary "
        f"files {result['peak_child_MB']:.0f} MB. "
        f"Processor time of the commands {result['processor_seconds'] / 60:.1f} minutes.",
        "",
        "| file | cases | " + " | ".join(outcomes) + " | slowest [s of processor] |",
        "|---" * (len(outcomes) + 3) + "|",
    ]
    for target in (*TABLES, *RUN_FILES):
        rows = [row for row in result["counts"] if row["target"] == target]
        by = Counter({o: sum(r["cases"] for r in rows if r["outcome"] == o) for o in outcomes})
        slow = result["slowest_seconds"].get(target, 0.0)
        cells = " | ".join(f"{by[o]:,}" for o in outcomes)
        lines.append(f"| {target} | {sum(by.values()):,} | {cells} | {slow:.1f} |")
    lines += [
        "",
        "summary.json is read by no command. Half the files of runs are damaged with their seal "
        "(SHA-256) in place, half without it, as earlier versions wrote them.",
        "",
    ]
    return "\n".join(lines)


def study(cases: int, seed: int, work: Path, minutes: float) -> dict:
    """All blocks, or as many as the time allows."""
    make_corpus(work / "corpus")
    ends = time.monotonic() + 60.0 * minutes
    for block in range(-(-cases // BLOCK)):
        if time.monotonic() > ends:
            break
        finish_block(block, seed, work)
        print(f"block {block}", file=sys.stderr)
    return summary(work, seed)


def options() -> argparse.Namespace:
    """The words of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--block", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    given = options()
    given.work.mkdir(parents=True, exist_ok=True)
    if given.block is not None:
        run_block(given.block, given.seed, given.work, given.first)
    else:
        found = study(given.cases, given.seed, given.work.resolve(), given.minutes)
        write_atomically(given.out / "damaged_files.json", json.dumps(found, indent=1) + "\n")
        write_atomically(given.out / "damaged_files.md", page(found))
        print(page(found))
