"""Numbers of pages are those of committed results: marked, up to date, and no others."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import pytest

import bayes_inertia as bi

ROOT = Path(bi.__file__).parents[1]
DOCS = ROOT / "docs"
# Pages that say how well it works: no number may stand there that a script did not put there.
STRICT = ("README.md", "docs/index.md", "docs/results.md", "docs/studies.md")
# What is no result: versions, names, definitions.
NO_RESULT = re.compile(
    r"3\.12|90 %|99 of 100|ideal test finds in 99 %|88 to 92 %|60°|Exit code 0|, [23] is"
)


# All other pages: a size with a unit of how well or how fast is a result, and has a mark,
NUMBER = r"\d[\d.,]*(?:e-?\d+)?(?: × 10[⁻⁰-⁹]+)?"
UNIT = r"%|(?:robust |prior |quoted )?sds?\b|times\b|[kMGT]i?B\b|m?s\b|min\b|h\b|arcsec|kg m²"
PERFORMANCE = re.compile(
    rf"factors? of {NUMBER}|{NUMBER} (?:of|in) {NUMBER}|{NUMBER}(?: to {NUMBER})? ?"
    rf"(?:{UNIT}|effective|in log)"
)
# unless it is a setting, a threshold, a definition or an example, as these are.
DEFINITIONS = {
    "faq.md": ("Only 1 of 3 starts", "up to 2 sd are usual"),
    "glossary.md": ("90 % intervals should", "hold it in 90 %", "in 95 % of right studies"),
    "how_to/before_you_fly.md": (
        "12 fixes of 5 arcsec",
        "Prior: 4 % of the moments, 0.03 kg m² of the products",
        "20 s before, 30 s and more",
    ),
    "how_to/compiled_code.md": ("134 MB for each version", "a process keeps 12 MB of programs"),
    "how_to/series.md": ("a jump where that probability is above 95 %",),
    "how_to/dirty_telemetry.md": (
        "above 100 times the wheel's limit",
        "here 0.25 s",
        "4 sd from one half",
        "What 2 % lost rows cost",
    ),
    "how_to/doctor.md": (
        "within 3 sds",
        "beyond 8 sds",
        "more than 0.5 % of a slew, or 0.9 s",
    ),
    "how_to/export.md": ("90 % interval, correction slew", "median and 95 %"),
    "how_to/import.md": (
        "up to 5 % of a",
        "18 s of GPS, 37 s of TAI, 3600 s of a time zone",
        "Stamps that are 0.25 s early",
        "Stamps that are 1.5 s late",
        "at least 120 s",
    ),
    "how_to/noise.md": (
        "above 3 % of the readings",
        "median 1, sd of the logarithm",
        "95 % within a factor of 2.7",
        "median 6, sd of the logarithm",
        "1.41 times that",
        "beyond 3.3 prior sds of its logarithm (a factor of 5.2)",
    ),
    "how_to/plan.md": ("8 % of the rate",),
    "how_to/priors.md": (
        "| 1, sd",
        "| 0, sd",
        "Up to 20 % and 10 deg, the largest allowed",
        "has the 5, 50 and 95 % points",
        "within 0.3 of their sds; up to 10 % and 5 deg within 0.15",
    ),
    "how_to/robust_sd.md": ("same 90 % interval", "its 90 % intervals hold"),
    "how_to/stochastic_effects.md": (
        "90 % intervals of J",
        "a torque of 1 % of",
        "a factor of 20 either way (95 %), times a factor of 4",
    ),
    "method/diagnosis.md": (
        "all undercuts in 2 % of\ncampaigns",
        "weight of 1 % up to",
        "A parameter beyond 4 prior sds",
        "about 5 in log evidence",
    ),
    "method/forecasts.md": ("median and 95 %",),
    "method/trust.md": ("at least 400 effective", "more than 5 prior sds"),
    "method/uncertainty.md": ("Rows of less than 2 %",),
}
_CODE = re.compile(r"```.*?```|:::.*?$|`[^`]*`|\]\([^)]*\)|<!--.*?-->", re.DOTALL | re.MULTILINE)


@pytest.fixture
def pages(analysis):
    """`analyses/pages/fill.py`."""
    return analysis("pages.fill")


def test_marked_numbers_are_those_of_the_results(pages):
    values = pages.texts()
    for path in pages.pages():
        text = path.read_text(encoding="utf-8")
        assert pages.filled(text, values) == text, f"{path}: run python -m analyses.pages.fill"


def test_a_stale_number_is_seen(pages):
    values = pages.texts()
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    stale = text.replace(f"-->{values['quoted.low']}<!--/-->", "-->99<!--/-->", 1)
    assert pages.filled(stale, values) != stale


@pytest.mark.parametrize("name", STRICT)
def test_no_number_stands_beside_the_marks(name, pages):
    text = pages.unmarked((ROOT / name).read_text(encoding="utf-8"))
    assert re.findall(r".{0,20}\d+.{0,20}", NO_RESULT.sub("", _CODE.sub("", text))) == []


def results_without_mark(text: str, definitions: Sequence[str]) -> list[str]:
    """Sizes with a unit of performance, in a page without marks, that are no definition."""
    text = _CODE.sub("", text)
    for phrase in definitions:
        text = text.replace(phrase, "")
    return [text[max(0, m.start() - 30) : m.end()] for m in PERFORMANCE.finditer(text)]


@pytest.mark.parametrize("path", [p for p in DOCS.rglob("*.md") if f"docs/{p.name}" not in STRICT])
def test_no_result_stands_without_a_mark(path, pages):
    text = pages.unmarked(path.read_text(encoding="utf-8"))
    definitions = DEFINITIONS.get(str(path.relative_to(DOCS)), ())
    assert results_without_mark(text, definitions) == []
    assert [phrase for phrase in definitions if phrase not in text] == [], "stands there no more"


@pytest.mark.parametrize(
    "said",
    ["takes 3 s", "within 1e-6 sd", "2.5 times better", "a factor of 3", "named in 17 of 20"],
)
def test_a_result_without_a_mark_is_seen(said):
    assert results_without_mark(f"It {said}.", ["takes 4 s"])
    assert not results_without_mark(f"It {said}.", [said])


def test_no_mark_begins_a_line_of_text(pages):
    # Markdown would take the rest of the line as HTML.
    for path in pages.pages():
        lines = path.read_text(encoding="utf-8").splitlines()
        assert [line for line in lines if re.match(r"<!--=\S+-->.", line)] == [], path
