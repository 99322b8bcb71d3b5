"""`bayes-inertia diagnose` on thrown bodies: what the command itself says, in one call for each.

From raw rates at 4 kHz to verdict, J and report. Times are the command's own, by the clock and of
its processors, compiler included: once with nothing compiled before, once with what that run
compiled.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path

import numpy as np

from analyses.engine.timed_process import timed_process
from analyses.pages.table import table_lines

_COMMAND = "import sys; from bayes_inertia.app.cli import main; sys.exit(main(sys.argv[1:]))"
# Largest distance at which an interval of 90 % of a Gaussian posterior holds the truth [sd].
_NINETY_PERCENT = 1.645
_TRUTH_KNOWN_TO = 0.01


def command_row(folder: Path) -> dict:
    """Run the command on a folder; its verdict, its principal moments and what it cost.

    Twice: with nothing compiled before, then with what the first run compiled.
    """
    with tempfile.TemporaryDirectory() as scratch:
        first, second = Path(scratch) / "first", Path(scratch) / "second"
        cost = _cost_of(folder, first, Path(scratch))
        again = _cost_of(folder, second, Path(scratch))
        return row_of(first) | cost | {f"compiled_{key}": value for key, value in again.items()}


def _cost_of(folder: Path, run: Path, scratch: Path) -> dict:
    """Run the command once, its compiled code kept in `scratch`; exit code and seconds."""
    # The compiled code of other runs would spare the first one time.
    environment = os.environ | {
        "BAYES_INERTIA_CACHE": str(scratch / "compiled"),
        "XDG_CACHE_HOME": str(scratch),
    }
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    done = timed_process([_COMMAND, "diagnose", str(folder), "-o", str(run)], environment)
    if done.exit_code not in (0, 3):
        raise RuntimeError(done.message)
    return {
        "exit_code": done.exit_code,
        "processor_seconds": done.processor_seconds,
        "clock_seconds": done.clock_seconds,
    }


def row_of(run: Path) -> dict:
    """Verdict and steps of a run folder, and principal moments where its fit came to an end."""
    diagnosis = json.loads((run / "diagnosis.json").read_text())
    row = {
        "verdict": diagnosis["verdict"],
        "named": diagnosis["named"],
        "why_unknown": diagnosis["why_unknown"],
        "looks_like": (diagnosis["unknown"] or {}).get("description", ""),
        "steps": [_step(step) for step in diagnosis["steps"]],
    }
    if not (run / "summary.json").is_file():
        return row
    summary = json.loads((run / "summary.json").read_text())
    moments = list(summary["derived"].values())
    return row | {
        "verdict_sentence": summary["verdict_sentence"],
        "effects": summary["effects"],
        "reduced_chi2": summary["fit"]["reduced_chi2"]["total"],
        "principal_moments": [row["mean"] for row in moments],
        "sd": [row["sd"] for row in moments],
        "robust_sd": [row["robust_sd"] for row in moments],
    }


def _step(step: dict) -> dict:
    chi2 = {key: step[key]["total"] for key in ("reduced_chi2_before", "reduced_chi2_after")}
    held_out = {key: step[key] for key in ("held_out_before", "held_out_after")}
    return {"added": step["added"]} | chi2 | held_out


def command_lines(rows: list[dict]) -> list[str]:
    """What the command says of all configurations, in Markdown."""
    rows = [row for row in rows if "command" in row]
    if not rows:
        return []
    return [
        "## What the command itself says",
        "",
        "One call of `bayes-inertia diagnose` for each body, from the raw rates at 4 kHz, which it "
        "reduces to block means. The distance is to a truth that is itself known to 1 %.",
        "",
        *_moment_lines([row for row in rows if "principal_moments" in row["command"]]),
        "",
        *_verdict_lines(rows),
        "",
    ]


def _moment_lines(rows: list[dict]) -> list[str]:
    if not rows:
        return ["No fit after a diagnosis has come to its end yet: of J there is nothing to say."]
    columns = (
        "body",
        "moment",
        "plain fit [10⁻⁶ kg m²]",
        "its error",
        "the command's",
        "sd",
        "error",
        "in sds",
        "truth ± 1 % within the 90 % interval",
        "first run: time (of processors)",
        "again, with that compiled code",
    )
    cells = [line for row in rows for line in _moment_cells(row)]
    lines = table_lines(columns, cells)
    for row in (row for row in rows if "truth" in row):
        plain, command = (
            100 * np.mean(np.abs(np.array(values) / row["truth"] - 1.0))
            for values in (
                row["fits"][0]["principal_moments"],
                row["command"]["principal_moments"],
            )
        )
        lines += [
            "",
            f"{row['configuration']}: mean error {plain:.2f} % plain, {command:.2f} % by the "
            f"command (authors, mean of single throws: {row['authors_percent']} %).",
        ]
    return lines


def _moment_cells(row: dict) -> list[list[str]]:
    """A line of the table for each principal moment of a body."""
    command, plain = row["command"], row["fits"][0]["principal_moments"]
    cells = []
    for i, (moment, sd) in enumerate(zip(command["principal_moments"], command["sd"], strict=True)):
        first = [row["configuration"], f"I{i + 1}", f"{1e6 * plain[i]:.1f}"]
        estimate = [f"{1e6 * moment:.1f}", f"{1e6 * sd:.1f}"]
        seconds = _seconds(command) if i == 0 else ["", ""]
        if "truth" not in row:
            cells.append([*first, "-", *estimate, "-", "-", "-", *seconds])
            continue
        truth = row["truth"][i]
        against = [
            f"{100 * (moment / truth - 1):+.2f} %",
            f"{(moment - truth) / sd:+.1f}",
            "yes" if is_covered(moment, sd, truth) else "no",
        ]
        plain_error = f"{100 * (plain[i] / truth - 1):+.2f} %"
        cells.append([*first, plain_error, *estimate, *against, *seconds])
    return cells


def _seconds(command: dict) -> list[str]:
    """By the clock and, in brackets, of processors: nothing compiled before, and compiled."""
    return [
        f"{command[f'{which}clock_seconds']:.0f} s ({command[f'{which}processor_seconds']:.0f} s)"
        for which in ("", "compiled_")
    ]


def is_covered(moment: float, sd: float, truth: float) -> bool:
    """Whether the 90 % interval reaches what the truth may be, known to 1 %."""
    return abs(moment - truth) <= _NINETY_PERCENT * sd + _TRUTH_KNOWN_TO * truth


def _verdict_lines(rows: list[dict]) -> list[str]:
    lines: list[str] = []
    for row in rows:
        command = row["command"]
        verdict = f"`{command['verdict']}` ({command['why_unknown'] or 'explained'}). "
        verdict += command.get("verdict_sentence", "The fit that follows was stopped.")
        lines.append(f"**{row['configuration']}**: {verdict}")
        if command["looks_like"]:
            lines += ["", f"What is left looks like this: {command['looks_like']}."]
        if command["steps"]:
            lines += [
                "",
                "Tried one after the other (what is random: one size for all throws):",
                "",
            ]
            lines += table_lines(
                ("effect", "reduced chi²", "reduced chi² of throws held out"),
                [
                    (
                        step["added"],
                        f"{step['reduced_chi2_before']:.1f} → {step['reduced_chi2_after']:.1f}",
                        f"{step['held_out_before']:.1f} → {step['held_out_after']:.1f}",
                    )
                    for step in command["steps"]
                ],
            )
        lines.append("")
    return lines
