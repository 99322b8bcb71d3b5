"""A fit or a run as an `ExportedResult`, and its export to a file."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.options import FormatName
from bayes_inertia.app.result_folder import NEW_RUN, finished_posterior
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.design.after_campaign import UpdateForecast, correction_with_update
from bayes_inertia.design.numerics import NUMERICS as DESIGN_NUMERICS
from bayes_inertia.errors import SettingsError, require, require_kind
from bayes_inertia.files import path_of, write_atomically
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.maths.values import require_flags
from bayes_inertia.physics.parameters import after_changes_of_J, base_count, changes_of_J
from bayes_inertia.progress import Progress, silent
from bayes_inertia.report.criteria import (
    criteria_of,
    determination_of,
    interval_90,
    ratios_told,
    sd_in_print,
)
from bayes_inertia.report.export.formats import (
    EXPORT_FORMATS,
    ExportedCorrection,
    ExportedParameter,
    ExportedResult,
)
from bayes_inertia.report.words import sentences
from bayes_inertia.sealing import blaming, is_sealed, sha256_of

_CORRECTION_SAYS = (
    f"after a slew of {DESIGN_NUMERICS.corrected_turn_deg:g} deg about the worst body axis, "
    "noise and effects left out; old and new J and K on board; median and 95 % quantile over the "
    "posterior"
)


def export(
    result: Posterior | str | Path,
    path: str | Path,
    to: FormatName,
    *,
    campaign: Campaign | None = None,
    even_untrusted: bool = False,
) -> Path:
    """Write a result for another tool, as the command `export` does.

    Parameters
    ----------
    result : Posterior, str or Path
        A fit, its posterior.nc, or the folder of a finished run.
    path : str or Path
        The file; replaced if it exists.
    to : {"acm", "apm", "json", "csv", "matlab", "latex", "basilisk", "42"}
        The format: CCSDS attitude comprehensive message (504.0-B-2), inertia block of an attitude
        parameter message, all digits, sheet for an upload, script of MATLAB, table of LaTeX,
        Python lines for Basilisk, lines for NASA 42.
    campaign : Campaign, optional
        What was fitted: for the correction slew in "json" and "csv", which is left out without it.
        A run brings its own.
    even_untrusted : bool, optional
        Write a result whose gates failed too; the file then begins with a warning.

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    SettingsError
        If the format is unknown.
    CampaignError
        If the result is not trusted, or the campaign is not the one that was fitted.

    Examples
    --------
    >>> export("run_march", "inertia.apm", "apm")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: run_march: no run here: ...
    """
    require_flags(even_untrusted=even_untrusted)
    advice = f"choose one of {', '.join(EXPORT_FORMATS)}"
    require_kind(to, str, "to", advice, error=SettingsError)
    require(to in EXPORT_FORMATS, "to", f"no format {to!r}", advice, error=SettingsError)
    form = EXPORT_FORMATS[to]
    found = exported_result(result, campaign, with_correction=form.shows_correction)
    what = f"do not use this result as it stands ({'; '.join(found.reasons)})"
    advice = "mend that and fit again; even_untrusted=True writes it with a warning"
    require(found.trusted or even_untrusted, "result", what, advice)
    return write_atomically(path, form.text(found))


def exported_result(
    source: Posterior | str | Path,
    campaign: Campaign | None = None,
    *,
    with_correction: bool,
    progress: Progress = silent,
) -> ExportedResult:
    """A fit or a finished run as all formats see it.

    `campaign`: that was fitted; a run brings its own. `with_correction`: whether to forecast the
    correction slew, which takes seconds and needs a campaign. Returns: with a warning's reasons
    where the result is not trusted.
    """
    require_kind(campaign, Campaign | None, "campaign")
    if not isinstance(source, Posterior) and path_of(source, "result").is_file():
        source = Posterior.load(source)
    if isinstance(source, Posterior):
        _require_fitted(source, campaign)
        return _exported(source, campaign, with_correction, progress)
    run = path_of(source, "result")
    stored, posterior = run / "posterior.nc", finished_posterior(run)
    if campaign is None:
        campaign = read_campaign(run / "campaign")
    else:
        _require_fitted(posterior, campaign)
    with blaming(stored, intact=is_sealed(stored, NEW_RUN), advice=NEW_RUN):
        return _exported(posterior, campaign, with_correction, progress)


def _require_fitted(posterior: Posterior, campaign: Campaign | None) -> None:
    """Raise `CampaignError` where what is needed of the campaign is not known, or of another."""
    known = campaign is not None or "wheel_spin_kgm2" in posterior.attributes
    what, advice = "a fit of an older version does not state the wheels' spin", "give its campaign"
    require(known, "campaign", what, advice)
    own = posterior.attributes.get("slew_digests", {}).get("own")
    same = campaign is None or own is None or list(own) == campaign.slew_digests["own"]
    what, advice = "its slews are not those of the fit", "give the campaign that was fitted"
    require(same, "campaign", what, advice)


def _exported(
    posterior: Posterior, campaign: Campaign | None, with_correction: bool, progress: Progress
) -> ExportedResult:
    summary = posterior.summary()
    parameters = _parameters(posterior, summary)
    correction = None
    if with_correction and campaign is not None:
        progress("forecasting a correction slew", 0, 0)
        correction = _exported_correction(posterior, campaign.without_locked_wheels())
    spin = np.array(summary.get("wheel_spin_kgm2") if campaign is None else campaign.wheel_spin)
    # Fits that do not say it are exported with their campaign.
    stated = campaign is not None and campaign.inertia.includes_wheel_spin
    locked = bool(summary.get("includes_wheel_spin", stated))
    changes = changes_of_J(summary["parameters"])
    J = np.array(inertia_tensor.tensor(jnp.array([p.new for p in parameters[:6]])))
    J -= spin if locked else 0.0
    mission = dict(campaign.mission if campaign else posterior.attributes.get("mission", {}))
    slews = posterior.attributes.get("slew_digests", {})
    return ExportedResult(
        campaign=str(summary["campaign"] or (campaign.name if campaign else "")),
        source=_source(summary),
        trusted=summary["trusted"],
        reasons=tuple(summary["reasons"]),
        parameters=parameters,
        covariance=_quoted_covariance(posterior, parameters),
        includes_wheel_spin=locked,
        wheels=bool(spin.any()),
        inertia_B=J,
        inertia_locked_B=J + spin,
        correction=correction,
        notes=tuple(sentences("commands", "export_notes", summary, _known(summary), changes)),
        begin_utc=summary.get("begin_utc") if campaign is None else campaign.begin_utc,
        learnt_from=tuple(chain.from_iterable(slews.get(key, ()) for key in ("own", "former"))),
        scale_of_J=tuple(posterior.attributes.get("scale_of_J", ())),
        **{key: mission.get(key, "") for key in ("spacecraft", "operator")},
    )


def forecast_of(posterior: Posterior, campaign: Campaign) -> UpdateForecast | None:
    """The error of the next slew with the old and with the new J and K on board, in seconds.

    Where J changed during the campaign, it is the one after that.
    """
    n, changes = base_count(posterior.names), changes_of_J(posterior.names)
    # What changed goes along with J draw by draw, which an average over models would part.
    samples = posterior.samples if changes else posterior.averaged_samples
    rows: Any = posterior.summary()["parameters"]
    flown = np.vstack([[row["mean"] for row in rows.values()], posterior.widened(samples)])
    new, *draws = flown @ after_changes_of_J(posterior.names).T if changes else flown[:, :n]
    draws = np.array(draws)
    draws = draws[np.linspace(0, len(draws) - 1, LAYOUT.forecast_draws).astype(int)]
    prior_mean: Any = posterior.tree["estimate"]["prior_mean"]
    return correction_with_update(campaign, draws, np.asarray(prior_mean)[:n], new)


def _exported_correction(posterior: Posterior, campaign: Campaign) -> ExportedCorrection | None:
    forecast = forecast_of(posterior, campaign)
    if forecast is None:
        return None
    says = _CORRECTION_SAYS + ("; J after its change" if changes_of_J(posterior.names) else "")
    return ExportedCorrection(forecast.axis, forecast.before[1:], forecast.after[1:], says)


def _quoted_covariance(posterior: Posterior, parameters: Sequence[ExportedParameter]) -> np.ndarray:
    """Covariance of the draws, widened to the sds that are quoted; of J at its mean trace where
    nothing ties its size.
    """
    covariance = np.cov(posterior.sized_samples, rowvar=False)
    widening = np.array([p.sd for p in parameters]) / np.sqrt(np.diag(covariance))
    return covariance * np.outer(widening, widening)


def _parameters(posterior: Posterior, summary: dict[str, Any]) -> tuple[ExportedParameter, ...]:
    criteria = criteria_of(summary)
    rows, known = summary["parameters"], _known(summary)
    trace = sum(rows[name]["mean"] for name in ELEMENTS[:3])
    prior_means: Any = posterior.tree["estimate"]["prior_mean"]
    exported = []
    for i, (name, row) in enumerate(rows.items()):
        told = known[name]
        size = 1.0 if told is row else trace
        low, high = (size * end for end in interval_90(told) or (told["q05"], told["q95"]))
        exported.append(
            ExportedParameter(
                name=name,
                unit=row["unit"],
                old=float(prior_means[i]),
                old_sd=row["prior_sd"],
                new=size * told["mean"],
                sd=size * sd_in_print(told),
                low=low,
                high=high,
                determined=determination_of(row, criteria) if told is row else "only its ratio",
            )
        )
    return tuple(exported)


def _known(summary: dict[str, Any]) -> dict[str, Any]:
    """The row of each parameter; of J without a size of its own, that of its ratio to the trace."""
    ratios = ratios_told(summary)
    return {n: ratios.get(f"{n}/trace", row) for n, row in summary["parameters"].items()}


def _source(summary: dict[str, Any]) -> str:
    version = summary["versions"].get("bayes-inertia", "?")
    digest, what = summary.get("campaign_sha256"), "data"
    if digest is None and "own" in summary.get("slew_digests", {}):
        # A campaign in memory has no files, but slews.
        digest, what = sha256_of(*summary["slew_digests"]["own"]), "slews"
    effects = ", ".join(summary["effects"]) or "none"
    seed, told = summary["seed"], (digest or "unknown")[:16]
    return f"bayes-inertia {version}, seed {seed}, effects: {effects}, {what} sha256 {told}"
