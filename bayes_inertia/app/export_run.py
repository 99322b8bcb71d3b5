"""A run folder as an `ExportedResult`, and its export to a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.result_folder import NEW_RUN, finished_posterior
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.design.after_campaign import UpdateForecast, correction_with_update
from bayes_inertia.design.numerics import NUMERICS as DESIGN_NUMERICS
from bayes_inertia.flight.spacecraft import spin_tensor, without_spin
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.inertia_tensor import ELEMENTS
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
    ExportedCorrection,
    ExportedParameter,
    ExportedResult,
)
from bayes_inertia.report.words import sentences
from bayes_inertia.sealing import blaming, is_sealed

_CORRECTION_SAYS = (
    f"after a slew of {DESIGN_NUMERICS.corrected_turn_deg:g} deg about the worst body axis, "
    "noise and effects left out; old and new J and K on board; median and 95 % quantile over the "
    "posterior"
)


def exported_result(
    run: Path, *, with_correction: bool, progress: Progress = silent
) -> ExportedResult:
    """Read a finished run.

    `with_correction`: whether to forecast the correction slew, which takes seconds. Returns: with a
    warning's reasons where the result is not trusted.
    """
    stored = run / "posterior.nc"
    posterior = finished_posterior(run)
    campaign = read_campaign(run / "campaign").without_locked_wheels()
    with blaming(stored, intact=is_sealed(stored, NEW_RUN), advice=NEW_RUN):
        summary = posterior.summary()
        parameters = _parameters(posterior, summary)
        if with_correction:
            progress("forecasting a correction slew", 0, 0)
        correction = _exported_correction(posterior, campaign) if with_correction else None
        locked = bool(summary.get("includes_wheel_spin", campaign.inertia.includes_wheel_spin))
        means = jnp.array([p.new for p in parameters[:6]])
        changes = changes_of_J(summary["parameters"])
        J = without_spin(np.array(inertia_tensor.tensor(means)), locked, campaign.wheels)
    return ExportedResult(
        campaign=str(summary["campaign"] or campaign.name),
        source=_source(summary),
        trusted=summary["trusted"],
        reasons=tuple(summary["reasons"]),
        parameters=parameters,
        covariance=_quoted_covariance(posterior, parameters),
        includes_wheel_spin=locked,
        wheels=bool(campaign.wheels),
        inertia_B=J,
        inertia_locked_B=J + spin_tensor(campaign.wheels),
        correction=correction,
        notes=tuple(sentences("commands", "export_notes", summary, _known(summary), changes)),
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
    data = (summary.get("campaign_sha256") or "unknown")[:16]
    effects = ", ".join(summary["effects"]) or "none"
    seed = summary["seed"]
    return f"bayes-inertia {version}, seed {seed}, effects: {effects}, data sha256 {data}"
