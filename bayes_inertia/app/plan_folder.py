"""`design`, `compare` and `simulate` on a folder: plans are named, designed, compared, flown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from bayes_inertia.app.fit_campaign import settled_estimate
from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.options import DesignRequest, names_in
from bayes_inertia.app.result_folder import ResultFolder
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.checked_toml import checked_document, parse_toml
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.campaign.schema import Part, Vector3
from bayes_inertia.design.after_campaign import mission_after, plan_after
from bayes_inertia.design.comparison import Contender
from bayes_inertia.design.designer import design_plan
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.limits import KeepOut, Limits, rate_turned_at
from bayes_inertia.design.margins import broken_limits, planned_margins
from bayes_inertia.design.result import Design
from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import read_bytes, text_of, write_atomically
from bayes_inertia.flight.mission import (
    Mission,
    devices_at_rest,
    following_plan,
    most_like_mission,
    why_no_plans,
)
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_file import read_plan, write_plan
from bayes_inertia.flight.planned_motion import plan_start
from bayes_inertia.flight.simulated_campaigns import draw_spacecraft, simulate, simulate_again
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths.values import json_ready, picked
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named, pinned_names
from bayes_inertia.physics.parameters import base_names
from bayes_inertia.progress import Progress, silent
from bayes_inertia.report.formatting import brief, plain
from bayes_inertia.report.plan_sections import comparison_sections, design_sections
from bayes_inertia.sealing import sha256_of
from bayes_inertia.studies.engine import Execution
from bayes_inertia.studies.plan_comparison import compare_plans

PAPER = "paper"


def plans_named(texts: Sequence[str], campaign: Campaign) -> dict[str, Plan]:
    """Plans from files, or `paper`, all of them from where the campaign ended.

    Those that would be printed alike bear the name of their file too.
    """
    base, wheels = following_plan(campaign), len(campaign.without_locked_wheels().wheels)
    read = [(text, plan_for(text, wheels, base)) for text in texts]
    printed = [plain(plan.name) for _, plan in read]
    named = {
        plan.name if printed.count(name) == 1 else f"{plan.name} ({Path(text).stem})": plan
        for name, (text, plan) in zip(printed, read, strict=True)
    }
    if len({plain(name) for name in named}) < len(read):
        raise CampaignError("the same plan twice", where="plans", advice="give each once")
    return named


def plan_for(path: str | Path, wheels: int, base: Plan | None = None) -> Plan:
    """The plan in a file, for a spacecraft of so many wheels; `base`: see `read_plan`.

    `paper` stands for five slews like the paper's, which start as `base` does.
    """
    if str(path) == PAPER:
        like = paper_like_plan()
        name = "five slews like the paper's"
        return like if base is None else replace(base, name=name, slews=like.slews)
    plan = read_plan(path, base)
    try:
        plan_start(plan, wheels)
    except CampaignError as error:
        raise error.inside(str(path)) from None
    return plan


def plan_sha256(plan: Plan) -> str:
    """Digest of a plan: two plans of one digest are flown alike."""
    return sha256_of(repr(asdict(plan)))


_ACHIEVED_KEYS = ("achieved_sd", "achieved_sd_standard_error", "stated_sd")
_MARGIN_KEYS = ("limit", "where", "used", "allowed", "unit", "left", "kept", "says")


def contender_json(contender: Contender) -> dict[str, Any]:
    """A plan in a comparison: expected and achieved sds, costs, margins, slews."""
    names = base_names(len(contender.expected))
    content = {
        "expected_sd": dict(zip(names, contender.expected, strict=True)),
        "total_time_s": contender.total_time,
        "motion_time_s": contender.motion_time,
        "peak_momentum_Nms": contender.peak_momentum,
        "peak_torque_Nm": contender.peak_torque,
        "margins": [picked(margin, *_MARGIN_KEYS) for margin in contender.margins],
        "slews": contender.plan.slew_rows(),
    }
    if (achieved := contender.achieved) is not None:
        sds = (achieved.sd, achieved.sd_error, achieved.stated_sd)
        for key, sd in zip(_ACHIEVED_KEYS, sds, strict=True):
            content[key] = dict(zip(names, sd, strict=True))
        content |= {"reduced_chi2": achieved.chi2.mean(), "campaigns": len(achieved.errors)}
    return json_ready(content)


def design_json(
    design: Design, contenders: Sequence[Contender], campaign: Campaign
) -> dict[str, Any]:
    """A design: what it is expected to give, beside slews like the paper's."""
    designed, reference = contenders
    return {
        "campaign": campaign.name,
        "goal": {"name": str(design.goal), "says": design.goal.says, "unit": design.goal.unit},
        **picked(design, "value", "reference_value", "gain"),
        "best_of_random_plans": json_ready(design.best_random),
        "random_plans": design.random_plans,
        "expected_sd": design.sd,
        **picked(design, "reference_sd", "sd_before"),
        "plan": contender_json(designed),
        "reference": contender_json(reference),
        "margins": [picked(margin, *_MARGIN_KEYS) for margin in design.margins],
        "flown_margins": [picked(margin, *_MARGIN_KEYS) for margin in design.flown],
        "kept": design.kept,
        "active_limits": list(design.active),
        "limits": design.limits.to_json(),
        "history": [list(path) for path in design.history],
        **picked(design, "seed", "seconds"),
    }


