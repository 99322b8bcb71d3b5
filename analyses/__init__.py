"""Studies and figures: README.md says what each page shows.

A script runs from the root of the repository: `python -m analyses.FOLDER.NAME`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayes_inertia.studies.engine import Execution

_RESULTS = Path(__file__).parent / "results"


def results_of(script: str) -> Path:
    """Folder of the committed results of a script's folder."""
    return _RESULTS / Path(script).parent.name


def aloud(jobs: int = 1) -> Execution:
    """How a study runs its tasks: in so many processes, progress and notices printed."""
    from bayes_inertia.studies.engine import Execution

    return Execution(jobs=jobs, progress=lambda *told: print(*told, flush=True), notice=print)


def rows_of(path: Path) -> list[dict[str, Any]]:
    """Rows of a study, a line each; none where there is no file yet."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def made_rows(
    path: Path, cases: Iterable[Mapping[str, Any]], row_of: Callable[..., dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Rows of cases that the file lacks, made and appended one by one: a study goes on.

    A row holds its case.
    """
    known = rows_of(path)
    for case in cases:
        if any(all(row[key] == value for key, value in case.items()) for row in known):
            continue
        row = row_of(**case)
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        yield row
