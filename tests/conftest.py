"""Small campaigns simulated with the package's own dynamics plus noise, shared by all tests of the
core.

Campaigns of one `Setup` have one shape, so that all tests of a session share compiled code.
"""

from __future__ import annotations

import os

# Matrices are small: with workers on all cores, more threads only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gc
import pickle
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filelock import FileLock

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, vector
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import SlewInput, Start, idle_slew

# Until all is imported.
gc.disable()
# No test writes to the user's cache folder.
os.environ.setdefault("BAYES_INERTIA_CACHE", "off")


def pytest_collection_finish(session):
    """What was imported stays: tracing makes so many objects that looking through all of it again
    and again takes a twentieth of a session.
    """
    gc.enable()
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


PRIOR_TENSOR = np.array([[3.2, -0.02, 0.01], [-0.02, 2.2, 0.03], [0.01, 0.03, 1.9]])
SKEW_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.64, 0.48))


@dataclass(frozen=True)
class Setup:
    """What a simulated campaign looks like; lengths in rows, times in s, everything SI."""

    turns: tuple[tuple[float, float, float], ...] = (
        (0.6, 0.1, 0.0),
        (0.0, 0.7, 0.2),
        (0.1, -0.2, 0.8),
    )  # rotation vector of each slew [rad]
    rows: int = 96
    dt: float = 1.0
    wheels: int = 3
    rate_sigma: float = 2e-5
    momentum_sigma: float = 5e-6
    fix_rows: tuple[int, ...] = (0, 1, 2, 3, -4, -3, -2, -1)
    spin_inertia: float = 1e-3
    relative_sigma: float = 0.04
    product_sigma: float = 0.03
    commands: bool = True
    includes_wheel_spin: bool = False
    start_rate: tuple[float, float, float] = (2e-4, -1e-4, 3e-4)
    start_momentum: float = 0.02  # sd of each wheel's momentum at the first row [N m s]


@dataclass(frozen=True)
class Truth:
    """What the telemetry was simulated with: theta (9,) as `ParameterSpace` orders it, rate bias
    (3,) [rad/s].
    """

    theta: np.ndarray
    bias: np.ndarray


@dataclass(frozen=True)
class Flown:
    """A simulated campaign and its truth."""

    campaign: Campaign
    truth: Truth
    setup: Setup = field(default_factory=Setup)


@dataclass(frozen=True)
class TestTorque(Effect):
    """An external torque for tests: constant and rate-proportional in body axes."""

    __test__ = False
    name = "test_torque"

    def parameters(self, campaign):
        return (
            vector("constant", "xyz", unit="N m", prior=Normal(0.0, 1e-5)),
            vector("damping", "xyz", unit="N m s", prior=Normal(0.0, 1e-4)),
        )

    def body_torque(self, p, slew, t, state):
        return p["constant"] - p["damping"] * state.rate_B


_run = jax.jit(lambda slew, start, J: simulate_slew(slew, start, J)[0])


def _wheels(setup: Setup) -> tuple[Wheel, ...]:
    return tuple(
        Wheel(f"w{i}", SKEW_AXES[i], setup.spin_inertia, 0.02, 0.3, setup.momentum_sigma)
        for i in range(setup.wheels)
    )


def _profile(setup: Setup, turn) -> np.ndarray:
    """Wheel torques (n, wheels) of a bang-coast-bang slew for the prior's inertia."""
    rows, n = np.arange(setup.rows), setup.rows
    sign = np.where((rows >= 0.1 * n) & (rows < 0.3 * n), 1.0, 0.0) - np.where(
        (rows >= 0.7 * n) & (rows < 0.9 * n), 1.0, 0.0
    )
    # Speeding up over 0.2 T and coasting to 0.7 T: angle = a (0.2 T) (0.6 T).
    acceleration = np.asarray(turn) / (0.12 * (n * setup.dt) ** 2)
    axes = np.array(SKEW_AXES[: setup.wheels]).T
    return -sign[:, None] * (np.linalg.pinv(axes) @ (PRIOR_TENSOR @ acceleration))


def _truth(setup: Setup, rng: np.random.Generator) -> Truth:
    prior = InertiaPrior(PRIOR_TENSOR, setup.relative_sigma, setup.product_sigma)
    elements = prior.elements + prior.sd * rng.normal(size=6)
    while not bool(inertia_tensor.is_physical(elements)):
        elements = prior.elements + prior.sd * rng.normal(size=6)
    return Truth(
        np.concatenate([elements, 1.0 + 0.03 * rng.normal(size=3)]), 1e-5 * rng.normal(size=3)
    )