def limits_asked(request: DesignRequest, campaign: Campaign) -> Limits:
    """The limits that are asked for; without a largest rate, that which the campaign turned at."""
    usual = Limits()
    own_rate = rate_turned_at(campaign) / (1.0 - usual.rate_reserve)
    return Limits(
        rate=_positive_option("--max-rate", "deg/s", request.max_rate, own_rate),
        angle=_positive_option("--max-angle", "deg", request.max_angle, usual.angle),
        acceleration=_positive_option(
            "--max-acceleration", "deg/s^2", request.max_acceleration, None
        ),
        total_time=_positive_option("--total-time", "s", request.total_time, None),
        end_attitude=_quaternion(request.end_attitude),
        keep_out=keep_outs(request.keep_out or ()),
    )


def _positive_option(option: str, unit: str, value: float | None, otherwise: float | None) -> Any:
    """A positive number of an option, degrees in radians."""
    if value is None:
        return otherwise
    says = "no positive number" if value == math.inf else "not positive"
    what, advice = f"{value:g} {unit} is {says}", f"give a positive number of {unit}"
    require(0.0 < value < math.inf, option, what, advice)
    return math.radians(value) if unit.startswith("deg") else value


def _quaternion(text: str | None) -> tuple[float, float, float, float] | None:
    if text is None:
        return None
    try:
        q1, q2, q3, q4 = (float(part) for part in text.split(","))
    except ValueError:
        what, advice = f"{text!r} is no quaternion", "give q1,q2,q3,q4, scalar last"
        raise CampaignError(what, where="end_attitude", advice=advice) from None
    return q1, q2, q3, q4


def keep_outs(texts: Sequence[str]) -> tuple[KeepOut, ...]:
    """Keep-out cones from texts or files.

    `texts`: each `name,x,y,z,half_angle_deg` (inertial direction), or a TOML file with [[keep_out]]
    tables of the keys name, direction_N, half_angle_deg.

    >>> keep_outs(["Sun,1,0,0,30"])[0].name
    'Sun'
    """
    cones: list[KeepOut] = []
    for text in texts:
        cones += _cones_in(Path(text)) if Path(text).is_file() else _cone(text)
    return tuple(cones)


class _Cone(Part):
    name: str = Field(description='name = "Sun"')
    direction_N: Vector3 = Field(description="direction_N = [x, y, z], in inertial axes")
    half_angle_deg: float = Field(gt=0.0, lt=180.0, description="half_angle_deg = 35.0")


class _Cones(Part):
    keep_out: list[_Cone] = Field(description="a table [[keep_out]] for each cone")


def _cone(text: str) -> list[KeepOut]:
    label, (name, *numbers) = f"--keep-out {text!r}", (part.strip() for part in text.split(","))
    try:
        x, y, z, angle = (float(number) for number in numbers)
    except ValueError:
        what = "neither a file nor name,x,y,z,half_angle_deg"
        advice = "write for example Sun,0.8,0.5,0.3,35"
        raise CampaignError(what, where=label, advice=advice) from None
    cone = {"name": name, "direction_N": [x, y, z], "half_angle_deg": angle}
    return _cones_of(checked_document({"keep_out": [cone]}, label, _Cones), label)


def _cones_in(path: Path) -> list[KeepOut]:
    label = str(path)
    return _cones_of(parse_toml(text_of(read_bytes(path), label), label, _Cones), label)


def _cones_of(stated: _Cones, label: str) -> list[KeepOut]:
    try:
        return [
            KeepOut(cone.name, (x, y, z), math.radians(cone.half_angle_deg))
            for cone in stated.keep_out
            for x, y, z in [cone.direction_N]
        ]
    except CampaignError as error:
        raise error.inside(label) from None


_RESULTS = ("plan.toml", "design.png", "design.html")
FORMAT, COMPARISON_FORMAT = "bayes-inertia-design/1", "bayes-inertia-compare/1"
SIMULATE_FORMAT = "bayes-inertia-simulate/1"
WHEELS_AT_REST = (
    "the wheels are taken to be at rest at the start: no tachometer of the last slew tells more; "
    "with --after the fit tells their momentum"
)


