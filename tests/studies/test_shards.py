"""Shards: what was cut, changed, put in another's place or doubled is told and done anew."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.cheap_tasks import exact, work_of

from bayes_inertia.studies.engine import run_work
from bayes_inertia.studies.pools import InProcess
from bayes_inertia.studies.shard_file import ShardDamageError, shard_bytes, shard_rows
from bayes_inertia.studies.store import LEDGER

WORK = work_of(12)
NAMES = ("tasks_00000", "tasks_00001", "tasks_00002")


def path_of(folder, k: int):
    return folder / f"{NAMES[k]}.parquet"


def truncated(folder):
    path = path_of(folder, 1)
    path.write_bytes(path.read_bytes()[:-9])


def emptied(folder):
    path_of(folder, 1).write_bytes(b"")


def replaced_by_text(folder):
    path_of(folder, 1).write_text("task,value\n4,1.0\n")


def replaced_by_its_neighbour(folder):
    path_of(folder, 1).write_bytes(path_of(folder, 0).read_bytes())


def of_another_seed(folder):
    other = work_of(12, seed=8)
    run_work(other, InProcess(), folder.parent / "other")
    path_of(folder, 1).write_bytes(path_of(folder.parent / "other", 1).read_bytes())


def with_tasks_of_another(folder):
    rows = {str(i): {"value": 0.5} for i in (3, 4, 5, 6)}
    path_of(folder, 1).write_bytes(shard_bytes(rows, study=WORK.digest, name=NAMES[1]))


DAMAGES = {
    truncated: "was cut short or changed",
    emptied: "is no shard",
    replaced_by_text: "is no shard",
    replaced_by_its_neighbour: "is a copy of tasks_00000",
    of_another_seed: "of another study",
    with_tasks_of_another: "tasks of other shards",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_shard_is_told_and_done_anew(tmp_path, damage):
    folder = tmp_path / "run"
    whole = run_work(WORK, InProcess(), folder)
    before = {k: path_of(folder, k).read_bytes() for k in range(3)}
    damage(folder)
    said, done = [], []
    mended = run_work(
        WORK, InProcess(), folder, notice=said.append, progress=lambda *a: done.append(a[1])
    )
    assert len(said) == 1
    assert said[0].startswith("tasks_00001.parquet")
    assert DAMAGES[damage] in said[0]
    assert done == [9, 10, 11, 12]
    assert exact(mended) == exact(whole)
    assert {k: path_of(folder, k).read_bytes() for k in range(3)} == before


def test_every_flipped_bit_is_noticed():
    rows = {str(i): {"value": 1.0 / (i + 1), "text": "a"} for i in range(4)}
    data = shard_bytes(rows, study="ab", name="a")
    assert shard_rows(data, study="ab", name="a") == rows
    rng = np.random.default_rng(1)
    for place in rng.choice(8 * len(data), 400, replace=False):
        changed = bytearray(data)
        changed[place // 8] ^= 1 << (place % 8)
        with pytest.raises(ShardDamageError):
            shard_rows(bytes(changed), study="ab", name="a")
    for length in rng.choice(len(data), 50, replace=False):
        with pytest.raises(ShardDamageError):
            shard_rows(data[:length], study="ab", name="a")


def test_a_shard_is_a_parquet_table_that_says_what_it_holds(tmp_path):
    run_work(WORK, InProcess(), tmp_path)
    table = pq.read_table(path_of(tmp_path, 2))
    assert table["task"].to_pylist() == ["8", "9", "10", "11"]
    about = json.loads(table.schema.metadata[b"bayes_inertia"])
    assert about == {"format": "bayes-inertia-shard/1", "study": WORK.digest, "shard": NAMES[2]}


def test_every_number_comes_back_to_the_bit():
    values = [np.pi, -0.0, 5e-324, 1.7976931348623157e308, float("inf"), 0.1 + 0.2]
    rows = {str(i): {"value": v, "vector": [v, -v], "none": None} for i, v in enumerate(values)}
    back = shard_rows(shard_bytes(rows, study="ab", name="a"), study="ab", name="a")
    assert repr(back) == repr(rows)


def test_a_ledger_that_cannot_be_read_is_told(tmp_path):
    run_work(WORK, InProcess(), tmp_path)
    for text in ("{", "[]", json.dumps({"format": "bayes-inertia-failures/1", "study": "ab"})):
        (tmp_path / LEDGER).write_text(text)
        said = []
        assert len(run_work(WORK, InProcess(), tmp_path, notice=said.append).rows) == 12
        assert len(said) == 1
        assert LEDGER in said[0]
