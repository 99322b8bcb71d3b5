"""The simulator against convergence order, conservation laws, closed forms and an independent integration."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.packing import refined_grid
from bayes_inertia.physics.simulator import simulate
from bayes_inertia.physics.slew_input import Start

J = np.array([[3.2, -0.2, 0.1], [-0.2, 2.2, 0.3], [0.1, 0.3, 1.9]])
WHEEL_SETS = {
    "orthogonal": np.eye(3),
    "one": np.array([[0.0], [0.6], [0.8]]),
    "four skewed": np.array([[0.8, -0.8, 0.0, 0.6], [0.6, 0.6, 0.6, -0.64], [0.0, 0.0, 0.8, 0.48]]),
}
SKEWED = WHEEL_SETS["four skewed"]
RATE = np.array([0.25, -0.3, 0.2])
ATTITUDE = np.array([0.5, -0.1, 0.3, np.sqrt(1.0 - 0.35)])
PAD = 400
EXTERNAL = {
    "test_torque": {
        "constant": jnp.array([0.02, -0.03, 0.01]),
        "damping": jnp.array([0.05, 0.02, 0.1]),
    }
}

_run = jax.jit(simulate, static_argnums=4)


def run(slew, start, J_B=J, effects=(), values=None, drive="commanded"):
    """The trajectory; slews are padded as in campaigns, to a few lengths, so that they share compiled code."""
    n = len(slew.context.time)
    spare = -n % PAD

    def longer(rows):
        return jnp.concatenate([rows, jnp.repeat(rows[-1:], spare, axis=0)])

    context = slew.context._replace(
        time=longer(slew.context.time),
        step=longer(slew.context.step),
        torque=longer(slew.context.torque),
    )
    slew = type(slew)(context, *(longer(rows) for rows in slew[1:]))
    return jax.tree.map(
        lambda rows: rows[:n],
        _run(slew, start, jnp.asarray(J_B), ActiveEffects(effects, values or {}), drive)[0],
    )


def total_momentum_N(trajectory, inertia_B, wheel_axes_B, spin_inertia):
    """J w + G H (n, 3) [N m s] in inertial axes: constant where no external torque acts."""
    locked = inertia_B + inertia_tensor.wheel_spin_tensor(wheel_axes_B, spin_inertia)
    momentum_B = trajectory.rate_B @ locked + trajectory.wheel_momentum @ wheel_axes_B.T
    return quaternion.to_inertial(trajectory.attitude, momentum_B)


def start_with(wheels, rate=RATE, attitude=ATTITUDE):
    return Start(
        jnp.asarray(rate), jnp.asarray(attitude), jnp.asarray(0.3 * np.cos(np.arange(wheels) + 1.0))
    )


def torques(n, wheels, seed=0, size=0.05):
    return size * np.random.default_rng(seed).normal(size=(n, wheels))


def refine(time, held, linear, parts):
    """The same inputs on a grid with each step divided in `parts`: `held` repeated, `linear` interpolated."""
    grid, sample = refined_grid(time, float(np.diff(time)[0]) / parts)
    row = np.searchsorted(sample, np.arange(len(grid)), side="right") - 1
    return grid, held[row], np.stack([np.interp(grid, time, column) for column in linear.T], -1)


# --- order ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("external", [False, True])
@pytest.mark.parametrize("drive", ["commanded", "measured"])
def test_the_integrator_has_order_four(slew_of, test_torque, drive, external):
    time, wheels = np.arange(0.0, 13.0, 1.5), 4
    held, linear = torques(len(time), wheels), 0.4 * torques(len(time), wheels, 1, 1.0)
    effects, values = ((test_torque,), EXTERNAL) if external else ((), {})

    def end(parts):
        grid, torque, momentum = refine(time, held, linear, parts)
        slew = slew_of(grid, torque, SKEWED, np.full(wheels, 0.02), momentum)
        path = run(slew, start_with(wheels), effects=effects, values=values, drive=drive)
        return np.concatenate([path.attitude[-1], path.rate_B[-1]])

    parts = np.array([2, 3, 4, 6, 8, 12])
    exact = end(48)
    errors = np.array([np.linalg.norm(end(int(p)) - exact) for p in parts])
    # error = c step^4 (1 + e step): the next order is fitted too, so that the slope has an honest error of its own.
    step = 1.5 / parts
    design = np.stack([np.ones(len(step)), np.log(step), step], -1)
    solution, rest, *_ = np.linalg.lstsq(design, np.log(errors), rcond=None)
    slope_sd = np.sqrt(rest[0] / (len(step) - 3) * np.linalg.inv(design.T @ design)[1, 1])
    assert slope_sd < 0.1, (errors, slope_sd)
    assert abs(solution[1] - 4.0) < 4.0 * slope_sd + 0.02, (solution, slope_sd)
    assert errors[-1] < 1e-6


# --- closed form ------------------------------------------------------------------------------------
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


# --- conservation -----------------------------------------------------------------------------------
@pytest.mark.parametrize("axes", WHEEL_SETS.values(), ids=WHEEL_SETS)
def test_momentum_is_conserved_to_rounding_with_wheels_torqued(slew_of, axes):
    wheels = axes.shape[1]
    time = np.arange(0.0, 400.0, 1.0)
    spin = np.full(wheels, 0.02)
    path = run(slew_of(time, torques(len(time), wheels), axes, spin), start_with(wheels))
    total = np.asarray(total_momentum_N(path, jnp.asarray(J), jnp.asarray(axes), jnp.asarray(spin)))
    assert np.abs(np.asarray(path.rate_B)).max() > 0.2  # it tumbles
    np.testing.assert_allclose(
        total, np.broadcast_to(total[0], total.shape), atol=1e-13 * np.linalg.norm(total[0])
    )
    # Independently of `total_momentum_N`: J w + G H with H = h + Js g.w, turned by scipy.
    H = np.asarray(path.wheel_momentum) + spin * (np.asarray(path.rate_B) @ axes)
    other = Rotation.from_quat(np.asarray(path.attitude)).apply(
        np.asarray(path.rate_B) @ J + H @ axes.T
    )
    np.testing.assert_allclose(other, total, atol=1e-12)


def test_an_external_torque_changes_momentum_by_its_integral(slew_of, test_torque):
    time = np.arange(0.0, 30.0, 0.05)
    values = {"test_torque": {"constant": jnp.array([0.02, -0.03, 0.01]), "damping": jnp.zeros(3)}}
    path = run(
        slew_of(time, torques(len(time), 4), SKEWED, np.full(4, 0.02)),
        start_with(4),
        effects=(test_torque,),
        values=values,
    )
    total = np.asarray(
        total_momentum_N(path, jnp.asarray(J), jnp.asarray(SKEWED), jnp.full(4, 0.02))
    )
    torque_N = Rotation.from_quat(np.asarray(path.attitude)).apply([0.02, -0.03, 0.01])
    gained = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(0.5 * (torque_N[1:] + torque_N[:-1]) * 0.05, axis=0)]
    )  # trapezium: (w dt)^2 / 12
    np.testing.assert_allclose(total - total[0], gained, atol=2e-4 * np.abs(gained).max())
    assert np.abs(gained).max() > 0.1


@pytest.mark.parametrize("axes", WHEEL_SETS.values(), ids=WHEEL_SETS)
def test_energy_is_conserved_without_torque_and_grows_by_the_motors_work(slew_of, axes):
    wheels, dt = axes.shape[1], 0.02
    time = np.arange(0.0, 40.0, dt)
    spin = np.full(wheels, 0.02)

    def energy(path):
        rate, H = (
            np.asarray(path.rate_B),
            np.asarray(path.wheel_momentum) + spin * (np.asarray(path.rate_B) @ axes),
        )
        return 0.5 * np.sum(rate @ J * rate, 1) + 0.5 * np.sum(H**2 / spin, 1)

    free = energy(run(slew_of(time, np.zeros((len(time), wheels)), axes, spin), start_with(wheels)))
    assert np.abs(free / free[0] - 1.0).max() < 1e-10
    # The motor's power is u times the wheel's speed RELATIVE to the body.
    steady = np.broadcast_to(0.02 * np.sin(np.arange(wheels) + 1.0), (len(time), wheels))
    path = run(slew_of(time, steady, axes, spin), start_with(wheels))
    power = np.sum(steady * np.asarray(path.wheel_momentum) / spin, axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * dt)])
    gained = energy(path) - energy(path)[0]
    assert np.abs(gained).max() > 0.1
    np.testing.assert_allclose(gained, work, atol=1e-5 * np.abs(gained).max())


# --- an independent integration ----------------------------------------------------------------------
def _skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def reference_path(time, torque, axes, spin, start, external=lambda w: np.zeros(3)):
    """J w' + w x (J w + G H) = -G u + tau, H' = u, C' = -[w]x C: rates form, direction cosines, DOP853 step by step."""
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
    """From rest: w = -J^-1 G u t, and the wheel gains u t (seen from the body: plus Js times what the body turned away)."""
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


