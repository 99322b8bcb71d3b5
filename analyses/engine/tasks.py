"""Tasks of `studies.py` that are no fits; workers import them from here."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.studies.work import Row

# About a quarter of a second of one core.
_BLOCK = bytes(2**20)
_ROUNDS = 200


def nothing(task_id: str, seed: np.random.SeedSequence) -> Row:
    """An empty row."""
    return {}


def busy(task_id: str, seed: np.random.SeedSequence) -> Row:
    """Keep a core busy, and say in which process."""
    digest = hashlib.sha256()
    for _ in range(_ROUNDS):
        digest.update(_BLOCK)
    return {"process": os.getpid(), "digest": digest.hexdigest()}


@dataclass(frozen=True)
class RowLikeAFit:
    """A row with the keys and texts of a real one and numbers of its own."""

    row: Mapping[str, Any]  # one that `fit-many` made

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Every real number is changed in most of its bits, so that files cannot be smaller."""
        rng = np.random.default_rng(seed)
        return {
            key: value * (1.0 + 1e-3 * rng.standard_normal()) if type(value) is float else value
            for key, value in self.row.items()
        }
