"""The contract of effects: the library keeps it, broken effects are rejected."""

from __future__ import annotations

import importlib.util
import itertools
import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.effects import thrown_body
from support.marks import LIKE_ANOTHER

import bayes_inertia as bi
from bayes_inertia.errors import EffectError
from bayes_inertia.inference.laplace import model_of
from bayes_inertia.physics.check_effect import check_effect
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import (
    LIBRARY,
    by_name,
)
from bayes_inertia.physics.parameters import LogNormal, Normal, scalar, vector
from bayes_inertia.physics.small_campaign import small_campaign

CANONICAL = [
    "rate_bias",
    "rate_bias_drift",
    "rate_sensor_misalignment",
    "rate_sensor_delay",
    "rate_sensor_nonlinearity",
    "star_tracker_misalignment",
    "star_tracker_shift",
    "star_tracker_time_offset",
    "wheel_torque_gain",
    "wheel_misalignment",
    "wheel_friction",
    "wheel_command_lag",
    "constant_torque",
    "magnetic_dipole",
    "gravity_gradient",
    "viscous_torque",
    "flexible_mode",
    "inertia_change",
]


@pytest.fixture(scope="module")
def commanded(campaign):
    """The campaign without tachometers, in which one drive is possible."""
    slews = tuple(replace(slew, wheel_momentum=None) for slew in campaign.slews)
    return replace(campaign, slews=slews)


def test_the_library_has_the_canonical_names():
    assert [effect.name for effect in LIBRARY] == CANONICAL


def test_unknown_names_are_refused_with_the_nearest_ones():
    with pytest.raises(EffectError, match=r"'wheel_gain'.*wheel_torque_gain"):
        by_name(["wheel_gain"])
    with pytest.raises(EffectError, match="twice"):
        by_name(["rate_bias", "rate_bias"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        pytest.param(e, id=e.name, marks=() if e.name == "wheel_command_lag" else pytest.mark.long)
        for e in LIBRARY
    ],
)
def test_every_library_effect_keeps_the_contract(effect, campaign):
    fingerprint = check_effect(effect, campaign).fingerprint
    assert set(fingerprint) == {"commanded", "measured"}
    # What acts on commands, or between wheels and body, cannot show where tachometers drive the
    # model.
    on_commands = effect.name in ("wheel_torque_gain", "wheel_friction", "wheel_command_lag")
    assert (max(fingerprint["measured"].values()) == 0.0) == on_commands


@pytest.mark.parametrize("effect", LIBRARY, ids=lambda e: e.name)
def test_default_priors_scale_with_the_body(effect, campaign):
    """What a prior sd does to a satellite in a minute and to a gram-scale body in half a second is
    alike in the body's own scales.
    """
    rate, duration, mass = campaign.scale_of_motion()
    rate_t, duration_t, mass_t = thrown_body().scale_of_motion()
    factors = {
        "N m": mass * rate / duration / (mass_t * rate_t / duration_t),
        "N m s": mass / duration / (mass_t / duration_t),
        "kg m^2": mass / mass_t,
        "kg^0.5 m": (mass / mass_t) ** 0.5,
        "s": duration / duration_t,
    }
    small = {p.name: p for p in effect.parameters(thrown_body())}
    for parameter in effect.parameters(campaign):
        assert all(np.isfinite(prior.sd) and prior.sd > 0.0 for prior in parameter.priors)
        if parameter.unit in factors and parameter.name in small:
            assert parameter.priors[0].sd == pytest.approx(
                small[parameter.name].priors[0].sd * factors[parameter.unit]
            )


def test_effects_on_wheels_do_nothing_where_there_are_none():
    for effect in LIBRARY:
        if effect.name.startswith("wheel") and effect.name != "wheel_command_lag":
            assert effect.parameters(thrown_body()) == ()


@dataclass(frozen=True)
class Torque(Effect):
    """A good effect that the broken ones spoil in one way each."""

    name = "torque"

    def parameters(self, campaign):
        return (vector("torque", "xyz", unit="N m", prior=Normal(0.0, 1e-5)),)

    def body_torque(self, p, slew, t, state):
        return p["torque"]


@dataclass(frozen=True)
class NotANoOp(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] + 1e-9


@dataclass(frozen=True)
class Impure(Torque):
    calls = itertools.count()

    def body_torque(self, p, slew, t, state):
        return p["torque"] * (1.0 + 1e-3 * next(self.calls))