# --- the two drives ----------------------------------------------------------------------------------
def test_the_measured_drive_reproduces_the_commanded_trajectory(slew_of):
    """Between rows the measured drive interpolates, so that the gap closes with the square of the step."""
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


# --- J and J_locked ------------------------------------------------------------------------------------
def test_locked_wheels_move_with_the_body_as_one_rigid_body_of_inertia_J_locked(slew_of):
    """Motor torques that keep the wheels still relative to the body: the motion is that of J_locked without wheels."""
    time, spin = np.arange(0.0, 30.0, 0.02), np.full(4, 0.2)
    still = Start(jnp.asarray(RATE), jnp.asarray(ATTITUDE), jnp.zeros(4))
    locked = J + SKEWED @ np.diag(spin) @ SKEWED.T
    rigid = run(
        slew_of(time, np.zeros((len(time), 0)), np.zeros((3, 0)), np.zeros(0)),
        still._replace(wheel_momentum=jnp.zeros(0)),
        locked,
    )
    held = run(slew_of(time, None, SKEWED, spin, np.zeros((len(time), 4))), still, drive="measured")
    np.testing.assert_allclose(held.rate_B, rigid.rate_B, atol=1e-13)
    # Commanded: u = Js g.w' keeps the relative momentum at zero, up to holding it over a step.
    change = np.diff(np.asarray(rigid.rate_B), axis=0, append=np.asarray(rigid.rate_B)[-1:])
    driven = run(slew_of(time, (change @ SKEWED) * spin / 0.02, SKEWED, spin), still)
    np.testing.assert_allclose(
        driven.wheel_momentum, np.zeros_like(driven.wheel_momentum), atol=1e-6
    )
    np.testing.assert_allclose(driven.rate_B, rigid.rate_B, atol=1e-6)
    # ... and confusing the two tensors would have shown.
    confused = run(
        slew_of(time, np.zeros((len(time), 0)), np.zeros((3, 0)), np.zeros(0)),
        still._replace(wheel_momentum=jnp.zeros(0)),
        J,
    )
    assert np.abs(np.asarray(confused.rate_B - rigid.rate_B)).max() > 1e-3


