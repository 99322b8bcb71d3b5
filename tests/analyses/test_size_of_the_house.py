"""The package does not grow where it was too large: deciding numbers, floors of the core."""

from __future__ import annotations

import json

import pytest

NEVER_MORE = (
    "deciding numbers at module level",
    "floors of inference",
    "floors of diagnosis",
)


@pytest.fixture
def size(analysis):
    return analysis("engine.size_of_the_house")


@pytest.mark.slow
def test_the_package_is_no_larger_than_the_committed_counts_say(size):
    now = size.counts(size.tree_of(size.ROOT / size.PACKAGE))
    committed = json.loads(size.RESULT.read_text(encoding="utf-8"))["now"]
    assert {what: now[what] for what in NEVER_MORE if now[what] > committed[what]} == {}


def test_the_committed_page_is_that_of_the_committed_counts(size):
    content = json.loads(size.RESULT.read_text(encoding="utf-8"))
    assert size.RESULT.with_suffix(".md").read_text(encoding="utf-8") == size.page(**content)


def test_a_new_number_a_new_floor_and_a_new_arrow_are_counted(size):
    sources = {
        "inference.fit": "from bayes_inertia.inference.noise import sd",
        "inference.noise": "from bayes_inertia.inference.limits import LIMITS",
        "inference.limits": "LIMITS = Limits()",
    }
    before = size.counts(size.Tree(sources))
    more = sources | {
        "inference.limits": "from bayes_inertia.inference.units import DEGREE\nFEW, FAR = 3, 5.0",
        "inference.units": "DEGREE: Annotated[float, 1] = None",
    }
    after = size.counts(size.Tree(more))
    assert [before[what] for what in NEVER_MORE] == [0, 3, 0]
    assert [after[what] for what in NEVER_MORE] == [2, 4, 0]
    assert after["import arrows inside inference"] == 3


def test_lines_are_those_of_code_and_of_docstrings(size):
    assert size.lines_of('"""Head.\n\nMore."""\n\nx = (\n    1\n)  # Why.\n') == (3, 3)
