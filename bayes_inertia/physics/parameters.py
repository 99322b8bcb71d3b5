"""Parameters with unit, prior and null value, and the flat space that a sampler sees."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import special, stats

from bayes_inertia.errors import SettingsError, members, require
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.maths.values import array_dataclass, numbers


@dataclass(frozen=True)
class Normal:
    """Gaussian prior, truncated where limits are given.

    Parameters
    ----------
    mean, scale : float
        Mean and standard deviation of the Gaussian, in the parameter's unit.
    lower, upper : float, optional
        Ends of the support.

    Raises
    ------
    SettingsError
        If a number is not finite, the scale not above zero, or the ends not in order.

    Examples
    --------
    >>> Normal(0.0, 2.0).sd, Normal(0.0, 1.0, lower=0.0).sd
    (2.0, 0.602...)
    """

    mean: float
    scale: float
    lower: float = -np.inf
    upper: float = np.inf
    logarithmic = False

    def __post_init__(self) -> None:
        _require_distribution(self)

    @property
    def distribution(self) -> stats.rv_continuous:
        """The same distribution from `scipy.stats`."""
        a, b = (self.lower - self.mean) / self.scale, (self.upper - self.mean) / self.scale
        return stats.truncnorm(a, b, loc=self.mean, scale=self.scale)

    @property
    def sd(self) -> float:
        """Standard deviation, in the parameter's unit."""
        if np.isinf(self.lower) and np.isinf(self.upper):
            return float(self.scale)
        return float(self.distribution.std())


@dataclass(frozen=True)
class LogNormal:
    """Prior of a positive quantity known to a factor: log(x / median) is Gaussian.

    Parameters
    ----------
    median : float
        Median, in the parameter's unit.
    scale : float
        Standard deviation of the logarithm.
    lower, upper : float, optional
        Ends of the support.

    Raises
    ------
    SettingsError
        If a number is not finite, the scale not above zero, or the ends not in order.

    Examples
    --------
    >>> round(LogNormal(0.5, 0.1).sd, 4)
    0.0504
    """

    median: float
    scale: float
    lower: float = 0.0
    upper: float = np.inf
    logarithmic = True

    def __post_init__(self) -> None:
        _require_distribution(self)

    @property
    def mean(self) -> float:
        """Logarithm of the median: the centre of the Gaussian that log(x) follows."""
        return float(np.log(self.median))

    @property
    def distribution(self) -> stats.rv_continuous:
        """The same distribution from `scipy.stats`."""
        if self.lower <= 0.0 and np.isinf(self.upper):
            return stats.lognorm(self.scale, scale=self.median)
        with np.errstate(divide="ignore"):
            a, b = np.log(np.maximum([self.lower, self.upper], 0.0) / self.median) / self.scale
        return _TRUNCATED(self.scale, a, b, scale=self.median)

    @property
    def sd(self) -> float:
        """Standard deviation, in the parameter's unit."""
        return float(self.distribution.std())


Prior = Normal | LogNormal


class _TruncatedLogNormal(stats.rv_continuous):
    """exp(s z) of a standard Gaussian z between a and b; scipy has none that is frozen alike."""

    def _argcheck(self, s, a, b):
        return (s > 0.0) & (a < b)

    def _get_support(self, s, a, b):
        return np.exp(s * a), np.exp(s * b)

    def _pdf(self, x, s, a, b):
        return stats.truncnorm.pdf(np.log(x) / s, a, b) / (s * x)

    def _cdf(self, x, s, a, b):
        return stats.truncnorm.cdf(np.log(x) / s, a, b)

    def _ppf(self, q, s, a, b):
        return np.exp(s * stats.truncnorm.ppf(q, a, b))


_TRUNCATED = _TruncatedLogNormal(name="truncated log-normal")


