"""Effects without a fixed shape, and shapes without a name: their forms, and their coefficients.

A signal of unit size has coefficients c = T z, z standard normal; with size a the data are r = D a
T z + e beyond all that is fitted. With A = D^T P D and g = D^T P r, P projecting off the fit with
its priors, the log evidence against no signal is

    1/2 sum_i [ a^2 u_i^2 / (1 + a^2 l_i) - log(1 + a^2 l_i) ],

l the eigenvalues of T^T A T and u the gradient T^T g along its eigenvectors. It is averaged over
sizes and over shapes (a correlation time) with their prior. A fit takes the coefficients of two
slews as independent; here a process that goes on between slews is one over the campaign. Where a
process on knots can act, two rivals without a name can act as well: a signal that is smooth (a
squared-exponential kernel, of any length), and one that is the same in every slew.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from bayes_inertia.diagnosis.formulas import DRIVEN_BY_LIBRARY, Block, told_blocks
from bayes_inertia.diagnosis.hypothesis_table import RandomMember, Signal, signal_of
from bayes_inertia.diagnosis.limits import LIMITS
from bayes_inertia.diagnosis.linear_system import LinearModel, ProjectedSignal
from bayes_inertia.diagnosis.torque_response import TorqueResponse, coefficient_columns
from bayes_inertia.inference.marginal_posterior import prior_roots
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect, require_of_effect
from bayes_inertia.physics.effects import REMAINDERS, STOCHASTIC
from bayes_inertia.physics.effects.formula import PLACES
from bayes_inertia.physics.effects.tachometer_noise_walk import TachometerRemainder
from bayes_inertia.physics.forward_model import Model, lacks
from bayes_inertia.physics.named_effects import effects_named
from bayes_inertia.physics.stated_noise import stated_terms
from bayes_inertia.physics.stochastic_effect import StochasticEffect

NAMELESS = {
    "body torque": "nameless_body_torque",
    "wheel torque": "nameless_wheel_torque",
    "rate sensor": "nameless_rate_error",
    "tachometers": "nameless_tachometer_error",
    "star tracker": "nameless_star_tracker_error",
}


# Where in a slew's signal chain an effect enters, in the words of `unexplained`.
SOURCES = {
    "body_torque": "body torque",
    "delivered_torque": "wheel torque",
    "rate_output": "rate sensor",
    "momentum_output": "tachometers",
    "attitude_output": "star tracker",
}

STOCHASTIC_CANDIDATES: tuple[StochasticEffect, ...] = tuple(
    e for e in STOCHASTIC if isinstance(e, StochasticEffect) and e not in REMAINDERS
)


def candidate_kinds(
    library: Sequence[Effect | str], stochastic: Sequence[Effect | str]
) -> tuple[tuple[Effect, ...], tuple[StochasticEffect, ...]]:
    """Candidates of a fixed shape, and those without one, whichever list they are given in."""
    listed, more = effects_named(library), effects_named(stochastic)
    random = {e.name: e for e in (*more, *listed) if isinstance(e, StochasticEffect)}
    for effect in random.values():
        what = "acts where no random candidate is looked for"
        advice = f"give one that acts through {', '.join(SOURCES)}, or fit it by its name"
        require_of_effect(any(map(effect.acts, SOURCES)), effect, what, advice)
    fixed = (e for e in (*listed, *more) if not isinstance(e, StochasticEffect))
    return tuple(fixed), tuple(random.values())


def usable(
    effects: Sequence[StochasticEffect], model: Model, numbers: int
) -> tuple[StochasticEffect, ...]:
    """Those that the campaign can have and that are not fitted or stated already.

    `model`: of the fit. What its campaign states is integrated out at the stated size.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> [effect.name for effect in usable(STOCHASTIC_CANDIDATES[:1], Model(small_campaign()), 99)]
    ['rate_random_walk']
    """
    fitted = {effect.name for effect in model.structure.effects} | {*stated_terms(model.campaign)}
    campaign = model.campaign
    return tuple(
        effect
        for effect in effects
        if not lacks(effect, campaign)
        and 0 < numbers * effect.coefficient_count(campaign) <= LIMITS.largest_columns
        and effect.parameters(campaign)
        and effect.name not in fitted
    )


def parameters_at(model: Model, effect: Effect, size: float, shape: float) -> np.ndarray:
    """An effect's parameters: so many medians in size, so many prior sds from them in shape."""
    part = model.space.slice_of(effect.name)
    values = model.space.mean[part]
    values[0] *= size
    values[1:] *= np.exp(shape * np.asarray(model.space.marginals()["scale"])[part][1:])
    return values