# --- invariances ---------------------------------------------------------------------------------------
def test_the_sign_of_the_quaternion_does_not_matter(slew_of, test_torque):
    time = np.arange(0.0, 20.0, 0.5)
    slew = slew_of(time, torques(len(time), 4), SKEWED, np.full(4, 0.02))
    one, other = (
        run(slew, start_with(4, attitude=sign * ATTITUDE), effects=(test_torque,), values=EXTERNAL)
        for sign in (1.0, -1.0)
    )
    np.testing.assert_array_equal(one.rate_B, other.rate_B)
    np.testing.assert_array_equal(one.attitude, -other.attitude)
    np.testing.assert_array_equal(
        quaternion.error(one.attitude, other.attitude), np.zeros((len(time), 3))
    )


@pytest.mark.parametrize(
    ("drive", "gain"),
    [("commanded", 2.0), ("measured", 2.0), ("commanded", 1.7), ("measured", 0.3)],
)
def test_a_common_gain_of_inertia_and_wheels_changes_no_rate(slew_of, drive, gain):
    """(J, Js, h, u) -> gain (J, Js, h, u): with wheels only, J and a common wheel gain are exactly degenerate."""
    time, spin = np.arange(0.0, 50.0, 0.5), np.full(4, 0.02)
    torque, momentum, start = (
        torques(len(time), 4),
        0.1 * torques(len(time), 4, 2, 1.0),
        start_with(4),
    )
    plain = run(slew_of(time, torque, SKEWED, spin, momentum), start, drive=drive)
    scaled_start = start._replace(wheel_momentum=gain * start.wheel_momentum)
    scaled = run(
        slew_of(time, gain * torque, SKEWED, gain * spin, gain * momentum),
        scaled_start,
        gain * J,
        drive=drive,
    )
    same = (
        np.testing.assert_array_equal
        if gain == 2.0
        else lambda a, b: np.testing.assert_allclose(a, b, atol=1e-12)
    )  # powers of two: to the last bit
    same(scaled.rate_B, plain.rate_B)
    same(scaled.attitude, plain.attitude)
    # Leaving one of them out is not an invariance.
    half = run(slew_of(time, torque, SKEWED, spin, momentum), start, gain * J, drive=drive)
    assert np.abs(np.asarray(half.rate_B - plain.rate_B)).max() > 1e-2


def test_another_inertial_frame_changes_no_body_quantity(slew_of):
    time = np.arange(0.0, 20.0, 0.5)
    slew = slew_of(time, torques(len(time), 4), SKEWED, np.full(4, 0.02))
    turn = quaternion.exp(jnp.array([0.4, -1.0, 0.3]))
    plain = run(slew, start_with(4))
    turned = run(slew, start_with(4, attitude=quaternion.multiply(turn, jnp.asarray(ATTITUDE))))
    np.testing.assert_allclose(turned.rate_B, plain.rate_B, atol=1e-13)
    np.testing.assert_allclose(
        turned.attitude, quaternion.multiply(turn, plain.attitude), atol=1e-13
    )


