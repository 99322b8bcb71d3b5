"""Simulated campaigns: one written to a folder with its truth, or one of many in a calibration study."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.inertia_prior import InertiaPrior
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import EffectError, OutputError
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import Flight, fly, planned_campaign
from bayes_inertia.flight.spacecraft import (
    Controller,
    Spacecraft,
    most_like_prior,
    most_like_spacecraft,
    spin_tensor,
)
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.physical_draws import draw_physical
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.parameters import ParameterSpace


def simulate(
    plan: Plan,
    out_folder: str | Path,
    seed: int,
    *,
    spacecraft: Spacecraft,
    prior: InertiaPrior,
    controller: Controller | None = None,
    name: str | None = None,
) -> Flight:
    """Fly a plan and write the campaign folder, with `truth.json` beside it.

    Parameters
    ----------
    controller : None for one that believes the prior.

    Raises `OutputError` if another campaign is in the folder; otherwise as `fly`.
    """
    controller = controller or Controller.from_prior(
        prior, spacecraft.rate_sensor, spacecraft.wheels
    )
    flight = fly(plan, spacecraft, controller, prior, seed, name)
    folder = Path(out_folder)
    text = json.dumps(truth_of(flight, seed), indent=1) + "\n"
    path = folder / "truth.json"
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise OutputError(
            "would overwrite the truth of another campaign",
            where=str(path),
            advice="write to a new folder",
        )
    write_campaign(flight.campaign, folder)
    write_atomically(path, text)
    return flight


def simulate_most(
    plan: Plan, out_folder: str | Path, seed: int, hidden: Sequence[str] = ()
) -> Flight:
    """Fly a plan with the MOST-like spacecraft of Ferguson's Table 1, and write the campaign folder.

    Parameters
    ----------
    hidden : effects that act and that the campaign does not mention, each `name` (parameters drawn from their
        priors) or `name.parameter=value[,value...]` (parameters not named are at their null).

    Raises `EffectError` for an unknown effect or parameter or a wrong number of values; otherwise as `simulate`.
    """
    craft, prior = most_like_spacecraft(), most_like_prior()
    template = planned_campaign(plan, craft, prior)
    effects, values = _hidden(hidden, template, np.random.default_rng([seed, 2]))
    return simulate(
        plan,
        out_folder,
        seed,
        spacecraft=replace(craft, effects=effects, values=values),
        prior=prior,
    )


def _hidden(
    requests: Sequence[str], template: Campaign, rng: np.random.Generator
) -> tuple[tuple[Effect, ...], dict[str, dict[str, Any]]]:
    """Effects and values that requests like `wheel_command_lag.tau=0.12` name."""
    parsed = [
        (*request.partition("=")[0].partition(".")[::2], request.partition("=")[2])
        for request in requests
    ]
    effects = by_name(tuple(dict.fromkeys(name for name, _, _ in parsed)))
    values: dict[str, dict[str, Any]] = {}
    for effect in effects:
        space = ParameterSpace(tuple((effect.name, p) for p in effect.parameters(template)))
        mine = [(key, text) for name, key, text in parsed if name == effect.name]
        drawn = not any(key for key, _ in mine)
        own = {
            k: np.asarray(v)
            for k, v in space.split(space.draw(rng, 1)[0] if drawn else space.nulls)[
                effect.name
            ].items()
        }
        for key, text in (pair for pair in mine if pair[0]):
            own[key] = _value(effect.name, key, text, own)
        values[effect.name] = own
    return effects, values


def _value(effect: str, key: str, text: str, own: Mapping[str, np.ndarray]) -> np.ndarray:
    if key not in own:
        raise EffectError(
            f"no parameter {key!r}", where=effect, advice=f"its parameters are {', '.join(own)}"
        )
    try:
        given = np.array([float(x) for x in text.split(",")])
        return np.broadcast_to(given, own[key].shape) if own[key].shape else given.reshape(())
    except ValueError:
        count = f"{own[key].size} number{'s' if own[key].size > 1 else ''}"
        raise EffectError(
            f"{text!r} is not {count}",
            where=f"{effect}.{key}",
            advice="give numbers separated by commas",
        ) from None


def truth_of(flight: Flight, seed: int | None = None) -> dict[str, Any]:
    """What was true in a flight, as plain numbers and lists: J, K, bias, effects, and each slew's start state and final error."""
    craft = flight.spacecraft
    locked = craft.inertia_B + spin_tensor(craft.wheels)
    values = {e: {k: np.asarray(v).tolist() for k, v in p.items()} for e, p in craft.values.items()}
    slews = [
        {
            "q0": x.attitude[0].tolist(),
            "w0": x.rate_B[0].tolist(),
            "h0_rel": x.wheel_momentum[0].tolist(),
            "final_error_B_rad": error.tolist(),
        }
        for x, error in zip(flight.truth, flight.final_error_B, strict=True)
    ]
    return {
        "J_kgm2": craft.inertia_B.tolist(),
        "J_locked_kgm2": locked.tolist(),
        "K": list(craft.scale_factor),
        "C_rate": craft.rate_sensor.axes.tolist(),
        "b_radps": list(craft.bias),
        "wheel_axes_B": craft.wheel_axes_B.tolist(),
        "effects": values or {"none": {}},
        "slews": slews,
        "seed": seed,
    }