@array_dataclass
class CandidateRoots:
    """Roots of the covariance of one effect's coefficients in all slews.

    Parameters
    ----------
    blocks : (slews, b, m, m) array
        Of each slew, where slews are independent: the diagonal blocks.
    across : (slews m, slews m) array or None
        Of one block in all slews, where these are one process.
    """

    blocks: np.ndarray
    across: np.ndarray | None = None

    @property
    def anew(self) -> np.ndarray:
        """Of the process less its first value in each slew (n, n)."""
        return dense(self.blocks - self.blocks[..., :1, :])

    @property
    def repeated(self) -> np.ndarray:
        """Where one draw is that of each slew (n, n)."""
        slews = len(self.blocks)
        return np.kron(np.ones((slews, 1)) * np.eye(1, slews), dense(self.blocks[:1]))

    @property
    def best(self) -> np.ndarray:
        """Of one process in all slews, else of each by itself (n, n)."""
        if self.across is None:
            return dense(self.blocks)
        n, b, m, _ = self.blocks.shape
        across = self.across.reshape(n, m, n, m)
        return np.einsum("smtk,ij->simtjk", across, np.eye(b)).reshape(n * b * m, n * b * m)


def dense(blocks: np.ndarray) -> np.ndarray:
    """The matrix (slews b m, slews b m) of its diagonal blocks (slews, b, m, m)."""
    return block_diag(*blocks.reshape(-1, *blocks.shape[2:]))


def roots_at(model: Model, shape: float) -> list[CandidateRoots]:
    """Roots of all random effects of a model, of size one, so many prior sds from their times."""
    theta = model.space.mean
    for effect in model.effects:
        part = model.space.slice_of(effect.name)
        theta[part] = parameters_at(model, effect, 1.0, shape)
    slews, found = model.data.contexts, []
    active = model.structure.active_effects(jnp.asarray(theta))
    own = (effect for effect in model.effects if isinstance(effect, StochasticEffect))
    # Behind theirs stand the roots of the noise of what devices are told, such as gimbal angles.
    for effect, blocks in zip(own, prior_roots(model.structure, theta, slews), strict=False):
        across, root = effect.covariance_across_slews(active.of(effect), slews), None
        if across is not None:
            floor = LIMITS.jitter * np.trace(across) / len(across)
            root = np.linalg.cholesky(np.asarray(across) + floor * np.eye(len(across)))
        found.append(CandidateRoots(np.asarray(blocks), root))
    return found


