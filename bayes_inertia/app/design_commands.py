"""`design` and `compare` on folders: read a campaign's hardware and prior, design or compare plans, write what was found."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.design.after_campaign import plan_after
from bayes_inertia.design.comparison import NAMES, Contender, compare_plans
from bayes_inertia.design.designer import Design, design_plan
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.limits import KeepOut, Limits
from bayes_inertia.design.margins import Margin
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.files import check_folder, make_folder, write_atomically
from bayes_inertia.flight.follow_on import following_plan, spacecraft_at
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_file import read_plan, write_plan
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.pictures.design import comparison as picture

DESIGN_FORMAT, COMPARE_FORMAT = "bayes-inertia-design/1", "bayes-inertia-compare/1"
PAPER = "paper"
WHEELS_AT_REST = (
    "The wheels are taken to be at rest at the start: no tachometer of the last slew tells more. "
    "With --after the fit tells their momentum."
)


@dataclass(frozen=True)
class Request:
    """What `design` is asked for: `goal`, number of `slews`, limits in degrees and seconds (None: not given), `keep_out` texts or
    files, `after` whether the campaign's telemetry counts, `seed`."""

    goal: str = "cross_terms"
    slews: int = 5
    total_time: float | None = None
    max_rate: float | None = None
    max_angle: float | None = None
    max_acceleration: float | None = None
    end_attitude: str | None = None
    keep_out: tuple[str, ...] = ()
    after: bool = False
    seed: int = 0


