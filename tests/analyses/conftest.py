"""Scripts of `analyses/`, imported as they import each other."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

ANALYSES = Path(__file__).resolve().parents[2] / "analyses"


@pytest.fixture
def analysis(monkeypatch):
    """`analysis(name)` imports a script; it and what it imports there are forgotten after."""
    monkeypatch.syspath_prepend(str(ANALYSES))
    before = set(sys.modules)
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if str(ANALYSES) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]