def forms_of(
    effect: StochasticEffect, model: Model, roots: Sequence[CandidateRoots]
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """All forms that an effect may have; `roots` are its own at each of `LIMITS.shapes`.

    Returns: roots of unit size; shapes [prior sd] and log odds of each.

    What goes on between slews, such as a gyro's bias, may last longer than a slew, and may begin
    anew in each, where it was measured before: a stationary process is the neighbour of a walk. An
    error of the rates that is one draw a slew, as a drift that restarts, may be the same in all
    slews: both are as probable. The star tracker's is `star_tracker_shift` then.
    """
    part, lasts = model.space.slice_of(effect.name), roots[0].across is not None
    shapes = np.array(LIMITS.shapes) if part.stop - part.start > 1 else np.zeros(1)
    shapes = shapes if lasts else shapes[shapes <= LIMITS.longest_in_slew]
    # A time that nobody stated is a guess: beyond what is thought of all are as probable.
    odds = -0.5 * np.minimum(shapes, LIMITS.longest_in_slew) ** 2
    of_each = roots[0].blocks.shape[-1] == 1 and effect.acts("rate_output")
    other = "anew" if lasts else "repeated" if of_each else ""
    forms = [own.best for own in roots[: len(shapes)]]
    if not other:
        return forms, shapes, odds
    long = shapes >= (min(LIMITS.longest_in_slew, shapes[-1]) if lasts else shapes[0])
    forms += [getattr(own, other) for own, kept in zip(roots, long, strict=False) if kept]
    more = odds[long] + logsumexp(odds) - logsumexp(odds[long])
    return forms, np.append(shapes, shapes[long]), np.append(odds, more)


def random_members(
    linear: LinearModel,
    response: TorqueResponse,
    effects: Sequence[StochasticEffect],
    *,
    nameless: bool = True,
    driven: bool = True,
) -> tuple[RandomMember, ...]:
    """Random effects, and shapes without a name, beside the effects of a fixed shape.

    `driven`: whether a shape may follow something known; not where formulas say what it follows.
    """
    # Where no effect has knots. Its prior is no wider than that of effects with a name.
    fit, shapes = linear.fit, (TachometerRemainder(factor_sd=1.5),) if nameless else ()
    both = usable((*effects, *shapes), fit.model, fit.residual.size)
    model = Model(fit.model.campaign, both, fit.model.structure.drive)
    roots = zip(*(roots_at(model, x) for x in LIMITS.shapes), strict=True)
    scales = np.asarray(model.space.marginals()["scale"])
    members: list[RandomMember] = []
    unnamed: dict[str, list[list[Signal]]] = {}
    for effect, own in zip(both, roots, strict=True):
        source = next(name for hook, name in SOURCES.items() if effect.acts(hook))
        has_name = not isinstance(effect, TachometerRemainder)
        if not has_name and source in unnamed:
            continue
        columns = coefficient_columns(response, effect)
        if not columns.any():
            continue
        signal = linear.projected(columns)
        # The largest size that its prior has, in medians.
        scale = float(scales[model.space.slice_of(effect.name).start])
        largest = float(np.exp(LIMITS.largest_random_size * scale))
        if has_name:
            # Numbers in the bases of all forms of all effects, were they all like this one.
            numbers = len(both) * len(own) * signal.gradient.size**2
            kept = len(linear.held) == 0 and numbers <= LIMITS.largest_matrices
            members.append(_random(effect, model, signal, own, largest, kept=kept))
        if nameless and own[0].blocks.shape[-1] > 1 and source not in unnamed:
            unnamed[source] = _free(signal, own, largest)
    for source, forms in (_driven(linear, response) if nameless and driven else {}).items():
        unnamed.setdefault(source, []).append(forms)
    for source, groups in unnamed.items():
        # Smooth, repeated, in proportion to something known: each kind is as probable.
        odds = np.concatenate([np.full(len(forms), -np.log(len(forms))) for forms in groups])
        members.append(RandomMember(NAMELESS[source], [*chain(*groups)], odds))
    return tuple(members)


def _random(
    effect: StochasticEffect,
    model: Model,
    signal: ProjectedSignal,
    own: Sequence[CandidateRoots],
    largest: float,
    *,
    kept: bool,
) -> RandomMember:
    """A random effect; `kept`: whether bases are, from which campaigns are simulated."""
    roots, shapes, odds = forms_of(effect, model, own)
    forms = [_signal(signal, root, largest, kept=kept) for root in roots]
    n = signal.gradient.size
    matrix = signal.matrix.reshape(n, n) if kept else None
    starts = [
        parameters_at(model, effect, size, shape)
        for form, shape in zip(forms, shapes, strict=True)
        for size in form.sizes
    ]
    return RandomMember(effect.name, forms, odds, np.array(starts), matrix)


def _free(
    signal: ProjectedSignal, roots: Sequence[CandidateRoots], largest: float
) -> list[list[Signal]]:
    """Smooth signals where an effect on knots enters, and such that repeat in every slew.

    They have squared-exponential kernels of the mean variance of the effect.
    """
    blocks, same = roots[LIMITS.shapes.index(0.0)].blocks, signal.repeated()
    kinds: list[list[Signal]] = [[], []]
    for smooth in smooth_roots(blocks):
        root = np.broadcast_to(smooth, blocks.shape)
        kinds[0].append(_signal(signal, dense(root), largest))
        kinds[1].append(_signal(same, dense(root[:1]), largest))
    return kinds


def smooth_roots(blocks: np.ndarray) -> list[np.ndarray]:
    """Roots (m, m) of smooth signals of each length, as large as those of an effect on m knots.

    `blocks` (slews, b, m, m): roots of the effect's coefficients.
    """
    m, sd = blocks.shape[-1], np.sqrt(np.mean(np.sum(blocks**2, -1)))
    apart, jitter = np.subtract.outer(np.arange(m), np.arange(m)), LIMITS.jitter * np.eye(m)
    lengths = np.geomspace(LIMITS.shortest, m, LIMITS.lengths)
    kernels = (np.exp(-0.5 * (apart / length) ** 2) + jitter for length in lengths)
    return [sd * np.linalg.cholesky(kernel) for kernel in kernels]


def driven_blocks(response: TorqueResponse) -> Iterator[tuple[str, Block]]:
    """What follows something known and is no effect of the library, and where it enters."""
    for block in told_blocks(response):
        formula = block.formula
        if (formula.place, formula.driver) not in DRIVEN_BY_LIBRARY:
            yield SOURCES[PLACES[formula.place].hook], block


def _driven(linear: LinearModel, response: TorqueResponse) -> dict[str, list[Signal]]:
    """Disturbances in proportion to something known, along any axes: by where they enter."""
    found: dict[str, list[Signal]] = {}
    for source, block in driven_blocks(response):
        signal = linear.projected(block.columns).repeated()
        found.setdefault(source, []).append(_signal(signal, np.eye(signal.gradient.size), 1.0))
    return found


def _signal(
    projected: ProjectedSignal, root: np.ndarray, largest: float, *, kept: bool = False
) -> Signal:
    """One form; `root` (n, n) of all coefficients. `kept`: whether its basis is."""
    n, cross = len(root), projected.cross
    matrix, gradient = projected.matrix.reshape(n, n), projected.gradient.ravel()
    found = signal_of(matrix, gradient, cross.reshape(n, -1), root, largest)
    return found if kept else replace(found, basis=np.zeros((0, len(found.powers))))
