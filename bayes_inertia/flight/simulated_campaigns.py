"""Simulated campaigns: one written to a folder with its truth, or one of many in a study.

Effects that act in a flight are not mentioned in its campaign: they are hidden.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import EffectError, OutputError, members, require
from bayes_inertia.files import path_of, write_atomically
from bayes_inertia.flight.example_flight import flown_again
from bayes_inertia.flight.mission import Mission, prior_mean, spacecraft_at
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import Flight, fly, require_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.spacecraft import Controller, Spacecraft, body_tensor, spin_tensor
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.printed import counted
from bayes_inertia.maths.values import json_ready, whole_number
from bayes_inertia.physics.effect import Effect, require_of_effect, require_rule
from bayes_inertia.physics.forward_model import base_space, lacks
from bayes_inertia.physics.named_effects import effects_named, pinned_names
from bayes_inertia.physics.parameters import ParameterSpace


def with_hidden_effects(mission: Mission, plan: Plan, hidden: Sequence[str], seed: int) -> Mission:
    """A mission in which further effects act.

    `plan`: what will be flown; it sets the scale of default priors. `hidden`: each is `name`
    (parameters drawn from their priors) or `name.parameter=value[,value...]` (parameters not named
    are at their null). Returns: the same prior; its spacecraft has the effects beside its own.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> names = ["wheel_command_lag.tau=0.1"]
    >>> hiding = with_hidden_effects(most_like_mission(), paper_like_plan(), names, 0)
    >>> hiding.spacecraft.values["wheel_command_lag"]["tau"].item()
    0.1
    """
    hidden = members(hidden, str, "hidden", error=EffectError)
    if not hidden:
        return mission
    template = planned_campaign(plan, mission)
    effects, values = _hidden_effects(hidden, template, np.random.default_rng([seed, 2]))
    craft = mission.spacecraft
    craft = replace(craft, effects=(*craft.effects, *effects), values={**craft.values, **values})
    return replace(mission, spacecraft=craft)


def parameter_space(effect: Effect, template: Campaign) -> ParameterSpace:
    """The parameters of one effect.

    `template`: whose hardware and slews set the scale of default priors.
    """
    return ParameterSpace(tuple((effect.name, p) for p in effect.parameters(template)))


def _request(text: str) -> tuple[str, str, str]:
    """Effect, parameter and value of a request like `wheel_command_lag.tau=0.12`.

    Without a parameter the effect is drawn.
    """
    key, _, value = text.partition("=")
    # An effect from outside is called `FILE.py:Class` or `package.module:Class`.
    source, colon, rest = key.rpartition(":")
    effect, _, parameter = rest.partition(".")
    return f"{source}{colon}{effect}", parameter, value


def _hidden_effects(
    texts: Sequence[str], template: Campaign, rng: np.random.Generator
) -> tuple[tuple[Effect, ...], dict[str, dict[str, Any]]]:
    """Effects and values that requests name."""
    requests = [_request(text) for text in texts]
    names = tuple(dict.fromkeys(effect for effect, *_ in requests))
    effects = tuple(e.in_campaign(template) for e in effects_named(pinned_names(names)))
    values: dict[str, dict[str, Any]] = {}
    for name, effect in zip(names, effects, strict=True):
        missing = lacks(effect, template)
        require_rule(not missing, effect, "lacks", missing=missing)
        space = parameter_space(effect, template)
        settings = [(key, value) for of, key, value in requests if of == name and key]
        flat = space.nulls if settings else space.draw(rng, 1)[0]
        by_parameter = {
            k: np.asarray(v) for k, v in space.split(jnp.asarray(flat))[effect.name].items()
        }
        for key, value in settings:
            by_parameter[key] = _requested_value(name, key, value, by_parameter)
        values[effect.name] = by_parameter
    return effects, values


def _requested_value(
    effect: str, parameter: str, value: str, by_parameter: Mapping[str, np.ndarray]
) -> np.ndarray:
    """The value that a request asks for, in the shape of its parameter."""
    known, what = parameter in by_parameter, f"no parameter {parameter!r}"
    require_of_effect(known, effect, what, f"its parameters are {', '.join(by_parameter)}")
    null = by_parameter[parameter]
    try:
        given = np.array([float(x) for x in value.split(",")])
        return np.broadcast_to(given, null.shape) if null.shape else given.reshape(())
    except ValueError:
        what = f"{value!r} is not {counted(null.size, 'number')}"
        where, advice = f"{effect}.{parameter}", "give numbers separated by commas"
        raise EffectError(what, where=where, advice=advice) from None


def simulate(
    plan: Plan,
    mission: Mission,
    out_folder: str | Path,
    seed: int,
    *,
    controller: Controller | None = None,
    name: str | None = None,
    hidden: Sequence[str] = (),
) -> Flight:
    """Fly a plan and write the campaign folder, with `truth.json` beside it.

    Parameters
    ----------
    plan : Plan
        What to fly.
    mission : Mission
        The spacecraft as it is, and the inertia tensor that the campaign states as known before
        flight.
    out_folder : str or Path
        Where to write; made if it is absent.
    seed : int
        Of noise, bias, rest errors and drawn effects.
    controller : Controller, optional
        None for one that believes the prior.
    name : str, optional
        Name of the campaign; None for the plan's.
    hidden : sequence of str, optional
        Effects that act beside the mission's own and that the campaign does not mention, see
        `with_hidden_effects`.

    Returns
    -------
    Flight
        What was flown.

    Raises
    ------
    OutputError
        If another campaign is in the folder.
    CampaignError
        If the plan does not fit the spacecraft.
    EffectError
        If an effect or parameter is unknown, lacks environment columns, or grows without bound
        together with the controller.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import PlannedSlew
    >>> plan = Plan("one", (PlannedSlew((1., 0., 0.), 0.5),))
    >>> with TemporaryDirectory() as folder:
    ...     flight = simulate(plan, most_like_mission(), folder, seed=1)
    ...     sorted(path.name for path in Path(folder).iterdir())
    ['campaign.toml', 'slew_01.csv', 'truth.json']
    """
    seed, folder = whole_number(seed, "seed"), path_of(out_folder, "out_folder")
    require_plan(plan, mission)
    mission = with_hidden_effects(mission, plan, hidden, seed)
    flight = fly(plan, mission, seed, controller=controller, name=name)
    _write_with_truth(flight.campaign, truth_of(flight, seed), folder)
    return flight


def simulate_again(
    campaign: Campaign, out_folder: Path, seed: int, *, draw: bool = False, hidden: Sequence[str]
) -> Campaign:
    """Fly a campaign's own slews again, in open loop, and write it, with `truth.json` beside it.

    Whatever turns the spacecraft does what it did. `draw`: see `flown_again`; `hidden`: see
    `with_hidden_effects`.
    """
    effects, values = _hidden_effects(hidden, campaign, np.random.default_rng([seed, 2]))
    flown, truth = flown_again(campaign, effects, values, seed, draw=draw)
    _write_with_truth(flown, truth, out_folder)
    return flown


def _write_with_truth(campaign: Campaign, truth: Mapping[str, Any], folder: Path) -> None:
    text = json.dumps(truth, indent=1) + "\n"
    path = folder / "truth.json"
    free = not path.exists() or path.read_text(encoding="utf-8") == text
    what, advice = "would overwrite the truth of another campaign", "write to a new folder"
    require(free, str(path), what, advice, error=OutputError)
    write_campaign(campaign, folder)
    write_atomically(path, text)


def truth_of(flight: Flight, seed: int | None = None) -> dict[str, Any]:
    """Truth of a flight, as plain numbers and lists.

    Returns: J, K, bias, effects, and each slew's start state and final error, with units in the
    keys.
    """
    craft = flight.spacecraft
    locked = craft.inertia_B + spin_tensor(craft.wheels)
    values = {
        effect: {key: np.asarray(value).tolist() for key, value in by_parameter.items()}
        for effect, by_parameter in craft.values.items()
    }
    slews = [
        {
            "q0": path.attitude[0].tolist(),
            "w0": path.rate_B[0].tolist(),
            "h0_rel": path.wheel_momentum[0].tolist(),
            "final_error_B_rad": json_ready(error),
        }
        for path, error in zip(flight.truth, flight.final_error_B, strict=True)
    ]
    return {
        "J_kgm2": craft.inertia_B.tolist(),
        "J_locked_kgm2": locked.tolist(),
        "K": list(craft.scale_factor),
        "C_rate": craft.rate_sensor.axes.tolist() if craft.rate_sensor else [],
        "b_radps": np.asarray(craft.bias).tolist(),
        "wheel_axes_B": craft.wheel_axes_B.tolist(),
        "effects": values or {"none": {}},
        **({"parameters": dict(flight.parameters)} if flight.parameters else {}),
        "slews": slews,
        "seed": seed,
    }


def draw_spacecraft(
    template: Campaign,
    rng: np.random.Generator,
    effects: Sequence[Effect] = (),
    values: Mapping[str, Mapping[str, Any]] | None = None,
    craft: Spacecraft | None = None,
) -> Spacecraft:
    """A spacecraft whose J, K and bias are drawn from a campaign's prior; every J is physical.

    `craft`: its hardware; None for what the template has.
    `template`: hardware and prior; its slews set the scale of default priors. `values`: {effect:
    {parameter: value}}. The values of effects that it does not name are drawn from their priors.
    """
    sensor = template.rate_sensor
    J, K = _drawn_base(template, rng)
    all_values = dict(values or {})
    for effect in effects:
        if effect.name not in all_values:
            space = parameter_space(effect, template)
            drawn = space.split(space.draw(rng, 1)[0])
            all_values[effect.name] = drawn.get(effect.name, {})
    if sensor and template.prior is None:
        K = rng.normal(sensor.scale_factor, sensor.scale_factor_sigma)
    bias = rng.normal(sensor.bias, sensor.bias_sigma) if sensor else np.zeros(0)
    return replace(
        craft or spacecraft_at(template, prior_mean(template)),
        inertia_B=J,
        scale_factor=tuple(K),
        bias=tuple(bias.tolist()),
        effects=tuple(effects),
        values=all_values,
    )


def _drawn_base(template: Campaign, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """J (3, 3) [kg m^2] without the wheels' spin, drawn from the prior; K where it is joint."""
    prior, joint = template.inertia, template.prior

    def draw(n: int) -> np.ndarray:
        if joint is None:
            return rng.normal(prior.elements, prior.sd, (n, 6))
        return base_space(prior, template.rate_sensor, joint).draw(rng, n)

    drawn = draw_bodies(template, draw, 1)[0]
    return body_tensor(drawn[:6], prior, template.wheels), drawn[6:]


