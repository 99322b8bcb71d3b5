"""J and K of one spacecraft over campaigns: constant, wandering, or with jumps.

From campaign to campaign J and K may take a random walk, and jump: fuel used, a deployment, a
sensor that ages. Each way is a hypothesis, a linear Gaussian model of which the evidence is exact;
what is reported is their average, as a diagnosis averages over effects.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.errors import require
from bayes_inertia.inference.likelihood_summary import (
    LikelihoodSummary,
    first_stated_prior,
    means_and_sds,
    require_same_parameters,
)
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.maths.printed import Card, listed, parameter_card, shown_as
from bayes_inertia.maths.values import array_dataclass, moments
from bayes_inertia.physics.parameters import base_names, base_units
from bayes_inertia.series.sources import Told, told_by, usable

if TYPE_CHECKING:
    import pandas as pd

Part = Literal["J", "K"]
OF_PART: Mapping[Part, slice] = {"J": slice(0, len(ELEMENTS)), "K": slice(len(ELEMENTS), None)}


def parts_of(n: int) -> tuple[Part, ...]:
    """What may change where J and K are n numbers: J alone where no rate sensor flies."""
    return tuple(part for part, numbers in OF_PART.items() if range(n)[numbers])


@dataclass(frozen=True)
class Changes:
    """What may happen to J and K between two campaigns, and how probable it is beforehand."""

    # Sds of the random walk from one campaign to the next: of J as a share of the mean moment of
    # inertia, of K itself. From what no campaign sees to what nobody would call a walk.
    walks: tuple[float, ...] = (1e-5, 1e-4, 1e-3, 1e-2)
    # Sds of a jump in the same units: from a tenth of a per mille (a tank moved) to a panel.
    jumps: tuple[float, ...] = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
    walk_probability: float = 0.5  # that J, and that K, wanders at all: as probable as not
    # Of a jump of J, and of K, between two campaigns: one in fifty, so that two hundred series of
    # six campaigns hold some twenty.
    jump_probability: float = 0.02
    most_jumps: int = 3  # of one hypothesis
    # The neighbours of so many of the best hypotheses are tried, until no new one is among them.
    kept: int = 8
    # J and K are averaged over the hypotheses that hold so much probability together.
    held: float = 0.999


@dataclass(frozen=True)
class Jump:
    """A sudden change between two campaigns."""

    after: int  # number of the campaign before it, from 0
    part: Part  # what changes
    sd: float  # its size, as `Changes.jumps` counts it


@dataclass(frozen=True)
class ChangeHypothesis:
    """One hypothesis: how J and K change from campaign to campaign."""

    # Sds of the random walk of a step, as `Changes.walks` counts them; 0 for none.
    walk_J: float = 0.0
    walk_K: float = 0.0
    jumps: tuple[Jump, ...] = ()  # sudden changes, at most one of each part between two campaigns

    def step_variance(self, after: int, n: int) -> np.ndarray:
        """Variance (n,) of the change after a campaign, as shares of `unit`."""
        variance = np.full(n, self.walk_J**2)
        variance[OF_PART["K"]] = self.walk_K**2
        for jump in self.jumps:
            if jump.after == after:
                variance[OF_PART[jump.part]] += jump.sd**2
        return variance


@dataclass(frozen=True, eq=False)
class WeighedChanges:
    """Hypotheses with their posterior probabilities, the most probable first."""

    hypotheses: tuple[ChangeHypothesis, ...]
    probability: np.ndarray

    def probability_of(self, holds: Iterable[bool]) -> float:
        """The probability of all hypotheses of which something holds."""
        total = self.probability[np.fromiter(holds, bool, len(self.hypotheses))].sum()
        return min(float(total), 1.0)  # Rounding may pass it.


@array_dataclass
class SeenJump:
    """A jump between two campaigns, with its probability.

    Parameters
    ----------
    after : int
        Number of the campaign before it, from 0.
    part : {"J", "K"}
        What changed.
    probability : float
        That it happened between these two campaigns.
    size : (6,) or (axes,) array
        Change of each element of J [kg m^2], or of each K, if it happened.
    sd : (6,) or (axes,) array
        How well that is known.
    """

    after: int
    part: Part
    probability: float
    size: np.ndarray
    sd: np.ndarray


def _card(history: History) -> Card:
    """Changes that are more probable than not, or the most probable one, and J and K now."""
    jumps = [
        (jump.probability, f"a jump of {jump.part} after number {jump.after + 1}")
        for jump in history.jumps
    ]
    jumped = {jump.part for jump in history.jumps if jump.probability > 0.5}
    wanders = [(p, f"a wander of {x}") for x, p in history.wanders.items() if x not in jumped]
    ordered = sorted(jumps + wanders, reverse=True)
    told = [each for each in ordered if each[0] > 0.5] or ordered[:1]
    changes = (f"{change} has the probability {100.0 * p:.1f} %" for p, change in told)
    first = f"History of {len(history.campaigns)} campaigns: {', '.join(changes)}"
    if history.left_out:
        first += f"; left out, not to be used: {listed(history.left_out)}"
    mean, sd = history.mean, history.sd
    now = zip(history.names, base_units(len(history.names)), mean[-1], sd[-1], strict=True)
    change = (mean[-1] - mean[0]) / sd[-1]
    return parameter_card(first, "now ± sd", now, **{"change [sd]": change.tolist()})


@shown_as(_card)
@array_dataclass
class History:
    """J and K over a series of n campaigns; p is how many numbers J and K are.

    Parameters
    ----------
    campaigns : tuple of str
        Their names, in the order flown.
    mean, sd : (n, p) arrays
        J [kg m^2] and K at each campaign, from all campaigns.
    alone, alone_sd : (n, p) arrays
        From each campaign alone, with the prior that the first states; with no former posterior.
    jumps : tuple of SeenJump
        The most probable first; improbable ones are among them.
    wanders : dict of str to float
        Probability that J, and that K, changes a little from each campaign to the next.
    changed : dict of str to float
        Probability that J, and that K, changes at all: at once, or from each campaign to the next.
    is_scale_untied : bool
        Whether no campaign ties the size of J.
    left_out : tuple of str
        Campaigns whose result must not be used.
    time : (n,) array, optional
        When each was flown, if that was told: dates in UTC, or numbers.
    """

    campaigns: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    alone: np.ndarray
    alone_sd: np.ndarray
    jumps: tuple[SeenJump, ...]
    wanders: dict[Part, float]
    changed: dict[Part, float]
    is_scale_untied: bool = False
    left_out: tuple[str, ...] = ()
    time: np.ndarray | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Jxx to Jyz and the K's, in the order of the columns."""
        return base_names(self.mean.shape[1])

    def to_dataframe(self) -> pd.DataFrame:
        """J and K at each campaign as a table.

        Returns
        -------
        pandas.DataFrame
            One row a campaign; of each parameter `Jxx` and `Jxx_sd` from all campaigns,
            `Jxx_alone` and `Jxx_alone_sd` from this one [kg m^2; K without unit]; `time` if known.
        """
        table = values_by_name(self.campaigns, self.mean, self.sd, self.alone, self.alone_sd)
        if self.time is not None:
            table.insert(0, "time", self.time)
        return table


