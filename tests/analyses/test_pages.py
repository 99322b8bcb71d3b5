"""Numbers of pages are those of committed results: marked, up to date, and no others."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import bayes_inertia as bi

ROOT = Path(bi.__file__).parents[1]
# Pages that say how well it works: no number may stand there that a script did not put there.
STRICT = ("README.md", "docs/index.md", "docs/results.md", "docs/studies.md")
# What is no result: versions, names, definitions.
NO_RESULT = re.compile(r"3\.12|90 %|99 of 100|88 to 92 %|60°|Exit code 0|, [23] is")


@pytest.fixture
def pages(analysis):
    """`analyses/pages.py`."""
    return analysis("pages")


def test_marked_numbers_are_those_of_the_results(pages):
    values = pages.texts()
    for path in pages.pages():
        text = path.read_text(encoding="utf-8")
        assert pages.filled(text, values) == text, f"{path}: run python analyses/pages.py"


def test_a_stale_number_is_seen(pages):
    values = pages.texts()
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    stale = text.replace(f"-->{values['quoted.low']}<!--/-->", "-->99<!--/-->", 1)
    assert pages.filled(stale, values) != stale


@pytest.mark.parametrize("name", STRICT)
def test_no_number_stands_beside_the_marks(name, pages):
    text = pages.unmarked((ROOT / name).read_text(encoding="utf-8"))
    text = re.sub(
        r"```.*?```|:::.*?$|`[^`\n]*`|\]\([^)]*\)", "", text, flags=re.DOTALL | re.MULTILINE
    )
    assert re.findall(r".{0,20}\d+.{0,20}", NO_RESULT.sub("", text)) == []


def test_no_mark_begins_a_line_of_text(pages):
    # Markdown would take the rest of the line as HTML.
    for path in pages.pages():
        lines = path.read_text(encoding="utf-8").splitlines()
        assert [line for line in lines if re.match(r"<!--=\S+-->.", line)] == [], path
