"""J and K of sister spacecraft: what they have in common makes each known better (shrinkage).

Each craft's J and K are drawn from the fleet's: a Gaussian with a mean and an own sd of every
parameter (Gelman et al. 2013, chapter 5). Mean and crafts are integrated out exactly, so that only
the logarithms of the sds are sampled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import emcee
import numpy as np
from scipy import special
from scipy.optimize import elementwise

from bayes_inertia.errors import require, require_kind
from bayes_inertia.inference.likelihood_summary import (
    LikelihoodSummary,
    first_stated_prior,
    means_and_sds,
    p_value_of_same,
    product,
    require_same_parameters,
)
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.printed import Card, listed, parameter_card, shown_as
from bayes_inertia.maths.values import array_dataclass, whole_number
from bayes_inertia.physics.parameters import base_names, base_units
from bayes_inertia.series.history import unit_of, values_by_name
from bayes_inertia.series.sources import Told, told_by, usable

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class FleetSettings:
    """How the spread of a fleet is sampled."""

    # Prior median of each sd across the fleet: of J as a share of the mean moment of inertia, of
    # K itself. Half a per cent is usual of one drawing and one parts list.
    spread: float = 5e-3
    # Prior sd of its logarithm: 95 % from a fiftieth to fifty times that.
    spread_of_spread: float = 2.0
    walkers: int = 32  # of the ensemble; the density has a dimension a parameter, and one mode
    # Steps of each walker, and draws that are kept. Of few spacecraft the spread has long tails,
    # which need many; each costs as much as there are spacecraft, whose product with draws is this
    # within the two ends.
    spacecraft_times_draws: int = 80_000
    least_draws: int = 400
    most_draws: int = 2000
    burn: float = 0.375  # of the steps, before
    seed: int = 0  # what reproduces the draws
    # Campaigns of a craft that differ more than by this p-value, shared by all crafts, disagree.
    disagree_p_value: float = 1e-3
    # Limits of the spread. Sisters whose moments differ by more than all of them are none; below
    # the other end no telemetry sees a spread, and matrices become singular.
    least: float = 1e-8
    largest: float = 1.0


def _card(fleet: Fleet) -> Card:
    """The fleet's J and K, and how alike its spacecraft are."""
    first = f"Fleet of {len(fleet.spacecraft)} spacecraft"
    if fleet.disagree:
        first += f"; do not use it: campaigns of {listed(fleet.disagree)} disagree"
    elif fleet.left_out:
        first += f"; left out, not to be used: {listed(fleet.left_out)}"
    told = zip(fleet.names, base_units(fleet.mean.size), fleet.mean, fleet.sd, strict=True)
    return parameter_card(first, "fleet's mean ± sd", told, spread=fleet.spread.tolist())


@shown_as(_card)
@array_dataclass
class Fleet:
    """J and K of a fleet and of each of its n spacecraft; p is how many numbers J and K are.

    Parameters
    ----------
    spacecraft : tuple of str
        Their names.
    mean, sd : (p,) arrays
        The fleet's mean of J [kg m^2] and K: median, and half of the central 68 % interval. Its
        tails are long where spacecraft are few.
    spread, spread_low, spread_high : (p,) arrays
        Sd from craft to craft: median and 90 % interval.
    craft_mean, craft_sd : (n, p) arrays
        Each spacecraft, from its own campaigns and from its sisters.
    alone, alone_sd : (n, p) arrays
        Each spacecraft, from its own campaigns alone.
    is_scale_untied : bool
        Whether nothing ties the size of any J.
    disagree : tuple of str
        Spacecraft whose campaigns do not tell of one J and K.
    left_out : tuple of str
        Campaigns whose result must not be used.
    """

    spacecraft: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    spread: np.ndarray
    spread_low: np.ndarray
    spread_high: np.ndarray
    craft_mean: np.ndarray
    craft_sd: np.ndarray
    alone: np.ndarray
    alone_sd: np.ndarray
    is_scale_untied: bool = False
    disagree: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Jxx to Jyz and the K's, in the order of the columns."""
        return base_names(self.mean.size)

    def to_dataframe(self) -> pd.DataFrame:
        """J and K of each spacecraft as a table.

        Returns
        -------
        pandas.DataFrame
            One row a spacecraft; of each parameter `Jxx` and `Jxx_sd` with its sisters,
            `Jxx_alone` and `Jxx_alone_sd` without them [kg m^2; K without unit].
        """
        mean, sd = self.craft_mean, self.craft_sd
        return values_by_name(self.spacecraft, mean, sd, self.alone, self.alone_sd)