def values_by_name(
    rows: Sequence[str],
    mean: np.ndarray,
    sd: np.ndarray,
    alone: np.ndarray,
    alone_sd: np.ndarray,
) -> pd.DataFrame:
    """A table of J and K (rows, p) that are known together and alone, columns beside each other."""
    from pandas import DataFrame

    kinds = {"": mean, "_sd": sd, "_alone": alone, "_alone_sd": alone_sd}
    names = enumerate(base_names(mean.shape[1]))
    columns = {f"{name}{key}": x[:, k] for k, name in names for key, x in kinds.items()}
    table = DataFrame(columns, index=list(rows))
    table.attrs["units"] = {x: "kg m^2" if x.startswith("J") else "" for x in columns}
    return table


def history(sources: Sequence[Posterior | str | Path] | str | Path, *, time: Any = None) -> History:
    """Whether J and K changed from campaign to campaign: when, by how much, how probable.

    From campaign to campaign J and K may stay, wander a little, or jump. Each way is a linear
    Gaussian model with an exact evidence (Kalman filter); what is returned is their average. The
    command `history` does the same.

    Parameters
    ----------
    sources : sequence of Posterior, str or Path
        Fits of one spacecraft in the order flown, or folders of runs. A folder of `fit-many` is
        all of its campaigns in the order of their names, and may stand alone.
    time : (n,) array_like, optional
        When each campaign was flown, increasing: datetimes, or numbers in a unit of your own. For
        tables and plots alone: what may happen between two campaigns does not depend on it.

    Returns
    -------
    History
        J and K at each campaign, jumps with their probabilities.

    Raises
    ------
    CampaignError
        If fewer than two results may be used, two hold the same telemetry (it would count twice),
        they differ in their number of K's, or times do not fit.

    Examples
    --------
    >>> history(["run_march", "run_june"])
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: run_march: no finished fit is here; give a Posterior, ...
    """
    return history_told(told_by(sources), time)


