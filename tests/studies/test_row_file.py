"""Rows on the disk: what was cut, changed or left by another study is told and done anew."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.cheap_tasks import exact, work_of

from bayes_inertia.errors import OutputError
from bayes_inertia.studies.engine import NAME, RowFile, run_work
from bayes_inertia.studies.work import Work
from bayes_inertia.studies.workers import IN_PROCESS

WORK = work_of(12)
OLD = Path(__file__).parents[1] / "data" / "shards_0.4"


def changed(folder: Path, change) -> None:
    """Rewrite the file of rows as a function of its lines."""
    path = folder / NAME
    path.write_bytes(b"".join(change(path.read_bytes().splitlines(keepends=True))))


def cut(folder):
    changed(folder, lambda lines: [*lines[:-1], lines[-1][:-9]])


def with_another_number(folder):
    changed(folder, lambda lines: [lines[0].replace(b'"value": ', b'"value": 1'), *lines[1:]])


def with_two_lines_in_one(folder):
    changed(folder, lambda lines: [lines[0][:-1], *lines[1:]])


def with_a_row_of_another_task(folder):
    changed(folder, lambda lines: [lines[0].replace(b'"task": "0"', b'"task": "1"'), *lines[1:]])


def without_seal(folder):
    def bare(line: bytes) -> bytes:
        content = json.loads(line)
        content["content_sha256"] = None
        return json.dumps(content).encode() + b"\n"

    changed(folder, lambda lines: [bare(lines[0]), *lines[1:]])


def replaced_by_text(folder):
    changed(folder, lambda lines: [b"task,value\n", b"4,1.0\n", b"[1]\n", b"\xff\n", *lines[1:]])


def of_another_seed(folder):
    run_work(work_of(12, seed=8), IN_PROCESS, folder.parent / "other")
    others = (folder.parent / "other" / NAME).read_bytes().splitlines(keepends=True)
    changed(folder, lambda lines: [others[0], *lines[1:]])


DAMAGES = {
    cut: "1 lines are cut short or changed",
    with_another_number: "1 lines are cut short or changed",
    with_two_lines_in_one: "1 lines are cut short or changed",
    with_a_row_of_another_task: "1 lines are cut short or changed",
    without_seal: "1 lines are cut short or changed",
    replaced_by_text: "4 lines are cut short or changed",
    of_another_seed: "1 lines are of another study",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_line_is_reported_and_done_anew(tmp_path, damage):
    folder = tmp_path / "run"
    whole = run_work(WORK, IN_PROCESS, folder)
    before = (folder / NAME).read_bytes()
    damage(folder)
    said, done = [], []
    mended = run_work(
        WORK, IN_PROCESS, folder, notice=said.append, progress=lambda *a: done.append(a[1])
    )
    assert said == [f"{NAME}: {DAMAGES[damage]}; done anew"]
    assert done == ([11, 12] if damage is with_two_lines_in_one else [12])
    assert exact(mended) == exact(whole)
    assert (folder / NAME).read_bytes() == before


def test_no_flipped_bit_changes_a_row(tmp_path):
    whole = run_work(work_of(4), IN_PROCESS, tmp_path)
    data = (tmp_path / NAME).read_bytes()
    rng = np.random.default_rng(1)
    told = 0
    for place in rng.choice(8 * len(data), 100, replace=False):
        flipped = bytearray(data)
        flipped[place // 8] ^= 1 << (place % 8)
        (tmp_path / NAME).write_bytes(flipped)
        rows = RowFile(tmp_path, work_of(4).digest)
        told += bool(rows.damages)
        read = rows.settle(work_of(4).ids)
        assert set(exact(read)) <= set(exact(whole))
    # A space for another one, or "e" for "E" in a number, changes nothing.
    assert told > 85


def test_a_line_is_json_that_says_what_it_holds(tmp_path):
    run_work(WORK, IN_PROCESS, tmp_path)
    lines = [json.loads(line) for line in (tmp_path / NAME).read_text().splitlines()]
    assert [line["task"] for line in lines] == list(WORK.ids)
    assert {line["study_sha256"] for line in lines} == {WORK.digest}
    assert lines[3]["row"]["text"] == "3"


def test_every_number_comes_back_to_the_bit(tmp_path):
    values = [np.pi, -0.0, 5e-324, 1.7976931348623157e308, float("inf"), 0.1 + 0.2, float("nan")]

    def task(task_id, seed):
        value = values[int(task_id)]
        return {"value": np.float64(value), "vector": np.array([value, -value]), "none": None}

    work = Work("numbers", task, tuple(map(str, range(len(values)))))
    first = run_work(work, IN_PROCESS, tmp_path)
    again = run_work(work, IN_PROCESS, tmp_path)
    expected = [{"value": v, "vector": [v, -v], "none": None} for v in values]
    assert repr([{k: v for k, v in r.items() if k != "task"} for r in again.rows]) == repr(expected)
    assert repr(first.rows) == repr(again.rows)


def test_a_full_disk_is_one_message_and_keeps_what_was_finished(tmp_path, monkeypatch):
    rows = RowFile(tmp_path, WORK.digest)
    rows.add(("0", {"value": 1.0}))
    (tmp_path / NAME).rename(tmp_path / "moved")
    (tmp_path / NAME).mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        rows.add(("1", {"value": 1.0}))


def test_rows_of_version_0_4_are_taken(tmp_path):
    old = tmp_path / "shards"
    shutil.copytree(OLD, old)
    done: list[int] = []
    result = run_work(work_of(32), IN_PROCESS, tmp_path, progress=lambda *a: done.append(a[1]))
    assert done == [31, 32]
    assert exact(result) == exact(run_work(work_of(32), IN_PROCESS))
    # A damaged file of that version, or one of another study, gives nothing.
    (old / "tasks_00001.parquet").write_bytes((OLD / "tasks_00001.parquet").read_bytes()[:-9])
    assert len(RowFile(old, work_of(32).digest).settle(work_of(32).ids).rows) == 25
    assert not RowFile(old, work_of(32, seed=8).digest).settle(work_of(32).ids).rows
