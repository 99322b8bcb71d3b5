"""Are the stated uncertainties right? Simulation-based calibration of J and K (Talts et al. 2018).

Every campaign has a truth drawn from the prior, is flown in closed loop with noise, and is fitted
in full. If all of
prior, simulator, likelihood and sampler belong together, the truth's rank among posterior draws is
uniform, and
intervals contain it as often as they say. Two deliberate errors show that the test would notice.

    python analyses/calibration.py [--campaigns 400] [--jobs 1]

writes `figures/calibration.png` and `analyses/results/calibration.{md,parquet}`. Finished fits are
kept in
`run_calibration/`, each shard written all or nothing, so that a killed run goes on where it was.
Needs the extra
`parquet`.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import joblib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.sampler import Settings, sample
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.pictures.style import COLORS, DASHES, INK, MUTED, PALE, styled

ROOT = Path(__file__).parents[1]
RANKED = 99  # posterior draws that the truth is ranked among: ranks 0 to 99
SHARD = 20  # campaigns a file
LEVELS = (0.5, 0.9, 0.99)
SETTINGS = Settings(ensembles=2, walkers=64, steps=24, max_steps=24, threads=1)
SHRUNK = 0.8
# The truth's rank among the package's draws, and among draws with two deliberate errors.
RANKS = {
    "rank": "posterior",
    "rank_shrunk": "sd shrunk by 20 %",
    "rank_held": "start states and bias held at their best values",
}


@dataclass(frozen=True)
class Study:
    """Campaigns of one plan; `number` separates its random numbers from those of others, `share` is
    its part of the campaigns asked for.
    """

    name: str
    number: int
    plan: Plan
    says: str
    share: float = field(default=1.0, repr=False)


def studies() -> tuple[Study, ...]:
    """Five slews with information on all axes, and two that leave several parameters to the prior;
    telemetry at 1 Hz.
    """
    five = replace(paper_like_plan(), telemetry_period=1.0)
    two = replace(
        five, slews=(PlannedSlew((1.0, 0.0, 0.0), 1.0), PlannedSlew((0.0, 1.0, 1.0), 1.0))
    )
    return (
        Study("five slews", 0, five, "about x, y, z and two diagonals"),
        Study("two slews", 1, two, "about x and the diagonal of y and z", 0.5),
    )


def fit_one(study: Study, seed: int, i: int) -> pd.DataFrame:
    """Campaign i of a study, a row a parameter: truth, mean, sd, quantiles, ranks, gates."""
    flight = draw_flight(
        planned_campaign(study.plan, most_like_mission()),
        study.plan,
        np.random.SeedSequence(seed, spawn_key=(study.number, i)),
    )
    craft = flight.spacecraft
    J = craft.inertia_B
    truth = np.array([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *craft.scale_factor])
    at = estimate(Model(flight.campaign), seed=i)
    chains = sample(at, replace(SETTINGS, seed=seed + i), shared_code=True)
    return _row_of(
        at, chains.samples, truth, np.random.default_rng([seed, study.number, i])
    ).assign(
        study=study.name,
        campaign=i,
        explained=not any(test.rejected for test in at.tests.values()),
        nested_rhat=chains.diagnostics.nested_rhat_max,
        reduced_chi2=at.tests["total"].reduced_chi2,
    )


def _row_of(
    at: Estimate, samples: np.ndarray, truth: np.ndarray, rng: np.random.Generator
) -> pd.DataFrame:
    flat = samples.reshape(-1, len(truth))
    # The last draws of different walkers: hardly correlated, as nearly every step proposes anew.
    ranked = samples[:, :, -1].reshape(-1, len(truth))[:RANKED]
    mean, sd = flat.mean(0), flat.std(0, ddof=1)
    # With the nuisances held, the posterior's Laplace approximation is as wide as the Hessian's own
    # block says.
    held = rng.multivariate_normal(
        at.theta, inverse(at.hessian[: len(truth), : len(truth)]), RANKED
    )
    found = {
        "parameter": list(at.model.space.names),
        "truth": truth,
        "mean": mean,
        "sd": sd,
        "prior_sd": at.model.space.sd,
    }
    found |= {
        f"q{100 * p:g}": np.quantile(flat, p, axis=0)
        for level in LEVELS
        for p in (0.5 - level / 2, 0.5 + level / 2)
    }
    for name, draws in zip(RANKS, (ranked, mean + SHRUNK * (ranked - mean), held), strict=True):
        found[name] = (draws < truth).sum(0)
    return pd.DataFrame(found)


def shards(
    campaigns: int, seed: int, chosen: Sequence[Study]
) -> Iterator[tuple[Study, int, range, str]]:
    """The work: (study, seed, campaigns, file name); a file's name changes with everything that
    decides its content.
    """
    for study in chosen:
        digest = hashlib.sha256(repr((study, seed, SETTINGS, RANKED)).encode()).hexdigest()[:8]
        wanted = math.ceil(campaigns * study.share)
        for first in range(0, wanted, SHARD):
            span = range(first, min(first + SHARD, wanted))
            yield (
                study,
                seed,
                span,
                f"{study.name.replace(' ', '_')}-{digest}-{span.start:05d}-{span.stop:05d}.parquet",
            )


def do_shard(folder: Path, study: Study, seed: int, span: range, file: str) -> Path:
    """One shard, unless it is there already."""
    path = folder / file
    if not path.exists():
        table = pd.concat([fit_one(study, seed, i) for i in span], ignore_index=True)
        write_atomically(path, lambda temporary: table.to_parquet(temporary))
    return path


def run(
    campaigns: int, seed: int, folder: Path, jobs: int = 1, chosen: Sequence[Study] | None = None
) -> pd.DataFrame:
    """All fits (those already in the folder are read): one row a campaign and parameter."""
    folder.mkdir(parents=True, exist_ok=True)
    tasks = list(shards(campaigns, seed, chosen or studies()))
    files = []
    with joblib.parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
        for file in joblib.Parallel(return_as="generator")(
            joblib.delayed(do_shard)(folder, *task) for task in tasks
        ):
            files.append(file)
            print(
                f"{len(files)} of {len(tasks)} shards",
                end="\r" if len(files) < len(tasks) else "\n",
                file=sys.stderr,
            )
    return pd.concat([pd.read_parquet(file) for file in files], ignore_index=True)


def band(n: int, level: float, *, seed: int = 0, trials: int = 4000) -> float:
    """Half width, in standard errors sqrt(p (1 - p) / n), of the band that contains the whole ECDF
    of n uniform ranks with
    probability `level` (Säilynoja, Bürkner and Vehtari 2022, by simulation).

    >>> 2.5 < band(200, 0.95, trials=500) < 3.6
    True
    """
    ranks = np.random.default_rng(seed).integers(0, RANKED + 1, (trials, n))
    return float(np.quantile([np.abs(departure(r)).max() for r in ranks], level))


def departure(ranks: np.ndarray) -> np.ndarray:
    """ECDF of ranks minus that of uniform ones, in standard errors, at each possible rank but the
    last (99,).
    """
    p = np.arange(1, RANKED + 1) / (RANKED + 1)
    below = np.searchsorted(np.sort(ranks), np.arange(RANKED), side="right") / len(ranks)
    return (below - p) / np.sqrt(p * (1.0 - p) / len(ranks))


def uniformity(table: pd.DataFrame) -> pd.DataFrame:
    """Largest departure of each study's, parameter's and rank's ECDF, and the band for nine
    parameters at once (95 %).
    """
    rows = []
    for study, group in table.groupby("study", sort=False):
        n = group.campaign.nunique()
        limit = band(n, 0.95 ** (1 / group.parameter.nunique()))
        for parameter, own in group.groupby("parameter", sort=False):
            for key in RANKS:
                largest = float(np.abs(departure(own[key].to_numpy())).max())
                rows.append(
                    {
                        "study": study,
                        "parameter": parameter,
                        "ranks": key,
                        "largest": largest,
                        "band": limit,
                        "leaves": largest > limit,
                    }
                )
    return pd.DataFrame(rows)


def coverage(table: pd.DataFrame) -> pd.DataFrame:
    """How often intervals contain the truth, by study, parameter, level and kind, with 95 %
    Clopper-Pearson intervals.
    """
    rows = []
    for (study, parameter), own in table.groupby(["study", "parameter"], sort=False):
        z = (own.truth - own["mean"]) / own.sd
        for level in LEVELS:
            low, high = own[f"q{100 * (0.5 - level / 2):g}"], own[f"q{100 * (0.5 + level / 2):g}"]
            inside = {
                "sd": z.abs() <= stats.norm.ppf(0.5 + level / 2),
                "quantiles": (own.truth >= low) & (own.truth <= high),
            }
            for kind, hits in inside.items():
                interval = stats.binomtest(int(hits.sum()), len(hits)).proportion_ci(0.95)
                rows.append(
                    {
                        "study": study,
                        "parameter": parameter,
                        "level": level,
                        "kind": kind,
                        "share": hits.mean(),
                        **interval._asdict(),
                    }
                )
    return pd.DataFrame(rows)


def scores(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and sd of z = (truth - mean) / sd by study and parameter, and how much of the prior's
    variance the data removed.
    """
    z = table.assign(
        z=(table.truth - table["mean"]) / table.sd,
        contraction=1.0 - (table.sd / table.prior_sd) ** 2,
    )
    return (
        z.groupby(["study", "parameter"], sort=False)
        .agg(mean_z=("z", "mean"), sd_z=("z", "std"), contraction=("contraction", "median"))
        .reset_index()
    )


