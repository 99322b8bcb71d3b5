"""For authors of effects: `check_effect` proves that an effect keeps the contract of `bayes_inertia.physics.effect`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.inertia_prior import InertiaPrior
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import EffectError
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model, predict_all
from bayes_inertia.physics.parameters import Parameter
from bayes_inertia.physics.simulator import Drive, Start, idle_slew, simulate

_DRAWS = 8
_SEED = 20250
_NOT_SI = {"deg", "arcsec", "arcmin", "rpm", "min", "h", "gauss"}


@dataclass(frozen=True)
class CheckedEffect:
    """What `check_effect` found out.

    Attributes
    ----------
    name : of the effect.
    fingerprint : {drive: {parameter: size}}, the largest change of the telemetry over draws of the prior, in noise
        sigmas (root of the sum of squares) per prior sd of the parameter; zeros in a drive where the effect cannot act.
    """

    name: str
    fingerprint: Mapping[str, Mapping[str, float]]


def check_effect(effect: Effect, campaign: Campaign | None = None) -> CheckedEffect:
    """Prove that an effect keeps its contract, in every drive that the campaign allows.

    It is a frozen, hashable instance with a name and uniquely named parameters with SI units; at its null values nothing
    changes (1e-12); a batch of parameter vectors gives what a loop over them gives; it is pure (evaluated again, without
    compilation, it gives the same); telemetry and derivatives are finite over draws of the
    prior; every parameter leaves a trace in the telemetry of at least one drive; derivatives agree with differences.

    Parameters
    ----------
    campaign : where to try it; None takes `small_campaign()`.

    Raises
    ------
    EffectError : naming what is broken.

    >>> from bayes_inertia.physics.effects import ConstantTorque
    >>> check_effect(ConstantTorque()).name
    'constant_torque'
    """
    campaign = small_campaign() if campaign is None else campaign
    _check_declaration(effect, campaign)
    drives: list[Drive] = [
        d
        for d, possible in (
            ("commanded", campaign.has_commands),
            ("measured", campaign.has_tachometers),
        )
        if possible
    ]
    prints = {
        drive: _in_drive(effect, campaign, drive, thorough=i == 0)
        for i, drive in enumerate(drives or ["commanded"])
    }
    for name in Model(campaign, (effect,)).space.names[9:]:
        _require(
            max(sizes[name] for sizes in prints.values()) > 1e-6,
            effect,
            f"the parameter {name} changes nothing in the telemetry anywhere in its prior",
            "check that a hook uses it, and that this campaign can show it (pass one that can)",
        )
    return CheckedEffect(effect.name, prints)


def _require(condition: bool, effect: Effect, what: str, advice: str) -> None:
    if not condition:
        raise EffectError(
            what, where=str(getattr(effect, "name", type(effect).__name__)), advice=advice
        )


def _check_declaration(effect: Effect, campaign: Campaign) -> None:
    _require(
        isinstance(effect, Effect),
        effect,
        "this is not an instance of Effect",
        "derive from bayes_inertia.physics.effect.Effect and pass an instance",
    )
    frozen = dataclasses.is_dataclass(effect) and type(effect).__dataclass_params__.frozen
    _require(
        frozen and "__dataclass_params__" in vars(type(effect)),
        effect,
        "the class is not a frozen dataclass",
        "decorate it with @dataclass(frozen=True)",
    )
    named = (
        isinstance(effect.name, str) and effect.name.isidentifier() and effect.name != Effect.name
    )
    _require(
        named,
        effect,
        f"{effect.name!r} is no name for an effect",
        "set the class attribute `name` to an identifier",
    )
    try:
        hash(effect)
    except TypeError as reason:
        raise EffectError(
            "the instance cannot be hashed",
            where=effect.name,
            advice="use numbers, strings and tuples as fields, not arrays or lists",
        ) from reason
    parameters = _guarded(effect, "parameters(campaign)", lambda: effect.parameters(campaign))
    good = (
        isinstance(parameters, tuple)
        and all(isinstance(p, Parameter) for p in parameters)
        and len(parameters) > 0
    )
    _require(
        good,
        effect,
        "parameters(campaign) is not a non-empty tuple of Parameter",
        "return (scalar(...), vector(...))",
    )
    _require(
        parameters == effect.parameters(campaign),
        effect,
        "parameters(campaign) differs from call to call",
        "let it depend on fields and campaign only",
    )
    names = [n for p in parameters for n in p.names]
    doubled = sorted(
        {n for n in names if names.count(n) > 1}
        | {p.name for p in parameters if [q.name for q in parameters].count(p.name) > 1}
    )
    _require(
        not doubled,
        effect,
        f"the parameter name {doubled[:1]} is used twice",
        "give each parameter and component its own name",
    )
    for p in parameters:
        _require(
            isinstance(p.unit, str),
            effect,
            f"{p.name} has no unit",
            'state it as text, "" for a pure number',
        )
        words = set(p.unit.replace("/", " ").replace("^", " ").split())
        _require(
            not words & _NOT_SI,
            effect,
            f"{p.name} is in {p.unit}, not in SI units and radians",
            "convert it",
        )
        _require(
            len(p.priors) == len(p.names),
            effect,
            f"{p.name} has {len(p.priors)} priors for {len(p.names)} components",
            "give one prior a component",
        )
        inside = all(
            prior.lower <= p.null <= prior.upper and np.isfinite(p.null) for prior in p.priors
        )
        _require(
            inside,
            effect,
            f"the null value {p.null} of {p.name} lies outside its prior",
            "a null must be a possible value",
        )


def _guarded(effect: Effect, doing: str, call: Callable):
    """The call's result; whatever goes wrong in it becomes an `EffectError` that says where."""
    try:
        return call()
    except EffectError:
        raise
    except Exception as reason:
        first = (str(reason).strip() or type(reason).__name__).splitlines()[0]
        advice = "hooks must be plain jax.numpy with fixed shapes and no branches on values"
        raise EffectError(
            f"{doing} fails: {type(reason).__name__}: {first}", where=effect.name, advice=advice
        ) from reason