def _require_distribution(prior: Prior) -> None:
    """Raise unless the numbers make a distribution."""
    centre = "median" if prior.logarithmic else "mean"
    given = getattr(prior, centre)
    where = f"{type(prior).__name__} prior"
    known = all(isinstance(x, Real) for x in (given, prior.scale, prior.lower, prior.upper))
    advice = "give one number each; components that differ have priors of their own"
    require(known, where, "not all are numbers", advice, error=SettingsError)
    least = max(prior.lower, 0.0 if prior.logarithmic else -np.inf)
    no_value = f"no value lies between {prior.lower} and {prior.upper}"
    for good, what, advice in (
        (np.isfinite(given), f"the {centre} is {given}", "give a number"),
        (given > 0.0 or not prior.logarithmic, f"the {centre} is {given}", "give one above zero"),
        (0.0 < prior.scale < np.inf, f"the scale is {prior.scale}", "give one above zero"),
        (least < prior.upper, no_value, "give lower < upper"),
    ):
        require(good, where, what, advice, error=SettingsError)


# J and K, first in every model, before the parameters of effects: of a rate sensor of three axes,
# as series of campaigns and planned flights have it. What a model has: `Structure.n_base`.
N_BASE = len(ELEMENTS) + 3


def base_names(n: int) -> tuple[str, ...]:
    """Names of J and K where they are n numbers: six elements, then K of each sensor axis.

    Examples
    --------
    >>> base_names(8)[5:]
    ('Jyz', 'K1', 'K2')
    """
    return (*ELEMENTS, *(f"K{i + 1}" for i in range(n - len(ELEMENTS))))


def base_units(n: int) -> tuple[str, ...]:
    """Units of `base_names`; empty for K.

    Examples
    --------
    >>> base_units(7)[4:]
    ('kg m^2', 'kg m^2', '')
    """
    return (*("kg m^2" for _ in ELEMENTS), *("" for _ in range(n - len(ELEMENTS))))


BASE_NAMES, BASE_UNITS = base_names(N_BASE), base_units(N_BASE)


def base_count(names: Sequence[str]) -> int:
    """How many of a model's parameters, the first, are J and K: what has no owner.

    Examples
    --------
    >>> base_count(("Jxx", "K1", "rate_bias.bias_x"))
    2
    """
    return sum("." not in name for name in names)


_FIRST_CHANGE = ".change_Jxx"


def changes_of_J(names: Iterable[str]) -> list[str]:
    """Names of the changes of J among parameters: an effect's, and those that a campaign dates.

    >>> changes_of_J(["Jxx", "fuel.change_Jxx", "fuel.change_Jyy"])
    ['fuel']
    """
    return [name.removesuffix(_FIRST_CHANGE) for name in names if name.endswith(_FIRST_CHANGE)]


def after_changes_of_J(names: Sequence[str]) -> np.ndarray:
    """What makes J after all its changes, and K, of all parameters (n, size)."""
    sums = np.eye(base_count(names), len(names))
    for change in changes_of_J(names):
        first = names.index(f"{change}{_FIRST_CHANGE}")
        sums[:6, first : first + 6] += np.eye(6)
    return sums


