"""How well the diagnosis names what is wrong with one device of many.

    python -m analyses.naming.devices [--seeds 3] [--kinds gain[torquers] ...] [--page]

One spacecraft has everything: three wheels, two gyros, a star tracker, a magnetometer, torquers
and thrusters. Its slews are flown by the package's own model with one effect hidden, at the size
that an ideal test finds in 99 % among all candidates, in a direction of its own. Appends a row a
campaign to `results/naming/devices.jsonl`; campaigns whose rows are there are left out; writes
`devices.md`. About a minute of processor time a campaign.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from time import process_time

import numpy as np

from analyses import made_rows, results_of, rows_of
from analyses.naming.fixed_shape import RULES, truth_of
from analyses.naming.fixed_shape_campaigns import (
    degrees_of_freedom,
    direction,
    draw,
    noncentrality,
    plain_fit,
    scaled,
    unit_step,
)
from bayes_inertia.campaign.actuators import Magnetorquer, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.diagnosis.candidates import candidate_effects
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.diagnosis.score_test import score_tests
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.inference.optimizer import move_to
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, by_name
from bayes_inertia.physics.forward_model import Model

FOLDER = results_of(__file__)
ROWS = FOLDER / "devices.jsonl"
HIDDEN = (
    "clean",
    "gain[torquers]",
    "direction[torquers]",
    "gain[jets]",
    "direction[jets]",
    "delay[rate sensor]",
    "delay[mems]",
    "misalignment[mems]",
    "bias[mems]",
    "offset[magnetometer]",
    "scale[magnetometer]",
    "misalignment[magnetometer]",
)
POWER = 0.99
DIPOLE, HELD = 5.0, 10.0  # largest dipole [A m^2], and how long each is held [s]
TORQUE, PULSE, PERIOD = 0.02, 0.1, 6.0  # of a thruster [N m]; of its pulses [s]
MEMS_SIGMA, FIELD_SIGMA = 1e-4, 1e-7  # [rad/s], [T]
MEMS_AXES = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def with_devices(campaign: Campaign, rng: np.random.Generator) -> Campaign:
    """The campaign with everything else that a spacecraft may have; readings are NaN so far."""
    devices = (
        Magnetorquer("torquers"),
        Thruster("jets", TORQUE * np.vstack([np.eye(3), -np.eye(3)])),
    )
    more = (
        ("mems", RateSensor(MEMS_SIGMA, MEMS_AXES)),
        ("magnetometer", DirectionSensor(FIELD_SIGMA, unit="T")),
    )
    slews = tuple(_equipped(slew, rng) for slew in campaign.slews)
    return replace(campaign, slews=slews, actuators=devices, more_sensors=more)


def _equipped(slew: Slew, rng: np.random.Generator) -> Slew:
    first, last = slew.time[0], slew.time[-1]
    held, pulses = np.arange(first, last, HELD), np.arange(first + 1.0, last - 1.0, PERIOD)
    on_time = PULSE * rng.integers(0, 2, (len(pulses), 6))
    inputs = {
        "torquers": InputStream(held, rng.uniform(-DIPOLE, DIPOLE, (len(held), 3)), "hold"),
        "jets": InputStream(pulses, on_time, "on_time"),
    }
    angle = 1e-3 * (slew.start + slew.time)  # an orbit of 100 minutes, twice
    field_N = np.stack(
        [2.4e-5 * np.cos(angle), 2.4e-5 * np.sin(angle), 1.2e-5 * np.cos(0.5 * angle)], 1
    )
    empty = np.full((len(slew.time), 3), 1e-9)
    return replace(
        slew, magnetic_field_N=field_N, inputs=inputs, more={"mems": empty, "magnetometer": empty}
    )


def flown(
    campaign: Campaign, effects: tuple[Effect, ...], theta: np.ndarray, rng: np.random.Generator
) -> Campaign:
    """The campaign with telemetry of these effects: as the model predicts it, with noise.

    `theta` (d,): J, K, then the effects' parameters.
    """
    model = Model(campaign, effects, "commanded")
    predicted = model.predict(theta)
    slews = list(campaign.slews)
    for channel, readings in zip(model.channels, model.data.arrays.telemetry.readings, strict=True):
        noise = channel.noise(campaign, theta, "commanded")
        for s, slew in enumerate(slews):
            valid = np.asarray(readings.valid[s]).any(axis=1)
            unit = rng.normal(size=(int(valid.sum()), np.asarray(readings.valid).shape[-1]))
            values = channel.moved(predicted[channel.name][0, s][valid], channel.drawn(noise, unit))
            rows = np.asarray(readings.row[s])[valid]
            whole = np.full_like(np.asarray(channel.stream.values(slew), dtype=float), np.nan)
            whole[rows] = values
            field = channel.stream.field
            changed = (
                {field: whole} if field else {"more": {**(slew.more or {}), channel.name: whole}}
            )
            slews[s] = replace(slew, **changed)
    return replace(campaign, slews=tuple(slews))


def theta_of(model: Model, truth: np.ndarray, hidden: dict, rng: np.random.Generator) -> np.ndarray:
    """J and K as drawn, errors of further sensors from their priors, and what is hidden."""
    space, theta = model.space, np.array(model.space.nulls)
    drawn = space.draw(rng, 1)[0]
    theta[: len(truth)] = truth
    theta[len(truth) :] = np.where(
        [name.startswith("mems.") for name in space.names[len(truth) :]],
        drawn[len(truth) :],
        theta[len(truth) :],
    )
    for owner, values in hidden.items():
        theta[space.slice_of(owner)] = np.concatenate([np.atleast_1d(v) for v in values.values()])
    return theta


def campaign_with(name: str, index: int) -> tuple[Campaign, float, np.ndarray]:
    """A campaign with an effect hidden, its size in prior sds, and J and K."""
    flight = draw(np.random.SeedSequence(20261, spawn_key=(index,)), (), {}, True)
    kind = list(HIDDEN).index(name)
    rng = np.random.default_rng([index, kind, 1])
    truth, plan = truth_of(flight), with_devices(flight.campaign, np.random.default_rng(index))
    clean = flown(
        plan, (), theta_of(Model(plan), truth, {}, np.random.default_rng([index, 2])), rng
    )
    if name == "clean":
        return clean, 0.0, truth
    (effect,) = (effect.in_campaign(clean) for effect in by_name([name]))
    values, size, length = size_found(effect, clean, rng)
    hidden = {name: scaled(values, size)}
    model = Model(plan, (effect,), "commanded")
    theta = theta_of(model, truth, hidden, np.random.default_rng([index, 2]))
    return flown(plan, (effect,), theta, rng), size * length, truth


def size_found(
    effect: Effect, campaign: Campaign, rng: np.random.Generator
) -> tuple[dict, float, float]:
    """A random direction of an effect, and how far along it an ideal test finds the effect.

    Returns: values as `direction` gives them; their multiple; the length of one [prior sd].
    """
    level = RULES.false_alarm_probability / len(candidate_effects(campaign, LIBRARY).linear)
    wanted = noncentrality(POWER, degrees_of_freedom(effect, campaign), level)
    values = direction(effect, rng, campaign)
    fit = move_to(plain_fit(campaign), Model(campaign, (effect,)))
    step = unit_step(effect, values, campaign)
    size = float(np.sqrt(wanted / (step @ score_tests(linear_model(fit)).matrix @ step)))
    return values, size, float(np.linalg.norm(step))


def row_of(hidden: str, index: int) -> dict:
    """One campaign flown and diagnosed."""
    campaign, size, truth = campaign_with(hidden, index)
    began = process_time()
    diagnosis = diagnose(campaign, seed=index)
    quoted = quoted_parameters(diagnosis)
    return {
        "hidden": hidden,
        "index": index,
        "prior_sds": size,
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "ambiguous_with": [list(names) for names in diagnosis.ambiguous_with],
        "candidates": len(diagnosis.candidates),
        "quoted_z": ((quoted.mean - truth) / quoted.sd).tolist(),
        "seconds": process_time() - began,
    }


def is_found(row: dict) -> bool:
    """Whether what is hidden is named, alone or as one of the answers; nothing where nothing is."""
    if row["hidden"] == "clean":
        return row["verdict"] == "consistent"
    answers = {tuple(row["named"])} | {(n,) for names in row["ambiguous_with"] for n in names}
    return (row["hidden"],) in answers


def write_page(rows: list[dict]) -> None:
    """The table of the study."""
    lines = [
        "# What is wrong with one device of many",
        "",
        "`python -m analyses.naming.devices`. One spacecraft with three wheels, two gyros, a star",
        "tracker, a magnetometer, torquers and thrusters; one effect hidden in each campaign, at",
        f"the size that an ideal test finds in {100 * POWER:.0f} % among {rows[0]['candidates']}",
        "candidates, in a direction of its own.",
        "",
        "| hidden | campaigns | named, or an answer | alone | wrong name | rms z of J and K |",
        "|---|---|---|---|---|---|",
    ]
    for name in (*HIDDEN, "all hidden"):
        own = [r for r in rows if r["hidden"] == name]
        own = own or [r for r in rows if name == "all hidden" and r["hidden"] != "clean"]
        if not own:
            continue
        found = [r for r in own if is_found(r)]
        alone = [r for r in found if r["verdict"] in ("named", "consistent")]
        wrong = [r for r in own if r["named"] and not is_found(r)]
        z = np.sqrt(np.mean([np.square(r["quoted_z"]) for r in own]))
        lines.append(
            f"| {name} | {len(own)} | {len(found)} | {len(alone)} | {len(wrong)} | {z:.2f} |"
        )
    (FOLDER / "devices.md").write_text("\n".join(lines) + "\n")


def main() -> None:
    """Fly and diagnose."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--kinds", nargs="+", default=list(HIDDEN))
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    wanted = [] if options.page else itertools.product(range(options.seeds), options.kinds)
    cases = ({"hidden": name, "index": index} for index, name in wanted)
    for row in made_rows(ROWS, cases, row_of):
        told = [row[key] for key in ("hidden", "index", "verdict", "named", "ambiguous_with")]
        print(*told, f"{row['seconds']:.0f} s", flush=True)
    write_page(rows_of(ROWS))


if __name__ == "__main__":
    main()