@styled
def picture(table: pd.DataFrame) -> Figure:
    """ECDFs of the ranks minus that of uniform ones with their simultaneous 95 % band; deliberate
    errors on the right.
    """
    names = list(dict.fromkeys(table.study))
    figure = Figure(figsize=(10.0, 2.7 * len(names) + 0.5), layout="constrained")
    axes = figure.subplots(len(names), 3, sharex=True, squeeze=False)
    x = np.arange(1, RANKED + 1) / (RANKED + 1)
    for row, study in zip(axes, names, strict=True):
        group = table[table.study == study]
        n = group.campaign.nunique()
        error = np.sqrt(x * (1.0 - x) / n)
        half = band(n, 0.95 ** (1 / group.parameter.nunique())) * error
        J, K = (
            (name for name in group.parameter.unique() if name[0] == "J"),
            (name for name in group.parameter.unique() if name[0] == "K"),
        )
        panels = (
            ("J", [(name, "rank", name) for name in J]),
            ("K", [(name, "rank", name) for name in K]),
            ("errors put in", _controls(group)),
        )
        for ax, (title, lines) in zip(row, panels, strict=True):
            ax.fill_between(
                x,
                -half,
                half,
                color=PALE,
                lw=0,
                label="95 % band of all nine" if title == "J" else None,
            )
            ax.axhline(0.0, color=MUTED, lw=0.6)
            for k, (parameter, key, label) in enumerate(lines):
                ranks = group[group.parameter == parameter][key].to_numpy()
                ax.plot(x, departure(ranks) * error, color=COLORS[k], ls=DASHES[k], label=label)
            ax.set_title(f"{study}, {n} campaigns: {title}", color=INK)
            ax.legend(
                ncols=2,
                fontsize=7.0,
                loc="lower left" if title != "errors put in" else "upper right",
            )
        row[0].set_ylabel("ECDF of rank minus uniform")
        reach = 1.9 * half.max()
        for ax in row[:2]:
            ax.set_ylim(-reach, reach)
        row[2].set_ylim(top=1.9 * row[2].get_ylim()[1])
    for ax in axes[-1]:
        ax.set_xlabel("rank of the truth / number of draws")
    return figure