@dataclass(frozen=True)
class _Inert(Effect):
    """Changes nothing but the integration grid, which it shares with the effect that is compared with it."""

    name = "inert"
    step: float | None = None

    def max_step(self, campaign):
        return self.step


@dataclass(frozen=True, eq=False)
class _Bench:
    """One effect in one drive: telemetry as a function of the effect's parameters alone, J and K at their prior means."""

    model: Model
    sigma: np.ndarray = field(init=False)

    def __post_init__(self):
        campaign, like = (
            self.model.campaign,
            jax.eval_shape(self._predict, jnp.asarray(self.model.space.nulls[9:])),
        )
        tracker = campaign.star_tracker
        momentum = np.array([w.momentum_sigma or np.inf for w in campaign.wheels]) * np.ones(
            like.momentum.shape
        )
        if self.model.drive == "measured":
            momentum = np.full(like.momentum.shape, np.inf)
        rate = np.array(campaign.rate_sensor.sigma) * np.ones(like.rate.shape)
        attitude = np.full(like.attitude.shape, 0.5 * tracker.sigma_cross if tracker else np.inf)
        object.__setattr__(
            self, "sigma", np.concatenate([a.ravel() for a in (rate, attitude, momentum)])
        )

    def _predict(self, x: Array):
        model = self.model
        theta = jnp.concatenate([jnp.asarray(model.space.mean[:9]), x])
        return predict_all(
            model.structure,
            theta,
            jnp.zeros((model.n_slews, model.structure.n_local)),
            jnp.zeros(3),
            model.data,
        )

    def __call__(self, x: Array) -> Array:
        """Telemetry (numbers,) in units of its noise."""
        return jnp.concatenate([a.ravel() for a in self._predict(x)]) / self.sigma


