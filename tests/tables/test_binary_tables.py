"""Parquet, HDF5 and MAT tables."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pytest
import scipy.io
from pyarrow import parquet
from support.campaign_files import (
    BINARY_CASES,
    CSV,
    TOML,
    assert_same,
    assert_teaches,
    make,
)

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError


def table_columns() -> dict[str, np.ndarray]:
    header, *rows = CSV.splitlines()
    cells = np.array([[float(c or "nan") for c in row.split(",")[:-1]] for row in rows])
    return dict(zip(header.split(","), cells.T, strict=False))


def save_parquet(path: Path, columns: dict) -> None:
    parquet.write_table(
        pyarrow.table(
            {name: pyarrow.array(values, from_pandas=True) for name, values in columns.items()}
        ),
        path,
    )


def save_hdf5(path: Path, columns: dict, group: str = "/") -> None:
    with h5py.File(path, "a") as file:
        for name, values in columns.items():
            file.require_group(group)[name] = values


def save_mat(path: Path, columns: dict) -> None:
    scipy.io.savemat(path, columns)


def with_table(folder: Path, suffix: str) -> Path:
    return make(folder, TOML.replace(".csv", suffix))


SAVERS = {".parquet": save_parquet, ".h5": save_hdf5, ".hdf5": save_hdf5, ".mat": save_mat}


@pytest.mark.parametrize("suffix", SAVERS)
def test_other_formats_give_the_same_campaign(tmp_path, suffix):
    folder = with_table(tmp_path / "other", suffix)
    for name in "ab":
        SAVERS[suffix](folder / f"{name}{suffix}", table_columns())
    assert_same(read_campaign(make(tmp_path / "csv")), read_campaign(folder))


def test_parquet_null_and_integer(tmp_path):
    folder = with_table(tmp_path, ".parquet")
    for name in "ab":
        columns = table_columns() | {"t": np.arange(4), "wx": [None, 1, 2, 3], "mode": list("abcd")}
        save_parquet(folder / f"{name}.parquet", columns)
    slew = read_campaign(folder).slews[0]
    assert slew.time.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert np.isnan(slew.rate[:, 0]).tolist() == [True, False, False, False]


@pytest.mark.parametrize("suffix", [".h5", ".parquet"])
def test_nans_of_any_kind_are_missing_readings(tmp_path, suffix):
    """A bit that flips can make a NaN of which every calculation would warn."""
    folder = with_table(tmp_path, suffix)
    for name in "ab":
        columns = table_columns()
        columns["wx"] = columns["wx"].copy()
        columns["wx"].view(np.int64)[1] = 0x7FF0_0000_0000_0001
        SAVERS[suffix](folder / f"{name}{suffix}", columns)
    rate = read_campaign(folder).slews[0].rate
    assert np.isnan(rate[:, 0]).tolist() == [False, True, False, False]


def test_groups_and_structs(tmp_path):
    """One HDF5 or MAT file may hold all slews, each in the group (struct) of its name; a lone group
    needs no name.
    """
    expected = read_campaign(make(tmp_path / "csv"))
    folder = make(tmp_path / "h5", TOML.replace("a.csv", "all.h5").replace("b.csv", "all.h5"))
    for group in ("first", "second"):
        save_hdf5(folder / "all.h5", table_columns(), f"logs/{group}")
    assert_same(expected, read_campaign(folder))
    folder = make(tmp_path / "mat", TOML.replace("a.csv", "all.mat").replace("b.csv", "all.mat"))
    save_mat(folder / "all.mat", {"first": table_columns(), "second": table_columns()})
    assert_same(expected, read_campaign(folder))
    folder = with_table(tmp_path / "v73", ".mat")
    for name in "ab":
        save_hdf5(
            folder / f"{name}.mat", {k: v[None, :] for k, v in table_columns().items()}, "anything"
        )
    assert_same(expected, read_campaign(folder))


def test_groups_that_cannot_be_told_apart(tmp_path):
    folder = with_table(tmp_path, ".h5")
    for group in ("x", "y"):
        save_hdf5(folder / "a.h5", table_columns(), group)
    shutil.copy(folder / "a.h5", folder / "b.h5")
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, ["a.h5", "/x, /y"])


COLUMN = table_columns()


@pytest.mark.parametrize(
    ("suffix", "changes", "named"),
    [(suffix, *row[1:]) for suffix, row in BINARY_CASES],
    ids=[f"{s} {r[0]}" for s, r in BINARY_CASES],
)
def test_bad_binary_tables(tmp_path, suffix, changes, named):
    folder = with_table(tmp_path, suffix)
    for name in "ab":
        SAVERS[suffix](
            folder / f"{name}{suffix}",
            {k: v for k, v in (COLUMN | changes).items() if v is not None},
        )
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, [f"a{suffix}", *named])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"wx": np.zeros(3)}, ["column wx", "3 rows"]),
        ({"wx": np.zeros((4, 2))}, ["column wx", "(4, 2)"]),
    ],
    ids=["rows", "matrix"],
)
@pytest.mark.parametrize("suffix", [".h5", ".mat"])
def test_datasets_that_are_no_columns(tmp_path, suffix, changes, named):
    folder = with_table(tmp_path, suffix)
    for name in "ab":
        SAVERS[suffix](folder / f"{name}{suffix}", COLUMN | changes)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, [f"a{suffix}", *named])


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not a table\n" * 100,
        b"MATLAB 5.0 MAT-file" + bytes(200),
        b"\x89HDF\r\n\x1a\n" + bytes(99),
        b"PAR1" + bytes(50) + b"PAR1",
    ],
)
@pytest.mark.parametrize("suffix", [".parquet", ".h5", ".mat"])
def test_damaged_binary_tables(tmp_path, suffix, content):
    folder = with_table(tmp_path, suffix)
    for name in "ab":
        (folder / f"{name}{suffix}").write_bytes(content)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert caught.value.where.startswith(str(folder / f"a{suffix}"))
    assert caught.value.advice


def test_a_table_that_ends_the_process_of_its_library(tmp_path):
    folder = with_table(tmp_path, ".mat")
    for name in "ab":
        shutil.copy(Path(__file__).parents[1] / "data/damaged.mat", folder / f"{name}.mat")
    with pytest.raises(CampaignError, match=r"a\.mat: cannot be read as a MAT file"):
        read_campaign(folder)


@pytest.mark.parametrize("soft", [False, True], ids=["external", "through a soft link"])
def test_hdf5_links_may_not_leave_the_file(tmp_path, soft):
    save_hdf5(tmp_path / "outside.h5", COLUMN)
    folder = with_table(tmp_path / "campaign", ".h5")
    for name in "ab":
        save_hdf5(folder / f"{name}.h5", {k: v for k, v in COLUMN.items() if k != "wx"})
        with h5py.File(folder / f"{name}.h5", "a") as file:
            file["elsewhere" if soft else "wx"] = h5py.ExternalLink(
                str(tmp_path / "outside.h5"), "/wx"
            )
            if soft:
                file["wx"] = h5py.SoftLink("/elsewhere")
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, ["a.h5, column wx", "links to another file"])