def draw_spacecraft(
    template: Campaign,
    rng: np.random.Generator,
    effects: Sequence[Effect] = (),
    values: Mapping[str, Mapping[str, Any]] | None = None,
) -> Spacecraft:
    """A spacecraft whose J, K and bias are drawn from a campaign's prior (every J physical).

    Parameters
    ----------
    template : hardware and prior; its slews set the scale of default priors. effects, values : what else
        acts; the values of effects that `values` does not name are drawn from the effects' priors.

    Raises `CampaignError` if hardly any draw of the inertia prior is physical.
    """
    prior, sensor = template.inertia, template.rate_sensor
    spin = spin_tensor(template.wheels) if prior.includes_wheel_spin else np.zeros((3, 3))
    mean, sd = prior.elements, prior.sd
    elements = draw_physical(
        lambda n: rng.normal(mean, sd, (n, 6)), 1, wheel_spin=inertia_tensor.elements(spin)
    )[0]
    J = np.array(inertia_tensor.tensor(elements)) - spin
    drawn = {**(values or {})}
    for effect in effects:
        if effect.name not in drawn:
            space = ParameterSpace(tuple((effect.name, p) for p in effect.parameters(template)))
            drawn[effect.name] = space.split(space.draw(rng, 1)[0]).get(effect.name, {})
    K, bias = (
        rng.normal(sensor.scale_factor, sensor.scale_factor_sigma),
        rng.normal(sensor.bias, sensor.bias_sigma),
    )
    return Spacecraft(
        J,
        tuple(K),
        template.wheels,
        sensor,
        template.star_tracker,
        tuple(bias.tolist()),
        tuple(effects),
        drawn,
    )


def vary_plan(
    plan: Plan,
    rng: np.random.Generator,
    angles: tuple[float, float] = (math.radians(20.0), math.radians(60.0)),
) -> Plan:
    """The plan with random senses, angles [rad] and start attitude; all slews last equally long, so that studies share compiled code."""
    low, high = angles
    longest = max(
        replace(
            plan, slews=tuple(replace(s, angle=high, duration=None) for s in plan.slews)
        ).durations
    )
    senses, turned = (
        rng.choice([-1.0, 1.0], len(plan.slews)),
        rng.uniform(low, high, len(plan.slews)),
    )
    slews = tuple(
        replace(
            slew, axis_B=tuple(sense * x for x in slew.axis_B), angle=float(angle), duration=longest
        )
        for slew, sense, angle in zip(plan.slews, senses, turned, strict=True)
    )
    attitude = rng.normal(size=4)
    return replace(plan, slews=slews, start_attitude=tuple(attitude / np.linalg.norm(attitude)))


def draw_flight(
    template: Campaign,
    plan: Plan,
    seed: int | np.random.SeedSequence,
    *,
    effects: Sequence[Effect] = (),
    values: Mapping[str, Mapping[str, Any]] | None = None,
    vary: bool = True,
    controller: Controller | None = None,
) -> Flight:
    """One campaign of a calibration study: truth drawn from the template's prior, slews varied, flown with noise.

    The truth is in `Flight.spacecraft`. `controller` None believes the prior. Equal seeds give equal campaigns.
    """
    rng = np.random.default_rng(seed)
    craft = draw_spacecraft(template, rng, effects, values)
    flown = vary_plan(plan, rng) if vary else plan
    controller = controller or Controller.from_prior(
        template.inertia, template.rate_sensor, template.wheels
    )
    return fly(flown, craft, controller, template.inertia, int(rng.integers(2**63)), template.name)