def _in_drive(effect: Effect, campaign: Campaign, drive: Drive, thorough: bool) -> dict[str, float]:
    """All checks in one drive (those of the hooks' style only if `thorough`); returns the fingerprint."""
    step = _guarded(effect, "max_step(campaign)", lambda: effect.max_step(campaign))
    bench = _guarded(
        effect, "building the model", lambda: _Bench(Model(campaign, (effect,), drive))
    )
    draws = bench.model.draw_prior(np.random.default_rng(_SEED), _DRAWS)[:, 9:]
    points = np.concatenate([bench.model.space.nulls[None, 9:], draws])
    pushed = _compiled(lambda x, v: jax.jvp(bench, (x,), (v,)))
    at = _guarded(
        effect, "predicting telemetry", lambda: np.array([pushed(x, 0.0 * x)[0] for x in points])
    )
    without = np.array(_compiled(_Bench(Model(campaign, (_Inert(step),), drive)))(jnp.zeros(0)))
    size = max(1.0, float(np.abs(without).max()))
    bad = ~np.isfinite(at).all(axis=1)
    _require(
        not bad.any(),
        effect,
        f"telemetry is not finite at {_show(points[np.argmax(bad)])}",
        "keep every hook finite over the whole prior, and at the null",
    )
    gap = float(np.abs(at[0] - without).max()) / size
    _require(
        gap <= 1e-12,
        effect,
        f"at its null values it changes the telemetry by {gap:.1g} of its size ({drive} drive)",
        "make every hook the identity there",
    )
    if thorough:
        _check_style(effect, bench, points, at, size)
    return _check_derivatives(effect, bench, pushed, points, at)


def _check_style(
    effect: Effect, bench: _Bench, points: np.ndarray, at: np.ndarray, size: float
) -> None:
    """Pure, written for one slew and one vector: batch = loop, compiled = not compiled, and a second evaluation = the first."""
    batch = _guarded(
        effect, "predicting a batch", lambda: np.array(_compiled(jax.vmap(bench))(points))
    )
    gap = float(np.abs(batch - at).max()) / size
    _require(
        gap <= 1e-9,
        effect,
        f"a batch differs from a loop by {gap:.1g}",
        "hooks must be pure, for one slew and one parameter vector, without axes of their own",
    )
    plain = _guarded(
        effect, "predicting without compilation", lambda: np.array(bench(jnp.asarray(points[1])))
    )
    gap = float(np.abs(plain - at[1]).max()) / size
    _require(
        gap <= 1e-9,
        effect,
        f"a second evaluation, not compiled, differs by {gap:.1g}",
        "hooks must be pure: arguments and frozen fields only, no branch on tracing",
    )


def _check_derivatives(
    effect: Effect, bench: _Bench, pushed: Callable, points: np.ndarray, at: np.ndarray
) -> dict[str, float]:
    """Derivatives finite everywhere, equal to differences at the null and at two draws; returns the fingerprint."""
    space = bench.model.space
    sd, lower = space.sd[9:], space.lower[9:]
    units = np.diag(sd)
    jacobian = _guarded(
        effect,
        "differentiating",
        lambda: np.array([[pushed(x, v)[1] for v in units] for x in points]),
    )
    bad = ~np.isfinite(jacobian).all(axis=(1, 2))
    where = "its null values" if bad[0] else _show(points[np.argmax(bad)])
    _require(
        not bad.any(),
        effect,
        f"a derivative is not finite at {where}",
        "guard divisions, roots and norms with jnp.where on both sides",
    )
    sizes = np.linalg.norm(jacobian, axis=2).max(axis=0)
    rng, small = np.random.default_rng(_SEED + 1), 1e-4
    rounding = 1e-14 * float(np.abs(at).max()) * np.sqrt(at.shape[1]) / small
    for i, x in enumerate(points[:3]):
        direction = rng.choice([-1.0, 1.0], size=len(sd))
        if i == 0:  # where a prior ends at the null, the difference goes to the inside
            direction = np.where(x - small * sd < lower, 1.0, direction)
        behind = at[0] if i == 0 else pushed(x - small * sd * direction, x)[0]
        difference = np.array(pushed(x + small * sd * direction, x)[0] - behind) / (
            small if i == 0 else 2.0 * small
        )
        expected = direction @ jacobian[i]
        gap, largest = float(np.linalg.norm(difference - expected)), float(sizes.max())
        allowed = (
            1e-2 * largest
            if i == 0
            else 1e-3 * max(float(np.linalg.norm(expected)), 1e-3 * largest)
        )
        where = "its null values" if i == 0 else _show(x)
        advice = "avoid stop_gradient, rounding and lookups by value; where a formula has a corner, smooth it"
        what = f"the derivative differs from a finite difference by {gap / max(largest, 1e-300):.1g} of its size at {where}"
        _require(gap <= allowed + rounding, effect, what, advice)
    return dict(zip(space.names[9:], sizes.tolist(), strict=True))


