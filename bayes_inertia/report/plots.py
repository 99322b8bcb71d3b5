"""Single plots on axes of your own: the same code that the report draws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import wraps
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes

from bayes_inertia.campaign.sensors import STREAMS
from bayes_inertia.errors import SettingsError, members, require_kind, with_article
from bayes_inertia.maths.values import require_flags, whole_number
from bayes_inertia.report.formatting import arcsec
from bayes_inertia.report.pictures import chains, posterior_data, style
from bayes_inertia.report.pictures.diagnosis import candidates_panel
from bayes_inertia.report.pictures.observability import sd_panel
from bayes_inertia.report.pictures.pairs import most_correlated, pairs_panel, prior_panel
from bayes_inertia.report.pictures.series import fleet_panel, history_panel, named_ticks
from bayes_inertia.report.pictures.telemetry import attitude_panel, rate_panel, residual_panel

if TYPE_CHECKING:
    from bayes_inertia.campaign.slew import Slew
    from bayes_inertia.diagnosis.result import Diagnosis
    from bayes_inertia.inference.posterior import Posterior
    from bayes_inertia.observability.result import Observability
    from bayes_inertia.series.fleet import Fleet
    from bayes_inertia.series.history import History

# Inputs of the model, which no sensor's stream describes: title and unit.
_INPUTS = {
    "wheel_torque": ("wheel torque", "N m"),
    "magnetic_field_N": ("magnetic field", "T"),
    "position_N": ("position", "m"),
}


def _on_axes[**P](plot: Callable[P, Axes]) -> Callable[P, Axes]:
    """A plot in the package's style; without `ax` on a figure of its own, of pyplot."""
    # What each plot shows is the annotation of its first parameter.
    first, wanted = next(iter(plot.__annotations__.items()))

    @wraps(plot)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Axes:
        shown = args[0] if args else kwargs.get(first)
        if wanted not in [kind.__name__ for kind in type(shown).__mro__]:
            what = f"a {type(shown).__name__} was given"
            raise SettingsError(what, where=first, advice=f"give {with_article(wanted)}")
        ax = kwargs.get("ax")
        advice = "give one Axes: of plt.subplots(1, 2) one by its number, ax=axes[0]"
        require_kind(ax, Axes | None, "ax", advice, error=SettingsError)
        with rc_context(style.RC):
            if ax is None:
                from matplotlib import pyplot

                kwargs["ax"] = pyplot.subplots(layout="constrained")[1]
            return plot(*args, **kwargs)

    return drawn


def _index(names: Sequence[str], wanted: int | str, what: str) -> int:
    """Where a name or a number stands among names."""
    if isinstance(wanted, str) and wanted in names:
        return list(names).index(wanted)
    if isinstance(wanted, int | np.integer) and -len(names) <= wanted < len(names):
        return int(wanted) % len(names)
    advice = f"choose one of {', '.join(names)}"
    raise SettingsError(f"there is no {wanted!r}", where=what, advice=advice)


def _series(posterior: Posterior, channel: str) -> posterior_data.ChannelSeries:
    """A channel that the fit predicts at every row."""
    require_kind(channel, str, "channel", "give the name of a sensor", error=SettingsError)
    series = posterior_data.channel_series(posterior, channel)
    if series is None:
        names = map(str, posterior.tree["posterior_predictive"].data_vars)
        known = ", ".join(n for n in names if posterior_data.channel_series(posterior, n))
        lacks, advice = f"the fit predicts no {channel} row by row", f"choose one of {known}"
        raise SettingsError(lacks, where="channel", advice=advice)
    return series


@_on_axes
def plot_telemetry(slew: Slew, channel: str = "rate", *, ax: Axes | None = None) -> Axes:
    """What a slew recorded.

    Parameters
    ----------
    slew : Slew
        Of a campaign.
    channel : str, optional
        A field of `Slew`, or a name under `Slew.more`.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        With one line a component.
    """
    advice = "give a field of Slew, or a name under Slew.more"
    require_kind(channel, str, "channel", advice, error=SettingsError)
    words = {s.field: (s.title, s.unit) for s in STREAMS} | _INPUTS
    values = (slew.more or {}).get(channel)
    values = getattr(slew, channel, None) if values is None else values
    if not isinstance(values, np.ndarray) or values.ndim != 2:
        there = {k: getattr(slew, k, None) for k in words} | dict(slew.more or {})
        drawn = [k for k, x in there.items() if isinstance(x, np.ndarray) and x.ndim == 2]
        what, advice = f"{slew.name} has no {channel}", f"choose one of {', '.join(drawn)}"
        raise SettingsError(what, where="channel", advice=advice)
    assert ax is not None
    mark = "." if np.isnan(values).any() else ""
    for i, component in enumerate(values.T):
        ax.plot(slew.time, component, **style.line(i), marker=mark, ms=3)
    title, unit = words.get(channel, (channel, ""))
    ax.set(xlabel="time in slew [s]", ylabel=f"{title} [{unit}]" if unit else title)
    ax.set_title(slew.name)
    ax.legend([str(i + 1) for i in range(values.shape[1])], ncols=values.shape[1])
    return ax