def fleet(
    crafts: Mapping[str, Sequence[Posterior | str | Path]] | str | Path, *, seed: int = 0
) -> Fleet:
    """What sister spacecraft have in common; each of them is known better by it.

    Each craft's J and K are drawn from the fleet's, a Gaussian whose mean and spread are estimated
    (Gelman et al. 2013, chapter 5): what its own slews leave open comes from its sisters, as far
    as they are alike. The command `fleet` does the same.

    Parameters
    ----------
    crafts : mapping of str to sequence of Posterior, str or Path; or str or Path
        The fits of each spacecraft, by its name, or folders of their runs. Or the folder that
        `fit-many` wrote: the first folder of a campaign's path is its spacecraft.
    seed : int, optional
        Of the draws of the spread.

    Returns
    -------
    Fleet
        Mean and spread of the fleet, each spacecraft with and without its sisters.

    Raises
    ------
    CampaignError
        If fewer than two spacecraft have a result that may be used, two results hold the same
        telemetry (it would count twice), or they differ in their number of K's.

    Examples
    --------
    >>> fleet({"sat A": ["run_a"], "sat B": ["run_b1", "run_b2"]})
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: run_a: no finished fit is here; give a Posterior, ...
    """
    return fleet_told(told_by_craft(crafts), FleetSettings(seed=whole_number(seed, "seed")))


def told_by_craft(
    crafts: Mapping[str, Sequence[Posterior | str | Path]] | str | Path,
) -> dict[str, list[Told]]:
    """What the fits of each spacecraft tell, each called "craft/campaign"; see `fleet`."""
    found: dict[str, list[Told]] = {}
    if isinstance(crafts, str | Path):
        for one in told_by(crafts):
            found.setdefault(one.campaign.split("/")[0], []).append(one)
        return found
    advice = 'give {"sat A": [posterior, ...], "sat B": ...}, or the folder of `fit-many`'
    require_kind(crafts, Mapping, "crafts", advice)
    for name, sources in crafts.items():
        own = told_by(sources)
        found[str(name)] = [one._replace(campaign=f"{name}/{one.campaign}") for one in own]
    return found


def fleet_told(told: Mapping[str, Sequence[Told]], settings: FleetSettings) -> Fleet:
    """The fleet that the campaigns of its spacecraft tell of."""
    _, left_out = usable([one for own in told.values() for one in own])
    of_each = {name: [one.summary for one in own if one.summary] for name, own in told.items()}
    crafts = {name: own for name, own in of_each.items() if own}
    what = f"{len(crafts)} of {len(told)} spacecraft have a result that can be used"
    advice = "a fleet needs at least two: put the campaigns of each in a folder or list of its own"
    require(len(crafts) >= 2, "crafts", what, advice)
    summaries = [replace(product(own), campaign=name) for name, own in crafts.items()]
    # Campaigns of one craft that differ more than campaigns of one J and K do.
    rare = settings.disagree_p_value / len(crafts)
    disagree = tuple(name for name, own in crafts.items() if p_value_of_same(own) < rare)
    return replace(fleet_of(summaries, settings), disagree=disagree, left_out=left_out)


@dataclass(frozen=True, eq=False)
class _Told:
    """What the craft tell, in the prior sds of the first: roots (craft, n, n), data (craft, n).

    `prior` (n, n): precision of the fleet's mean.
    """

    roots: np.ndarray
    data: np.ndarray
    unit: np.ndarray
    prior: np.ndarray

    @classmethod
    def by(cls, crafts: Sequence[LikelihoodSummary]) -> _Told:
        """What summaries of crafts tell; the first stated prior is that of the fleet's mean."""
        first = first_stated_prior(crafts)
        roots, data = map(np.array, zip(*(craft.whitened(first) for craft in crafts), strict=True))
        return cls(roots, data, unit_of(first), np.linalg.inv(first.prior_matrix))

    def conditional(self, log_spread: np.ndarray) -> _Conditional:
        """Mean and crafts given the spreads (b, n), integrated one after the other."""
        variance = (np.exp(log_spread) * self.unit) ** 2
        # Of each craft given the mean: data = R (mean + own) + noise.
        across = variance[:, None, :, None] * np.swapaxes(self.roots, 1, 2)[None]
        covariance = self.roots[None] @ across + np.eye(self.unit.size)
        whole = np.linalg.solve(covariance, np.broadcast_to(self.roots, across.shape))
        solved = np.linalg.solve(covariance, self.data[None, ..., None])[..., 0]
        precision = np.einsum("nki,bnkj->bij", self.roots, whole) + self.prior
        pull = np.einsum("nki,bnk->bi", self.roots, solved)
        center = np.linalg.solve(precision, pull[..., None])[..., 0]
        log = 0.5 * np.einsum("bi,bi->b", pull, center)
        log -= 0.5 * np.einsum("nk,bnk->b", self.data, solved)
        log -= 0.5 * np.linalg.slogdet(precision)[1]
        log -= 0.5 * np.linalg.slogdet(covariance)[1].sum(axis=1)
        return _Conditional(log, center, np.linalg.inv(precision), across, covariance)


