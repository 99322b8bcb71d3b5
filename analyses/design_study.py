"""What designed plans achieve: predicted against achieved sds, gains, margins in flight, times, and
effects told apart.

    python analyses/design_study.py [--parts gains,flown,achieved,separate,times] [--campaigns 400]
    [--jobs 1]

writes `analyses/results/design_*.json[l]`, `analyses/results/design.md` and `figures/design_*.png`.
Results are kept as they are
made, each file written all or nothing: a killed study goes on where it was, and a finished part is
not done again
(delete its file for that).
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

import argparse
import hashlib
import json
import math
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import joblib
import numpy as np
from matplotlib.figure import Figure
from scipy import linalg

from bayes_inertia.design.comparison import Contender, compare_plans
from bayes_inertia.design.design_setup import set_up_design
from bayes_inertia.design.designer import design_plan
from bayes_inertia.design.expected_accuracy import estimate_at_truth, expected_sd
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import flown_margins
from bayes_inertia.design.plan_arrays import slew_arrays
from bayes_inertia.design.plan_search import random_plans
from bayes_inertia.design.separating_slew import separating_slew
from bayes_inertia.design.simulated_fits import AchievedErrors, fit_simulated_campaigns
from bayes_inertia.diagnosis.score_test import ScoreTests, score_tests
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_file import read_plan, write_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.flight.spacecraft import (
    Controller,
    Spacecraft,
    most_like_prior,
    most_like_spacecraft,
)
from bayes_inertia.inference.optimizer import estimate, move_to
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import BASE_NAMES, ParameterSpace
from bayes_inertia.report.pictures import style
from bayes_inertia.report.pictures.design import draw_comparison

ROOT = Path(__file__).resolve().parent.parent
RESULTS, FIGURES = ROOT / "analyses" / "results", ROOT / "figures"
PRIOR = most_like_prior()
CRAFT = replace(most_like_spacecraft(), inertia_B=PRIOR.tensor, scale_factor=(1.0, 1.0, 1.0))
MISSION = Mission(CRAFT, PRIOR)
# The planned rate is the paper-like slews' 1 deg/s, the time that of the five of them.
LIMITS = Limits(rate=math.radians(1.0) / (1.0 - Limits().rate_reserve), total_time=1855.0)
GOALS = ("cross_terms", "inertia", "scale_factors", "correction_slew")
RANDOM = 10_000
SHARD = 25
FLIGHTS = 100
PAPER = "five slews like the paper's"
# A pair that slews like the paper's show nearly alike, and one that without tachometers no slew
# tells apart.
PAIRS = (("constant_torque", "star_tracker_shift"),)
HOPELESS = ("wheel_command_lag", "rate_sensor_delay")


def kept(name: str, make: Callable[[], dict]) -> dict:
    """A result from its file, or made and written."""
    path = RESULTS / f"design_{name}.json"
    if not path.exists():
        write_atomically(path, json.dumps(make(), indent=1) + "\n")
    return json.loads(path.read_text())


def plan_for(
    wanted: str, craft: Spacecraft = CRAFT, limits: Limits = LIMITS, tag: str = ""
) -> Plan:
    """The plan designed for a goal, from its file or designed now."""
    path = RESULTS / f"plan_{wanted.replace(':', '_').replace(',', '_')}{tag}.toml"
    if not path.exists():
        write_plan(design_plan(Mission(craft, PRIOR), wanted, limits).plan, path)
    return read_plan(path)


# --- gains: against slews like the paper's and against random plans
# --------------------------------------------------


def gains() -> dict:
    """For every goal: the number for designed, paper-like and the best of 10,000 random feasible
    plans, all at the prior's mean.
    """
    out = {}
    for wanted in GOALS:
        plan = plan_for(wanted)
        problem, _, reference, _ = set_up_design(
            MISSION, parse_goal(wanted), LIMITS, paper_like_plan(), 5, seed=0, draws=1
        )
        values, tried, seed = [], 0, 1000
        while len(values) < RANDOM:
            _, logs, least = random_plans(problem, 5, 2000, seed)
            values += np.exp(logs[least >= 0.0]).tolist()
            tried, seed = tried + 2000, seed + 1
        number = {
            "designed": problem.value(problem.variables(slew_arrays(plan))),
            "paper": problem.value(problem.variables(slew_arrays(reference))),
        }
        exact = [estimate_at_truth(p, MISSION).sd for p in (plan, reference)]
        out[wanted] = {
            "unit": parse_goal(wanted).unit,
            **number,
            "gain": number["paper"] / number["designed"],
            "random": {
                "feasible": RANDOM,
                "tried": tried,
                "best": min(values[:RANDOM]),
                "median": float(np.median(values[:RANDOM])),
            },
            "values": np.quantile(values[:RANDOM], np.linspace(0.0, 1.0, 201)).tolist(),
            "sd": dict(zip(BASE_NAMES, exact[0].tolist(), strict=True)),
            "sd_paper": dict(zip(BASE_NAMES, exact[1].tolist(), strict=True)),
            "seeds": [design_plan(MISSION, wanted, LIMITS, seed=seed).gain for seed in (1, 2)]
            if wanted == "cross_terms"
            else [],
        }
    return out


# --- flown: every limit in the closed loop
# ------------------------------------------------------------------------------


def flown() -> dict:
    """Margins of every designed plan over flights with noise by a controller that believes the
    prior, each with its own truth.
    """
    out = {}
    for wanted in GOALS:
        plan = plan_for(wanted)
        template = planned_campaign(plan, MISSION)
        found: dict[str, list[float]] = {}
        for i in range(FLIGHTS):
            flight = draw_flight(
                template, plan, np.random.SeedSequence(77, spawn_key=(i,)), vary=False
            )
            for margin in flown_margins(flight, LIMITS):
                found.setdefault(margin.limit, []).append(margin.left)
        out[wanted] = {
            limit: {
                "smallest": min(left),
                "median": float(np.median(left)),
                "broken": sum(x < 0 for x in left),
            }
            for limit, left in found.items()
        }
    return out


# --- achieved: predicted against achieved sds
# ------------------------------------------------------------------------------


def plans() -> dict[str, Plan]:
    """The three plans whose sds are checked."""
    return {
        PAPER: paper_like_plan(),
        "for the cross terms": plan_for("cross_terms"),
        "for the scale factors": plan_for("scale_factors"),
    }


def _do_shard(path: Path, plan: Plan, seed: int, n: int) -> None:
    found = fit_simulated_campaigns(plan, MISSION, n, seed)
    write_atomically(
        path,
        json.dumps(
            {key: getattr(found, key).tolist() for key in AchievedErrors.__dataclass_fields__}
        )
        + "\n",
    )


def achieved(campaigns: int, jobs: int) -> dict[str, AchievedErrors]:
    """Errors of refitted campaigns by plan; shards of 25 that are there already are read."""
    folder = ROOT / "run_design"
    folder.mkdir(exist_ok=True)
    tasks, files = [], {name: [] for name in plans()}
    for k, (name, plan) in enumerate(plans().items()):
        for shard in range(math.ceil(campaigns / SHARD)):
            path = folder / f"achieved_{k}_{shard:04d}.json"
            files[name].append(path)
            if not path.exists():
                tasks.append((path, plan, 10_000 + shard, SHARD))
    with joblib.parallel_config("loky" if jobs > 1 else "sequential", n_jobs=jobs):
        for done, _ in enumerate(
            joblib.Parallel(return_as="generator_unordered")(
                joblib.delayed(_do_shard)(*task) for task in tasks
            )
        ):
            print(f"{done + 1} of {len(tasks)} shards", end="\r", file=sys.stderr)
    out = {}
    for name, paths in files.items():
        parts = [json.loads(path.read_text()) for path in paths]
        out[name] = AchievedErrors(
            *(
                np.concatenate([np.array(p[key]) for p in parts])
                for key in AchievedErrors.__dataclass_fields__
            )
        )
    return out


def against_achieved(campaigns: int, jobs: int) -> dict:
    """Predicted over achieved sd of every parameter of three plans, with its Monte Carlo error."""
    found = achieved(campaigns, jobs)
    out = {}
    for name, plan in plans().items():
        expected, got = expected_sd(plan, MISSION, truths=200, seed=9), found[name]
        out[name] = {
            "campaigns": len(got.errors),
            "expected": expected.tolist(),
            "achieved": got.sd.tolist(),
            "achieved_error": got.sd_error.tolist(),
            "stated": np.sqrt((got.stated**2).mean(0)).tolist(),
            "ratio": (expected / got.sd).tolist(),
            "ratio_error": (expected / got.sd * got.sd_error / got.sd).tolist(),
            "peak_torque": float(got.peak_torque.max()),
            "peak_momentum": float(got.peak_momentum.max()),
            "reduced_chi2": float(got.chi2.mean()),
        }
    return out


# --- separate: two effects that the five slews cannot tell apart
# -----------------------------------------------------------


def deaf_craft() -> Spacecraft:
    """The same spacecraft without tachometers."""
    return replace(CRAFT, wheels=tuple(replace(w, momentum_sigma=None) for w in CRAFT.wheels))


# Non-centrality that a hidden effect leaves in five slews like the paper's once everything else is
# fitted: an ideal test of three
# components at the level of one candidate's share of the false alarms finds it with probability
# 0.99.
STRENGTH = 30.0


def _hidden(effect: Effect, marks: ScoreTests, seed: int) -> dict:
    """Values {effect: {parameter: value}} of that strength, in the direction that the other effect
    imitates best in the campaign of these fingerprints.
    """
    k = marks.names.index(effect.name)
    own, other = marks.indices[k], marks.indices[1 - k]
    matrix, cross = marks.matrix[np.ix_(own, own)], marks.matrix[np.ix_(own, other)]
    taken = (
        cross
        @ np.linalg.pinv(marks.matrix[np.ix_(other, other)], rcond=1e-9, hermitian=True)
        @ cross.T
    )
    along = linalg.eigh(taken, matrix)[1][:, -1] * (-1.0) ** seed
    space = ParameterSpace(
        tuple(
            (effect.name, p)
            for p in effect.parameters(
                planned_campaign(replace(paper_like_plan(), telemetry_period=0.5), MISSION)
            )
        )
    )
    along = along * np.sqrt(STRENGTH / (along @ matrix @ along)) * space.sd
    return {effect.name: {k: np.asarray(v) for k, v in space.split(along)[effect.name].items()}}


def told_apart(seeds: int) -> dict:
    """Verdicts of `diagnose` for either effect of each pair hidden, on slews like the paper's, and
    when more of them or slews
    designed to separate the two have been flown in addition."""
    out = {"pairs": {}, "hopeless": {}}
    for pair in PAIRS:
        shown, marks = _plans_and_marks(pair, CRAFT)
        rows = out["pairs"].setdefault(",".join(pair), {"plans": {}, "verdicts": []})
        for label, plan in shown.items():
            rows["plans"][label] = {
                "canonical_correlation": marks[label].canonical_correlation(0, 1)
            }
            for effect in by_name(pair):
                for seed in range(seeds):
                    acting = replace(
                        CRAFT, effects=(effect,), values=_hidden(effect, marks["paper"], seed)
                    )
                    rows["verdicts"].append(_verdict(label, plan, acting, effect.name, seed))
    _, marks = _plans_and_marks(HOPELESS, deaf_craft())
    out["hopeless"] = {label: found.canonical_correlation(0, 1) for label, found in marks.items()}
    return out


def _plans_and_marks(
    pair: tuple[str, str], craft: Spacecraft
) -> tuple[dict[str, Plan], dict[str, ScoreTests]]:
    """Slews like the paper's, alone, twice, and with those designed to separate a pair; the pair's
    fingerprints in each.
    """
    tag = "" if craft is CRAFT else "_deaf"
    paper, designed = paper_like_plan(), plan_for(f"separate:{','.join(pair)}", craft, tag=tag)
    shown = {
        "paper": paper.slews,
        "paper twice": paper.slews + paper.slews,
        "paper and designed": paper.slews + designed.slews,
    }
    shown = {
        label: replace(paper, slews=slews, telemetry_period=0.5) for label, slews in shown.items()
    }
    return shown, {label: _marks(plan, craft, pair) for label, plan in shown.items()}


def _marks(plan: Plan, craft: Spacecraft, pair: tuple[str, str]) -> ScoreTests:
    """Score tests of two effects in a flight without them."""
    at = estimate_at_truth(plan, Mission(craft, PRIOR), controller=MISSION.controller())
    return score_tests(move_to(at, Model(at.model.campaign, by_name(pair))), pair)


def _verdict(label: str, plan: Plan, acting: Spacecraft, hidden: str, seed: int) -> dict:
    """What `diagnose` says of one campaign; kept in a file of its own."""
    other = hashlib.sha256(
        repr((plan.slews, hidden, str(acting.values[hidden]))).encode()
    ).hexdigest()[:8]
    path = ROOT / "run_design" / f"verdict_{label.replace(' ', '_')}_{hidden}_{other}_{seed}.json"
    if not path.exists():
        campaign = fly(
            plan,
            Mission(acting, PRIOR),
            500 + seed,
        ).campaign
        found = diagnose(campaign, seed=seed)
        row = {
            "plan": label,
            "hidden": hidden,
            "seed": seed,
            "verdict": found.verdict,
            "named": found.named,
            "ambiguous": found.ambiguous_with,
        }
        row["evidence"] = [(s.added, s.log_bayes_factor) for s in found.steps]
        path.parent.mkdir(exist_ok=True)
        write_atomically(path, json.dumps(row) + "\n")
        print(row, file=sys.stderr)
    return json.loads(path.read_text())


# --- times

_COLD = """
import time; t0 = time.perf_counter()
import resource, json
from bayes_inertia.design.designer import design_plan
from bayes_inertia.flight.mission import most_like_mission
found = design_plan(most_like_mission())
used = resource.getrusage(resource.RUSAGE_SELF)
wall, cpu = time.perf_counter() - t0, used.ru_utime + used.ru_stime
numbers = {"wall": wall, "cpu": cpu, "gain": found.gain, "memory_GB": used.ru_maxrss / 1e6}
print(json.dumps(numbers))
"""


def times() -> dict:
    """Wall and processor time of a cold five-slew design, imports and compilation included, and of
    one gradient.
    """
    cold = json.loads(
        subprocess.run(
            [sys.executable, "-c", _COLD], check=True, capture_output=True, text=True
        ).stdout.splitlines()[-1]
    )
    problem, _, reference, _ = set_up_design(
        MISSION, parse_goal("cross_terms"), LIMITS, paper_like_plan(), 5, seed=0, draws=3
    )
    x = problem.variables(slew_arrays(reference))
    began = time.perf_counter()
    problem.log_value_and_gradient(x, 3)
    first = time.perf_counter() - began
    began = time.perf_counter()
    for _ in range(20):
        problem.log_value_and_gradient(x, 1)
    gradient = (time.perf_counter() - began) / 20
    at = estimate(
        Model(
            fly(
                replace(paper_like_plan(), telemetry_period=0.5),
                MISSION,
                1,
                controller=Controller(CRAFT.inertia_B),
            ).campaign
        ),
        starts=1,
    )
    began = time.perf_counter()
    separating_slew(at, *by_name(PAIRS[0]))
    used = resource.getrusage(resource.RUSAGE_SELF)
    return {
        "cold_design": cold,
        "gradient": gradient,
        "first_gradient": first,
        "separating_slew": time.perf_counter() - began,
        "cpu": used.ru_utime,
    }


# --- pictures and page


@style.styled
def gains_picture(found: dict) -> Figure:
    """Distribution of the goal's number over random feasible plans, with the paper-like and the
    designed plan.
    """
    figure = Figure(figsize=(style.WIDTH, 3.2), layout="constrained")
    titles = {
        "cross_terms": "worst cross term",
        "inertia": "all of J",
        "scale_factors": "worst scale factor",
        "correction_slew": "correction slew",
    }
    for axes, (wanted, row) in zip(figure.subplots(1, len(found)), found.items(), strict=True):
        paper = row["paper"]
        grid = np.linspace(0.0, 1.0, len(row["values"]))
        axes.plot(
            np.array(row["values"]) / paper, grid, color=style.BLUE, label="10,000 random plans"
        )
        axes.axvline(1.0, color=style.MUTED, ls=(0, (4, 2)), label="like the paper's")
        axes.axvline(row["designed"] / paper, color=style.VERMILLION, lw=1.8, label="designed")
        axes.set(xlim=(0.0, 2.0), ylim=(0.0, 1.0), xlabel="sd, over that of paper-like slews")
        axes.set_title(f"{titles[wanted]}: {paper / row['designed']:.2f} times", fontsize=9.0)
    first = figure.axes[0]
    first.set_ylabel("part of the random plans below")
    first.legend(loc="upper right", fontsize=7.5, frameon=True, framealpha=1.0, edgecolor="none")
    return figure


@style.styled
def ratio_picture(found: dict) -> Figure:
    """Predicted over achieved sd of every parameter, three plans, with 2 standard errors."""
    figure = Figure(figsize=(style.WIDTH, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.axhspan(0.95, 1.05, color=style.PALE, alpha=0.6, lw=0, label="± 5 %")
    axes.axhline(1.0, color=style.MUTED, lw=0.8)
    for k, (name, row) in enumerate(found.items()):
        x = np.arange(9) + 0.18 * (k - 1)
        axes.errorbar(
            x,
            row["ratio"],
            2.0 * np.array(row["ratio_error"]),
            fmt=style.MARKERS[k],
            ms=4.5,
            capsize=2,
            color=style.color(k),
            label=name,
        )
        stated = np.array(row["expected"]) / np.array(row["stated"])
        axes.plot(
            x,
            stated,
            "_",
            color=style.INK,
            ms=9,
            label="over the sd that fits state (rms)" if k == 0 else None,
        )
    axes.set(
        xticks=range(9),
        xticklabels=BASE_NAMES,
        ylabel="predicted sd / achieved sd",
        ylim=(0.85, 1.2),
    )
    number = next(iter(found.values()))["campaigns"]
    axes.set_title(
        f"{number} simulated campaigns of each plan, J, K and bias drawn from the prior (bars: "
        "2 standard errors)"
    )
    axes.legend(ncols=3, loc="upper left")
    return figure


def save(figure: Figure, name: str) -> None:
    """Write a picture without date or version."""
    FIGURES.mkdir(exist_ok=True)
    write_atomically(
        FIGURES / name,
        lambda temporary: figure.savefig(temporary, dpi=150, metadata={"Software": None}),
    )


def page() -> str:
    """All results there are, as Markdown."""
    lines = [
        "# Designed plans",
        "",
        "Made by `python analyses/design_study.py`. MOST-like spacecraft; "
        "planned rate 1 deg/s, 1855 s from first to last telemetry:",
    ]
    lines += [
        "the rate and the time of five slews like the paper's (30 to 60 deg about x, y, z and two "
        "diagonals). Wheel limits with 20 % reserve.",
        "",
    ]
    read = {
        key: json.loads(p.read_text())
        for key in ("gains", "flown", "achieved", "separate", "times")
        if (p := RESULTS / f"design_{key}.json").exists()
    }
    if "gains" in read:
        lines += [
            "## Gains",
            "",
            "| goal | paper-like | best of 10,000 random | designed | gain |",
            "|---|---|---|---|---|",
        ]
        for wanted, row in read["gains"].items():
            unit = f" {row['unit']}" if row["unit"] else ""
            best = row["random"]["best"]
            lines.append(
                f"| {wanted} | {row['paper']:.3g}{unit} | {best:.3g} | {row['designed']:.3g} | "
                f"**{row['gain']:.2f}** |"
            )
        seeds = ", ".join(f"{g:.2f}" for g in read["gains"]["cross_terms"]["seeds"])
        lines += [
            "",
            f"Other seeds of the search for the cross terms: gain {seeds}. Smaller is better; "
            "each number is an sd as `criterion` defines it.",
            "",
        ]
    if "achieved" in read:
        lines += [
            "## Predicted over achieved",
            "",
            "| plan | campaigns | " + " | ".join(BASE_NAMES) + " |",
            "|---" * 11 + "|",
        ]
        for name, row in read["achieved"].items():
            cells = [
                f"{r:.3f} ± {e:.3f}" for r, e in zip(row["ratio"], row["ratio_error"], strict=True)
            ]
            lines.append(f"| {name} | {row['campaigns']} | " + " | ".join(cells) + " |")
        paper, better = read["achieved"][PAPER], read["achieved"]["for the cross terms"]
        worst = [max(row["achieved"][3:6]) for row in (paper, better)]
        said = (
            f"Worst cross term, achieved: {worst[0]:.3g} kg m² with slews like the paper's, "
            f"{worst[1]:.3g} designed: "
        )
        lines += ["", f"{said}**{worst[0] / worst[1]:.2f}** times smaller.", ""]
    if "flown" in read:
        lines += [
            "## Margins in flight",
            "",
            f"Smallest margin over {FLIGHTS} closed-loop flights a plan, truths from the prior, "
            "noise on.",
            "",
        ]
        limits = list(next(iter(read["flown"].values())))
        lines += [
            "| goal | " + " | ".join(limits) + " | broken |",
            "|---" * (len(limits) + 2) + "|",
        ]
        for wanted, row in read["flown"].items():
            cells = [f"{100 * row[limit]['smallest']:.1f} %" for limit in limits]
            lines.append(
                f"| {wanted} | "
                + " | ".join(cells)
                + f" | {sum(row[limit]['broken'] for limit in limits)} |"
            )
        lines.append("")
    if "separate" in read:
        lines += [
            "## Effects told apart",
            "",
            f"Either effect of a pair hidden at a strength (non-centrality {STRENGTH:.0f}) that "
            "slews like the paper's just show, in the direction",
            "that the other imitates best. Right: the effect alone is named.",
            "",
            "| hidden | alternative | plan | canonical correlation | named rightly | verdicts |",
            "|---|---|---|---|---|---|",
        ]
        for pair, row in read["separate"]["pairs"].items():
            for hidden in pair.split(","):
                other = next(e for e in pair.split(",") if e != hidden)
                for label in row["plans"]:
                    own = [
                        v for v in row["verdicts"] if v["hidden"] == hidden and v["plan"] == label
                    ]
                    right = sum(v["verdict"] == "named" and v["named"] == [hidden] for v in own)
                    counts = ", ".join(
                        f"{sum(v['verdict'] == k for v in own)} {k}"
                        for k in dict.fromkeys(v["verdict"] for v in own)
                    )
                    lines.append(
                        f"| {hidden} | {other} | {label} | "
                        f"{row['plans'][label]['canonical_correlation']:.3f} | {right} of "
                        f"{len(own)} | {counts} |"
                    )
        apart = " and ".join(
            f"{1.0 - c:.0e} ({label})" for label, c in read["separate"]["hopeless"].items()
        )
        said = (
            f"No slew tells {HOPELESS[0]} from {HOPELESS[1]} without tachometers: "
            "their canonical correlation is 1 but for"
        )
        lines += ["", f"{said} {apart}, although the last plan was designed for it.", ""]
    if "times" in read:
        t = read["times"]
        cold = t["cold_design"]
        lines += [
            "## Times",
            "",
            "A cold design of five slews, imports and compilation included: "
            f"{cold['wall']:.0f} s ({cold['cpu']:.0f} s of processor time).",
        ]
        lines += [
            f"One exact gradient: {1e3 * t['gradient']:.0f} ms (the first one, with compilation: "
            f"{t['first_gradient']:.0f} s)."
        ]
        lines += [f"`separating_slew`: {t['separating_slew']:.0f} s.", ""]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Do the parts asked for and renew page and pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", default="gains,flown,achieved,separate,times")
    parser.add_argument("--campaigns", type=int, default=400, help="for each of three plans")
    parser.add_argument(
        "--seeds", type=int, default=4, help="campaigns for each hidden effect and plan"
    )
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args(arguments)
    parts = given.parts.split(",")
    RESULTS.mkdir(parents=True, exist_ok=True)
    if "gains" in parts:
        save(gains_picture(kept("gains", gains)), "design_gains.png")
    if "flown" in parts:
        kept("flown", flown)
    if "achieved" in parts:
        path = RESULTS / "design_achieved.json"
        found = against_achieved(given.campaigns, given.jobs)
        write_atomically(path, json.dumps(found, indent=1) + "\n")
        save(ratio_picture(found), "design_ratio.png")
        contenders = list(
            compare_plans(
                {k: v for k, v in plans().items() if k != "for the scale factors"},
                MISSION,
                limits=LIMITS,
            )
        )
        done = achieved(given.campaigns, given.jobs)
        shown: list[Contender] = [replace(c, achieved=done[c.name]) for c in contenders]
        save(draw_comparison(shown), "design_compare.png")
    if "separate" in parts:
        kept("separate", lambda: told_apart(given.seeds))
    if "times" in parts:
        kept("times", times)
    text = page()
    write_atomically(RESULTS / "design.md", text)
    print(text)


if __name__ == "__main__":
    main()