def run_design(campaign: Path, folder: Path, request: Request) -> Design:
    """Design a campaign that follows another one, and write design.json, plan.toml and design.png.

    It begins where the campaign ended, with its telemetry period and, unless one is given, its
    largest rate. The wheel momentum at the start is that of the tachometers; without them that of
    the fit (`after`), or zero where nothing was fitted, which the results then say.

    Raises
    ------
    CampaignError, EffectError : bad input. DesignError : no plan keeps the limits. OutputError : the folder holds something else. Nothing is written then.
    """
    flown, digest = read_campaign(campaign), campaign_sha256(campaign)
    parse_goal(request.goal)
    _ours_or_error(folder, "design.json", DESIGN_FORMAT, digest, ("plan.toml", "design.png"))
    limits = _limits(flown, request)
    at = estimate(Model(flown), seed=request.seed) if request.after else None
    craft = prior_spacecraft(flown)
    found = design_plan(
        craft,
        flown.inertia,
        request.goal,
        limits,
        base=following_plan(flown) if at is None else plan_after(at),
        n_slews=request.slews,
        seed=request.seed,
        after=at,
    )
    contenders = compare_plans(
        [found.plan, found.reference], craft, flown.inertia, limits=found.limits
    )
    make_folder(folder)
    content = _design_content(found, contenders, flown) | {
        "campaign_sha256": digest,
        "after": request.after,
        "start_wheel_momentum_Nms": list(found.plan.wheel_momentum) or [0.0] * len(flown.wheels),
        "start_wheel_momentum_from": _momentum_source(flown, request),
    }
    write_plan(found.plan, folder / "plan.toml", overwrite=True)
    write_atomically(
        folder / "plan.toml", _for_operators(found, (folder / "plan.toml").read_text())
    )
    _save(picture(contenders), folder / "design.png")
    write_atomically(folder / "design.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    return found


def run_compare(
    campaign: Path,
    plans: Sequence[str],
    folder: Path,
    *,
    simulated: int = 0,
    seed: int = 0,
    jobs: int = 1,
) -> tuple[Contender, ...]:
    """Compare plan files (or `paper`, the five slews like the paper's) and write compare.json and compare.png.

    Raises
    ------
    CampaignError : campaign or a plan is no good. OutputError : the folder holds something else.
    """
    flown, digest = read_campaign(campaign), campaign_sha256(campaign)
    _ours_or_error(folder, "compare.json", COMPARE_FORMAT, digest, ("compare.png",))
    named = plans_named(plans, flown)
    contenders = compare_plans(
        named, prior_spacecraft(flown), flown.inertia, simulated=simulated, seed=seed, jobs=jobs
    )
    make_folder(folder)
    content = {
        "format": COMPARE_FORMAT,
        "campaign": flown.name,
        "campaign_sha256": digest,
        "simulated": simulated,
        "seed": seed,
        "plans": {c.name: _contender_content(c) for c in contenders},
    }
    _save(picture(contenders), folder / "compare.png")
    write_atomically(folder / "compare.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    return contenders


def keep_outs(given: Sequence[str]) -> tuple[KeepOut, ...]:
    """Keep-out cones from texts `name,x,y,z,half_angle_deg` (inertial direction) or TOML files with [[keep_out]] tables of those keys.

    Raises `CampaignError` naming what cannot be read.

    >>> keep_outs(["Sun,1,0,0,30"])[0].name
    'Sun'
    """
    out: list[KeepOut] = []
    for text in given:
        path = Path(text)
        if path.is_file():
            out += _cones_in(path)
            continue
        parts = [part.strip() for part in text.split(",")]
        try:
            x, y, z, angle = (float(part) for part in parts[1:])
        except ValueError:
            where = f"keep-out {text!r}"
            raise CampaignError(
                "neither a file nor name,x,y,z,half_angle_deg",
                where=where,
                advice="write for example Sun,0.8,0.5,0.3,35",
            ) from None
        out.append(KeepOut(parts[0], (x, y, z), math.radians(angle)))
    return tuple(out)


def _cones_in(path: Path) -> list[KeepOut]:
    try:
        tables = tomllib.loads(path.read_text())["keep_out"]
        return [
            KeepOut(
                t["name"],
                tuple(float(x) for x in t["direction_N"]),
                math.radians(t["half_angle_deg"]),
            )
            for t in tables
        ]
    except (tomllib.TOMLDecodeError, KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        advice = (
            'write [[keep_out]] with name = "Sun", direction_N = [x, y, z], half_angle_deg = 35'
        )
        raise CampaignError(
            f"no keep-out cones ({error!r})", where=str(path), advice=advice
        ) from error


def _limits(campaign: Campaign, request: Request) -> Limits:
    reserve = Limits().rate_reserve
    end = None
    if request.end_attitude is not None:
        try:
            end = tuple(float(part) for part in request.end_attitude.split(","))
        except ValueError:
            raise CampaignError(
                f"{request.end_attitude!r} is no quaternion",
                where="end attitude",
                advice="give q1,q2,q3,q4, scalar last",
            ) from None
    degrees = {"angle": request.max_angle, "acceleration": request.max_acceleration}
    return Limits(
        rate=campaign.largest_rate() / (1.0 - reserve)
        if request.max_rate is None
        else math.radians(request.max_rate),
        total_time=request.total_time,
        end_attitude=end,
        keep_out=keep_outs(request.keep_out),
        **{key: math.radians(value) for key, value in degrees.items() if value is not None},
    )


def prior_spacecraft(campaign: Campaign) -> Spacecraft:
    """The spacecraft that a campaign's prior describes."""
    return spacecraft_at(
        campaign, np.concatenate([campaign.inertia.elements, campaign.rate_sensor.scale_factor])
    )


def plans_named(given: Sequence[str], campaign: Campaign) -> dict[str, Plan]:
    """Plans from files (or `paper`, the five slews like the paper's, from where the campaign ended), by name.

    Raises `CampaignError` for a plan that cannot be read or is given twice.
    """
    base = following_plan(campaign)
    # The paper's slews from where the campaign ended, so that all plans start alike.
    paper = replace(base, name="five slews like the paper's", slews=paper_like_plan().slews)
    read = [(text, paper if text == PAPER else read_plan(text)) for text in given]
    names = [plan.name for _, plan in read]
    named = {
        plan.name if names.count(plan.name) == 1 else f"{plan.name} ({Path(text).stem})": plan
        for text, plan in read
    }
    if len(named) < len(read):
        raise CampaignError("the same plan twice", where="plans", advice="give each once")
    return named


def _ours_or_error(folder: Path, name: str, form: str, digest: str, others: Sequence[str]) -> None:
    advice = "choose another folder; nothing was overwritten"
    check_folder(folder)
    path = folder / name
    if not path.exists():
        for other in others:
            if (folder / other).exists():
                raise OutputError(
                    f"{other} is there already, without {name}", where=str(folder), advice=advice
                )
        return
    try:
        there = json.loads(path.read_text())
        known, same = there.get("format") == form, there.get("campaign_sha256") == digest
    except (ValueError, OSError, AttributeError):
        known, same = False, False
    if not known or not same:
        what = (
            f"{name} there was not written by this command"
            if not known
            else "holds results of other data"
        )
        raise OutputError(what, where=str(folder), advice=advice)


def _save(figure: Any, path: Path) -> None:
    write_atomically(
        path,
        lambda temporary: figure.savefig(
            temporary, format="png", dpi=130, metadata={"Software": None}
        ),
    )


def _momentum_source(campaign: Campaign, request: Request) -> str:
    """What tells the wheel momentum that the plan begins with."""
    if following_plan(campaign).wheel_momentum:
        return "tachometers"
    return "fit" if request.after else "unknown, taken to be zero"


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _margin_content(margin: Margin) -> dict[str, Any]:
    return {
        key: getattr(margin, key)
        for key in ("limit", "where", "used", "allowed", "unit", "left", "kept", "says")
    }


def _slew_content(plan: Plan) -> list[dict[str, Any]]:
    return [
        {
            "axis_B": list(slew.axis_B),
            "angle_deg": math.degrees(slew.angle),
            "rate_deg_s": math.degrees(slew.rate),
            "acceleration_deg_s2": math.degrees(slew.acceleration),
            "start_s": start,
            "duration_s": duration,
        }
        for slew, start, duration in zip(plan.slews, plan.starts, plan.durations, strict=True)
    ]


def _contender_content(c: Contender) -> dict[str, Any]:
    content = {
        "expected_sd": dict(zip(NAMES, c.expected.tolist(), strict=True)),
        "total_time_s": c.total_time,
        "motion_time_s": c.motion_time,
        "peak_momentum_Nms": _number(c.peak_momentum),
        "peak_torque_Nm": _number(c.peak_torque),
        "margins": [_margin_content(m) for m in c.margins],
        "slews": _slew_content(c.plan),
    }
    if c.achieved is None:
        return content
    a = c.achieved
    return content | {
        "achieved_sd": dict(zip(NAMES, a.sd.tolist(), strict=True)),
        "achieved_sd_standard_error": dict(zip(NAMES, a.sd_error.tolist(), strict=True)),
        "stated_sd": dict(zip(NAMES, a.stated.mean(0).tolist(), strict=True)),
        "reduced_chi2": float(a.chi2.mean()),
        "campaigns": len(a.errors),
    }


def _design_content(
    found: Design, contenders: Sequence[Contender], campaign: Campaign
) -> dict[str, Any]:
    designed, reference = contenders
    return {
        "format": DESIGN_FORMAT,
        "campaign": campaign.name,
        "goal": {"name": str(found.goal), "says": found.goal.says, "unit": found.goal.unit},
        "value": found.value,
        "reference_value": found.reference_value,
        "gain": found.gain,
        "best_of_random_plans": _number(found.best_random),
        "random_plans": found.random_plans,
        "expected_sd": found.sd,
        "reference_sd": found.reference_sd,
        "plan": _contender_content(designed),
        "reference": _contender_content(reference),
        "margins": [_margin_content(m) for m in found.margins],
        "flown_margins": [_margin_content(m) for m in found.flown],
        "kept": found.kept,
        "active_limits": list(found.active),
        "limits": found.limits.to_json(),
        "history": [list(path) for path in found.history],
        "seed": found.seed,
        "seconds": found.seconds,
    }


def _for_operators(found: Design, text: str) -> str:
    """The plan file with a table of its slews and margins as comments."""
    lines = [
        f"# {found.plan.name}: {found.goal.says}, {found.value:.3g} {found.goal.unit} expected".rstrip(),
        "#",
    ]
    lines += [
        "# slew   starts [s]   lasts [s]   angle [deg]   rate [deg/s]   about body axes x, y, z"
    ]
    for i, row in enumerate(_slew_content(found.plan)):
        axis = ", ".join(f"{x:+.3f}" for x in row["axis_B"])
        lines.append(
            f"# {i + 1:4d} {row['start_s']:12.2f} {row['duration_s']:11.2f} {row['angle_deg']:13.1f} {row['rate_deg_s']:14.3f}   {axis}"
        )
    lines += [
        "#",
        "# tightest margins when flown in closed loop, with noise and J, K drawn from what is known:",
    ]
    lines += [f"#   {m.says}" for m in sorted(found.flown, key=lambda m: m.left)[:6]]
    if not found.plan.wheel_momentum:
        lines += ["#", f"# {WHEELS_AT_REST}"]
    return "\n".join([*lines, "", text])
