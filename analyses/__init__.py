"""Studies and figures: README.md says what each page shows.

A script runs from the root of the repository: `python -m analyses.FOLDER.NAME`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

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