@dataclass(frozen=True)
class NotFinite(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] * jnp.sqrt(p["torque"][0])


@dataclass(frozen=True)
class DerivativeNotFinite(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] * jnp.linalg.norm(p["torque"])


@dataclass(frozen=True)
class DoubledName(Torque):
    def parameters(self, campaign):
        return (
            *super().parameters(campaign),
            scalar("torque_x", unit="N m", prior=Normal(0.0, 1.0)),
        )


@dataclass(frozen=True)
class Degrees(Torque):
    def parameters(self, campaign):
        return (vector("torque", "xyz", unit="deg/s", prior=Normal(0.0, 1e-5)),)


@dataclass(frozen=True)
class NoUnit(Torque):
    def parameters(self, campaign):
        return (vector("torque", "xyz", unit=None, prior=Normal(0.0, 1e-5)),)


@dataclass(frozen=True)
class NoFingerprint(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] * jnp.array([1.0, 1.0, 0.0])


@dataclass(frozen=True)
class WrongDerivative(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] * (1.0 + 1e5 * jax.lax.stop_gradient(p["torque"][0]))


@dataclass(frozen=True)
class BranchOnValue(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"] if p["torque"][0] > 0.0 else 0.0 * p["torque"]


@dataclass(frozen=True)
class OneNumber(Torque):
    def body_torque(self, p, slew, t, state):
        return p["torque"][0]


@dataclass(frozen=True)
class NoAnswer(Torque):
    def body_torque(self, p, slew, t, state):
        return None


@dataclass(frozen=True)
class Unhashable(Torque):
    direction: object = None


@dataclass(frozen=True)
class OfPrior(Torque):
    prior: object = None

    def parameters(self, campaign):
        kind, *numbers = self.prior
        return (vector("torque", "xyz", unit="N m", prior=kind(*numbers)),)


class NotADataclass(Torque):
    pass


@dataclass(frozen=True)
class OfLibrary(Torque):
    name = "constant_torque"


@dataclass(frozen=True)
class NoName(Torque):
    name = 3


@dataclass(frozen=True)
class UnknownNeed(Torque):
    needs = ("magfield",)


@dataclass(frozen=True)
class NoSuchParameter(Torque):
    def body_torque(self, p, slew, t, state):
        return p["force"]


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        pytest.param(NotANoOp(), "at its null values it changes", marks=pytest.mark.slow),
        pytest.param(Impure(), "pure", marks=pytest.mark.slow),
        pytest.param(NotFinite(), "telemetry is not finite", marks=pytest.mark.slow),
        pytest.param(
            DerivativeNotFinite(),
            "a derivative is not finite at its null",
            marks=LIKE_ANOTHER,
        ),
        (DoubledName(), "'torque_x'.*used twice"),
        (Degrees(), "not in SI units"),
        (NoUnit(), "no unit"),
        pytest.param(
            NoFingerprint(),
            "torque_z changes nothing",
            marks=LIKE_ANOTHER,
        ),
        pytest.param(WrongDerivative(), "finite difference", marks=pytest.mark.slow),
        (BranchOnValue(), "TracerBoolConversionError"),
        (OneNumber(), r"body_torque returned .*\(\), not an array of shape \(3,\)"),
        (NoAnswer(), "body_torque returned a NoneType"),
        (Unhashable(direction=[1.0]), "cannot be hashed"),
        (NotADataclass(), "not a frozen dataclass"),
        (Torque, "not an instance"),
        (OfLibrary(), "the library has an effect called 'constant_torque'"),
        (NoName(), "3 is no name for an effect"),
        (UnknownNeed(), r"needs \['magfield'\], which no slew has; it may need magnetic_field_N"),
        (NoSuchParameter(), "torque: body_torque fails: KeyError: 'force'"),
        (OfPrior((lambda: 3,)), "priors of torque: an int is no Normal or LogNormal"),
        (OfPrior((Normal, 0.0, 0.0)), r"parameters.*Normal prior: the scale is 0.0"),
        (OfPrior((LogNormal, 1.0, np.nan)), "LogNormal prior: the scale is nan"),
        (Torque(prior_scale=0.0), r"prior_scale: 0.0 is not above zero"),
    ],
    ids=lambda x: getattr(x, "__name__", type(x).__name__) if not isinstance(x, str) else "",
)
def test_broken_effects_are_rejected(effect, words, commanded):
    with pytest.raises(EffectError, match=words):
        check_effect(effect, commanded)


