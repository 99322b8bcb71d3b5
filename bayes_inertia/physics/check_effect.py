"""For authors of effects: prove that an effect keeps the contract of `physics.effect`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import block_diag

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.maths.inertia_tensor import tensor as inertia
from bayes_inertia.physics.declaration import check_declaration
from bayes_inertia.physics.effect import (
    LOOKING_BACK,
    MOVING_HOOKS,
    ActiveEffects,
    Effect,
    guarded,
    require_rule,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.packing import Data
from bayes_inertia.physics.prediction import Structure, predict_all, prior_blocks
from bayes_inertia.physics.slew_context import State
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# Functions here run a few dozen times: compiling them well costs more than it saves.
_COMPILED_QUICKLY = {"xla_backend_optimization_level": 0}


@dataclass(frozen=True)
class CheckedEffect:
    """What `check_effect` found out.

    Parameters
    ----------
    name : str
        Name of the effect.
    fingerprint : mapping of str to mapping of str to float
        {drive: {parameter: size}}, the largest change of the telemetry over draws of the prior:
        root of the sum of squares in noise sigmas, per prior sd of the parameter. Zero in a drive
        where the effect cannot act.
    warnings : tuple of str, optional
        What keeps the contract and is probably not meant: a torque that jumps within a step of
        the integration, which mixes what is before and after.
    """

    name: str
    fingerprint: Mapping[str, Mapping[str, float]]
    warnings: tuple[str, ...] = ()


def check_effect(effect: Effect, campaign: Campaign | None = None) -> CheckedEffect:
    """Prove that an effect keeps its contract, in every drive that the campaign allows.

    It is a frozen, hashable instance with a name and uniquely named parameters in SI units. At its
    null values nothing changes (1e-12). A batch of parameter vectors gives what a loop over them
    gives. It is pure: evaluated again, without compilation, it gives the same. Telemetry and
    derivatives are finite over draws of the prior. Derivatives agree with differences. Every
    parameter leaves a trace in the telemetry of at least one drive. The coefficients of an effect
    without a fixed shape have a positive definite covariance, zero at its null; they are tried with
    one draw.

    Parameters
    ----------
    effect : Effect
        The instance to check.
    campaign : Campaign, optional
        Where to try it; `small_campaign()` by default.

    Returns
    -------
    CheckedEffect
        The trace that each parameter leaves.

    Raises
    ------
    EffectError
        Naming what is broken.

    Examples
    --------
    >>> from bayes_inertia.physics.effects import ConstantTorque
    >>> check_effect(ConstantTorque)
    Traceback (most recent call last):
    ...
    bayes_inertia.errors.EffectError: constant_torque: this is not an instance of Effect; ...
    """
    campaign = small_campaign() if campaign is None else campaign
    check_declaration(effect, campaign)
    possible: dict[Drive, bool] = {
        "commanded": campaign.has_commands,
        "measured": campaign.has_tachometers,
    }
    drives = [drive for drive in possible if possible[drive]] or ["commanded"]
    fingerprint: dict[str, dict[str, float]] = {
        drive: _in_drive(effect, campaign, drive, thorough=i == 0) for i, drive in enumerate(drives)
    }
    for name in fingerprint[drives[0]]:
        shows = max(sizes[name] for sizes in fingerprint.values()) > 1e-6
        require_rule(shows, effect, "changes_telemetry", name=name)
    model = Model(campaign, (effect,), drives[0])
    return CheckedEffect(effect.name, fingerprint, _jumps(effect, model))


def _jumps(effect: Effect, model: Model) -> tuple[str, ...]:
    """A warning for each torque that changes within a step as no smooth function of time does."""
    if isinstance(effect, StochasticEffect):
        return ()
    inputs, start = jax.tree.map(
        lambda x: x[0], (model.data.arrays.slews, model.data.arrays.reference)
    )
    context, theta = inputs.context, jnp.asarray(_points(model)[1])
    p = model.structure.active_effects(theta).of(effect)
    environment = jax.tree.map(lambda x: x[0], inputs.environment)
    own = effect.initial_state(p, context, start.rate_B)
    state = State(
        start.attitude, start.rate_B, start.wheel_momentum, own, inertia(theta[:6]), *environment
    )._replace(inputs={name: x.first[0] for name, x in (inputs.inputs or {}).items()})
    part = np.arange(NUMERICS.parts_of_step + 1) / NUMERICS.parts_of_step
    times = context.time[:, None] + part * context.step[:, None]
    found = []
    for hook in ("body_torque", "wheel_torque"):
        if not effect.acts(hook):
            continue
        torque = getattr(effect, hook)
        values = np.asarray(jax.vmap(jax.vmap(lambda t, f=torque: f(p, context, t, state)))(times))
        near = np.abs(np.diff(values, axis=1)).max(axis=(1, 2))
        far = np.abs(np.diff(values[:, ::4], axis=1)).max(axis=(1, 2))
        # A smooth torque changes a quarter as much over a quarter of the time.
        jump = (near > 0.5 * far) & (near > 1e-3 * np.abs(values).max())
        if jump.any():
            at = float(context.time[np.argmax(jump)])
            found.append(
                f"{hook} jumps within the step of the integration that begins at {at:.6g} s, and "
                "the step mixes what is before and after: give what jumps as an input of the slew "
                f'(Slew.inputs), list it (`inputs = ("NAME",)`), and read it by state.input("NAME")'
            )
    return tuple(found)


@dataclass(frozen=True)
class _Inert(Effect):
    """Changes nothing but the grid, which it shares with the effect it is compared with."""

    name = "inert"
    step: float | None = None
    hooks: tuple[str, ...] = ()
    between: bool = True

    def max_step(self, campaign):
        return self.step

    def looks_between_rows(self, campaign):
        return self.between

    def acts(self, hook):
        return hook in self.hooks


@dataclass(frozen=True, eq=False)
class _Bench:
    """Telemetry as a function of one effect's parameters alone, J and K at their prior means."""

    model: Model
    sigma: np.ndarray  # of the noise of all numbers

    def __call__(self, x: Array) -> Array:
        """Telemetry (numbers,) in units of its noise."""
        model = self.model
        theta = jnp.concatenate([jnp.asarray(model.space.mean[: model.n_base]), x])
        local, bias = jnp.asarray(coefficient_draw(model)), jnp.zeros(model.n_bias)
        return _flat(predict_all(model.structure, theta, local, bias, model.data)) / self.sigma


