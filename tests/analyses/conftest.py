"""Scripts of `analyses/`, imported as they import each other."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def analysis():
    """`analysis("FOLDER.NAME")` imports a script; all of `analyses` is forgotten after."""
    before = set(sys.modules)
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(ROOT))
        yield lambda name: importlib.import_module(f"analyses.{name}")
    for name in set(sys.modules) - before:
        if name.split(".")[0] == "analyses":
            del sys.modules[name]
