"""The formats that a result is exported to: a table, handed in where it is used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from bayes_inertia.report.export.basilisk import basilisk_text
from bayes_inertia.report.export.ccsds_acm import ccsds_acm_text
from bayes_inertia.report.export.ccsds_apm import ccsds_apm_text
from bayes_inertia.report.export.content import ExportedResult
from bayes_inertia.report.export.csv_sheet import csv_text
from bayes_inertia.report.export.json_document import json_text
from bayes_inertia.report.export.latex import latex_text
from bayes_inertia.report.export.matlab import matlab_text
from bayes_inertia.report.export.nasa_42 import nasa_42_text


@dataclass(frozen=True)
class ExportFormat:
    """One format.

    Parameters
    ----------
    says : str
        What the file holds.
    text : callable
        From an `ExportedResult` to the content of the file.
    shows_correction : bool
        Whether the forecast of the correction slew is shown; it takes seconds to make.
    """

    says: str
    text: Callable[[ExportedResult], str]
    shows_correction: bool = False


EXPORT_FORMATS: Mapping[str, ExportFormat] = {
    "acm": ExportFormat("CCSDS attitude comprehensive message: J, K, covariance", ccsds_acm_text),
    "apm": ExportFormat("inertia block of a CCSDS attitude parameter message", ccsds_apm_text),
    "json": ExportFormat("everything, all digits", json_text, shows_correction=True),
    "csv": ExportFormat("sheet for an upload: old, new, change", csv_text, shows_correction=True),
    "matlab": ExportFormat("script that defines a struct", matlab_text),
    "latex": ExportFormat("table of the parameters", latex_text),
    "basilisk": ExportFormat("Python lines for the hub of a Basilisk spacecraft", basilisk_text),
    "42": ExportFormat("lines of a spacecraft file of NASA 42", nasa_42_text),
}
