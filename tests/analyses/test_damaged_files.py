"""The study of damaged files sees what it looks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def study(analysis, monkeypatch, tmp_path):
    """The study's modules, and a corpus of a campaign alone."""
    fault_study, fault_targets = (
        analysis("data_quality.damaged_files"),
        analysis("data_quality.damaged_targets"),
    )
    fault_targets.make_campaign(tmp_path / "corpus")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    return fault_study, fault_targets, tmp_path / "corpus"


def test_a_case_is_drawn_from_its_number_and_judged(study):
    fault_study, fault_targets, corpus = study
    draws = [
        fault_targets.draw_case(corpus, ("csv", "toml"), np.random.default_rng([5, k]))
        for k in (1, 1, 2)
    ]
    assert draws[0] == draws[1] != draws[2]
    outcomes = set()
    for number in range(12):
        random = np.random.default_rng([5, number])
        case = fault_targets.draw_case(corpus, ("csv", "toml"), random)
        outcomes.add(judged(fault_study, fault_targets, case, corpus, random))
    assert outcomes <= {"accepted", "refused"}
    assert "refused" in outcomes


@pytest.mark.slow
def test_every_format_can_be_damaged_in_its_structure(study):
    _, fault_targets, corpus = study
    columns = fault_targets.sound_columns(corpus)
    for suffix, write in fault_targets.WRITERS.items():
        random = np.random.default_rng(5)
        drawn = {write(columns, random) for _ in range(100)}
        assert len(drawn) > 90, suffix


def judged(fault_study, fault_targets, case, corpus, random) -> str:
    folder = corpus.parent / "case"
    folder.mkdir(exist_ok=True)
    given = fault_targets.place_case(case, corpus, folder)
    return fault_study._outcome(case, given, corpus, random)[0]


def raises(error: BaseException):
    def command(*_):
        raise error

    return command


def loops(*_):
    while True:
        pass


def writes(*_):
    Path("stray").write_text("x")
    raise SystemExit(0)


@pytest.mark.parametrize(
    ("command", "outcome"),
    [
        (raises(KeyError("x")), "traceback"),
        (loops, "hang"),
        (writes, "stray file"),
        (raises(SystemExit(2)), "bad message"),
        (raises(SystemExit(0)), "accepted"),
    ],
    ids=["traceback", "hang", "stray", "silent", "accepted"],
)
def test_what_is_wrong_is_counted(study, monkeypatch, command, outcome):
    fault_study, fault_targets, corpus = study
    monkeypatch.setattr(fault_targets, "main", command)
    monkeypatch.setattr(fault_study, "_SECONDS", 0.2)
    import signal

    before = signal.signal(signal.SIGPROF, fault_study._too_long)
    random = np.random.default_rng(0)
    case = fault_targets.draw_case(corpus, ("csv",), random)
    assert judged(fault_study, fault_targets, case, corpus, random) == outcome
    signal.signal(signal.SIGPROF, before)