def test_the_good_effect_that_the_broken_ones_derive_from_passes(commanded):
    assert min(check_effect(Torque(), commanded).fingerprint["commanded"].values()) > 1.0


@pytest.mark.parametrize(
    ("effects", "says"),
    [
        (["magnetic_dipol"], "no effect of this name.*perhaps magnetic_dipole"),
        ("magnetic_dipole", "'magnetic_dipole' is no list of effects"),
        ([Torque], "is no effect; give instances"),
        (Torque(), "is no list of effects"),
        ([Unhashable(direction=[1.0])], "torque: the instance cannot be hashed"),
        ([OfLibrary()], "the library has an effect called 'constant_torque'"),
        ([NotADataclass()], "not a frozen dataclass"),
        ([UnknownNeed()], r"needs \['magfield'\]"),
        ([NoSuchParameter()], "torque: body_torque fails: KeyError: 'force'"),
    ],
)
def test_a_fit_says_what_is_no_list_of_effects(effects, says, campaign):
    for call in (bi.fit, bi.log_density):
        with pytest.raises(EffectError, match=says):
            call(campaign, effects=effects)


def test_effects_are_taken_by_name_as_at_the_command_line(campaign):
    model = model_of(campaign, effects=["inertia_change:from_slew=2", Torque()])
    assert [effect.name for effect in model.effects] == ["inertia_change", "torque"]
    assert model.effects[0].from_slew == 2


def test_a_fit_says_what_is_no_settings(campaign):
    with pytest.raises(bi.SettingsError, match=r"settings: a dict is no Settings; give Settings"):
        bi.fit(campaign, settings={"steps": 64})
    with pytest.raises(bi.SettingsError, match=r"settings: a dict is no Settings; give Settings"):
        bi.diagnose_and_fit(campaign, settings={"steps": 64})


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"as_stated": "no"}, "as_stated: a str is no bool; give True or False"),
        ({"predict": 0}, "predict: an int is no bool"),
        ({"context": {}}, "context: a dict is no FitContext"),
        ({"alternatives": 3}, "alternatives: an int is no list"),
    ],
)
def test_a_fit_says_what_is_no_argument_of_its_kind(asked, says, campaign):
    with pytest.raises(bi.SettingsError, match=says):
        bi.fit(campaign, **asked)


@pytest.mark.parametrize("noise", [bi.ChannelNoise("student_t"), "student_t"])
def test_a_fit_says_what_is_no_model_of_the_noise(noise, campaign):
    with pytest.raises(bi.CampaignError, match=r"noise: a \w+ is no NoiseModel; give"):
        bi.fit(campaign, noise=noise)
    with pytest.raises(bi.SettingsError, match="noise of rate: 'student_t' is no ChannelNoise"):
        bi.NoiseModel(rate="student_t")
    with pytest.raises(bi.SettingsError, match="scale_sampled: a str is no bool"):
        bi.ChannelNoise(scale_sampled="x")


@pytest.mark.long
@pytest.mark.slow
def test_a_random_effect_is_checked_where_devices_act_too():
    campaign = small_campaign()
    slews = tuple(
        replace(s, inputs={"jets": bi.InputStream(s.time[:1], np.zeros((1, 3)))})
        for s in campaign.slews
    )
    jets = bi.Thruster("jets", 1e-3 * np.eye(3), gain_sigma=0.1)
    with_jets = replace(campaign, actuators=(jets,), slews=slews)
    checked = check_effect(bi.RateRandomWalk(), with_jets)
    assert set(checked.fingerprint["commanded"]) == {"rate_random_walk.density"}


@pytest.mark.long
@pytest.mark.slow
def test_an_outsider_s_effect_needs_one_file(capsys):
    path = Path(__file__).resolve().parents[2] / "analyses/naming/outside_effect.py"
    spec = importlib.util.spec_from_file_location("outside_effect", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["outside_effect"] = module
    spec.loader.exec_module(module)
    fitted, truth = module.main()
    assert re.search("the contract holds", capsys.readouterr().out)
    assert np.abs((fitted.theta - truth) / fitted.sd).max() < 3.5
    assert (fitted.sd[9:] < 0.5 * fitted.model.space.sd[9:]).all()