@partial(jax.jit, static_argnums=0, compiler_options=_COMPILED_QUICKLY)
def _prediction(structure: Structure, theta: Array, local: Array, data: Data) -> tuple[Array, ...]:
    return predict_all(structure, theta, local, jnp.zeros_like(data.scale.bias), data)


def _undisturbed(
    effect: Effect, campaign: Campaign, drive: Drive, step: float | None
) -> tuple[Array, ...]:
    """Telemetry without the effect, on its grid; compiled once for all effects with that grid."""
    # One hook of each kind that decides the grid stands for all.
    kinds = (MOVING_HOOKS, LOOKING_BACK)
    hooks = tuple(kind[0] for kind in kinds if any(effect.acts(hook) for hook in kind))
    inert = _Inert(step, hooks, effect.looks_between_rows(campaign))
    model = Model(campaign, (inert,), drive)
    local = jnp.zeros((model.n_slews, model.structure.n_local))
    return _prediction(model.structure, jnp.asarray(model.space.mean), local, model.data)


def _noise_sigma(model: Model, shapes: tuple[Array, ...]) -> np.ndarray:
    """Noise (numbers,) of telemetry in these shapes; infinite where nothing is compared."""
    sigma = []
    for channel, values in zip(model.channels, shapes, strict=True):
        of_columns = channel.column_sigma(model.campaign) if channel.compared else np.inf
        sigma.append(np.broadcast_to(of_columns, values.shape).ravel())
    return np.concatenate(sigma)


def _flat(prediction: tuple[Array, ...]) -> Array:
    """All numbers of predicted telemetry."""
    return jnp.concatenate([a.ravel() for a in prediction])


@dataclass(frozen=True, eq=False)
class _Trial:
    """Telemetry (points, numbers) at the null (first) and at draws of the prior (points, d)."""

    effect: Effect
    bench: _Bench
    points: np.ndarray
    telemetry: np.ndarray
    pushed: Callable  # x (d,), v (d,) -> telemetry at x, and its derivative along v