@dataclass(frozen=True)
class DesignedPlan:
    """Result of `design` on a folder."""

    design: Design
    notes: tuple[str, ...]  # what must be known before the plan is flown

    @property
    def kept(self) -> bool:
        """Whether the plan, when flown, keeps all limits."""
        return self.design.kept


def run_design(
    campaign: Path, folder: Path, request: DesignRequest, progress: Progress = silent
) -> DesignedPlan:
    """Design a campaign that follows another one; write design.json, plan.toml, .png and .html.

    It begins where the campaign ended, with its telemetry period and, unless one is given, its
    largest rate. The wheel momentum at the start is that of the tachometers; without them that of
    the fit (`after`), or zero where nothing was fitted, which the results then say.
    """
    flown, digest = read_campaign(campaign), campaign_sha256(campaign)
    parse_goal(request.goal)
    effects = pinned_names(names_in(request.effects))
    options = asdict(request) | {"effects": effects, "keep_out": request.keep_out or []}
    owner = ResultFolder(folder, "design", "design.json", FORMAT, digest, options, _RESULTS)
    owner.holds_this_work()
    limits = limits_asked(request, flown)
    after = _fitted(flown, effects, request.seed, progress) if request.after else None
    mission = Mission.of(flown)
    design = design_plan(
        mission,
        request.goal,
        limits,
        base=following_plan(flown) if after is None else plan_after(after),
        n_slews=request.slews,
        seed=request.seed,
        after=after,
        effects=effects,
        progress=progress,
    )
    known = mission if after is None else mission_after(mission, after)
    contenders = compare_plans(
        [design.plan, design.reference], known, limits=design.limits, progress=progress
    )
    content = design_json(design, contenders, flown) | _start(design.plan, flown, request.after)
    left_out = devices_at_rest(flown)
    content |= {"left_out": left_out} if left_out else {}
    unknown = content["start_wheel_momentum_Nms"] and not design.plan.wheel_momentum
    notes = (*left_out, *((WHEELS_AT_REST,) if unknown else ()))
    sections = design_sections(design, contenders, request.after, notes)
    owner.write(
        content, f"Next slews after {flown.name}", sections, campaign, mission=flown.mission
    )
    write_plan(design.plan, folder / "plan.toml", overwrite=True)
    text = read_bytes(folder / "plan.toml").decode()
    write_atomically(folder / "plan.toml", _comments(design, notes) + text)
    return DesignedPlan(design, notes)


def _fitted(flown: Campaign, effects: Sequence[str], seed: int, progress: Progress) -> Estimate:
    """The estimate that `fit` samples; effects take from what the campaign tells of J and K."""
    progress("fitting the campaign", 0, 0)
    model = Model(flown, effects_named(effects))
    return settled_estimate(model, seed, False, progress)[0]


def _start(plan: Plan, flown: Campaign, after: bool) -> dict[str, Any]:
    """Start of the plan, as it stands in design.json."""
    wheels, source = len(flown.without_locked_wheels().wheels), "tachometers"
    if not wheels:
        source = "there are no wheels"
    elif not following_plan(flown).wheel_momentum:
        source = "fit" if after else "unknown, taken to be zero"
    return {
        "after": after,
        "start_wheel_momentum_Nms": list(plan.wheel_momentum) or [0.0] * wheels,
        "start_wheel_momentum_from": source,
    }


def _comments(design: Design, notes: Sequence[str]) -> str:
    """For operators: the plan's slews and margins, as comments of its file."""
    goal = f"{design.goal.says}, {brief(design.value, 3)} {design.goal.unit} expected".rstrip()
    lines = [
        f"# {design.plan.name}: {goal}",
        "#",
        "# slew   starts [s]   lasts [s]   angle [deg]   rate [deg/s]   about body axes x, y, z",
    ]
    for i, row in enumerate(design.plan.slew_rows()):
        axis = ", ".join(f"{x:+.3f}" for x in row["axis_B"])
        times = f"{row['start_s']:12.2f} {row['duration_s']:11.2f}"
        motion = f"{row['angle_deg']:13.1f} {row['rate_deg_s']:14.3f}"
        lines.append(f"# {i + 1:4d} {times} {motion}   {axis}")
    lines += ["#", "# tightest margins when flown, with noise and J, K drawn from what is known:"]
    tightest = sorted(design.flown, key=lambda m: m.left)[: LAYOUT.margins_of_folder]
    lines += [f"#   {m.says}" for m in tightest]
    lines += [line for note in notes for line in ("#", f"# {note}")]
    return "\n".join([*lines, "", ""])


