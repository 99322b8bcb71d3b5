"""The study of diagnoses adds the campaigns that it lacks, in their order, and keeps the others."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest


@pytest.fixture
def study(analysis, monkeypatch, tmp_path):
    """The study with diagnoses that take no time, and results in a folder of its own."""
    diagnosis_study = analysis("naming.fixed_shape")

    def run_one(case, power, level):
        return {"label": case.label, "index": case.index, "hidden": case.hidden, "power": power}

    monkeypatch.setattr(diagnosis_study, "run_one", run_one)
    monkeypatch.setattr(diagnosis_study, "FOLDER", tmp_path)
    return diagnosis_study


def test_rows_stand_in_order_and_a_larger_study_keeps_them(study, monkeypatch, tmp_path):
    def run(kind: str, count: int) -> list[dict]:
        words = ["--kind", kind, "--count", str(count), "--work", str(tmp_path / "work")]
        monkeypatch.setattr(sys, "argv", ["fixed_shape.py", *words])
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
    strong = run("strong", 1)
    assert len(strong) == len(study.FACTORS) * len(study.NAMES)
    assert {row["label"] for row in strong if row["hidden"] == ["rate_bias"]} == {
        "rate_bias*3",
        "rate_bias*10",
        "rate_bias*30",
    }
    assert [len(row["hidden"]) for row in run("triple", 2)] == [3, 3]


def test_strong_effects_have_factors_and_seeds_of_their_own(study):
    """Names that end alike have one hash."""
    cases = [
        study.Case("strong", label, 0, effects, True)
        for label, _, effects in study.tasks("strong", 1)
    ]
    assert [case.factor for case in cases[:: len(study.NAMES)]] == list(study.FACTORS)
    assert len({case.seed.generate_state(4).tobytes() for case in cases}) == len(cases)
    single = study.Case("single", "rate_bias", 0, cases[0].effects, True)
    assert single.factor == 1.0


def test_what_no_spacecraft_has_is_not_flown(study):
    from analyses.naming.physical_limits import why_not_physical

    J = np.diag([3.0, 2.0, 2.5])
    turned = {"rate_sensor_misalignment": {"angle": np.array([0.087, 0.0, 0.0])}}
    assert why_not_physical(turned, J) == ""
    impossible = {
        "an angle of 0.9 rad": {"rate_sensor_misalignment": {"angle": [0.9, 0.0, 0.0]}},
        "more inertia than": {"flexible_mode": {"coupling": [1.5, 1.5, 0.0]}},
        "no body has": {"inertia_change": {"change": [9.0, 0.0, 0.0, 0.0, 0.0, 0.0]}},
        "times the Earth": {"gravity_gradient": {"factor": -9.0}},
        "a wheel with gain": {"wheel_torque_gain": {"gain": [1.0, -0.2, 1.0]}},
        "a delay of": {"wheel_command_lag": {"tau": 90.0}},
    }
    for words, values in impossible.items():
        assert words in why_not_physical(values, J)