@dataclass(frozen=True)
class Parameter:
    """One named quantity of an effect, scalar or with named components.

    `scalar` and `vector` make it; `check_effect` proves that the effect reads it as it should.

    Parameters
    ----------
    name : str
        Identifier, unique within its owner.
    unit : str
        SI unit as printed ("" for a pure number).
    priors : tuple of Prior
        One prior a component.
    null : float, optional
        The value at which the parameter does nothing (the same for all components).
    components : tuple of str, optional
        Labels of the components; empty for a scalar.

    Examples
    --------
    >>> Parameter("tau", "s", (Normal(0.0, 1.0),)).names
    ('tau',)
    """

    name: str
    unit: str
    priors: tuple[Prior, ...]
    null: float = 0.0
    components: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        where = f"priors of {self.name}"
        priors = members(self.priors, Normal | LogNormal, where, error=SettingsError)
        object.__setattr__(self, "priors", priors)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components: `name_component`, or just the name."""
        return tuple(f"{self.name}_{c}" for c in self.components) or (self.name,)


def scalar(name: str, *, unit: str, prior: Prior, null: float = 0.0) -> Parameter:
    """A parameter that is one number; effects read it as `p[name]`, shape ().

    Call `check_effect` on the finished effect before `fit`.

    Parameters
    ----------
    name : str
        Identifier, unique within its owner.
    unit : str
        SI unit as printed ("" for a pure number).
    prior : Prior
        Its prior.
    null : float, optional
        The value at which it does nothing.

    Returns
    -------
    Parameter
        Without components.

    Examples
    --------
    >>> scalar("lag", unit="s", prior=Normal(0.0, 0.1)).unit
    's'
    """
    return Parameter(name, unit, (prior,), null)


def vector(
    name: str, components: Sequence[str], *, unit: str, prior: Prior, null: float = 0.0
) -> Parameter:
    """A parameter with components that share one prior; effects read `p[name]`, shape (n,).

    Call `check_effect` on the finished effect before `fit`.

    Parameters
    ----------
    name : str
        Identifier, unique within its owner.
    components : sequence of str
        Labels: "xyz", the wheels' names, ...
    unit : str
        SI unit as printed ("" for a pure number).
    prior : Prior
        The prior of each component.
    null : float, optional
        The value at which it does nothing.

    Returns
    -------
    Parameter
        With these components.

    Examples
    --------
    >>> vector("torque", "xyz", unit="N m", prior=Normal(0.0, 1e-5)).names
    ('torque_x', 'torque_y', 'torque_z')
    """
    labels = [*components] if isinstance(components, str) else components
    labels = members(labels, str, f"components of {name}", error=SettingsError)
    return Parameter(name, unit, (prior,) * len(labels), null, labels)


def with_prior_scale(parameter: Parameter, factor: float) -> Parameter:
    """A parameter whose Gaussian priors are as many times wider; log-normal ones stay.

    Examples
    --------
    >>> lag = scalar("lag", unit="s", prior=Normal(0.0, 0.1))
    >>> with_prior_scale(lag, 8.0).priors[0].sd
    0.8
    """
    if factor == 1.0:
        return parameter
    advice = "give how many times as wide as stated the priors are to be"
    what = f"{factor} is not above zero"
    require(0.0 < factor < np.inf, "prior_scale", what, advice, error=SettingsError)
    priors = (p if p.logarithmic else replace(p, scale=factor * p.scale) for p in parameter.priors)
    return replace(parameter, priors=tuple(priors))


@array_dataclass
class ParameterSpace:
    """All sampled parameters in one flat vector: blocks of parameters, each with its owner's name.

    A base parameter has the owner "" and keeps its plain name ("Jxx"); an effect's is called
    "effect.parameter". Flat vectors hold physical values in the unit of each parameter.

    Parameters
    ----------
    entries : tuple of (str, Parameter)
        Owner and parameter, in the order of the vector.
    correlation : (size, size) array, optional
        Of the parameters' priors: of their Gaussians, whose sds the entries state. None where all
        are independent.

    Examples
    --------
    >>> space = ParameterSpace((("", scalar("K1", unit="", prior=Normal(1.0, 0.03), null=1.0)),))
    >>> space.names, space.sd.tolist()
    (('K1',), [0.03])
    """

    entries: tuple[tuple[str, Parameter], ...]
    correlation: np.ndarray | None = None
    names: tuple[str, ...] = field(init=False, repr=False, compare=False)
    units: tuple[str, ...] = field(init=False, repr=False, compare=False)
    priors: tuple[Prior, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        names = [f"{owner}.{n}" if owner else n for owner, p in self.entries for n in p.names]
        object.__setattr__(self, "names", tuple(names))
        object.__setattr__(self, "units", tuple(p.unit for _, p in self.entries for _ in p.names))
        priors = tuple(prior for _, p in self.entries for prior in p.priors)
        object.__setattr__(self, "priors", priors)

    @property
    def n_base(self) -> int:
        """How many of them, the first, are J and K."""
        return base_count(self.names)

    @property
    def size(self) -> int:
        """Number of scalar parameters."""
        return len(self.names)

    @property
    def nulls(self) -> np.ndarray:
        """The vector at which every effect does nothing (size,)."""
        return np.array([p.null for _, p in self.entries for _ in p.names])

    @property
    def mean(self) -> np.ndarray:
        """Prior means (medians of log-normal priors) (size,)."""
        return np.array([p.median if isinstance(p, LogNormal) else p.mean for p in self.priors])

    @cached_property
    def sd(self) -> np.ndarray:
        """Prior standard deviations (size,), worked out once: truncated priors take long."""
        sds = np.array([p.sd for p in self.priors])
        sds.setflags(write=False)
        return sds

    @property
    def lower(self) -> np.ndarray:
        """Lower ends of the priors' supports (size,)."""
        return np.array([p.lower for p in self.priors])

    @property
    def upper(self) -> np.ndarray:
        """Upper ends of the priors' supports (size,)."""
        return np.array([p.upper for p in self.priors])

    def slice_of(self, owner: str) -> slice:
        """Where the parameters of one owner stand in the flat vector.

        Parameters
        ----------
        owner : str
            Name of an effect, or "" for J and K.

        Returns
        -------
        slice
            Empty for an owner without parameters.
        """
        owners = [name for name, p in self.entries for _ in p.names]
        start = owners.index(owner) if owner in owners else len(owners)
        return slice(start, start + owners.count(owner))

    def split(self, flat: Array) -> Mapping[str, Mapping[str, Array]]:
        """The flat vector by owners and parameters; traceable by JAX.

        Parameters
        ----------
        flat : (size,) array
            Physical values.

        Returns
        -------
        mapping of str to mapping of str to Array
            {owner: {parameter: array}}.
        """
        values: dict[str, dict[str, Array]] = {}
        start = 0
        for owner, p in self.entries:
            stop = start + len(p.names)
            values.setdefault(owner, {})[p.name] = flat[start:stop] if p.components else flat[start]
            start = stop
        return values

    def marginals(self) -> dict[str, Array]:
        """The prior of each parameter alone as arrays, for compiled code.

        Returns
        -------
        dict of str to (size,) array
            `logarithmic`, `mean`, `scale`, `lower` and `upper`.
        """
        return {kind: on_device(column) for kind, column in self._columns.items()}

    @cached_property
    def _columns(self) -> dict[str, np.ndarray]:
        """What `marginals` holds, on the host."""
        kinds = ("logarithmic", "mean", "scale", "lower", "upper")
        return {k: np.array([getattr(prior, k) for prior in self.priors]) for k in kinds}

    def constants(self) -> dict[str, Array]:
        """The joint prior as arrays, for compiled code.

        Returns
        -------
        dict of str to (size,) array
            `marginals`, and `whitening` (size, size) where priors are correlated.
        """
        joint = {} if self.whitening is None else {"whitening": on_device(self.whitening)}
        return self.marginals() | joint

    @cached_property
    def whitening(self) -> np.ndarray | None:
        """What makes the distances from the priors' means independent, in prior sds; or None."""
        if self.correlation is None:
            return None
        return np.linalg.inv(np.linalg.cholesky(self.correlation))

    def draw(self, rng: np.random.Generator | int | None, n: int) -> np.ndarray:
        """Draws of the priors.

        Parameters
        ----------
        rng : numpy.random.Generator or int or None
            Source of randomness, or the seed of one.
        n : int
            How many draws.

        Returns
        -------
        (n, size) array
            Physical values; J is not checked (`Model.draw_prior` does).
        """
        rng = np.random.default_rng(rng)
        columns = [p.distribution.rvs(n, random_state=rng) for p in self.priors]
        drawn = np.stack(columns, axis=-1).reshape(n, self.size)
        if self.correlation is None:
            return drawn
        together = np.any(self.correlation != np.eye(self.size), axis=1)
        kept = drawn[:0]
        while len(kept) < n:  # Gaussians are seldom outside their ends.
            drawn[:, together] = self._correlated(rng.standard_normal(drawn.shape))[:, together]
            inside = ((drawn >= self.lower) & (drawn <= self.upper)).all(1)
            kept = np.concatenate([kept, drawn[inside]])
        return kept[:n]

    def _correlated(self, normal: np.ndarray) -> np.ndarray:
        """Standard normal numbers (..., size) as parameters of the untruncated joint prior."""
        assert self.correlation is not None
        return self._of_standard(normal @ np.linalg.cholesky(self.correlation).T)

    def _of_standard(self, standardised: np.ndarray) -> np.ndarray:
        """Distances from the priors' centres in their scales (..., size) as parameters."""
        log, values = self._columns["logarithmic"], self._columns["scale"] * standardised
        values = self._columns["mean"] + values
        return np.where(log, np.exp(np.where(log, values, 0.0)), values)

    def from_unit(self, unit: np.ndarray) -> np.ndarray:
        """Points of the unit cube as parameters that follow the priors.

        Of correlated priors the ends are open.

        Parameters
        ----------
        unit : (..., size) array
            Uniform between 0 and 1.

        Returns
        -------
        (..., size) array
            Physical values.
        """
        low, high = self._ends_in_unit
        normal = special.ndtri(low + (high - low) * unit)
        values = self._of_standard(normal)
        if self.correlation is None:
            return values
        together = np.any(self.correlation != np.eye(self.size), axis=1)
        return np.where(together, self._correlated(special.ndtri(unit)), values)

    @cached_property
    def _ends_in_unit(self) -> np.ndarray:
        """Shares (2, size) of the untruncated priors below each end."""
        log, centres, scales, *ends = self._columns.values()
        limits = np.array(ends, float)
        with np.errstate(divide="ignore"):
            logs = np.log(np.where(log, np.maximum(limits, 0.0), 1.0))
        return special.ndtr((np.where(log, logs, limits) - centres) / scales)


