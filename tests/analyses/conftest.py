"""Scripts of `analyses/`, imported as they import each other."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

ANALYSES = Path(__file__).resolve().parents[2] / "analyses"


@pytest.fixture(scope="module")
def analysis():
    """`analysis(name)` imports a script; it and what it imports there are forgotten after."""
    before = set(sys.modules)
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(ANALYSES))
        yield importlib.import_module
    for name in set(sys.modules) - before:
        if str(ANALYSES) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]
