"""The two ways to run a study on SLURM, against the same study in one process.

    python analyses/slurm_check.py --partition main

Needs a SLURM cluster that runs jobs of three tasks (Debian's `slurm-wlm` on one machine does) and
`dask-jobqueue`. One study is done three times: by `docs/how_to/cluster_slurm.py`, one job of which
is cancelled on the way, by `docs/how_to/cluster_slurm.sh`, and in one process. Takes five minutes.
Writes `analyses/results/slurm.md`.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from page_table import table_lines

from bayes_inertia.files import write_atomically

ROOT = Path(__file__).parents[1]
SCRIPTS = ROOT / "docs" / "how_to"
# The command of this environment comes first, for jobs too: sbatch hands the environment on.
ENVIRONMENT = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
_CANCELLED_AFTER = 25.0  # [s] of the study


def main() -> None:
    """Run the three studies and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--partition", required=True)
    parser.add_argument("--campaigns", type=int, default=40)
    parser.add_argument("--work", type=Path, default=Path("slurm_run"))
    options = parser.parse_args()
    work = options.work.resolve()
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    command = ["study", str(ROOT / "bayes_inertia" / "example"), "--seed", "5"]
    command += ["--campaigns", str(options.campaigns), "-o"]
    subprocess.run(["bayes-inertia", *command, str(work / "serial")], env=ENVIRONMENT, check=True)
    cancelled = _by_workers(work, options.partition, [*command, str(work / "workers")])
    _by_batch(work, options.partition, [*command, str(work / "batch")])
    _write_page(work, options.campaigns, cancelled)


def _by_workers(work: Path, partition: str, command: list[str]) -> int:
    """The study on workers that are jobs; returns how many jobs were cancelled on the way."""
    script = [sys.executable, str(SCRIPTS / "cluster_slurm.py"), "--partition", partition]
    size = ["--workers", "2", "--workers-a-job", "1", "--hours", "1"]
    with subprocess.Popen([*script, *size], stdout=subprocess.PIPE, text=True, cwd=work) as cluster:
        try:
            address = cluster.stdout.readline().strip()
            on_it = ["--engine", "dask", "--scheduler", address]
            with subprocess.Popen(["bayes-inertia", *command, *on_it], env=ENVIRONMENT) as driver:
                time.sleep(_CANCELLED_AFTER)
                jobs = [] if driver.poll() is not None else _running_jobs()[:1]
                if jobs:
                    subprocess.run(["scancel", *jobs], check=True)
                if driver.wait():
                    raise SystemExit("The study on workers failed.")
        finally:
            cluster.terminate()
    return len(jobs)


def _running_jobs() -> list[str]:
    told = subprocess.run(
        ["squeue", "--me", "-h", "-t", "R", "-o", "%i"], capture_output=True, text=True, check=True
    )
    return told.stdout.split()


def _by_batch(work: Path, partition: str, command: list[str]) -> None:
    """The study in one allocation of three tasks."""
    size = ["--partition", partition, "--ntasks", "3", "--mem-per-cpu", "1G", "--wait"]
    subprocess.run(
        ["sbatch", *size, str(SCRIPTS / "cluster_slurm.sh"), *command],
        cwd=work,
        env=ENVIRONMENT,
        check=True,
    )


def _digest(folder: Path) -> str:
    """Of a study's result and rows."""
    files = [folder / "study.json", folder / "rows.jsonl"]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def _write_page(work: Path, campaigns: int, cancelled: int) -> None:
    version = subprocess.run(["sinfo", "--version"], capture_output=True, text=True, check=True)
    serial = _digest(work / "serial")
    rows = [
        ["workers as jobs, `cluster_slurm.py`", str(cancelled), _same(work / "workers", serial)],
        ["one allocation, `cluster_slurm.sh`", "0", _same(work / "batch", serial)],
    ]
    lines = [
        "# Studies on SLURM",
        "",
        f"Made by `python analyses/slurm_check.py` on {version.stdout.strip()}, one node.",
        f"A study of {campaigns} fits, against the same one in one process.",
        "",
        *table_lines(["how", "jobs cancelled on the way", "result and rows: same bytes"], rows),
    ]
    write_atomically(ROOT / "analyses" / "results" / "slurm.md", "\n".join(lines) + "\n")


def _same(folder: Path, serial: str) -> str:
    return "yes" if _digest(folder) == serial else "NO"


if __name__ == "__main__":
    main()
