"""The engine: the same bits from every executor, in any order, after any interruption."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.cheap_tasks import Flaky, exact, numbers, work_of

from bayes_inertia.errors import OutputError, SettingsError
from bayes_inertia.folder_lock import working_in
from bayes_inertia.studies.engine import NAME, Execution, run_work
from bayes_inertia.studies.work import Work, task_seed
from bayes_inertia.studies.workers import IN_PROCESS, open_workers

NAMES = ("MOST 2005", "delft/7", "weak/0", "weak/1", "weak/11", "12", "../../etc", "ä b")


class Stop(BaseException):
    """What a signal raises in the driver."""


def kept(folder) -> bytes:
    return (folder / NAME).read_bytes()


@pytest.fixture(scope="module")
def workers():
    with open_workers("joblib", 2) as workers:
        yield workers


def test_joblib_and_this_process_give_the_same_bits(tmp_path, workers):
    here = run_work(work_of(30), IN_PROCESS, tmp_path / "here")
    there = run_work(work_of(30), workers, tmp_path / "there")
    assert exact(here) == exact(there)
    assert kept(tmp_path / "here") == kept(tmp_path / "there")
    assert exact(run_work(work_of(30, seed=8), IN_PROCESS)) != exact(here)


def test_a_seed_depends_on_nothing_but_the_study_and_the_task():
    every = run_work(work_of(NAMES), IN_PROCESS)
    for name in NAMES:
        alone = run_work(work_of([name]), IN_PROCESS)
        assert [row for row in exact(every) if row[0] == name] == exact(alone)
    drawn = {task_seed(seed, name).generate_state(4).tobytes() for seed in (0, 1) for name in NAMES}
    assert len(drawn) == 2 * len(NAMES)
    # Numbered tasks have numpy's own spawned seeds.
    expected = np.random.SeedSequence(3).spawn(13)[12].generate_state(4)
    np.testing.assert_array_equal(task_seed(3, "12").generate_state(4), expected)


@pytest.mark.parametrize("ended", [1, 5, 9, 23])
def test_an_interrupted_study_goes_on_to_the_same_bits(tmp_path, workers, ended):
    whole = run_work(work_of(24), IN_PROCESS, tmp_path / "whole")
    done = []

    def stop(what, count, of):
        done.append(count)
        if count == ended:
            raise Stop

    with pytest.raises(Stop):
        run_work(work_of(24), IN_PROCESS, tmp_path / "cut", progress=stop)
    assert run_work(work_of(24), workers, tmp_path / "cut", progress=lambda *a: done.append(a[1]))
    # Nothing that was finished is done again, nothing is forgotten.
    assert done == list(range(1, 25))
    assert kept(tmp_path / "cut") == kept(tmp_path / "whole")
    assert exact(run_work(work_of(24), IN_PROCESS, tmp_path / "cut")) == exact(whole)


def test_more_tasks_are_added_to_those_that_are_there(tmp_path):
    few = run_work(work_of(6), IN_PROCESS, tmp_path)
    done = []
    more = run_work(work_of(11), IN_PROCESS, tmp_path, progress=lambda *a: done.append(a[1]))
    assert exact(more)[:6] == exact(few)
    assert done == [7, 8, 9, 10, 11]
    assert exact(run_work(work_of(6), IN_PROCESS, tmp_path)) == exact(few)
    assert exact(run_work(work_of(11), IN_PROCESS)) == exact(more)


def test_failures_stand_among_the_rows_with_their_reasons(tmp_path):
    mended, said = tmp_path / "mended", []
    work = work_of(9, Flaky(bad=("2",), broken=("5",), mended=mended))
    first = run_work(work, IN_PROCESS, tmp_path / "run", notice=said.append)
    assert [(f.task, f.error, f.final) for f in first.failures] == [
        ("2", "CampaignError", True),
        ("5", "ZeroDivisionError", False),
    ]
    assert "numbers: 2 failed: 2: no telemetry; fly again" in said
    lines = [json.loads(line) for line in kept(tmp_path / "run").splitlines()]
    assert [line["failure"]["reason"] for line in lines if "failure" in line] == [
        "2: no telemetry; fly again",
        "a bug",
    ]
    # Bad data stay bad; the bug is tried again.
    mended.touch()
    done = []
    second = run_work(work, IN_PROCESS, tmp_path / "run", progress=lambda *a: done.append(a[1]))
    assert done == [9]
    assert [f.task for f in second.failures] == ["2"]
    assert [row["task"] for row in second.rows] == [i for i in work.ids if i != "2"]


def test_a_task_that_kills_its_workers_is_named_and_the_others_are_done():
    work = work_of(12, Flaky(deadly=("4",)))
    with open_workers("joblib", 2) as workers:
        result = run_work(work, workers)
    assert [f.task for f in result.failures] == ["4"]
    assert "died 3 times" in result.failures[0].reason
    good = [row for row in exact(run_work(work_of(12), IN_PROCESS)) if row[0] != "4"]
    assert exact(result) == good


def test_seeds_of_numpy_generators_and_texts_do_as_arguments(tmp_path):
    work = Work("numbers", numbers, (str(k) for k in range(2)), seed=np.int64(3))
    assert work == Work("numbers", numbers, ("0", "1"), seed=3)
    rows = Execution().run(work, str(tmp_path)).rows
    assert [row["task"] for row in rows] == ["0", "1"]
    with pytest.raises(SettingsError, match="seed: is -1; give a whole number"):
        Work("numbers", numbers, ("0",), seed=-1)


def test_two_runs_do_not_share_a_folder(tmp_path):
    with working_in(tmp_path), pytest.raises(OutputError, match="another process"):
        run_work(work_of(3), IN_PROCESS, tmp_path)
    assert len(run_work(work_of(3), IN_PROCESS, tmp_path).rows) == 3


def test_each_task_is_reported():
    told = []
    run_work(work_of(3), IN_PROCESS, progress=lambda *a: told.append(a))
    assert told == [("numbers", 1, 3), ("numbers", 2, 3), ("numbers", 3, 3)]


def test_progress_says_what_is_counted():
    told = []
    run_work(work_of(3), IN_PROCESS, progress=lambda *a: told.append(a))
    assert told == [("numbers", 1, 3), ("numbers", 2, 3), ("numbers", 3, 3)]


def test_requests_that_cannot_be_are_refused():
    with pytest.raises(SettingsError, match="no task"):
        Work("numbers", numbers, ())
    with pytest.raises(SettingsError, match="twice"):
        Work("numbers", numbers, ("1", "1"))
    for engine, jobs, scheduler in (
        ("process", 2, None),
        ("joblib", 0, None),
        ("joblib", 2, "tcp://nowhere:1"),
        ("slurm", 1, None),
    ):
        with pytest.raises(SettingsError), open_workers(engine, jobs, scheduler):
            pass