def test_an_effect_that_does_nothing_changes_nothing(slew_of, test_torque):
    """The path that integrates all states against the one that integrates only the attitude, padding included."""
    time = np.concatenate([np.cumsum(np.random.default_rng(3).uniform(0.1, 0.5, 40)), np.zeros(8)])
    time[40:] = time[39]
    slew = slew_of(
        time, torques(len(time), 4), SKEWED, np.full(4, 0.02), 0.1 * torques(len(time), 4, 2, 1.0)
    )
    nothing = {"test_torque": {"constant": jnp.zeros(3), "damping": jnp.zeros(3)}}
    for drive in ("commanded", "measured"):
        plain = run(slew, start_with(4), drive=drive)
        full = run(slew, start_with(4), effects=(test_torque,), values=nothing, drive=drive)
        for a, b in zip(plain, full, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-13)
    commanded = run(slew, start_with(4))
    np.testing.assert_array_equal(
        commanded.rate_B[39:], np.broadcast_to(commanded.rate_B[39], (9, 3))
    )  # time stands still in the padding


# --- conventions -----------------------------------------------------------------------------------------
def test_quaternion_algebra_agrees_with_scipy():
    rng = np.random.default_rng(7)
    p, q = Rotation.random(50, rng=rng), Rotation.random(50, rng=rng)
    v = rng.normal(size=(50, 3))
    P, Q = jnp.asarray(p.as_quat()), jnp.asarray(q.as_quat())
    np.testing.assert_allclose(
        Rotation.from_quat(np.asarray(quaternion.multiply(P, Q))).as_matrix(),
        (p * q).as_matrix(),
        atol=1e-14,
    )
    np.testing.assert_allclose(quaternion.to_inertial(P, v), p.apply(v), atol=1e-14)
    np.testing.assert_allclose(quaternion.to_body(P, v), p.inv().apply(v), atol=1e-14)
    np.testing.assert_allclose(quaternion.log(P), p.as_rotvec(), atol=1e-13)
    np.testing.assert_allclose(
        Rotation.from_quat(np.asarray(quaternion.exp(jnp.asarray(v)))).as_matrix(),
        Rotation.from_rotvec(v).as_matrix(),
        atol=1e-14,
    )
    np.testing.assert_allclose(quaternion.error(P, Q), (p.inv() * q).as_rotvec(), atol=1e-13)


def test_the_contracts_matrix_is_v_B_from_v_N():
    """C(q) = (eta^2 - eps.eps) 1 + 2 eps eps^T - 2 eta [eps]x, and eps' = (eps x w + eta w)/2, eta' = -(eps.w)/2."""
    eps, eta = ATTITUDE[:3], ATTITUDE[3]
    C = (eta**2 - eps @ eps) * np.eye(3) + 2.0 * np.outer(eps, eps) - 2.0 * eta * _skew(eps)
    v = np.array([0.3, -1.0, 2.0])
    np.testing.assert_allclose(
        quaternion.to_body(jnp.asarray(ATTITUDE), jnp.asarray(v)), C @ v, atol=1e-14
    )
    slope = np.concatenate([0.5 * (np.cross(eps, RATE) + eta * RATE), [-0.5 * eps @ RATE]])
    np.testing.assert_allclose(
        quaternion.rate_of(jnp.asarray(ATTITUDE), jnp.asarray(RATE)), slope, atol=1e-15
    )


def test_small_rotations_are_smooth_through_zero_and_across_the_switch_of_formulas():
    direction = np.array([0.6, 0.0, 0.8])
    for size in (0.0, 1e-12, 0.99e-4, 1.01e-4, 1e-3):
        x = jnp.asarray(size * direction)
        np.testing.assert_allclose(quaternion.log(quaternion.exp(x)), x, rtol=1e-13, atol=0)
        np.testing.assert_allclose(
            jax.jacfwd(lambda y: quaternion.log(quaternion.exp(y)))(x), np.eye(3), atol=1e-7
        )


def test_locked_tensor_is_what_total_momentum_uses():
    spin = jnp.full(4, 0.02)
    locked = J + np.asarray(inertia_tensor.wheel_spin_tensor(jnp.asarray(SKEWED), spin))
    np.testing.assert_allclose(locked - J, 0.02 * SKEWED @ SKEWED.T, atol=1e-15)
