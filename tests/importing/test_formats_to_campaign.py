"""One log in every format becomes the same campaign, bit for bit."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray as xr
from support.raw_logs import edited_mapping, log_columns, write_csv

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.importing.import_logs import import_logs

COLUMNS = log_columns([(40.0, 30.0, 0.5)], 110.0)


def _semicolons(path: Path) -> None:
    """As spreadsheets of many countries write it: UTF-16, semicolons, decimal commas."""
    rows = zip(*(values.tolist() for values in COLUMNS.values()), strict=True)
    lines = [";".join(COLUMNS), *(";".join(map(repr, row)).replace(".", ",") for row in rows)]
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-16")


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name, values in COLUMNS.items():
            file[f"adcs/{name}"] = values


def _json_lines(path: Path) -> None:
    rows = zip(*(values.tolist() for values in COLUMNS.values()), strict=True)
    lines = (json.dumps(dict(zip(COLUMNS, row, strict=True))) for row in rows)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


WRITERS = {
    "log.txt": _semicolons,
    "log.parquet": lambda path: pd.DataFrame(COLUMNS).to_parquet(path),
    "log.h5": _hdf5,
    "log.nc": lambda path: xr.Dataset({n: ("row", v) for n, v in COLUMNS.items()}).to_netcdf(path),
    "log.mat": lambda path: scipy.io.savemat(path, {"adcs": COLUMNS}),
    "log.npz": lambda path: np.savez(path, **COLUMNS),
    "log.jsonl": _json_lines,
}


@pytest.fixture(scope="module")
def from_csv(tmp_path_factory):
    folder = tmp_path_factory.mktemp("csv")
    log = write_csv(folder / "log.csv", COLUMNS)
    import_logs([log], edited_mapping(folder), folder / "c")
    return read_campaign(folder / "c")


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_campaign(name, from_csv, tmp_path):
    WRITERS[name](tmp_path / name)
    changes = [("log*.csv", name)]
    if name.endswith((".h5", ".mat")):
        changes.append((f'files = ["{name}"]', f'files = ["{name}"]\ntable = "adcs"'))
    import_logs([tmp_path / name], edited_mapping(tmp_path, *changes), tmp_path / "c")
    assert read_campaign(tmp_path / "c") == from_csv