@_on_axes
def plot_prior(posterior: Posterior, name: str | int, *, ax: Axes | None = None) -> Axes:
    """One parameter, before and after the data.

    Parameters
    ----------
    posterior : Posterior
        Of a fit.
    name : str or int
        Of the parameter, or its number from 0.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Posterior density with its sd (blue) and a wider quoted sd (orange), and the prior (dashed);
        far sharper than the prior, a strip above shows its place in it.
    """
    name = posterior.names[_index(posterior.names, name, "name")]
    assert ax is not None
    prior_panel(ax, posterior, name, posterior.summary()["parameters"][name])
    return ax


@_on_axes
def plot_pairs(
    posterior: Posterior,
    names: Sequence[str | int] = (),
    *,
    max_parameters: int = 16,
    ax: Axes | None = None,
) -> Axes:
    """What goes along with what.

    Parameters
    ----------
    posterior : Posterior
        Of a fit.
    names : sequence of str or int, optional
        Of the parameters, or their numbers from 0; empty for all.
    max_parameters : int, optional
        Of more parameters than this those with the strongest correlations are drawn, if none is
        named.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        One cell a pair: density and 90 % ellipse below the diagonal, correlation above. Beside each
        row stands where its cells end, 3.4 sd on both sides of the mean.
    """
    max_parameters = whole_number(max_parameters, "max_parameters", 1)
    given = [names] if isinstance(names, str) else names
    wanted = members(given, object, "names", error=SettingsError)
    shown = [_index(posterior.names, name, "names") for name in wanted]
    assert ax is not None
    pairs_panel(ax, posterior, shown or most_correlated(posterior, max_parameters))
    return ax


@_on_axes
def plot_rates(posterior: Posterior, slew: int | str = 0, *, ax: Axes | None = None) -> Axes:
    """Rates of one slew, as measured and as predicted.

    Parameters
    ----------
    posterior : Posterior
        Of a fit.
    slew : int or str, optional
        Its number from 0, or its name.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Dots as measured, lines as predicted with 90 % bands.
    """
    channel = _series(posterior, "rate")
    s = _index(channel.slews, slew, "slew")
    largest = float(np.nanmax(np.abs(channel.measured[s]), initial=1e-12))
    scale = style.scale("rate", "rad/s", 0.0, largest)
    assert ax is not None
    rate_panel(ax, channel, s, scale)
    ax.set(xlabel="time in slew [s]", ylabel=scale.label)
    ax.legend(handles=style.component_lines(channel.components))
    return ax


@_on_axes
def plot_residuals(
    posterior: Posterior, slew: int | str = 0, channel: str = "rate", *, ax: Axes | None = None
) -> Axes:
    """Measured less predicted of one slew, in stated sigmas.

    Parameters
    ----------
    posterior : Posterior
        Of a fit.
    slew : int or str, optional
        Its number from 0, or its name.
    channel : str, optional
        "rate", or another sensor that reads at every row.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        With guides at 1, 2 and 3 sigma.
    """
    series = _series(posterior, channel)
    s = _index(series.slews, slew, "slew")
    assert ax is not None
    residual_panel(ax, series, s)
    ax.set(xlabel="time in slew [s]", ylabel=f"{channel} residual [σ]")
    ax.set_title(series.slews[s])
    ax.legend(handles=style.component_marks(series.components))
    return ax


