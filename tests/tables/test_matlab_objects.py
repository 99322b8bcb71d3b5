"""MATLAB timeseries, tables and timetables, written by the library that knows their format."""

from __future__ import annotations

import sys
import warnings

import numpy as np
import pandas as pd
import pytest

from bayes_inertia.tables.array_files import FileArrays, read_mat
from bayes_inertia.tables.raw_files import read_raw

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # It sets an option that pandas 3 no longer needs.
    save_to_mat = pytest.importorskip("matio", reason="no wheel for this Python").save_to_mat
    from matio.utils.matclass import MatlabOpaque

TIME = 0.25 * np.arange(8)
RATE = np.random.default_rng(1).normal(size=(8, 3))
NONE = np.zeros((0, 0))


def timeseries(times: dict) -> MatlabOpaque:
    """As MATLAB keeps it: the times in TimeInfo, the readings in Data_."""
    details = MatlabOpaque(times, "tsdata.timemetadata")
    about = MatlabOpaque({"Units": "deg/s"}, "tsdata.datametadata")
    return MatlabOpaque({"Data_": RATE, "TimeInfo": details, "DataInfo": about}, "timeseries")


def regular(**others) -> dict:
    return {
        "Start_": np.array([[0.0]]),
        "Increment_": np.array([[0.25]]),
        "Length": np.array([[8.0]]),
        "Time_": NONE,
    } | others


STORED = {"Start_": NONE, "Increment_": NONE, "Length": np.array([[8.0]])}
SERIES = {
    "regular": regular(),
    "in minutes": regular(Increment_=np.array([[0.25 / 60.0]]), Units="minutes"),
    "stored": STORED | {"Time_": TIME[:, None], "Units": "seconds"},
    "stored in ms": STORED | {"Time_": 1e3 * TIME[:, None], "Units": "milliseconds"},
}


def saved(file, version: str, **variables):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        save_to_mat(str(file), variables, version=version)
    return file


def contents(file) -> FileArrays:
    into = FileArrays(left=10**8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read_mat(str(file), into)
    return into


@pytest.mark.parametrize("version", ["v7", "v7.3"])
@pytest.mark.parametrize("name", SERIES)
def test_a_timeseries_becomes_time_and_data(tmp_path, version, name):
    held = contents(saved(tmp_path / "a.mat", version, gyro=timeseries(SERIES[name])))
    np.testing.assert_allclose(held.arrays["gyro/Time"], TIME, rtol=1e-12)
    np.testing.assert_array_equal(held.arrays["gyro/Data"], RATE)
    assert held.units == {"gyro/Time": "s", "gyro/Data": "deg/s"}
    assert held.closed == {}


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_objects_inside_structs_and_beside_arrays(tmp_path, version):
    file = saved(
        tmp_path / "a.mat",
        version,
        plain=TIME,
        log={"gyro": timeseries(regular()), "note": "demo"},
    )
    held = contents(file)
    np.testing.assert_array_equal(held.arrays["log/gyro/Data"], RATE)
    np.testing.assert_array_equal(held.arrays["plain"].ravel(), TIME)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_tables_and_timetables(tmp_path, version):
    columns = {"wx": RATE[:, 0], "wy": RATE[:, 1]}
    since = pd.DataFrame(columns, index=pd.to_timedelta(TIME, unit="s"))
    dated = pd.DataFrame(columns, index=pd.to_datetime("2026-03-01") + since.index)
    since.index.name = dated.index.name = "Time"
    file = saved(tmp_path / "a.mat", version, since=since, dated=dated, flat=pd.DataFrame(columns))
    held = contents(file)
    for name in ("since", "dated", "flat"):
        np.testing.assert_array_equal(held.arrays[f"{name}/wy"], RATE[:, 1])
    np.testing.assert_allclose(held.arrays["since/Time"], TIME, atol=1e-9)
    assert held.units["since/Time"] == "s"
    dates = held.arrays["dated/Time"].astype("datetime64[ns]") - np.datetime64("2026-03-01", "ns")
    # MATLAB's dates are milliseconds in floats.
    np.testing.assert_allclose(dates / np.timedelta64(1, "s"), TIME, atol=1e-6)


def test_a_table_of_a_raw_log(tmp_path):
    file = saved(tmp_path / "a.mat", "v7", gyro=timeseries(regular()))
    table = read_raw(file, table="gyro")
    assert table.columns["Time"].unit == "s"
    assert table.columns["Data[2]"].unit == "deg/s"
    np.testing.assert_array_equal(table.numbers("Data[1]"), RATE[:, 1])


@pytest.mark.parametrize(
    "times",
    [
        regular(Units="fortnights"),
        regular(Increment_=np.array([[np.nan]])),
        regular(Length=np.array([[5.0]])),
    ],
    ids=["unit", "step", "length"],
)
def test_what_cannot_be_recognised_stays_closed(tmp_path, times):
    held = contents(saved(tmp_path / "a.mat", "v7", gyro=timeseries(times), plain=TIME))
    assert held.closed == {"gyro": "a MATLAB timeseries object"}
    assert list(held.arrays) == ["plain"]


def test_other_classes_stay_closed(tmp_path):
    other = MatlabOpaque({"a": TIME}, "my.sensor")
    held = contents(saved(tmp_path / "a.mat", "v7", gyro=other, plain=TIME))
    assert held.closed == {"gyro": "a MATLAB my.sensor object"}


def test_without_the_library_objects_say_what_opens_them(tmp_path, monkeypatch):
    file = saved(tmp_path / "a.mat", "v7", gyro=timeseries(regular()), plain=TIME)
    monkeypatch.setitem(sys.modules, "matio", None)
    held = contents(file)
    assert held.closed["gyro"].endswith(
        "timeseries object (pip install 'bayes-inertia[matlab]' may open it)"
    )
    assert list(held.arrays) == ["plain"]