def _controls(group: pd.DataFrame) -> list[tuple[str, str, str]]:
    short = {"rank_shrunk": "sd × 0.8", "rank_held": "starts held"}
    names = [p for p in ("Jxx", "Jyz", "K1") if p in set(group.parameter)]
    return [(p, key, f"{p}, {label}") for key, label in short.items() for p in names]


def report(table: pd.DataFrame, seconds: float | None) -> str:
    """The result as Markdown."""
    flat, covered, z = uniformity(table), coverage(table), scores(table)
    lines = [
        "# Calibration of J and K over simulated campaigns",
        "",
        *_introduction(table, seconds),
        "",
    ]
    lines += [
        "## Ranks",
        "",
        "Largest departure of the rank's ECDF from uniform over the nine parameters, in standard "
        "errors, and the simultaneous",
    ]
    lines += [
        "95 % band for nine parameters; the last two rows of each study are deliberate errors that "
        "the test must notice.",
        "",
    ]
    lines += [
        "| study | ranks among | largest | band | parameters outside | verdict |",
        "|---|---|---|---|---|---|",
    ]
    for (study, key), own in flat.groupby(["study", "ranks"], sort=False):
        outside = ", ".join(own[own.leaves].parameter) or "none"
        verdict = "leaves the band" if own.leaves.any() else "inside the band"
        lines.append(
            f"| {study} | {RANKS[key]} | {own.largest.max():.2f} | {own.band.iloc[0]:.2f} | "
            f"{outside} | {verdict} |"
        )
    lines += [
        "",
        "## Standardised errors z = (truth - mean) / sd",
        "",
        "| study | parameter | mean z | sd z | contraction |",
        "|---|---|---|---|---|",
    ]
    for _, r in z.iterrows():
        n = table[table.study == r.study].campaign.nunique()
        lines.append(
            f"| {r.study} | {r.parameter} | {r.mean_z:+.3f} ± {1 / math.sqrt(n):.3f} | "
            f"{r.sd_z:.3f} ± {1 / math.sqrt(2 * n):.3f} | {r.contraction:.3f} |"
        )
    lines += ["", *_overall(table)]
    lines += [
        "",
        "## Coverage",
        "",
        "Share of campaigns whose interval contains the truth, in %, with its 95 % binomial "
        "interval.",
        "",
    ]
    kinds = ("sd", "quantiles")
    columns = " | ".join(f"{100 * level:g} %, {kind}" for level in LEVELS for kind in kinds)
    lines += [f"| study | parameter | {columns} |", "|---" * 8 + "|"]
    for (study, parameter), own in covered.groupby(["study", "parameter"], sort=False):
        cells = [
            f"{100 * r.share:.1f} [{100 * r.low:.1f}, {100 * r.high:.1f}]"
            for _, r in own.iterrows()
        ]
        lines.append(f"| {study} | {parameter} | {' | '.join(cells)} |")
    outside = covered[(covered.level < covered.low) | (covered.level > covered.high)]
    lines += [
        "",
        f"{len(outside)} of {len(covered)} binomial intervals miss their level (5 % of them would "
        "by chance; those of one parameter are alike).",
        "",
    ]
    return "\n".join(lines)


