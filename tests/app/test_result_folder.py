"""Folders of results: one owner, nothing overwritten, and a kill while writing is no obstacle."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import bayes_inertia
from bayes_inertia.app import (
    observe_folder,
    plan_folder,
    run_folder,
)
from bayes_inertia.app.options import DesignRequest
from bayes_inertia.app.result_folder import ResultFolder
from bayes_inertia.design.comparison import Contender
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.result import Design
from bayes_inertia.errors import CampaignError, EffectError, OutputError
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.inference.settings import Settings
from bayes_inertia.report.section import Picture, Section
from bayes_inertia.sealing import SEAL_KEY, sealed

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


def owner(folder: Path, **changes) -> ResultFolder:
    folder = ResultFolder(
        folder, "design", "design.json", "test/1", "aa", {"seed": 1, "goal": "x"}, ("plan.toml",)
    )
    return replace(folder, **changes)


def test_a_free_folder_is_claimed_and_the_same_work_goes_on(tmp_path):
    folder = owner(tmp_path / "new")
    assert not folder.holds_this_work()
    assert not folder.path.exists()
    folder.claim({"value": 3.0})
    assert folder.holds_this_work()
    claim = json.loads((folder.path / "design.json").read_text())
    assert claim == sealed(claim)
    del claim[SEAL_KEY]
    assert claim == {
        "format": "test/1",
        "campaign_sha256": "aa",
        "value": 3.0,
        "options": {"seed": 1, "goal": "x"},
    }


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"campaign_sha256": "bb"}, "other data"),
        ({"options": {"seed": 2, "goal": "x"}}, "other seed"),
        ({"options": {"seed": 2, "goal": "y"}}, "other seed, goal"),
        ({"format": "test/2"}, "not written by this command"),
    ],
)
def test_other_work_is_refused_with_what_differs(tmp_path, changes, words):
    owner(tmp_path).claim()
    before = (tmp_path / "design.json").read_bytes()
    for act in (ResultFolder.holds_this_work, ResultFolder.claim):
        with pytest.raises(OutputError, match=words):
            act(owner(tmp_path, **changes))
    assert (tmp_path / "design.json").read_bytes() == before


@pytest.mark.parametrize("content", ["mine", "[1, 2]", '{"format": "test/1"}', "\x00\xff"])
def test_a_claim_that_is_none_is_never_overwritten(tmp_path, content):
    (tmp_path / "design.json").write_text(content)
    with pytest.raises(OutputError, match="not written by this command"):
        owner(tmp_path).claim()
    assert (tmp_path / "design.json").read_text() == content


def test_results_without_a_claim_are_somebody_elses(tmp_path):
    (tmp_path / "plan.toml").write_text("mine")
    with pytest.raises(OutputError, match=r"plan.toml is there already, without design.json"):
        owner(tmp_path).claim()
    (tmp_path / "plan.toml").unlink()
    (tmp_path / "notes.txt").write_text("mine")
    assert not owner(tmp_path).holds_this_work()
    with pytest.raises(OutputError, match=r"notes.txt is there already"):
        owner(tmp_path, results=()).holds_this_work()


def test_a_kill_in_the_middle_of_a_claim_leaves_a_free_folder(tmp_path):
    (tmp_path / ".design.json.0a1b.tmp.json").write_text("half")
    assert not owner(tmp_path, results=()).holds_this_work()


def test_options_that_an_older_version_did_not_state_count_as_equal(tmp_path):
    old = {"format": "test/1", "campaign_sha256": "aa", "seed": 7, "goal": {"name": "y"}}
    (tmp_path / "design.json").write_text(json.dumps(old))
    assert owner(tmp_path).holds_this_work()
    flat = owner(tmp_path, flat=True, options={"seed": 7, "settings": {"steps": 3}})
    assert flat.holds_this_work()
    with pytest.raises(OutputError, match="other seed"):
        replace(flat, options={"seed": 8}).holds_this_work()
    # Nested ones too, and a default says what a missing one was.
    (tmp_path / "design.json").write_text(json.dumps(old | {"settings": {"steps": 3}}))
    assert replace(flat, options={"settings": {"steps": 3, "new": 1}}).holds_this_work()
    with pytest.raises(OutputError, match="other kind"):
        replace(flat, options={"kind": "b"}, defaults={"kind": "a"}).holds_this_work()


def test_a_run_folder_of_version_0_1_is_read_and_goes_on(tmp_path):
    run = run_folder.start(EXAMPLE, tmp_path / "run", settings=Settings(seed=3))
    path = tmp_path / "run" / "run.json"
    content = json.loads(path.read_text())
    assert content["format"] == run_folder.FORMAT
    del content["kind"], content[SEAL_KEY]
    path.write_text(json.dumps(content))
    assert run_folder.read_run(tmp_path / "run") == run
    assert run_folder.start(EXAMPLE, tmp_path / "run", settings=Settings(seed=3)) == run
    with pytest.raises(OutputError, match="other kind"):
        run_folder.start(EXAMPLE, tmp_path / "run", settings=Settings(seed=3), kind="diagnose")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("noise", "white"),
        ("noise", ["white"]),
        ("noise", 1.0),
        ("drive", "both"),
        ("effects", [1]),
        ("as_stated", "yes"),
    ],
)
def test_a_run_with_a_value_of_another_kind_is_refused_by_its_file(tmp_path, key, value):
    run_folder.start(EXAMPLE, tmp_path / "run", settings=Settings(seed=3))
    path = tmp_path / "run" / "run.json"
    content = json.loads(path.read_text()) | {key: value}
    del content[SEAL_KEY]
    path.write_text(json.dumps(content))
    with pytest.raises(CampaignError, match=rf"run\.json: not a run description \({key}"):
        run_folder.read_run(tmp_path / "run")


def test_a_run_with_an_effect_that_is_nowhere_is_refused_by_its_file(tmp_path):
    run = run_folder.start(EXAMPLE, tmp_path / "run", settings=Settings(seed=3))
    with pytest.raises(EffectError, match=r"run\.json, effects: no effect of this name: 'x'"):
        run_folder.effects_of_run(tmp_path / "run", replace(run, effects=("x",)))


def contender(name: str) -> Contender:
    return Contender(name, paper_like_plan(), np.ones(9), None, 1.0, 1.0, 1.0, 1.0, ())


def designed(*_, **__) -> Design:
    plan = paper_like_plan()
    return Design(
        plan,
        parse_goal("cross_terms"),
        Limits(),
        0,
        plan,
        1.0,
        2.0,
        3.0,
        4,
        {},
        {},
        {},
        {},
        (),
        (),
        (),
        (),
        1.0,
    )


@pytest.fixture
def quick(monkeypatch):
    """Designs, comparisons and observations that take no time."""
    monkeypatch.setattr(plan_folder, "design_plan", designed)
    pair = contender("a"), contender("b")
    monkeypatch.setattr(plan_folder, "compare_plans", lambda *_, **__: pair)
    monkeypatch.setattr(observe_folder, "settled_estimate", lambda *_, **__: (None, None))
    monkeypatch.setattr(observe_folder, "observe", lambda *_: None)
    monkeypatch.setattr(observe_folder, "observability_json", lambda _: {"drive": "commanded"})
    section = Section("Result", "", pictures=(Picture(Figure(), "", ""),))
    for module, name in (
        (plan_folder, "design_sections"),
        (plan_folder, "comparison_sections"),
        (observe_folder, "observability_sections"),
    ):
        monkeypatch.setattr(module, name, lambda *_: [section])


def run_design(folder: Path, seed: int = 0) -> None:
    plan_folder.run_design(EXAMPLE, folder, DesignRequest(seed=seed))


def run_compare(folder: Path, seed: int = 0) -> None:
    plan_folder.run_compare(EXAMPLE, ["paper"], folder, seed=seed)


def run_observe(folder: Path, seed: int = 0) -> None:
    observe_folder.run_observe(EXAMPLE, folder, seed=seed, both_drives=False)


COMMANDS = {
    "design": (run_design, ["design.html", "design.json", "design.png", "plan.toml"]),
    "compare": (run_compare, ["compare.html", "compare.json", "compare.png"]),
    "observe": (run_observe, ["observability.html", "observability.json", "observability.png"]),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("written", [0, 1, 2, 3])
def test_after_a_kill_between_two_writes_the_same_command_goes_on(
    tmp_path, monkeypatch, quick, command, written
):
    run, files = COMMANDS[command]
    replaced = []

    def killed(temporary, path):
        if len(replaced) == written:
            raise KeyboardInterrupt
        replaced.append(path)
        os.rename(temporary, path)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", killed)
        try:
            run(tmp_path / "run")
        except KeyboardInterrupt:
            pass
        else:
            assert written >= len(files)
    run(tmp_path / "run")
    assert sorted(p.name for p in (tmp_path / "run").iterdir()) == files


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_does_not_overwrite_what_it_made_with_other_options(tmp_path, quick, command):
    run, files = COMMANDS[command]
    run(tmp_path)
    before = {name: (tmp_path / name).read_bytes() for name in files}
    with pytest.raises(OutputError, match="other seed"):
        run(tmp_path, seed=1)
    run(tmp_path)
    assert {name: (tmp_path / name).read_bytes() for name in files} == before


def test_observe_writes_into_the_run_of_the_same_data_only(tmp_path, quick):
    run_folder.start(EXAMPLE, tmp_path / "run")
    run_observe(tmp_path / "run")
    path = tmp_path / "run" / "run.json"
    claim = json.loads(path.read_text())
    path.write_text(json.dumps(sealed(claim | {"campaign_sha256": "0"})))
    with pytest.raises(OutputError, match="run of other data"):
        run_observe(tmp_path / "run")
