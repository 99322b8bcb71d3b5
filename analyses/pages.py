"""Put the numbers of committed results into the pages that quote them.

    python analyses/pages.py [--check]

A page marks a number with its name, `<!--=NAME-->TEXT<!--/-->`; the text between is written anew.
Pages stay plain Markdown, here and where the code is hosted. `tests/analyses/test_pages.py` fails
where a page is stale.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path

from page_numbers import numbers
from study_table import study_table

from bayes_inertia.files import write_atomically

ROOT = Path(__file__).parents[1]
_MARK = re.compile(r"<!--=(\S+?)-->(.*?)<!--/-->", re.DOTALL)


def pages() -> list[Path]:
    """All pages that mark numbers."""
    candidates = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [path for path in candidates if _MARK.search(path.read_text(encoding="utf-8"))]


def texts() -> dict[str, str]:
    """What marks may name: numbers, and tables of them."""
    return numbers() | {"studies": "\n" + "\n".join(study_table(numbers())) + "\n"}


def filled(text: str, values: Mapping[str, str]) -> str:
    """A page with its marks written anew.

    >>> filled("in <!--=a-->1<!--/--> of 9", {"a": "2"})
    'in <!--=a-->2<!--/--> of 9'
    """
    return _MARK.sub(lambda mark: f"<!--={mark[1]}-->{values[mark[1]]}<!--/-->", text)


def unmarked(text: str) -> str:
    """A page without its marked numbers.

    >>> unmarked("in <!--=a-->1<!--/--> of 9")
    'in  of 9'
    """
    return _MARK.sub("", text)


def main() -> None:
    """Write the pages, or say which are stale."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing; fail if one is stale")
    check, values = parser.parse_args().check, texts()
    stale = []
    for path in pages():
        text = path.read_text(encoding="utf-8")
        if (new := filled(text, values)) != text:
            stale.append(str(path.relative_to(ROOT)))
            if not check:
                write_atomically(path, new)
    print("\n".join(stale) or "all pages are up to date")
    if check and stale:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