def _in_drive(effect: Effect, campaign: Campaign, drive: Drive, thorough: bool) -> dict[str, float]:
    """All checks in one drive (of the hooks' style only if `thorough`); the fingerprint."""
    step = guarded(effect, "max_step(campaign)", lambda: effect.max_step(campaign))
    model = guarded(effect, "building the model", lambda: Model(campaign, (effect,), drive))
    check_coefficients(effect, model, _points(model))
    undisturbed = _undisturbed(effect, campaign, drive, step)
    bench = _Bench(model, _noise_sigma(model, undisturbed))
    points = _points(model)[:, model.n_base :]
    pushed = _compiled(lambda x, v: jax.jvp(bench, (x,), (v,)))
    telemetry = guarded(
        effect, "predicting telemetry", lambda: np.array([pushed(x, 0.0 * x)[0] for x in points])
    )
    without = np.array(_flat(undisturbed)) / bench.sigma
    bad = ~np.isfinite(telemetry).all(axis=1)
    require_rule(not bad.any(), effect, "finite", where=_show(points[np.argmax(bad)]))
    size = max(1.0, float(np.abs(without).max()))
    # Without parameters nothing switches an effect off.
    gap = float(np.abs(telemetry[0] - without).max()) / size if points.shape[1] else 0.0
    require_rule(gap <= 1e-12, effect, "null", gap=gap, drive=drive)
    trial = _Trial(effect, bench, points, telemetry, pushed)
    if thorough:
        _check_style(trial, size)
    sizes = _check_derivatives(trial) if points.shape[1] else {}
    # The campaign's devices and sensors may have parameters too.
    own = model.space.names[model.space.slice_of(effect.name)]
    return {name: sizes[name] for name in own}


def _points(model: Model) -> np.ndarray:
    """Parameter vectors (points, d): the nulls first, then draws of the prior."""
    draws = model.draw_prior(np.random.default_rng(NUMERICS.checked_seed), NUMERICS.checked_draws)
    return np.concatenate([model.space.nulls[None], draws])


def _check_style(trial: _Trial, size: float) -> None:
    """Batch = loop, compiled = not compiled, and a second evaluation = the first."""
    effect, bench = trial.effect, trial.bench
    batch = guarded(
        effect, "predicting a batch", lambda: np.array(_compiled(jax.vmap(bench))(trial.points))
    )
    gap = float(np.abs(batch - trial.telemetry).max()) / size
    require_rule(gap <= 1e-9, effect, "batches", gap=gap)
    x = jnp.asarray(trial.points[1])
    plain = guarded(effect, "predicting without compilation", lambda: np.array(bench(x)))
    gap = float(np.abs(plain - trial.telemetry[1]).max()) / size
    require_rule(gap <= 1e-9, effect, "pure", gap=gap)


def _check_derivatives(trial: _Trial) -> dict[str, float]:
    """Derivatives: finite everywhere, equal to differences at three points; the fingerprint."""
    effect, space, points = trial.effect, trial.bench.model.space, trial.points
    units = np.diag(space.sd[space.n_base :])
    jacobian = guarded(
        effect,
        "differentiating",
        lambda: np.array([[trial.pushed(x, v)[1] for v in units] for x in points]),
    )
    bad = ~np.isfinite(jacobian).all(axis=(1, 2))
    where = "its null values" if bad[0] else _show(points[np.argmax(bad)])
    require_rule(not bad.any(), effect, "finite_derivatives", where=where)
    sizes = np.linalg.norm(jacobian, axis=2).max(axis=0)
    rng = np.random.default_rng(NUMERICS.checked_seed + 1)
    for i in range(min(3, len(points))):
        _compare_with_difference(trial, i, jacobian[i], float(sizes.max()), rng)
    return dict(zip(space.names[space.n_base :], sizes.tolist(), strict=True))


def _compare_with_difference(
    trial: _Trial, i: int, jacobian: np.ndarray, largest: float, rng: np.random.Generator
) -> None:
    """The derivative (d, numbers) at point i, along a random diagonal, against a difference."""
    space, x, at_null = trial.bench.model.space, trial.points[i], i == 0
    sd, lower = space.sd[space.n_base :], space.lower[space.n_base :]
    step = NUMERICS.difference_step
    direction = rng.choice([-1.0, 1.0], size=len(sd))
    if at_null:  # where a prior ends at the null, the difference goes to the inside
        direction = np.where(x - step * sd < lower, 1.0, direction)
    move = step * sd * direction
    behind = trial.telemetry[0] if at_null else trial.pushed(x - move, x)[0]
    length = step if at_null else 2.0 * step
    difference = np.array(trial.pushed(x + move, x)[0] - behind) / length
    expected = direction @ jacobian
    gap, size = (float(np.linalg.norm(v)) for v in (difference - expected, expected))
    # A difference to one side is less exact.
    allowed = 1e-2 * largest if at_null else 1e-3 * max(size, 1e-3 * largest)
    telemetry = trial.telemetry
    rounding = 1e-14 * float(np.abs(telemetry).max()) * np.sqrt(telemetry.shape[1]) / step
    where = "its null values" if at_null else _show(x)
    told = {"gap": gap / max(largest, 1e-300), "where": where}
    require_rule(gap <= allowed + rounding, trial.effect, "derivatives", **told)


