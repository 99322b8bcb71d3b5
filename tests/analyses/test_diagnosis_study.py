"""The study of diagnoses adds the campaigns that it lacks, in their order, and keeps the others."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

ANALYSES = Path(__file__).resolve().parents[2] / "analyses"


@pytest.fixture
def study(monkeypatch, tmp_path):
    """The study with diagnoses that take no time, and results in a folder of its own."""
    monkeypatch.syspath_prepend(str(ANALYSES))
    before = set(sys.modules)
    import diagnosis_study

    def run_one(case, power, level):
        return {"label": case.label, "index": case.index, "hidden": case.hidden, "power": power}

    monkeypatch.setattr(diagnosis_study, "run_one", run_one)
    monkeypatch.setattr(diagnosis_study, "FOLDER", tmp_path)
    yield diagnosis_study
    for name in set(sys.modules) - before:
        if str(ANALYSES) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def test_rows_stand_in_order_and_a_larger_study_keeps_them(study, monkeypatch, tmp_path):
    def run(kind: str, count: int) -> list[dict]:
        words = ["--kind", kind, "--count", str(count), "--work", str(tmp_path / "work")]
        monkeypatch.setattr(sys, "argv", ["diagnosis_study.py", *words])
        study.main()
        path = tmp_path / f"diagnosis_{kind}_0.99_tacho.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()]

    few = run("pair", 3)
    assert [(row["label"], row["index"]) for row in few] == [("pair", i) for i in range(3)]
    assert [row["hidden"] for row in few] == [
        [effect.name for effect in effects] for _, _, effects in study.tasks("pair", 3)
    ]
    assert run("pair", 5)[:3] == few
    assert len(run("pair", 5)) == 5
    single = run("single", 2)
    assert [row["label"] for row in single] == [*study.NAMES, *study.NAMES]
    assert all(row["hidden"] == [row["label"]] for row in single)