def draw_bodies(
    campaign: Campaign, draw: Callable[[int], np.ndarray], n: int, **said: Any
) -> np.ndarray:
    """Draws of J and what follows it, every J one that a body can have.

    `campaign`: it tells whether the draws hold J or J_locked. `draw`: takes a number k and returns
    k draws (k, d); J's six elements [kg m^2] come first. `said`: see `draw_physical`. Returns (n,
    d).
    """
    spin = None
    if campaign.inertia.includes_wheel_spin:
        spin = np.asarray(inertia_tensor.elements(jnp.asarray(spin_tensor(campaign.wheels))))
    return inertia_tensor.draw_physical(draw, n, wheel_spin=spin, **said)


def vary_plan(
    plan: Plan,
    rng: np.random.Generator,
    angles: tuple[float, float] = (math.radians(20.0), math.radians(60.0)),
) -> Plan:
    """The plan with random senses and angles of its slews, and a random start attitude.

    All slews last equally long, so that studies share compiled code.

    `angles` [rad].

    Examples
    --------
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> varied = vary_plan(paper_like_plan(), np.random.default_rng(0))
    >>> len(set(varied.durations))
    1
    """
    smallest, largest = angles
    at_largest = (replace(slew, angle=largest, duration=None) for slew in plan.slews)
    longest = max(replace(plan, slews=tuple(at_largest)).durations)
    senses = rng.choice([-1.0, 1.0], len(plan.slews))
    drawn_angles = rng.uniform(smallest, largest, len(plan.slews))
    slews = tuple(
        replace(
            slew, axis_B=tuple(sense * x for x in slew.axis_B), angle=float(angle), duration=longest
        )
        for slew, sense, angle in zip(plan.slews, senses, drawn_angles, strict=True)
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
    craft: Spacecraft | None = None,
) -> Flight:
    """One campaign of a calibration study: truth drawn from the template's prior, flown with noise.

    `template`: hardware and prior; its slews set the scale of default priors. `values`: {effect:
    {parameter: value}}. The values of effects that it does not name are drawn from their priors.
    """
    rng = np.random.default_rng(seed)
    drawn = draw_spacecraft(template, rng, effects, values, craft)
    mission = Mission(drawn, template.inertia, template.prior)
    flown_plan = vary_plan(plan, rng) if vary else plan
    return fly(flown_plan, mission, int(rng.integers(2**63)), name=template.name)
