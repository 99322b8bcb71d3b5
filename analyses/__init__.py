"""Studies and figures: README.md says what each page shows.

A script runs from the root of the repository: `python -m analyses.FOLDER.NAME`.
"""

from __future__ import annotations

from pathlib import Path

_RESULTS = Path(__file__).parent / "results"


def results_of(script: str) -> Path:
    """Folder of the committed results of a script's folder."""
    return _RESULTS / Path(script).parent.name