def history_told(told: Sequence[Told], time: Any = None) -> History:
    """The history that campaigns tell, in the order flown; `time` (n,): see `history`."""
    series, left_out = usable(told)
    what = f"{len(series)} of {len(told)} campaigns have a result that can be used"
    require(len(series) >= 2, "sources", what, "give at least two whose fit is trusted")
    kept = [one.summary is not None for one in told]
    when = None if time is None else _times(time, len(told), left_out)[kept]
    return replace(history_of(_named_apart(series)), left_out=left_out, time=when)


def _times(time: Any, n: int, left_out: Sequence[str]) -> np.ndarray:
    """When each of n campaigns was flown, those left out among them."""
    when = moments(time, "time", "give datetimes or numbers")
    fits = when.shape == (n,) and when.dtype.kind in "Miuf"
    advice = "give a datetime or a number for each campaign"
    advice += f", for what is left out too: {listed(left_out)}" if left_out else ""
    advice += "; `pandas.to_datetime` reads texts" if when.dtype.kind in "OU" else ""
    require(fits, "time", f"shape {when.shape} of {when.dtype} for {n} campaigns", advice)
    later = bool((when[1:] > when[:-1]).all())
    what, advice = "times do not increase", "give campaigns in the order flown, with their times"
    require(later, "time", what, advice)
    return when


def _named_apart(series: list[LikelihoodSummary]) -> list[LikelihoodSummary]:
    """The series; campaigns of one name get their number."""
    count = Counter(summary.campaign for summary in series)
    return [
        replace(one, campaign=f"{one.campaign} ({k})") if count[one.campaign] > 1 else one
        for k, one in enumerate(series, 1)
    ]


def weigh_changes(
    series: Sequence[LikelihoodSummary], changes: Changes = Changes()
) -> WeighedChanges:
    """The posterior probabilities of how J and K changed over a series of campaigns."""
    require_same_parameters(series)
    told: dict[ChangeHypothesis, float] = {}
    campaigns, parts = len(series), parts_of(series[0].mean.size)
    tried = _other_walks(ChangeHypothesis(), parts, changes)
    while new := [hypothesis for hypothesis in dict.fromkeys(tried) if hypothesis not in told]:
        for hypothesis, value in zip(new, log_evidence(series, new).tolist(), strict=True):
            told[hypothesis] = value + log_prior(hypothesis, campaigns, changes, parts)
        order = sorted(told, key=told.__getitem__, reverse=True)
        best = order[: changes.kept]
        tried = [more for row in best for more in _neighbours(row, campaigns, parts, changes)]
    weights = np.array([told[hypothesis] for hypothesis in order])
    return WeighedChanges(tuple(order), np.exp(weights - logsumexp(weights)))


def _other_walks(
    hypothesis: ChangeHypothesis, parts: Sequence[Part], changes: Changes
) -> list[ChangeHypothesis]:
    sizes = (0.0, *changes.walks)
    of_K = sizes if "K" in parts else (0.0,)
    return [replace(hypothesis, walk_J=J, walk_K=K) for J, K in product(sizes, of_K)]


