"""The result of `observability`: numbers, plain sentences, and the content of observability.json."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from bayes_inertia.inference.posterior import OBSERVABLE_ABOVE
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.observability.degeneracy import Degeneracy
from bayes_inertia.physics.packing import CHANNELS

FORMAT = "bayes-inertia-observability/1"
# Contraction of the prior variance: below, the answer is the prior; above, the data's.
PRIOR_BELOW, DETERMINED_ABOVE = 0.05, 0.9
_BINS = 24
_CONTROLLER = (
    "A controller commands whatever torque keeps a slew on its profile, so that a wrong J hardly shows in the motion. The fit takes the commands as recorded: "
    "nothing is hidden from it. commands_worth is the sd with the commands ignored (tachometers drive the model) over the sd with them; "
    "1 means that they add nothing."
)


@array_dataclass
class ParameterView:
    """One parameter: how uncertain, and why.

    Attributes
    ----------
    value, prior_sd, sd, robust_sd : at the optimum, in `unit`; robust_sd None for a single slew. contraction : 1 - (sd / prior_sd)^2.
    signal : whitened response of all telemetry to one prior sd of it [sigma]; `signal_by` (slews, 3) by slew and channel.
    signal_of_size : the same for its own size (|J|; |K - 1|; an effect's distance from its null).
    conditional_sd : were everything else known. variance_inflation : (sd / conditional_sd)^2.
    inflation : {group: factor}, all together the variance inflation.
    share : (slews, 3) part of the marginal precision that comes from each slew and channel; with `share_own_prior`
        and `share_other_priors` they sum to 1.
    sd_without_slew : (slews,), sd_without_channel : (3,) were those data missing (NaN: no such data).
    partners : parameters with the largest posterior correlation, [(name, correlation)].
    sd_other_drive : sd where the model is driven the other way; None where that was not asked or not possible.
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
    def verdict(self) -> str:
        """How far the data determine it, from its contraction: "determined", "partly", "weakly" (mostly prior) or "prior"."""
        if self.contraction < PRIOR_BELOW:
            return "prior"
        return (
            "determined"
            if self.contraction >= DETERMINED_ABOVE
            else "partly"
            if self.contraction > OBSERVABLE_ABOVE
            else "weakly"
        )


@array_dataclass
class Direction:
    """A direction of the parameters in prior sds: `weights` (f,) of unit length, `information` of the data along it
    (1: as much as the prior), `contraction` of the prior variance, `exact` if degenerate, `says` in words."""

    weights: np.ndarray
    information: float
    contraction: float
    exact: bool
    says: str

    @property
    def verdict_is_prior(self) -> bool:
        """Whether the data hardly narrow the prior along it."""
        return self.contraction < PRIOR_BELOW


@array_dataclass
class Arrival:
    """When information arrives in one slew: `time` (rows,) [s], `precision` (rows, 3, f) by row, channel and parameter,
    in inverse squares of the parameters' units."""

    slew: str
    time: np.ndarray
    precision: np.ndarray


@array_dataclass
class Observability:
    """What `observability` found; `covariance` (f, f) of the parameters in their order, `directions` least known first."""

    campaign: str
    drive: str
    effects: tuple[str, ...]
    slews: tuple[str, ...]
    parameters: tuple[ParameterView, ...]
    covariance: np.ndarray
    directions: tuple[Direction, ...]
    degeneracies: tuple[Degeneracy, ...]
    arrivals: tuple[Arrival, ...]
    discounted: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        return tuple(p.name for p in self.parameters)

    def __getitem__(self, name: str) -> ParameterView:
        """The parameter of this name; KeyError if it was not fitted."""
        return dict(zip(self.names, self.parameters, strict=True))[name]

    def middle_half(self, name: str) -> tuple[str, float, float] | None:
        """Slew that tells most of a parameter, and the times [s] within it before which a quarter and three quarters of its part came.

        None without data.
        """
        i = self.names.index(name)
        sums = [a.precision[..., i].sum() for a in self.arrivals]
        if not np.max(sums) > 0.0:
            return None
        best = self.arrivals[int(np.argmax(sums))]
        grown = np.cumsum(best.precision[..., i].sum(1))
        first, last = (best.time[np.searchsorted(grown, q * grown[-1])] for q in (0.25, 0.75))
        return best.slew, float(first), float(last)

    def to_json(self) -> dict[str, Any]:
        """The content of observability.json, plain numbers and text."""
        return _plain(_content(self))


def in_windows(arrival: Arrival, bins: int = _BINS) -> tuple[np.ndarray, np.ndarray]:
    """Edges (bins + 1,) [s] of equal windows of a slew, and the precision (bins, 3, f) that arrives in each.

    >>> in_windows(Arrival("a", np.arange(4.0), np.ones((4, 3, 1))), 2)[1][:, 0, 0].tolist()
    [2.0, 2.0]
    """
    edges = np.linspace(arrival.time[0], arrival.time[-1], bins + 1)
    place = np.clip(np.searchsorted(edges, arrival.time, side="right") - 1, 0, bins - 1)
    starts = np.searchsorted(place, np.arange(bins + 1))
    return edges, np.stack([arrival.precision[a:b].sum(0) for a, b in pairwise(starts)])


def commands_worth(view: ParameterView, drive: str) -> float | None:
    """sd with the torque commands ignored over sd with them; None where the model was driven in one way only."""
    if view.sd_other_drive is None:
        return None
    return view.sd_other_drive / view.sd if drive == "commanded" else view.sd / view.sd_other_drive


def sentence(found: Observability, name: str) -> str:
    """Why a parameter is as uncertain as it is, in one plain sentence."""
    p = found[name]
    if p.signal < 1.0:
        return f"{name} is the prior: a change by its whole prior sd moves all telemetry by {p.signal:.2g} sigma, less than the noise."
    gain = p.prior_sd / p.sd
    verdict = {
        "prior": "is the prior, although the telemetry responds",
        "weakly": f"is mostly the prior, {gain:.2g} times sharper than it",
        "partly": f"is partly determined, {gain:.2g} times sharper than the prior",
        "determined": f"is determined, {gain:,.3g} times sharper than the prior",
    }[p.verdict]
    parts = [f"{name} {verdict} (signal {p.signal:,.3g} sigma)", _lost(p)]
    where = found.middle_half(name)
    if where and p.verdict != "prior":
        parts.append(
            f"{_source(p, found.slews)}, half of that slew's part between {where[1]:.4g} and {where[2]:.4g} s"
        )
    worth = commands_worth(p, found.drive)
    if worth is not None and worth > 1.2:
        parts.append(f"without the recorded commands its sd would be {worth:.2g} times larger")
    return "; ".join(parts) + "."


def _lost(p: ParameterView) -> str:
    if p.variance_inflation < 1.21:
        return "almost nothing is lost to other unknowns"
    logs = {g: math.log(max(v, 1.0)) for g, v in p.inflation.items()}
    worst = [
        g
        for g in sorted(logs, key=lambda g: -logs[g])
        if logs[g] > 0.15 * sum(logs.values()) and p.inflation[g] > 1.1
    ]
    named = [f"{_others(p.name, g)} (x{math.sqrt(p.inflation[g]):.2g})" for g in worst[:3]]
    return f"its sd is {math.sqrt(p.variance_inflation):.2g} times what it would be with all else known, mostly through {', '.join(named)}"


def _others(name: str, group: str) -> str:
    """A group of unknowns as seen from one parameter, which may be a member of it."""
    own = {"J": name.startswith("J"), "K": name in ("K1", "K2", "K3"), "effects": "." in name}
    return f"the rest of {group}" if own.get(group) else group


def _source(p: ParameterView, slews: tuple[str, ...]) -> str:
    by_slew, by_channel = p.share.sum(1), p.share.sum(0)
    best, channel = int(np.argmax(by_slew)), int(np.argmax(by_channel))
    prior = p.share_own_prior + p.share_other_priors
    if prior > 0.5:
        return f"{100 * prior:.0f} % of what is known is prior knowledge; of the slews {slews[best]} tells most, through the {CHANNELS[channel]} channel"
    return f"{100 * by_slew[best]:.0f} % of what is known comes from {slews[best]}, {100 * by_channel[channel]:.0f} % from the {CHANNELS[channel]} channel"


def _content(found: Observability) -> dict[str, Any]:
    windows = {a.slew: in_windows(a) for a in found.arrivals}
    return {
        "format": FORMAT,
        "campaign": found.campaign,
        "drive": found.drive,
        "effects": found.effects,
        "discounted": found.discounted,
        "parameters": {p.name: _parameter(found, p, windows) for p in found.parameters},
        "directions": [
            {
                "says": d.says,
                "information": d.information,
                "contraction": d.contraction,
                "exact": d.exact,
                "weights": dict(zip(found.names, d.weights, strict=True)),
            }
            for d in found.directions
        ],
        "degeneracies": [
            {
                key: getattr(d, key)
                for key in ("name", "exact", "in_sd", "parameters", "information_ratio", "says")
            }
            for d in found.degeneracies
        ],
        "windows": {slew: edges for slew, (edges, _) in windows.items()},
        "controller": _CONTROLLER,
    }


def _parameter(found: Observability, p: ParameterView, windows: dict) -> dict[str, Any]:
    i = found.names.index(p.name)
    where = found.middle_half(p.name)

    def table(numbers: np.ndarray) -> dict:
        return {
            s: dict(zip(CHANNELS, row, strict=True))
            for s, row in zip(found.slews, numbers, strict=True)
        }

    plain = (
        "unit",
        "value",
        "prior_sd",
        "sd",
        "robust_sd",
        "contraction",
        "verdict",
        "signal",
        "signal_of_size",
        "conditional_sd",
        "variance_inflation",
        "inflation",
    )
    return {key: getattr(p, key) for key in plain} | {
        "says": sentence(found, p.name),
        "signal_by": table(p.signal_by),
        "share": table(p.share),
        "share_own_prior": p.share_own_prior,
        "share_other_priors": p.share_other_priors,
        "sd_without_slew": dict(zip(found.slews, p.sd_without_slew, strict=True)),
        "sd_without_channel": dict(zip(CHANNELS, p.sd_without_channel, strict=True)),
        "partners": [{"with": name, "correlation": r} for name, r in p.partners],
        "sd_other_drive": p.sd_other_drive,
        "commands_worth": commands_worth(p, found.drive),
        "middle_half": None
        if where is None
        else {"slew": where[0], "t_start": where[1], "t_end": where[2]},
        "arrival": {
            slew: dict(zip(CHANNELS, (rows[..., i] * p.sd**2).T, strict=True))
            for slew, (_, rows) in windows.items()
        },
    }


def _plain(value: Any) -> Any:
    """The same with Python's own types, and None for what is not finite."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
