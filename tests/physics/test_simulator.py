"""The simulator, against order, closed form and an independent integration."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from support.other_spacecraft import by_rotors, by_thrusters
from support.slews import (
    ATTITUDE,
    EXTERNAL,
    SKEWED,
    WHEEL_SETS,
    J,
    _skew,
    run,
    start_with,
    torques,
)

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import BODY_HOOKS, LOOKING_BACK, Effect
from bayes_inertia.physics.effects import LIBRARY, ConstantTorque, Formula
from bayes_inertia.physics.effects.formula import DRIVERS, FORMS, drivers_known
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.packing import refined_grid
from bayes_inertia.physics.prediction import predict
from bayes_inertia.physics.slew_input import Start
from bayes_inertia.physics.small_campaign import small_campaign


def test_a_slew_of_too_many_rows_is_told_by_its_rows():
    with pytest.raises(CampaignError, match="a slew has 1,000,001 rows; give fewer than 1,000,000"):
        refined_grid(np.arange(1_000_001) * 1e-3, 1.0)


def refine(time, held, linear, parts):
    """The same inputs on a grid with each step divided in `parts`: `held` repeated, `linear`
    interpolated.
    """
    grid, sample = refined_grid(time, float(np.diff(time)[0]) / parts)
    row = np.searchsorted(sample, np.arange(len(grid)), side="right") - 1
    return grid, held[row], np.stack([np.interp(grid, time, column) for column in linear.T], -1)


@pytest.mark.parametrize("external", [False, True])
@pytest.mark.parametrize("drive", ["commanded", "measured"])
def test_the_integrator_has_order_six(slew_of, test_torque, drive, external):
    time, wheels = np.arange(0.0, 13.0, 1.5), 4
    held, linear = torques(len(time), wheels), 0.4 * torques(len(time), wheels, 1, 1.0)
    effects, values = ((test_torque,), EXTERNAL) if external else ((), {})

    def end(parts):
        grid, torque, momentum = refine(time, held, linear, parts)
        slew = slew_of(grid, torque, SKEWED, np.full(wheels, 0.02), momentum)
        path = run(slew, start_with(wheels), effects=effects, values=values, drive=drive)
        return np.concatenate([path.attitude[-1], path.rate_B[-1]])

    parts = np.array([2, 3, 4, 5, 6, 8])
    exact = end(48)
    errors = np.array([np.linalg.norm(end(int(p)) - exact) for p in parts])
    # error = c step^6 (1 + e step): the next order is fitted too, so that the slope has an honest
    # error of its own.
    step = 1.5 / parts
    design = np.stack([np.ones(len(step)), np.log(step), step], -1)
    solution, rest, *_ = np.linalg.lstsq(design, np.log(errors), rcond=None)
    slope_sd = np.sqrt(rest[0] / (len(step) - 3) * np.linalg.inv(design.T @ design)[1, 1])
    assert slope_sd < 0.1, (errors, slope_sd)
    assert abs(solution[1] - 6.0) < 0.2, (solution, slope_sd)
    assert errors[-1] < 1e-6


def test_a_symmetric_top_precesses_as_in_the_closed_form(slew_of):
    across, along, spin, tilt = 2.0, 1.3, 0.3, 0.2
    time = np.linspace(0.0, 60.0, 2401)
    slew = slew_of(time, np.zeros((len(time), 0)), np.zeros((3, 0)), np.zeros(0))
    path = run(
        slew,
        Start(jnp.array([tilt, 0.0, spin]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0)),
        np.diag([across, across, along]),
    )
    # Body axes: w_x + i w_y turns at (I3 - I1)/I1 w_z (w_x' = (I1 - I3)/I1 w_y w_z).
    turning = (along - across) / across * spin
    np.testing.assert_allclose(
        path.rate_B,
        np.stack(
            [
                tilt * np.cos(turning * time),
                tilt * np.sin(turning * time),
                np.full_like(time, spin),
            ],
            -1,
        ),
        atol=1e-9,
    )
    # Inertial axes: the symmetry axis goes round the momentum at |M| / I1.
    momentum = np.array([across * tilt, 0.0, along * spin])
    precession = np.linalg.norm(momentum) / across
    unit = momentum / np.linalg.norm(momentum)
    axis = Rotation.from_rotvec(np.outer(precession * time, unit)).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(
        quaternion.to_inertial(path.attitude, jnp.array([0.0, 0.0, 1.0])), axis, atol=1e-9
    )
    # Attitude: precession about M, then the body's own turn about its symmetry axis.
    exact = Rotation.from_rotvec(np.outer(precession * time, unit)) * Rotation.from_rotvec(
        np.outer(-turning * time, [0.0, 0.0, 1.0])
    )
    gap = (Rotation.from_quat(np.asarray(path.attitude)).inv() * exact).magnitude()
    assert gap.max() < 1e-8


def reference_path(time, torque, axes, spin, start, external=lambda w: np.zeros(3)):
    """J w' + w x (J w + G H) = -G u + tau, H' = u, C' = -[w]x C: rates form, direction cosines,
    DOP853 step by step.
    """
    n = axes.shape[1]
    C = Rotation.from_quat(np.asarray(start.attitude)).as_matrix().T
    H = np.asarray(start.wheel_momentum) + spin * (axes.T @ np.asarray(start.rate_B))
    x, rows = np.concatenate([start.rate_B, H, C.ravel()]), []
    for k, t in enumerate(time):
        rows.append(x)
        if k + 1 == len(time):
            break

        def slope(_, y, u=torque[k]):
            w, h = y[:3], y[3 : 3 + n]
            dw = np.linalg.solve(J, -np.cross(w, J @ w + axes @ h) - axes @ u + external(w))
            return np.concatenate([dw, u, (-_skew(w) @ y[3 + n :].reshape(3, 3)).ravel()])

        x = solve_ivp(slope, (t, time[k + 1]), x, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    rows = np.array(rows)
    rate, H, C = rows[:, :3], rows[:, 3 : 3 + n], rows[:, 3 + n :].reshape(-1, 3, 3)
    return rate, H - spin * (rate @ axes), C


@pytest.mark.parametrize("axes", WHEEL_SETS.values(), ids=WHEEL_SETS)
@pytest.mark.parametrize("external", [False, True])
def test_it_agrees_with_an_independent_integration_of_the_rates_form(
    slew_of, test_torque, axes, external
):
    wheels = axes.shape[1]
    time = np.cumsum(np.random.default_rng(3).uniform(0.01, 0.04, 300))
    time -= time[0]
    torque, spin = torques(len(time), wheels, 5), 0.02 + 0.01 * np.arange(wheels)
    start = start_with(wheels)
    effects, values = ((test_torque,), EXTERNAL) if external else ((), {})
    torque_of = (
        (lambda w: np.array([0.02, -0.03, 0.01]) - np.array([0.05, 0.02, 0.1]) * w)
        if external
        else (lambda w: np.zeros(3))
    )
    path = run(slew_of(time, torque, axes, spin), start, effects=effects, values=values)
    rate, momentum, C = reference_path(time, torque, axes, spin, start, torque_of)
    assert np.ptp(rate, axis=0).min() > 0.05  # something happens
    np.testing.assert_allclose(path.rate_B, rate, atol=2e-9)
    np.testing.assert_allclose(path.wheel_momentum, momentum, atol=2e-9)
    np.testing.assert_allclose(
        Rotation.from_quat(np.asarray(path.attitude)).as_matrix().transpose(0, 2, 1), C, atol=2e-9
    )


def test_the_torque_reaches_the_body_with_the_sign_of_the_contract(slew_of):
    """From rest: w = -J^-1 G u t, and the wheel gains u t (seen from the body: plus Js times what
    the body turned away).
    """
    time, u = np.array([0.0, 0.01, 0.02]), np.array([0.03, -0.01, 0.02, 0.04])
    start = Start(jnp.zeros(3), jnp.asarray(ATTITUDE), jnp.zeros(4))
    path = run(slew_of(time, np.broadcast_to(u, (3, 4)), SKEWED, np.full(4, 0.02)), start)
    rate = -np.linalg.solve(J, SKEWED @ u) * 0.02
    np.testing.assert_allclose(path.rate_B[-1], rate, rtol=1e-6)
    np.testing.assert_allclose(
        path.wheel_momentum[-1], u * 0.02 - 0.02 * (SKEWED.T @ rate), rtol=1e-6
    )


def test_a_command_acts_from_its_own_row_to_the_next(slew_of):
    time, torque = np.array([0.0, 1.0, 3.0, 4.0]), np.zeros((4, 1))
    torque[1] = 0.01
    path = run(
        slew_of(time, torque, np.eye(3)[:, :1], np.array([0.02])),
        Start(jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(1)),
        np.diag([2.0, 3.0, 4.0]),
    )
    np.testing.assert_allclose(path.rate_B[:, 0], [0.0, 0.0, -0.01, -0.01], atol=1e-15)


def test_the_measured_drive_reproduces_the_commanded_trajectory(slew_of):
    """Between rows the measured drive interpolates, so that the gap closes with the square of the
    step.
    """
    coarse = np.arange(0.0, 40.0, 1.0)
    spin, gaps, parts = np.full(4, 0.02), [], [2, 4, 8]
    for part in parts:
        grid, torque, _ = refine(coarse, torques(len(coarse), 4), np.zeros((len(coarse), 1)), part)
        commanded = run(slew_of(grid, torque, SKEWED, spin), start_with(4))
        measured = run(
            slew_of(grid, None, SKEWED, spin, commanded.wheel_momentum),
            start_with(4),
            drive="measured",
        )
        np.testing.assert_array_equal(measured.wheel_momentum, commanded.wheel_momentum)
        gaps.append(
            max(
                np.abs(measured.rate_B - commanded.rate_B).max(),
                np.abs(measured.attitude - commanded.attitude).max(),
            )
        )
    assert gaps[-1] < 1e-4
    assert all(3.0 < a / b < 18.0 for a, b in itertools.pairwise(gaps)), gaps


def test_the_measured_drive_needs_no_torque_and_ignores_it(slew_of):
    time = np.arange(0.0, 10.0, 0.5)
    momentum = 0.1 * torques(len(time), 4, 2, 1.0)
    with_torque = run(
        slew_of(time, torques(len(time), 4), SKEWED, np.full(4, 0.02), momentum),
        start_with(4),
        drive="measured",
    )
    without = run(
        slew_of(time, None, SKEWED, np.full(4, 0.02), momentum), start_with(4), drive="measured"
    )
    np.testing.assert_array_equal(with_torque.rate_B, without.rate_B)


def test_every_method_of_an_effect_is_a_hook_or_says_what_it_is():
    """What the simulator does not call cannot move the body: fits save its motion."""
    about = {"parameters", "max_step", "looks_between_rows", "afterwards", "acts", "in_campaign"}
    methods = {k for k, v in vars(Effect).items() if callable(v) and not k.startswith("_")}
    assert methods - about == {*BODY_HOOKS, *LOOKING_BACK}


def products_in_steps(jaxpr, in_steps=False):
    """How many matrix products a program calls inside its loops."""
    count = 0
    for equation in jaxpr.eqns:
        inside = in_steps or equation.primitive.name in ("scan", "while")
        count += in_steps and equation.primitive.name == "dot_general"
        parts = jax.tree.leaves(equation.params, is_leaf=lambda x: hasattr(x, "eqns"))
        inner = (getattr(part, "jaxpr", part) for part in parts)
        count += sum(products_in_steps(x, inside) for x in inner if hasattr(x, "eqns"))
    return count


def products_in_steps_of(campaign, effects):
    model = Model(campaign, effects)
    structure, data = model.structure, model.data
    of_slew = jax.tree.map(lambda rows: rows[0], data.arrays)

    def prediction(theta, local, bias):
        nuisances = structure.nuisances(local)
        return predict(structure, theta, nuisances, bias, *of_slew, data)

    zeros = np.zeros(structure.n_local), np.zeros(model.n_bias)
    return products_in_steps(jax.make_jaxpr(prediction)(model.space.mean, *zeros).jaxpr)


@dataclass(frozen=True)
class WithProduct(ConstantTorque):
    """Turns its torque by a matrix product."""

    name = "turned_torque"

    def body_torque(self, p, slew, t, state):
        return jnp.eye(3) @ super().body_torque(p, slew, t, state)


@pytest.mark.slow
def test_no_effect_calls_a_matrix_product_in_a_step():
    """Each call takes longer than the numbers in it: derivatives took three times as long."""
    formulas = [Formula("body_torque", driver, "full") for driver in DRIVERS]
    formulas += [Formula("body_torque", "rate", form) for form in FORMS]
    campaign = small_campaign()
    known = set(drivers_known(campaign))
    formulas = [formula for formula in formulas if formula.driver in known]
    assert len(formulas) > len(FORMS)
    for effect in (*LIBRARY, *formulas):
        assert products_in_steps_of(campaign, (effect,)) == 0, effect.name
    for equipped in (by_thrusters(), by_rotors()):
        assert products_in_steps_of(equipped, ()) == 0
    assert products_in_steps_of(campaign, (WithProduct(),)) > 0