def _neighbours(
    hypothesis: ChangeHypothesis, campaigns: int, parts: Sequence[Part], changes: Changes
) -> list[ChangeHypothesis]:
    """What differs by one jump, or by the walks: a jump unseen looks like a walk at first."""
    taken = {(jump.after, jump.part) for jump in hypothesis.jumps}
    found = _other_walks(hypothesis, parts, changes)
    if len(taken) == changes.most_jumps:
        return found
    for after, part, sd in product(range(campaigns - 1), parts, changes.jumps):
        if (after, part) not in taken:
            jumps = sorted((*hypothesis.jumps, Jump(after, part, sd)), key=astuple)
            found.append(replace(hypothesis, jumps=tuple(jumps)))
    return found


def history_of(series: Sequence[LikelihoodSummary], changes: Changes = Changes()) -> History:
    """J and K of one spacecraft at each of its campaigns, averaged over how they may change."""
    ways = weigh_changes(series, changes)
    few = int(np.searchsorted(np.cumsum(ways.probability), changes.held)) + 1
    weights = ways.probability[:few] / ways.probability[:few].sum()
    parts = [smoothed(series, hypothesis) for hypothesis in ways.hypotheses[:few]]
    means = np.array([mean for mean, _ in parts])
    mean = np.einsum("h,hkp->kp", weights, means)
    variances = np.array([np.diag(covariance).reshape(mean.shape) for _, covariance in parts])
    spread = np.einsum("h,hkp->kp", weights, variances + (means - mean) ** 2)
    may_change = parts_of(mean.shape[1])
    jumps = [
        _seen_jump(after, part, ways, weights, parts)
        for after, part in product(range(len(series) - 1), may_change)
    ]
    names = tuple(campaign.campaign for campaign in series)

    def walks(hypothesis: ChangeHypothesis, part: Part) -> bool:
        return getattr(hypothesis, f"walk_{part}") > 0.0

    def changes_at_all(hypothesis: ChangeHypothesis, part: Part) -> bool:
        return walks(hypothesis, part) or any(jump.part == part for jump in hypothesis.jumps)

    wanders, changed = (
        {part: ways.probability_of(of(h, part) for h in ways.hypotheses) for part in may_change}
        for of in (walks, changes_at_all)
    )
    likely = tuple(sorted((j for j in jumps if j is not None), key=lambda j: -j.probability))
    # The prior of an update is a former posterior, which no campaign alone tells.
    stated = first_stated_prior(series)
    alone, alone_sd = means_and_sds([campaign.with_prior_of(stated) for campaign in series])
    untied = all(campaign.is_scale_untied for campaign in series)
    told = alone, alone_sd, likely, wanders, changed, untied
    return History(names, mean, np.sqrt(spread), *told)


def _seen_jump(
    after: int,
    part: Part,
    ways: WeighedChanges,
    weights: np.ndarray,
    parts: Sequence[tuple[np.ndarray, np.ndarray]],
) -> SeenJump | None:
    """A jump after a campaign with its size, averaged over the hypotheses that have it."""

    def has(hypothesis: ChangeHypothesis) -> bool:
        return any(jump.after == after and jump.part == part for jump in hypothesis.jumps)

    chosen = [k for k in range(len(weights)) if has(ways.hypotheses[k])]
    if not chosen:
        return None
    w = weights[chosen] / weights[chosen].sum()
    n = parts[0][0].shape[1]
    before = slice(after * n, (after + 1) * n)
    next_one = slice(before.stop, before.stop + n)
    sizes, variances = [], []
    for k in chosen:
        mean, covariance = parts[k]
        sizes.append(mean[after + 1] - mean[after])
        both = covariance[before, before] + covariance[next_one, next_one]
        change = both - covariance[before, next_one] - covariance[next_one, before]
        variances.append(np.diag(change))
    size = w @ np.array(sizes)
    sd = np.sqrt(w @ (np.array(variances) + (np.array(sizes) - size) ** 2))
    probability = ways.probability_of(has(hypothesis) for hypothesis in ways.hypotheses)
    return SeenJump(after, part, probability, size[OF_PART[part]], sd[OF_PART[part]])


