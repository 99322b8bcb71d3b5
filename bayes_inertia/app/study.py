"""`study` on a folder: do the uncertainties hold that fits of a plan's campaigns state?

The plan is flown again and again with noise, each time with another J, K and bias from the campaign's prior, and each
campaign is fitted as real data would be. If the stated sds are right, errors over sds are standard normal, and
intervals hold the truth as often as they say. Campaigns are kept in shards: a killed study goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from scipy import stats

from bayes_inertia.app.design_commands import PAPER, plans_named, prior_spacecraft
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.design.comparison import NAMES, Achieved, achieve
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.files import make_folder, write_atomically
from bayes_inertia.flight.plan import Plan
from bayes_inertia.report.pictures.study import coverage_picture

FORMAT = "bayes-inertia-study/1"
LEVELS = (0.68, 0.95)
_SHARD = 25
# Probability that sound uncertainties are called too small, any of the nine.
_FALSE_ALARM = 0.01


@dataclass(frozen=True)
class Study:
    """What n simulated campaigns of one plan say about the uncertainties that are stated of it.

    Attributes
    ----------
    plan, found : the plan, and errors and stated sds of every campaign.
    """

    plan: Plan
    found: Achieved

    @property
    def z(self) -> np.ndarray:
        """Errors in units of the stated sd (n, 9)."""
        return self.found.errors / self.found.stated

    def coverage(self, level: float) -> list[tuple[float, float, float]]:
        """For each parameter: how often the central interval of this level held the truth, with the 95 % interval of that share."""
        held = np.abs(self.z) < stats.norm.ppf(0.5 + 0.5 * level)
        tests = [stats.binomtest(int(h.sum()), len(h)) for h in held.T]
        intervals = [t.proportion_ci(method="exact") for t in tests]
        return [
            (float(t.statistic), float(i.low), float(i.high))
            for t, i in zip(tests, intervals, strict=True)
        ]

    @property
    def too_small(self) -> tuple[str, ...]:
        """Parameters whose errors are larger than their stated sds allow (chi^2 of all errors, Bonferroni over parameters)."""
        p = stats.chi2.sf(np.sum(self.z**2, axis=0), len(self.z))
        return tuple(
            name for name, value in zip(NAMES, p, strict=True) if value < _FALSE_ALARM / len(NAMES)
        )


def run_study(
    campaign: Path,
    folder: Path,
    plan: str = PAPER,
    *,
    campaigns: int = 200,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable | None = None,
) -> Study:
    """Simulate and fit campaigns of one plan with a campaign's hardware and prior; write study.json and study.png.

    Parameters
    ----------
    plan : file of the plan, or `paper`. campaigns : how many; shards of 25 that are there already are read. jobs : processes.
    progress : called with (what, done, of).

    Raises
    ------
    CampaignError : campaign or plan is no good. OutputError : the folder holds something else.
    """
    given, digest = read_campaign(campaign), campaign_sha256(campaign)
    (chosen,) = plans_named([plan], given).values()
    if campaigns < 2:
        raise CampaignError(
            f"{campaigns} campaign tells nothing of scatter",
            where="campaigns",
            advice="ask for 200",
        )
    content = {
        "format": FORMAT,
        "campaign_sha256": digest,
        "plan": hashlib.sha256(repr(chosen).encode()).hexdigest(),
        "seed": seed,
    }
    _begin(folder, content)
    spans = [range(i, min(i + _SHARD, campaigns)) for i in range(0, campaigns, _SHARD)]
    tasks = [
        (
            folder / f"shard_{span.start:05d}_{span.stop:05d}.npz",
            chosen,
            prior_spacecraft(given),
            given.inertia,
            seed,
            span,
        )
        for span in spans
    ]
    with joblib.parallel_config(
        "loky" if jobs > 1 else "sequential",
        n_jobs=jobs,
        inner_max_num_threads=1 if jobs > 1 else None,
    ):
        shards = []
        for shard in joblib.Parallel(return_as="generator")(
            joblib.delayed(_shard)(*task) for task in tasks
        ):
            shards.append(shard)
            if progress is not None:
                progress("campaigns", sum(len(s.errors) for s in shards), campaigns)
    done = Study(
        chosen,
        Achieved(*(np.concatenate([getattr(s, f.name) for s in shards]) for f in fields(Achieved))),
    )
    figure = coverage_picture(NAMES, done.found, done.z)
    write_atomically(
        folder / "study.png",
        lambda temporary: figure.savefig(
            temporary, format="png", dpi=130, metadata={"Software": None}
        ),
    )
    write_atomically(
        folder / "study.json",
        json.dumps(content | _content(done), indent=1, allow_nan=False) + "\n",
    )
    return done


def _begin(folder: Path, content: dict[str, Any]) -> None:
    """Claim the folder for this study, or go on with the same one."""
    path = folder / "study_of.json"
    try:
        same = path.exists() and json.loads(path.read_text()) == content
    except ValueError:
        same = False
    if not same:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            what = "holds another study, or something else"
            raise OutputError(
                what, where=str(folder), advice="choose another folder; nothing was overwritten"
            )
        make_folder(folder)
        write_atomically(path, json.dumps(content) + "\n")


def _shard(path: Path, plan: Plan, spacecraft, prior, seed: int, span: range) -> Achieved:
    """Some of the campaigns, from their file or made and written."""
    if not path.exists():
        found = achieve(plan, spacecraft, prior, span, seed)
        arrays = {f.name: getattr(found, f.name) for f in fields(Achieved)}

        def save(temporary: Path) -> None:
            with open(temporary, "wb") as file:
                np.savez(file, **arrays)

        write_atomically(path, save)
    with np.load(path) as arrays:
        return Achieved(**{f.name: arrays[f.name] for f in fields(Achieved)})


def _content(study: Study) -> dict[str, Any]:
    z, found = study.z, study.found
    rows = {}
    for i, name in enumerate(NAMES):
        rows[name] = {
            "achieved_sd": float(found.sd[i]),
            "achieved_sd_standard_error": float(found.sd_error[i]),
            "stated_sd": float(np.sqrt(np.mean(found.stated[:, i] ** 2))),
            "mean_z": float(z[:, i].mean()),
            "sd_z": float(np.sqrt(np.mean(z[:, i] ** 2))),
            "coverage": {f"{100 * level:.0f}": study.coverage(level)[i] for level in LEVELS},
        }
    return {
        "campaigns": len(z),
        "parameters": rows,
        "too_small": list(study.too_small),
        "reduced_chi2": float(found.chi2.mean()),
    }
