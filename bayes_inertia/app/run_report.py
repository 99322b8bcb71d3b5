"""Content of a run folder's summary.json, and its page."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from bayes_inertia.app.diagnosis_json import blaming_diagnosis, read_diagnosis
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.design.numerics import NUMERICS as DESIGN_NUMERICS
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.plan_promise import PlanPromise
from bayes_inertia.report.verdict import with_verdict_sentence
from bayes_inertia.sealing import SEAL_KEY, blaming, read_sealed_json

_NEW_RUN = "start a new run in another folder"


def run_summary(posterior: Posterior, folder: Path) -> dict[str, Any]:
    """The content of a run's summary.json."""
    content = read_diagnosis(folder)
    if content is None:
        return with_verdict_sentence(posterior.summary())
    with blaming_diagnosis(folder, content):
        return with_verdict_sentence(posterior.summary(), content)


def run_page(
    posterior: Posterior, folder: Path, *, intact: bool, promise: PlanPromise | None = None
) -> str:
    """The report of a run: of its fit, and of its diagnosis if it has one."""
    # Plots take half a second to load: not before sampling.
    from bayes_inertia.report.fit_sections import standard_sections
    from bayes_inertia.report.page import render
    from bayes_inertia.report.plan_promise import plan_promise_section

    content = read_diagnosis(folder)
    sealed_diagnosis = content is None or SEAL_KEY in content
    with blaming(folder, intact=intact and sealed_diagnosis, advice=_NEW_RUN):
        sections = standard_sections(posterior, content, _forecast(posterior, folder))
        if promise is not None:
            # Behind result, reasons and parameters.
            sections.insert(3, plan_promise_section(promise))
        return render(posterior, sections, _origin(folder))


def _origin(folder: Path) -> dict[str, str]:
    """Date and data of the run, as far as it states them."""
    path = folder / "run.json"
    claim = read_sealed_json(path, _NEW_RUN) if path.is_file() else {}
    return {key: str(claim[key]) for key in ("date", "data") if key in claim}


def _forecast(posterior: Posterior, folder: Path) -> dict[str, Any] | None:
    """The error of the next slew, of a result that may be used and whose campaign is at hand."""
    from bayes_inertia.app.export_run import forecast_of

    copy = folder / "campaign"
    if not posterior.trusted or not copy.is_dir():
        return None
    if campaign_sha256(copy) != posterior.attributes.get("campaign_sha256"):
        return None
    forecast = forecast_of(posterior, read_campaign(copy))
    return (
        None
        if forecast is None
        else asdict(forecast) | {"angle_deg": DESIGN_NUMERICS.corrected_turn_deg}
    )


def write_run_report(
    posterior: Posterior, folder: Path, *, intact: bool, promise: PlanPromise | None = None
) -> Path:
    """Write report.html in a run folder."""
    page = run_page(posterior, folder, intact=intact, promise=promise)
    return write_atomically(folder / "report.html", page)