def _compiled(function: Callable) -> Callable:
    # Each function runs a few dozen times: compiling it well costs more than it saves.
    return jax.jit(function, compiler_options={"xla_backend_optimization_level": 0})


def _show(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in point) + ")"


def small_campaign() -> Campaign:
    """Three slews of a microsatellite without noise: three wheels with tachometers, star-tracker fixes in all rows, field and position.

    The truth is the prior mean.

    >>> [len(slew.time) for slew in small_campaign().slews]
    [64, 64, 64]
    """
    tensor = np.array([[3.2, -0.02, 0.01], [-0.02, 2.2, 0.03], [0.01, 0.03, 1.9]])
    axes = np.eye(3)
    wheels = tuple(
        Wheel(n, tuple(g), 1e-3, 0.02, 0.3, 5e-6) for n, g in zip("xyz", axes, strict=True)
    )
    pushes = np.array([[3e-3, -1e-3, 0.5e-3], [-1e-3, 3e-3, 1e-3], [1e-3, 0.5e-3, -3e-3]])
    slews = tuple(_small_slew(i, push, tensor, axes) for i, push in enumerate(pushes))
    sensor = RateSensor(sigma=2e-5, bias_sigma=2e-6)
    return Campaign(
        "small",
        InertiaPrior(tensor, 0.04, 0.03),
        wheels,
        sensor,
        StarTracker((0.0, 0.0, 1.0), 2.4e-5, 1.4e-4),
        slews,
    )


def _small_slew(index: int, push: np.ndarray, tensor: np.ndarray, axes: np.ndarray) -> Slew:
    """Turn up, coast, and turn down, with some ripple on the torques."""
    time, start = np.arange(64.0), 300.0 * index
    profile = np.where((time >= 8) & (time < 24), 1.0, 0.0) - np.where(
        (time >= 38) & (time < 54), 1.0, 0.0
    )
    torque = push * profile[:, None] * (1.0 + 0.1 * np.sin(0.7 * time[:, None] + np.arange(3)))
    slew = idle_slew(time, wheel_axes_B=axes, spin_inertia=np.full(3, 1e-3), torque=torque)
    first = Start(
        jnp.array([2e-4, -1e-4, 3e-4]),
        quaternion.exp(jnp.array([0.3, -0.2, 0.1 * index])),
        jnp.array([0.05, -0.04, 0.06]),
    )
    path = simulate(slew, first, jnp.asarray(tensor))[0]
    along = (start + time) * 1.08e-3  # [rad] of a low orbit
    round_N = np.stack([np.cos(along), np.sin(along), np.zeros_like(along)], -1) @ np.array(
        [[0.9, 0.3, -0.3], [-0.3, 0.2, -0.93], [0, 0, 0]]
    )
    return Slew(
        f"slew {index + 1}",
        start,
        time,
        rate=np.array(path.rate_B),
        attitude=np.array(path.attitude),
        wheel_torque=torque,
        wheel_momentum=np.array(path.wheel_momentum),
        magnetic_field_N=3e-5 * np.roll(round_N, 1, axis=1) + 1e-5,
        position_N=7.0e6 * round_N,
    )