@_on_axes
def plot_attitude(posterior: Posterior, *, after: bool = True, ax: Axes | None = None) -> Axes:
    """Misfit of the attitude at the star-tracker's fixes.

    Parameters
    ----------
    posterior : Posterior
        Of a fit.
    after : bool, optional
        Fixes in the second half of each slew; False for those in the first.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Small marks are fixes about body x, y and z, large ones their mean in each slew.
    """
    require_flags(after=after)
    misfit = posterior_data.attitude_misfit(posterior)
    if misfit is None:
        raise SettingsError("the fit has no attitude", where="posterior", advice="draw the rates")
    here = np.isfinite(misfit.time) & (misfit.after == after)
    assert ax is not None
    values = np.where(here[..., None], arcsec(misfit.angle_B), np.nan)
    attitude_panel(ax, values, misfit.slews, label_slews=True)
    ax.axhline(0.0, color=style.MUTED, lw=0.6, zorder=0.5)
    ax.set(ylabel="misfit [arcsec]", title=misfit.sides[after])
    ax.legend(handles=style.component_marks("xyz", "about body "))
    return ax


@_on_axes
def plot_trace(
    posterior: Posterior, name: str | int | None = None, *, ax: Axes | None = None
) -> Axes:
    """How one parameter moved in each independent ensemble.

    Parameters
    ----------
    posterior : Posterior
        Of a fit.
    name : str or int, optional
        Of the parameter, or its number from 0; None for the one whose ensembles agree least.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        One line an ensemble: the mean of its walkers, with the band that holds 90 % of them.
    """
    values, label = chains.ensembles_of(posterior, _least_agreed(posterior, name))
    assert ax is not None
    discarded = posterior.attributes["diagnostics"]["discarded"]
    chains.trace_panel(ax, label(values), label.label, discarded)
    return ax


@_on_axes
def plot_ranks(
    posterior: Posterior, name: str | int | None = None, *, ax: Axes | None = None
) -> Axes:
    """Ranks of each ensemble's draws among all draws: flat where the ensembles agree.

    Parameters
    ----------
    posterior : Posterior
        Of a fit.
    name : str or int, optional
        Of the parameter, or its number from 0; None for the one whose ensembles agree least.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        The band holds 99 % of the shares of ensembles that agree.
    """
    shown = _least_agreed(posterior, name)
    values, _ = chains.ensembles_of(posterior, shown)
    assert ax is not None
    chains.rank_panel(ax, values, posterior.attributes["diagnostics"]["tau_max"])
    ax.set_xlabel(f"rank of {shown} among all draws [–]")
    return ax


def _least_agreed(posterior: Posterior, name: str | int | None) -> str:
    """The parameter that is asked for; None for the one whose ensembles agree least."""
    shown = chains.worst_parameter(posterior) if name is None else name
    return posterior.names[_index(posterior.names, shown, "name")]


@_on_axes
def plot_observability(observability: Observability, *, ax: Axes | None = None) -> Axes:
    """How far the data narrow the prior of each parameter.

    Parameters
    ----------
    observability : Observability
        Of a campaign.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Bars: sd over prior sd; marks: what it would be if all else were known.
    """
    assert ax is not None
    sd_panel(ax, observability)
    return ax


@_on_axes
def plot_candidates(diagnosis: Diagnosis, *, ax: Axes | None = None) -> Axes:
    """Strength of the evidence for each candidate effect, each alone, before any was added.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of a campaign.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Effects that were named are hatched; the dashed line is where significance begins.
    """
    scored = [asdict(c) for c in diagnosis.candidates if c.dof]
    assert ax is not None
    if scored:
        candidates_panel(ax, scored, diagnosis.threshold, diagnosis.named)
    return ax


@_on_axes
def plot_history(history: History, name: str | int = 0, *, ax: Axes | None = None) -> Axes:
    """One element of J or K over campaigns.

    Parameters
    ----------
    history : History
        Of one spacecraft.
    name : str or int, optional
        Of the parameter, or its number from 0.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Dots: each campaign alone, with its sd. Line: all together, with its 90 % band. A dashed
        line stands where a jump is possible. Over time where the history has it.
    """
    assert ax is not None
    history_panel(ax, history, _index(history.names, name, "name"))
    ax.legend()
    return ax


@_on_axes
def plot_fleet(fleet: Fleet, name: str | int = 0, *, ax: Axes | None = None) -> Axes:
    """One element of J or K of each spacecraft of a fleet.

    Parameters
    ----------
    fleet : Fleet
        Of sister spacecraft.
    name : str or int, optional
        Of the parameter, or its number from 0.
    ax : matplotlib.axes.Axes, optional
        Where to draw; None for a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Squares: from the own campaigns alone; dots: with the sisters'. Line and band: the fleet's
        mean and spread.
    """
    assert ax is not None
    order = fleet_panel(ax, fleet, _index(fleet.names, name, "name"))
    named_ticks(ax, [fleet.spacecraft[k] for k in order])
    ax.legend()
    return ax
