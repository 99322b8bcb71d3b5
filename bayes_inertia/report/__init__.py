"""The report of a fit: one offline HTML file with the verdict first.

A report is a list of `Section`s; to add one, append it to `standard_sections(posterior)`. That of a diagnosis
begins with `diagnosis_sections(content of diagnosis.json)`.
"""

from bayes_inertia.report.diagnosis_sections import diagnosis_sections
from bayes_inertia.report.page import render, write_report
from bayes_inertia.report.section import Picture, Section, packaged
from bayes_inertia.report.sections import standard_sections

__all__ = [
    "Picture",
    "Section",
    "diagnosis_sections",
    "packaged",
    "render",
    "standard_sections",
    "write_report",
]