def _compiled(function: Callable) -> Callable:
    return jax.jit(function, compiler_options=_COMPILED_QUICKLY)


def _show(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in point) + ")"


def coefficient_draw(model: Model) -> np.ndarray:
    """Whitened nuisances with coefficients to try an effect with.

    Returns (slews, n_local): zero but for the coefficients, which are standard normal.
    """
    structure = model.structure
    local = np.zeros((model.n_slews, structure.n_local))
    draw = np.random.default_rng(NUMERICS.coefficient_seed).standard_normal(local.shape)
    local[:, structure.n_start :] = draw[:, structure.n_start :]
    return local


def check_coefficients(effect: Effect, model: Model, points: np.ndarray) -> None:
    """Check the prior covariance of an effect's coefficients.

    `points` (n, d): parameter vectors: the null first, then draws of the prior.
    """
    if not isinstance(effect, StochasticEffect):
        return
    require_rule(bool(model.structure.coefficients), effect, "has_coefficients")
    roots = guarded(
        effect, "coefficient_root(p, slew, count)", lambda: _roots(effect, model, points)
    )
    count = roots.shape[-1]
    own = model.space.slice_of(effect.name)
    has_parameters = own.stop > own.start
    vanishes = not has_parameters or not np.any(roots[0])
    require_rule(vanishes, effect, "null_of_coefficients")
    for k, root in enumerate(roots[1:].reshape(-1, count, count)):
        require_rule(bool(np.isfinite(root).all()), effect, "finite_root", k=k)
        require_rule(_is_definite(root @ root.T), effect, "definite")
    _check_across_slews(effect, model, points[-1])


def _check_across_slews(effect: StochasticEffect, model: Model, theta: np.ndarray) -> None:
    """Check the covariance of all slews, where the effect has one."""
    structure, slews = model.structure, model.data.arrays.slews.context
    active, counts = _alone(effect, structure, jnp.asarray(theta))
    p = active.of(effect)
    call = partial(effect.covariance_across_slews, p, slews)
    given = guarded(effect, "covariance_across_slews(p, slews)", call)
    if given is None:
        return
    covariance = np.asarray(given)
    (blocks,) = jax.vmap(lambda slew: prior_blocks(active, counts, slew))(slews)
    size = blocks.shape[0] * blocks.shape[-1]
    told = {"shape": covariance.shape, "size": size}
    require_rule(covariance.shape == (size, size), effect, "across_shape", **told)
    scale = max(float(np.abs(covariance).max()), 1e-300)
    rounding = NUMERICS.covariance_rounding * scale
    symmetric = np.abs(covariance - covariance.T).max() <= rounding
    good = bool(symmetric and np.linalg.eigvalsh(covariance).min() >= -rounding * size)
    require_rule(good, effect, "across_covariance")


def _alone(
    effect: Effect, structure: Structure, theta: Array
) -> tuple[ActiveEffects, tuple[int, ...]]:
    """The effect without the campaign's devices and stated noise, and how many coefficients."""
    active = structure.active_effects(theta)
    names = [acting.name for acting in active.effects]
    k = names.index(effect.name)
    own = ActiveEffects((active.effects[k],), {effect.name: active.of(effect)})
    return own, (structure.coefficients[k],)


def _roots(effect: Effect, model: Model, points: np.ndarray) -> np.ndarray:
    """Roots (points, slews, k, k)."""
    structure, contexts = model.structure, model.data.arrays.slews.context

    def of_point(theta):
        active, counts = _alone(effect, structure, theta)

        def of_slew(slew):
            blocks = prior_blocks(active, counts, slew)
            return block_diag(*(root for effect in blocks for root in effect))

        return jax.vmap(of_slew)(contexts)

    return np.array(jax.jit(jax.vmap(of_point))(points))


def _is_definite(covariance: np.ndarray) -> bool:
    """Whether a covariance (k, k) has full rank, whatever the units of its rows."""
    sd = np.sqrt(np.diag(covariance))
    if not np.all(sd > 0.0):
        return False
    smallest = np.linalg.eigvalsh(covariance / np.outer(sd, sd)).min()
    return bool(smallest > NUMERICS.zero_eigenvalue)