def _overall(table: pd.DataFrame) -> list[str]:
    """Mean z^2 over all parameters, with a standard error that treats a campaign's nine errors as
    one number.
    """
    lines = []
    for study, group in table.assign(
        square=((table.truth - table["mean"]) / table.sd) ** 2
    ).groupby("study", sort=False):
        each = group.groupby("campaign").square.mean()
        lines.append(
            f"All nine parameters together, {study}: "
            f"mean z² = {each.mean():.3f} ± {each.std() / math.sqrt(len(each)):.3f} (1 if sd is "
            "right)."
        )
    return lines


def _introduction(table: pd.DataFrame, seconds: float | None) -> list[str]:
    about = {study.name: study for study in studies()}
    lines = [
        "Truth (J, K, rate bias) drawn from the prior, slews of 20 to 60 degrees with random "
        "senses and start attitudes flown in closed loop with noise at",
        "1 Hz telemetry, each campaign fitted in full (three starts of the optimizer, sampling in "
        "two ensembles of 64 walkers); the truth is ranked among",
        f"{RANKED} nearly independent draws. Made by `python analyses/calibration.py`.",
        "",
    ]
    for name, group in table.groupby("study", sort=False):
        each = group.groupby("campaign").first()
        passed = stats.binomtest(int(each.explained.sum()), len(each)).proportion_ci(0.95)
        lines.append(
            f"- {name} ({about[name].says}): {len(each)} campaigns; "
            f'the gate "explained" passes in {100 * each.explained.mean():.1f} % '
            f"[{100 * passed.low:.1f}, {100 * passed.high:.1f}] of these perfect fits; "
            f"reduced chi² {each.reduced_chi2.mean():.4f} on average; "
            f"nested R-hat of these short runs at most {each.nested_rhat.max():.3f}."
        )
    if seconds is not None:
        lines += ["", f"This run took {seconds / 60:.1f} minutes on one core."]
    return lines


def main(arguments: Sequence[str] | None = None) -> pd.DataFrame:
    """Run what is missing and write figure, report and table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--campaigns",
        type=int,
        default=400,
        help="of the first study; the second gets half as many",
    )
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument(
        "--out", type=Path, default=ROOT, help="folder with figures/ and analyses/results/"
    )
    asked = parser.parse_args(arguments)
    began, work = perf_counter(), asked.out / "run_calibration"
    fresh = not work.exists()
    table = run(asked.campaigns, asked.seed, work, asked.jobs)
    results, figures = asked.out / "analyses" / "results", asked.out / "figures"
    for folder in (results, figures):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomically(results / "calibration.parquet", lambda temporary: table.to_parquet(temporary))
    text = report(table, perf_counter() - began if fresh else None)
    write_atomically(results / "calibration.md", text)
    write_atomically(
        figures / "calibration.png", lambda temporary: picture(table).savefig(temporary, dpi=150)
    )
    print(text)
    return table


if __name__ == "__main__":
    main()
