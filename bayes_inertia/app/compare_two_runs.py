"""Two finished runs side by side, each from its files alone."""

from __future__ import annotations

from pathlib import Path

from bayes_inertia.app.run_folder import read_run
from bayes_inertia.app.run_report import run_summary
from bayes_inertia.errors import CampaignError
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.fit_sections import settings_rows
from bayes_inertia.report.run_comparison import ComparedRun, RunComparison, compare_runs
from bayes_inertia.sealing import blaming, is_sealed

_NEW_RUN = "start a new run in another folder"


def finished_posterior(folder: Path) -> Posterior:
    """The posterior of a finished run."""
    stored = folder / "posterior.nc"
    if not stored.is_file():
        if (folder / "run.json").is_file():
            raise CampaignError(
                "the run is not finished: it has no posterior.nc",
                where=str(folder),
                advice=f"finish it with `bayes-inertia resume {folder}`",
            )
        raise CampaignError(
            "no run here: there is neither run.json nor posterior.nc",
            where=str(folder),
            advice="give the folder that `fit -o` or `diagnose -o` wrote",
        )
    return Posterior.load(stored)


def compare_two_runs(first: Path, second: Path) -> RunComparison:
    """Read two runs and compare them."""
    if first.resolve() == second.resolve():
        raise CampaignError(
            "both runs are the same folder",
            where=str(first),
            advice="name two runs, such as one without and one with an effect",
        )
    names = [run.resolve().name for run in (first, second)]
    labels = names if names[0] != names[1] else [str(first), str(second)]
    return compare_runs(_compared_run(first, labels[0]), _compared_run(second, labels[1]))


def _compared_run(folder: Path, label: str) -> ComparedRun:
    posterior = finished_posterior(folder)
    with blaming(folder, intact=is_sealed(folder / "posterior.nc", ""), advice=_NEW_RUN):
        settings = dict(settings_rows(posterior))
        summary = run_summary(posterior, folder)
    return ComparedRun(str(folder), label, summary, settings | _asked_for(folder))


def _asked_for(folder: Path) -> dict[str, str]:
    """Options of the command line; none for a posterior saved from Python."""
    if not (folder / "run.json").is_file():
        return {}
    run = read_run(folder)
    return {
        "command": run.kind,
        "telemetry and noise": "as stated" if run.as_stated else "checked for faults",
        "noise model": run.noise.in_words() or "Gaussian, as stated",
    }