def run_compare(
    campaign: Path,
    plans: Sequence[str],
    folder: Path,
    *,
    simulated: int = 0,
    seed: int = 0,
    execution: Execution | None = None,
) -> tuple[Contender, ...]:
    """Compare plans and write compare.json, compare.png and compare.html."""
    flown, digest = read_campaign(campaign), campaign_sha256(campaign)
    named = plans_named(plans, flown)
    options = {
        "plans": {name: plan_sha256(plan) for name, plan in named.items()},
        "simulated": simulated,
        "seed": seed,
    }
    results = ("compare.png", "compare.html")
    owner = ResultFolder(
        folder, "comparison", "compare.json", COMPARISON_FORMAT, digest, options, results
    )
    if not owner.holds_this_work() and simulated:
        owner.claim()  # before the first fit is kept
    contenders = compare_plans(
        named,
        Mission.of(flown),
        simulated=simulated,
        seed=seed,
        folder=folder / "fits",
        **vars(execution or Execution()),
    )
    rows = {c.name: contender_json(c) for c in contenders}
    stated = {"campaign": flown.name, "simulated": simulated, "seed": seed}
    content = stated | {"plans": rows}
    sections = comparison_sections(contenders)
    owner.write(content, f"Plans after {flown.name}", sections, campaign, mission=flown.mission)
    return contenders


_FOLLOWED = (
    "the plan was followed exactly: only wheels with a gyro of three axes close an attitude loop "
    "in a simulated flight"
)


def run_simulate(
    folder: Path,
    plan: str | None = None,
    campaign: Path | None = None,
    *,
    hidden: Sequence[str] = (),
    draw: bool = False,
    seed: int = 0,
) -> dict[str, Any]:
    """Fly a plan and write the campaign folder, with its truth beside it; what `--json` prints.

    `plan`: file of the plan, or `paper`; None for five slews like the paper's. `campaign`: folder
    of the campaign whose spacecraft flies: its wheels and sensors, their noise, J and K at the mean
    of its prior; one that no plan flies repeats its own slews, where none is named. None for the
    MOST-like spacecraft. `draw`: whether J and K are drawn from the
    campaign's prior instead.
    """
    if campaign is None:
        advice = "name the campaign that states it with --campaign"
        require(not draw, "--draw", "J and K cannot be drawn without a prior", advice)
        mission = most_like_mission()
        wheels = len(mission.spacecraft.wheels)
        chosen = plan_for(plan or PAPER, wheels)
        flight = simulate(chosen, mission, folder, seed, hidden=hidden)
        notes = note_of_broken_limits(chosen, mission)
        return _simulated(folder, flight.campaign, "the MOST-like spacecraft", *notes)
    given = read_campaign(campaign)
    truth = "drawn from" if draw else "at the mean of"
    spacecraft = f"the spacecraft of {campaign}, J and K {truth} its prior"
    if plan is None and (why := why_no_plans(given)):
        flown = simulate_again(given, folder, seed, draw=draw, hidden=hidden)
        said = f"{why}: this campaign's own slews were flown again, from where each began"
        return _simulated(folder, flown, spacecraft, said)
    (chosen,) = plans_named([plan or PAPER], given).values()
    mission = _drawn_mission(given, seed) if draw else Mission.of(given)
    flight = simulate(chosen, mission, folder, seed, hidden=hidden)
    followed = () if mission.spacecraft.flies_by_gyro else (_FOLLOWED,)
    notes = (*note_of_broken_limits(chosen, mission), *followed, *devices_at_rest(given))
    return _simulated(folder, flight.campaign, spacecraft, *notes)


def _simulated(folder: Path, flown: Campaign, spacecraft: str, *notes: str) -> dict[str, Any]:
    """What was flown, by whose spacecraft, and what the simulation leaves out, as JSON values."""
    return {
        "format": SIMULATE_FORMAT,
        "campaign": str(folder),
        "slews": [slew.name for slew in flown.slews],
        "truth": str(folder / "truth.json"),
        "spacecraft": spacecraft,
        "notes": list(notes),
    }


def note_of_broken_limits(plan: Plan, mission: Mission) -> tuple[str, ...]:
    """The limits of a spacecraft that a plan breaks, in one note; none where it keeps all."""
    broken = broken_limits(planned_margins(plan, mission.spacecraft, Limits(angle=None)))
    said = "; ".join(margin.says for margin in broken)
    return (f"limits broken: {said}",) if broken else ()


def _drawn_mission(campaign: Campaign, seed: int) -> Mission:
    # Its own stream: the same seed draws noise and effects.
    rng = np.random.default_rng([seed, 3])
    craft = replace(draw_spacecraft(campaign, rng), bias=None)
    return Mission(craft, campaign.inertia, campaign.prior)