def parameter_vectors(theta: Any, size: int, where: str = "theta") -> Any:
    """Vectors (..., size) as arrays of numpy, or of JAX as they are; `SettingsError` of others.

    >>> parameter_vectors([1, 2], 2)
    array([1., 2.])
    """
    advice = f"give ({size},) or (n, {size})"
    own = isinstance(theta, Array)
    vectors = theta if own else numbers(theta, where, advice, SettingsError)
    fits = vectors.ndim > 0 and vectors.shape[-1] == size
    require(fits, where, f"its shape is {vectors.shape}", advice, error=SettingsError)
    return vectors


def prior_residual(constants: Mapping[str, Array], flat: Array) -> Array:
    """Whitened distances of the parameters from their priors' centres.

    `flat` (..., size). Returns (..., size): of correlated priors as many, independent of each
    other.

    Examples
    --------
    >>> space = ParameterSpace((("", scalar("K1", unit="", prior=Normal(1.0, 0.5))),))
    >>> prior_residual(space.constants(), jnp.array([2.0])).tolist()
    [2.0]
    """
    positive = jnp.where(constants["logarithmic"], jnp.maximum(flat, 1e-300), 1.0)
    value = jnp.where(constants["logarithmic"], jnp.log(positive), flat)
    distance = (value - constants["mean"]) / constants["scale"]
    return distance @ constants["whitening"].T if "whitening" in constants else distance


def log_prior(constants: Mapping[str, Array], flat: Array) -> Array:
    """Log prior density, up to the constant of the Gaussians' and truncations' norms.

    `flat` (..., size).

    Examples
    --------
    >>> space = ParameterSpace((("", scalar("tau", unit="s", prior=Normal(0.0, 1.0, lower=0.0))),))
    >>> log_prior(space.constants(), jnp.array([[2.0], [-1.0]])).tolist()
    [-2.0, -inf]
    """
    inside = (flat >= constants["lower"]) & (flat <= constants["upper"])
    inside = inside & ~(constants["logarithmic"] & (flat <= 0.0))
    measure = jnp.where(constants["logarithmic"], jnp.log(jnp.maximum(flat, 1e-300)), 0.0)
    density = -0.5 * jnp.sum(prior_residual(constants, flat) ** 2, -1) - jnp.sum(measure, -1)
    return jnp.where(jnp.all(inside, -1), density, -jnp.inf)
