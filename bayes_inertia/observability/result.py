"""Result of `observe`: numbers for each parameter, for directions, and over time."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np

from bayes_inertia.inference.limits import LIMITS as GATES
from bayes_inertia.maths.printed import Card, parameter_text, shown_as
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.observability.degeneracy import Degeneracy
from bayes_inertia.observability.limits import LIMITS

if TYPE_CHECKING:
    import pandas as pd

Determination = Literal["determined", "partly", "weakly", "prior"]


@array_dataclass
class ParameterObservability:
    """One parameter: how uncertain, and why.

    Parameters
    ----------
    name, unit : str
        Of the parameter; all values are in its unit.
    value, prior_sd, sd : float
        At the optimum.
    robust_sd : float or None
        What the slews themselves support; None for a single slew.
    contraction : float
        1 - (sd / prior_sd)^2.
    signal : float
        Whitened response of all telemetry to one prior sd of it [sigma].
    signal_by : (slews, 3) array
        The same by slew and channel.
    signal_of_size : float
        The same for its own size (`|J|`; `|K - 1|`; an effect's distance from its null).
    conditional_sd : float
        Were everything else known.
    variance_inflation : float
        (sd / conditional_sd)^2.
    inflation : dict of str to float
        Factor of each group of unknowns; all together the variance inflation.
    share : (slews, 3) array
        Part of the marginal precision that comes from each slew and channel.
    share_own_prior, share_other_priors : float
        Parts that come from priors; with `share` they sum to 1.
    sd_without_slew : (slews,) array
        Were that slew missing.
    sd_without_channel : (3,) array
        Were that channel missing; NaN: it has no data.
    partners : tuple of (str, float)
        Parameters with the largest posterior correlation, and the correlation.
    sd_other_drive : float or None
        Where the model is driven the other way; None where that was not asked or not possible.
    """

    name: str
    unit: str
    value: float
    prior_sd: float
    sd: float
    robust_sd: float | None
    contraction: float
    signal: float
    signal_by: np.ndarray
    signal_of_size: float
    conditional_sd: float
    variance_inflation: float
    inflation: dict[str, float]
    share: np.ndarray
    share_own_prior: float
    share_other_priors: float
    sd_without_slew: np.ndarray
    sd_without_channel: np.ndarray
    partners: tuple[tuple[str, float], ...]
    sd_other_drive: float | None

    @property
    def verdict(self) -> Determination:
        """How far the data determine it: "determined", "partly", "weakly" or "prior"."""
        if self.contraction < LIMITS.prior_below:
            return "prior"
        if self.contraction >= LIMITS.determined_above:
            return "determined"
        return "partly" if self.contraction > GATES.observable_above else "weakly"

    @property
    def tells_most(self) -> int | None:
        """The slew that tells most of it; None where no slew tells anything beside the priors."""
        by_slew = self.share.sum(1)
        return int(by_slew.argmax()) if by_slew.max() >= LIMITS.told_share else None


@array_dataclass
class Direction:
    """A direction in the space of the parameters, counted in prior sds.

    Parameters
    ----------
    weights : (f,) array
        Of unit length.
    information : float
        Of the data along it; 1 is as much as the prior.
    contraction : float
        Of the prior variance along it.
    exact : bool
        Whether it is degenerate.
    says : str
        The direction in words.
    """

    weights: np.ndarray
    information: float
    contraction: float
    exact: bool
    says: str

    @property
    def verdict_is_prior(self) -> bool:
        """Whether the data hardly narrow the prior along it."""
        return self.contraction < LIMITS.prior_below


@array_dataclass
class InformationArrival:
    """When information arrives in one slew.

    Parameters
    ----------
    slew : str
        Its name.
    time : (rows,) array
        From the slew's first row [s].
    precision : (rows, 3, f) array
        By row, channel and parameter, in inverse squares of the parameters' units.
    """

    slew: str
    time: np.ndarray
    precision: np.ndarray


def _card(observability: Observability) -> Card:
    """Which parameters the campaign determines."""
    parameters = observability.parameters
    known = sum(p.verdict == "determined" for p in parameters)
    worst = max(parameters, key=lambda p: p.sd / p.prior_sd)
    hidden = ", ".join(d.name for d in observability.degeneracies)
    lines = (
        f"Observability of {observability.campaign}: {known} of {len(parameters)} determined",
        f"least: {worst.name}, {worst.sd / worst.prior_sd:.2g} of its prior sd is left",
        *([f"not told apart: {hidden}"] if hidden else []),
    )
    rows = tuple(
        (p.name, parameter_text(p.name, p.value, p.sd, p.unit), f"{p.prior_sd:.2g}", p.verdict)
        for p in parameters
    )
    return Card(lines, ("parameter", "estimate ± sd", "prior sd", "verdict"), rows)


@shown_as(_card)
@array_dataclass
class Observability:
    """What a campaign tells about each of f fitted parameters, and why not more.

    Parameters
    ----------
    campaign : str
        Its name.
    drive : str
        "commanded" or "measured".
    wheels : int
        How many the spacecraft has; without any, nothing is driven.
    effects, slews, channels : tuple of str
        Names of the effects that were fitted along, of the slews, and of the channels.
    parameters : tuple of ParameterObservability
        One by one.
    covariance : (f, f) array
        Of the parameters, in their order and units.
    directions : tuple of Direction
        Eigen-directions of the covariance in prior sds, least known first.
    degeneracies : tuple of Degeneracy
        What the campaign cannot tell apart.
    arrivals : tuple of InformationArrival
        When information arrives, slew by slew.
    discounted : bool
        Whether misfit made any slew count for less than its stated noise says.
    """

    campaign: str
    drive: str
    wheels: int
    effects: tuple[str, ...]
    slews: tuple[str, ...]
    channels: tuple[str, ...]
    parameters: tuple[ParameterObservability, ...]
    covariance: np.ndarray
    directions: tuple[Direction, ...]
    degeneracies: tuple[Degeneracy, ...]
    arrivals: tuple[InformationArrival, ...]
    discounted: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        return tuple(p.name for p in self.parameters)

    def __getitem__(self, name: str) -> ParameterObservability:
        """The parameter of this name; KeyError if it was not fitted."""
        return dict(zip(self.names, self.parameters, strict=True))[name]

    def to_dataframe(self) -> pd.DataFrame:
        """The parameters as a table.

        Returns
        -------
        pandas.DataFrame
            One row a parameter: its sds, its verdict, and all else that is one number.
        """
        from pandas import DataFrame

        one_number = ("str", "float", "float | None")
        keys = [x.name for x in fields(ParameterObservability) if x.type in one_number]
        keys = [*keys[1:], "verdict"]  # Names are the index.
        rows = {p.name: {key: getattr(p, key) for key in keys} for p in self.parameters}
        return DataFrame.from_dict(rows, orient="index")

    def middle_half(self, name: str) -> tuple[str, float, float] | None:
        """When the middle half of what one slew tells of a parameter arrives.

        Parameters
        ----------
        name : str
            Of the parameter.

        Returns
        -------
        (slew, begin, end) or None
            The slew that tells most, and the times [s] within it before which a quarter and three
            quarters of its part came; None without data.
        """
        i = self.names.index(name)
        sums = [arrival.precision[..., i].sum() for arrival in self.arrivals]
        if not np.max(sums) > 0.0:
            return None
        best = self.arrivals[int(np.argmax(sums))]
        grown = np.cumsum(best.precision[..., i].sum(1))
        first, last = (best.time[np.searchsorted(grown, q * grown[-1])] for q in (0.25, 0.75))
        return best.slew, float(first), float(last)


def in_windows(
    arrival: InformationArrival, windows: int = LIMITS.windows_per_slew
) -> tuple[np.ndarray, np.ndarray]:
    """Sum the information of a slew in equal windows of time.

    Returns `edges` (windows + 1,) [s]; `precision` (windows, 3, f).

    Examples
    --------
    >>> arrival = InformationArrival("a", np.arange(4.0), np.ones((4, 3, 1)))
    >>> in_windows(arrival, 2)[1][:, 0, 0].tolist()
    [2.0, 2.0]
    """
    edges = np.linspace(arrival.time[0], arrival.time[-1], windows + 1)
    place = np.clip(np.searchsorted(edges, arrival.time, side="right") - 1, 0, windows - 1)
    starts = np.searchsorted(place, np.arange(windows + 1))
    return edges, np.stack([arrival.precision[a:b].sum(0) for a, b in pairwise(starts)])


def commands_worth(parameter: ParameterObservability, drive: str) -> float | None:
    """Ratio of sds without and with the recorded torque commands."""
    if parameter.sd_other_drive is None:
        return None
    if drive == "commanded":
        return parameter.sd_other_drive / parameter.sd
    return parameter.sd / parameter.sd_other_drive
