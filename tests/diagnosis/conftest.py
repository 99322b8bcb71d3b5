"""Campaigns with and without hidden effects, diagnosed once a session."""

import json
import math
from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.app.diagnosed_fit import Investigation
from bayes_inertia.app.diagnosis_json import to_json
from bayes_inertia.diagnosis.random_signals import STOCHASTIC_CANDIDATES
from bayes_inertia.diagnosis.residuals import scan_residuals
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, WheelCommandLag, by_name
from bayes_inertia.physics.parameters import Normal, scalar, vector

# Without the flexible mode, whose every refit compiles code of its own.
RIGID = tuple(e for e in LIBRARY if e.name != "flexible_mode")
# One of each kind: a model with all effects compiles three times as long.
FEW = by_name(["rate_bias", "star_tracker_shift", "wheel_command_lag", "constant_torque"])


@dataclass(frozen=True)
class Planted(Effect):
    """Torques that no fit is told of, flown by one program: a pump at 0.3 Hz about -y that never
    stops, one that grows with the square of the rate, a steady one.
    """

    name: ClassVar[str] = "planted"

    def parameters(self, campaign):
        prior = Normal(0.0, 1e-4)
        return (
            scalar("pump", unit="N m", prior=prior),
            vector("square", "xyz", unit="N m s^2", prior=prior),
            vector("steady", "xyz", unit="N m", prior=prior),
        )

    def body_torque(self, p, slew, t, state):
        ringing = p["pump"] * jnp.sin(2.0 * jnp.pi * 0.3 * t)
        turning = p["square"] * jnp.sum(state.rate_B**2)
        return turning + p["steady"] - ringing * jnp.array([0.0, 1.0, 0.0])


def of_planted(pump=0.0, square=(0.0, 0.0, 0.0), steady=(0.0, 0.0, 0.0)):
    """The effect, and its values, as `flight` takes them."""
    values = {"pump": pump, "square": square, "steady": steady}
    return (Planted(),), {Planted.name: {k: np.array(v) for k, v in values.items()}}


@pytest.fixture(scope="session")
def rigid_library():
    """The library without the flexible mode."""
    return RIGID


@pytest.fixture(scope="session")
def few_candidates():
    """A library of four effects."""
    return FEW


@pytest.fixture(scope="session")
def flight():
    """`flight(effects, values, seed)`: a campaign of three slews at 2 Hz; all have one shape, so
    that they share compiled code. Each other effect is flown by another program.
    """
    plan = replace(paper_like_plan(), telemetry_period=0.5)
    plan = replace(plan, slews=(plan.slews[0], plan.slews[3], plan.slews[4]))
    template = planned_campaign(plan, most_like_mission())

    def fly(effects=(), values=None, seed=11):
        return drawn(effects, values, seed).campaign

    def drawn(effects, values, seed=11):
        return draw_flight(template, plan, seed, effects=effects, values=values, vary=False)

    fly.spacecraft_of = lambda effects, values: drawn(effects, values).spacecraft
    return fly


@pytest.fixture(scope="session")
def planted(flight):
    """`planted(pump=, square=, steady=, seed=)`: a campaign of `flight` with these torques."""
    return lambda seed=11, **torques: flight(*of_planted(**torques), seed)


@pytest.fixture(scope="session")
def pumped_truth(flight):
    """J (six elements) and K of the spacecraft of `pumped`."""
    craft = flight.spacecraft_of(*of_planted(pump=3e-4))
    J = craft.inertia_B
    return np.array([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *craft.scale_factor])


@pytest.fixture(scope="session")
def clean(planted):
    return planted()


@pytest.fixture(scope="session")
def clean_diagnosis(clean, computed_once):
    """The diagnosis of a campaign where nothing is missing."""
    return computed_once("clean_diagnosis", lambda: diagnose(clean))


@pytest.fixture(scope="session")
def lagging(flight, computed_once):
    late = {"wheel_command_lag": {"tau": np.array(0.1)}}
    return computed_once("lagging", lambda: diagnose(flight((WheelCommandLag(),), late)))


@pytest.fixture(scope="session")
def pumped(planted, computed_once):
    return computed_once("pumped", lambda: diagnose(planted(pump=3e-4), library=RIGID))


@pytest.fixture(scope="session")
def pumped_for_few(planted, computed_once):
    """A weaker pump, and four candidates: no formula is tried, which compiles models of its own."""
    return computed_once("pumped_for_few", lambda: diagnose(planted(pump=6e-5), library=FEW))


@pytest.fixture(scope="session")
def torqued(planted, computed_once):
    """A weak constant torque, which three slews cannot tell from a star-tracker shift."""
    weak = 1e-7 * np.array([1.0, -1.0, 1.0])
    return computed_once("torqued", lambda: diagnose(planted(steady=weak), library=RIGID))


def _content_of(found, **more):
    changed = bool(found.steps) or any(f > 1.0 for f in found.noise.values())
    after = scan_residuals(found.final, stated=False) if changed else None
    return to_json(Investigation(found, scan_residuals(found.base), after, **more))


@pytest.fixture(scope="session")
def content_of():
    """`content_of(diagnosis, **more)`: what diagnosis.json holds."""
    return _content_of


def _check_contract(content: dict, library=LIBRARY) -> None:
    """diagnosis.json as DESIGN section 8 promises it."""
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert content["verdict"] in (
        "consistent",
        "named",
        "ambiguous",
        "formula",
        "partial",
        "unknown",
    )
    tried = {c["effect"] for c in content["candidates"] if "formula_" not in c["effect"]}
    assert {e.name for e in library} | {"noise_level"} <= tried
    assert tried <= {e.name for e in (*library, *STOCHASTIC_CANDIDATES)} | {"noise_level"}
    for c in content["candidates"]:
        assert {
            "effect",
            "dof",
            "score",
            "p_value",
            "log_bayes_factor",
            "parameters",
            "reason",
        } == set(c)
        assert (c["p_value"] is None) == (c["score"] is None)
        assert c["p_value"] is not None or c["reason"]
        assert (c["parameters"] is not None) == (
            c["effect"] in [s["added"] for s in content["steps"]]
        )
    for w in content["disagreement"]:
        assert {"channel", "slew", "t_start", "t_end", "p_value"} <= set(w)
        assert w["channel"] in ("rate", "attitude", "momentum")
        assert w["t_start"] <= w["t_end"]
        assert 0.0 <= w["p_value"] < 0.05
    for s in content["steps"]:
        assert (
            set(s["reduced_chi2_before"])
            == set(s["reduced_chi2_after"])
            == {"rate", "attitude", "momentum", "total"}
        )
        assert set(s["shift"]) == {"Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3"}
    assert (content["unknown"] is not None) == (content["verdict"] in ("partial", "unknown"))
    if content["unknown"]:
        assert {"description", "axis", "frequency_hz", "torque_rms"} <= set(content["unknown"])
        assert math.isclose(np.linalg.norm(content["unknown"]["axis"]), 1.0, rel_tol=1e-9)


@pytest.fixture(scope="session")
def check_contract():
    """`check_contract(content, library)`: diagnosis.json holds what DESIGN section 8 promises."""
    return _check_contract