def fly(
    seed: int, setup: Setup = Setup(), *, noise: float = 1.0, truth: Truth | None = None
) -> Flown:
    """Simulate one campaign; its truth is a draw of the prior, unless given; `noise` multiplies all
    noise.
    """
    rng = np.random.default_rng(seed)
    drawn = _truth(setup, rng)
    truth = truth or drawn
    axes, spin = (
        np.array(SKEW_AXES[: setup.wheels]).reshape(-1, 3).T,
        np.full(setup.wheels, setup.spin_inertia),
    )
    J = np.array(inertia_tensor.tensor(jnp.asarray(truth.theta[:6])))
    if setup.includes_wheel_spin:
        J = J - axes @ np.diag(spin) @ axes.T
    slews = []
    for i, turn in enumerate(setup.turns):
        time, torque = np.arange(setup.rows) * setup.dt, _profile(setup, turn)
        attitude = quaternion.exp(jnp.asarray(rng.normal(size=3)))
        start = Start(
            jnp.asarray(setup.start_rate),
            attitude,
            jnp.asarray(setup.start_momentum * rng.normal(size=setup.wheels)),
        )
        flown = _run(idle_slew(time, setup.wheels, axes, spin, torque), start, J)
        slews.append(
            _measure(f"slew {i + 1}", 500.0 * i, time, torque, flown, truth, setup, noise, rng)
        )
    prior = InertiaPrior(
        PRIOR_TENSOR, setup.relative_sigma, setup.product_sigma, setup.includes_wheel_spin
    )
    tracker = StarTracker((0.0, 0.0, 1.0), 2.5e-5, 1.5e-4) if setup.fix_rows else None
    campaign = Campaign(
        "simulated",
        prior,
        _wheels(setup),
        RateSensor(sigma=setup.rate_sigma, range=0.05),
        tracker,
        tuple(slews),
    )
    return Flown(campaign, truth, setup)


def _measure(
    name, begin, time, torque, flown, truth: Truth, setup: Setup, noise: float, rng
) -> Slew:
    n = len(time)
    rate = (np.asarray(flown.rate_B) + truth.bias) / truth.theta[
        6:9
    ] + noise * setup.rate_sigma * rng.normal(size=(n, 3))
    momentum = np.asarray(flown.wheel_momentum) + noise * setup.momentum_sigma * rng.normal(
        size=(n, setup.wheels)
    )
    attitude = np.full((n, 4), np.nan)
    rows = [r % n for r in setup.fix_rows]
    small = noise * rng.normal(size=(len(rows), 3)) * np.array([2.5e-5, 2.5e-5, 1.5e-4])
    if rows:
        attitude[rows] = quaternion.multiply(
            flown.attitude[np.array(rows)], quaternion.exp(jnp.asarray(small))
        )
    return Slew(
        name,
        begin,
        time,
        rate,
        attitude if rows else None,
        torque if setup.commands else None,
        momentum,
    )


def slew_input(time, torque, axes, spin, momentum=None) -> SlewInput:
    """A slew for the simulator with a wheel momentum (n, wheels) to drive the measured mode."""
    slew = idle_slew(time, np.shape(axes)[1], axes, spin, torque)
    return slew if momentum is None else slew._replace(momentum=np.asarray(momentum))


@pytest.fixture(scope="session")
def computed_once(tmp_path_factory, worker_id):
    """`computed_once(name, make)`: what `make()` returns, worked out by one worker for all.

    It is pickled into the folder that the workers of a session share.
    """
    shared = tmp_path_factory.getbasetemp()
    shared = shared if worker_id == "master" else shared.parent

    def compute(name, make):
        path = shared / f"{name}.pickle"
        with FileLock(f"{path}.lock"):
            if not path.exists():
                path.write_bytes(pickle.dumps(make()))
        return pickle.loads(path.read_bytes())

    return compute


@pytest.fixture(scope="session")
def flying():
    """`fly(seed, setup, noise=, truth=)` and `Setup`, for tests that need their own campaigns."""
    return fly


@pytest.fixture(scope="session")
def setup_type():
    """The class that describes a simulated campaign."""
    return Setup


@pytest.fixture(scope="session")
def truth_type():
    """The class of a simulated campaign's truth."""
    return Truth


@pytest.fixture(scope="session")
def test_torque():
    """An effect with an external torque."""
    return TestTorque()


@pytest.fixture(scope="session")
def slew_of():
    """`slew_input(time, torque, axes, spin, momentum)`."""
    return slew_input


@pytest.fixture(scope="session")
def flown():
    """One perfectly specified campaign of three slews."""
    return fly(1)


@pytest.fixture(scope="session")
def small_flown():
    """Two slews: few enough to sample every nuisance."""
    return fly(2, Setup(turns=((0.6, 0.1, 0.0), (0.1, 0.5, 0.5))))