@dataclass(frozen=True, eq=False)
class _Conditional:
    """Of each spread (b): log density (b,); the fleet's mean (b, n) and its covariance."""

    log_density: np.ndarray
    center: np.ndarray
    center_covariance: np.ndarray
    across: np.ndarray
    covariance: np.ndarray

    def crafts(self, told: _Told, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance (b, craft, n) of each craft."""
        gain = np.swapaxes(np.linalg.solve(self.covariance, np.swapaxes(self.across, 2, 3)), 2, 3)
        gap = told.data[None] - np.einsum("nki,bi->bnk", told.roots, self.center)
        mean = self.center[:, None] + np.einsum("bnik,bnk->bni", gain, gap)
        own = variance[:, None] - np.einsum("bnik,bnik->bni", gain, self.across)
        # What the mean leaves open moves a craft by what its own data do not tell.
        follows = np.eye(told.unit.size) - gain @ told.roots[None]
        shared = np.einsum("bnij,bjk,bnik->bni", follows, self.center_covariance, follows)
        return mean, own + shared


def fleet_of(
    crafts: Sequence[LikelihoodSummary], settings: FleetSettings = FleetSettings()
) -> Fleet:
    """The fleet that the summaries of its spacecraft imply, one summary a craft.

    The prior of the first craft is the prior of the fleet's mean, unless it is a former posterior.
    """
    require_same_parameters(crafts)
    first, told = first_stated_prior(crafts), _Told.by(crafts)
    draws = _sampled_spreads(told, settings)
    at = told.conditional(draws)
    scale, variance = first.prior_sd, (np.exp(draws) * told.unit) ** 2
    craft, craft_variance = at.crafts(told, variance)
    mean, sd = _center(at.center, np.diagonal(at.center_covariance, axis1=1, axis2=2))
    own_mean, own_sd = _averaged(craft, craft_variance)
    low, middle, high = np.quantile(np.sqrt(variance) * scale, [0.05, 0.5, 0.95], axis=0)
    names = tuple(c.campaign for c in crafts)
    untied = all(c.is_scale_untied for c in crafts)
    center, own = first.prior_mean + scale * mean, first.prior_mean + scale * own_mean
    stated = [c if c.prior_correlation is None else c.with_prior_of(first) for c in crafts]
    of_each = own, scale * own_sd, *means_and_sds(stated)
    return Fleet(names, center, scale * sd, middle, low, high, *of_each, untied)


def _averaged(means: np.ndarray, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd of a mixture of equal weights (b, ...)."""
    return means.mean(axis=0), np.sqrt(variances.mean(axis=0) + means.var(axis=0))


def _center(means: np.ndarray, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median and half of the central 68 % interval of a mixture of equal weights (b, p)."""
    sds, levels = np.sqrt(variances), special.ndtr(np.array([-1.0, 0.0, 1.0]))[:, None]

    def beyond(x: np.ndarray, level: np.ndarray, k: np.ndarray) -> np.ndarray:
        below = special.ndtr((x - means[:, k]) / sds[:, k])
        return below.mean(axis=0) - level

    ends = (means - 2.0 * sds).min(axis=0), (means + 2.0 * sds).max(axis=0)
    found = elementwise.find_root(beyond, ends, args=(levels, np.arange(means.shape[1])))
    low, middle, high = found.x
    return middle, 0.5 * (high - low)


def _sampled_spreads(told: _Told, settings: FleetSettings) -> np.ndarray:
    """Draws (b, n) of the logarithms of the fleet's sds."""
    middle, width = np.log(settings.spread), settings.spread_of_spread
    least, largest = np.log(settings.least), np.log(settings.largest)

    def log_density(log_spread: np.ndarray) -> np.ndarray:
        prior = -0.5 * np.sum(((log_spread - middle) / width) ** 2, axis=1)
        allowed = np.all((log_spread > least) & (log_spread < largest), axis=1)
        inside = np.clip(log_spread, least, largest)
        return np.where(allowed, prior + told.conditional(inside).log_density, -np.inf)

    rng = np.random.Generator(np.random.MT19937(settings.seed))
    start = middle + 0.25 * width * rng.standard_normal((settings.walkers, told.unit.size))
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DEMove(gamma0=1.0), 0.2)]
    sampler = emcee.EnsembleSampler(
        settings.walkers, told.unit.size, log_density, vectorize=True, moves=moves
    )
    state = np.random.MT19937(settings.seed).state
    affordable = settings.spacecraft_times_draws // len(told.data)
    draws = min(max(affordable, settings.least_draws), settings.most_draws)
    burn = int(settings.burn * draws)
    sampler.run_mcmc(emcee.State(start, random_state=state), burn + draws)
    chain = sampler.get_chain(discard=burn, flat=True)
    return chain[:: len(chain) // draws]
