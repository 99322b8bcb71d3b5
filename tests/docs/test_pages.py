"""The documentation is complete: each command and public name has its place, each link its file."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

import bayes_inertia as bi
from bayes_inertia.app.cli import COMMANDS
from bayes_inertia.design.goals import GOALS
from bayes_inertia.files import vocabulary

ROOT = Path(bi.__file__).parents[1]
DOCS = ROOT / "docs"
# Pages that the repository shows; Sphinx sees to the links of the others.
SHOWN = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]


def test_every_command_has_a_manual_page():
    pages = {path: path.read_text(encoding="utf-8") for path in (DOCS / "manual").glob("*.md")}
    named = [re.findall(r"```\{command\} (.+)", text) for text in pages.values()]
    assert Counter(name for names in named for name in names) == Counter(list(COMMANDS))
    without = [path.name for path, text in pages.items() if "exit code" not in text.lower()]
    assert without == []


@pytest.mark.parametrize("goal", GOALS)
def test_every_goal_is_named_in_the_help_and_in_both_tables(goal):
    pages = [DOCS / "how_to" / "plan.md", DOCS / "method" / "forecasts.md"]
    assert all(f"| `{goal}" in page.read_text(encoding="utf-8") for page in pages)
    assert goal in vocabulary("app")["of"]["design"]["goal"]


def test_every_public_name_is_in_the_reference_once():
    text = "\n".join(path.read_text("utf-8") for path in (DOCS / "reference").glob("*.md"))
    described = re.findall(r"^\.\. auto(?:function|class|exception):: (\w+)", text, re.MULTILINE)
    described += re.findall(r"^`bayes_inertia\.(\w+)`$", text, re.MULTILINE)
    assert Counter(described) == Counter(bi.__all__)


def files_linked(page: Path) -> list[str]:
    """Relative links and pictures of a page, without the part after #."""
    tokens = [
        child
        for token in MarkdownIt().enable("table").parse(page.read_text(encoding="utf-8"))
        for child in token.children or ()
    ]
    targets = [str(token.attrGet("href") or token.attrGet("src") or "") for token in tokens]
    return [t.split("#")[0] for t in targets if t.split("#")[0] and "://" not in t]


@pytest.mark.parametrize("page", SHOWN, ids=[str(p.relative_to(ROOT)) for p in SHOWN])
def test_links_lead_to_files(page):
    assert [link for link in files_linked(page) if not (page.parent / link).exists()] == []


def test_the_check_of_links_can_fail(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("| a |\n|---|\n| [x](gone.md#here) |\n", encoding="utf-8")
    assert files_linked(page) == ["gone.md"]