def log_prior(
    hypothesis: ChangeHypothesis,
    campaigns: int,
    changes: Changes,
    parts: Sequence[Part] = tuple(OF_PART),
) -> float:
    """Log prior probability of a hypothesis on what may change; sizes share theirs evenly.

    Examples
    --------
    >>> one = Changes(walks=(0.1,), jumps=(0.1,), walk_probability=0.5, jump_probability=0.5)
    >>> round(float(np.exp(log_prior(ChangeHypothesis(), 2, one))), 6)
    0.0625
    """
    some, none = np.log(changes.walk_probability), np.log1p(-changes.walk_probability)
    total = 0.0
    for part in parts:
        walk = getattr(hypothesis, f"walk_{part}")
        total += some - np.log(len(changes.walks)) if walk else none
    chances = len(parts) * (campaigns - 1)
    jump = np.log(changes.jump_probability / len(changes.jumps))
    quiet = np.log1p(-changes.jump_probability)
    return float(total + len(hypothesis.jumps) * jump + (chances - len(hypothesis.jumps)) * quiet)


def unit_of(first: LikelihoodSummary) -> np.ndarray:
    """What sizes of changes are shares of (n,), in prior sds: mean moment of inertia, and 1."""
    unit = np.full(first.mean.size, float(np.mean(first.prior_mean[:3])))
    unit[OF_PART["K"]] = 1.0
    return unit / first.prior_sd


def log_evidence(
    series: Sequence[LikelihoodSummary], hypotheses: Sequence[ChangeHypothesis]
) -> np.ndarray:
    """Log evidence (hypotheses,) of hypotheses, exact, by a Kalman filter over the campaigns.

    The prior of the first campaign holds for the series; those of later ones were taken off.
    """
    first = series[0]
    unit, size, n = unit_of(first), len(hypotheses), first.mean.size
    mean = np.zeros((size, n))
    covariance = np.broadcast_to(first.prior_matrix, (size, n, n)).copy()
    total = np.zeros(size)
    for k, campaign in enumerate(series):
        root, data = campaign.whitened(first)
        across = covariance @ root.T
        spread = root @ across + np.eye(n)
        gap = data - mean @ root.T
        gain = np.linalg.solve(spread, np.swapaxes(across, 1, 2))
        total -= 0.5 * np.linalg.slogdet(spread)[1]
        total -= 0.5 * np.einsum("bi,bi->b", gap, np.linalg.solve(spread, gap[..., None])[..., 0])
        mean = mean + np.einsum("bij,bi->bj", gain, gap)
        covariance = covariance - across @ gain
        steps = np.array([hypothesis.step_variance(k, n) for hypothesis in hypotheses]) * unit**2
        covariance[:, np.arange(n), np.arange(n)] += steps
    return total


def smoothed(
    series: Sequence[LikelihoodSummary], hypothesis: ChangeHypothesis
) -> tuple[np.ndarray, np.ndarray]:
    """J and K at each campaign under one hypothesis, from all campaigns.

    Returns: mean (campaigns, n); covariance (campaigns n, campaigns n) [kg m^2, 1].
    """
    first, campaigns = series[0], len(series)
    unit, n = unit_of(first), first.mean.size
    steps = (hypothesis.step_variance(k, n) for k in range(campaigns - 1))
    grown = np.cumsum([np.zeros(n), *steps], axis=0)
    earlier = np.minimum.outer(np.arange(campaigns), np.arange(campaigns))
    changed = np.einsum("klp,pq->kplq", grown[earlier] * unit**2, np.eye(n))
    prior = (changed + first.prior_matrix[:, None]).reshape(campaigns * n, -1)
    root, data = np.zeros_like(prior), np.zeros(campaigns * n)
    for k, campaign in enumerate(series):
        part = slice(k * n, (k + 1) * n)
        root[part, part], data[part] = campaign.whitened(first)
    across = prior @ root.T
    gain = np.linalg.solve(root @ across + np.eye(len(prior)), across.T).T
    scale = np.tile(first.prior_sd, campaigns)
    covariance = (prior - gain @ across.T) * np.outer(scale, scale)
    return first.prior_mean + (scale * (gain @ data)).reshape(campaigns, n), covariance
