"""The diagnosis of a run folder as it stands in its file."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from bayes_inertia.app.diagnosis_json import FORMAT
from bayes_inertia.errors import CampaignError
from bayes_inertia.sealing import SEAL_KEY, blaming, read_sealed_json

DIAGNOSIS_FILE = "diagnosis.json"
_ADVICE = "delete it and run `bayes-inertia resume`"


def blaming_diagnosis(folder: Path, content: Mapping[str, Any]) -> AbstractContextManager[None]:
    """Take any exception for damage of a run's diagnosis.json, where that has no seal."""
    return blaming(folder / DIAGNOSIS_FILE, intact=SEAL_KEY in content, advice=_ADVICE)


def read_diagnosis(folder: Path) -> dict[str, Any] | None:
    """The content of a run's diagnosis.json."""
    path = folder / DIAGNOSIS_FILE
    if not path.is_file():
        return None
    content = read_sealed_json(path, _ADVICE)
    if content.get("format") != FORMAT:
        raise CampaignError("not a diagnosis", where=str(path), advice=_ADVICE)
    return content
