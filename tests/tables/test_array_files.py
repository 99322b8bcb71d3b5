"""HDF5, netCDF, MAT, NumPy and Parquet, written by the libraries of these formats."""

from __future__ import annotations

import re
import subprocess
import sys

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import scipy.io
import xarray
from pyarrow import parquet

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables import isolated
from bayes_inertia.tables.array_files import FileArrays
from bayes_inertia.tables.array_tables import table_of, tables_of
from bayes_inertia.tables.raw_files import read_raw, tables_in
from bayes_inertia.tables.time_stamps import times_to_seconds

ROWS, FIXES = 40, 9
TIME = np.arange(ROWS) * 0.25
RATE = np.random.default_rng(2).normal(size=(ROWS, 3))
FIX_TIME = np.arange(FIXES) * 1.0
FIX = np.random.default_rng(3).normal(size=(FIXES, 4))
RATES = ["w[0]", "w[1]", "w[2]"]
FIXED = [f"q[{i}]" for i in range(4)]


def check_streams(file, rate: str, fix: str) -> None:
    """Both streams of a file, by their tables and by their columns."""
    assert {rate, fix} <= set(tables_in(file))
    table = read_raw(file, table=rate)
    np.testing.assert_array_equal(table.stack(["t", *RATES]), np.c_[TIME, RATE])
    table = read_raw(file, table=fix)
    np.testing.assert_array_equal(table.stack(["t", *FIXED]), np.c_[FIX_TIME, FIX])
    table = read_raw(file, columns=[f"{rate}.t", f"{rate}.w[1]"])
    np.testing.assert_array_equal(table.numbers(f"{rate}.w[1]"), RATE[:, 1])


def test_hdf5(tmp_path):
    file = tmp_path / "log.h5"
    with h5py.File(file, "w") as store:
        gyro = store.create_group("gyro")
        gyro["t"] = TIME
        gyro["t"].attrs["units"] = "s"
        gyro.create_dataset("w", data=RATE, compression="gzip")
        gyro["w"].attrs["unit"] = np.bytes_("deg/s")
        gyro["mode"] = ["SLEW"] * ROWS
        gyro["stored"] = RATE[:, 0].astype("f4")
        gyro["ns"] = (TIME * 1e9).astype("i8") + 2**60
        store["tracker/t"] = FIX_TIME
        store["tracker/q"] = FIX
        store["records"] = np.array(
            list(zip(TIME, range(ROWS), strict=True)), dtype=[("t", ">f8"), ("count", "u2")]
        )
    check_streams(file, "gyro", "tracker")
    table = read_raw(file, table="gyro")
    assert (table.columns["t"].unit, table.columns["w[0]"].unit) == ("s", "deg/s")
    assert table.columns["stored"].single
    assert table.columns["mode"].values.tolist() == ["SLEW"] * ROWS
    assert table.columns["ns"].values[1] == 2**60 + 250_000_000
    assert read_raw(file, table="records").numbers("count").tolist() == list(range(ROWS))
    with pytest.raises(CampaignError, match=r'differ in length.*or "gyro" or "records"'):
        read_raw(file)
    with pytest.raises(CampaignError, match=r"no table 'gyr'; the file has .*gyro"):
        read_raw(file, table="gyr")


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_netcdf(tmp_path, engine):
    file = tmp_path / "log.nc"
    data = xarray.Dataset(
        {
            "w": (("row", "axis"), RATE, {"units": "rad/s"}),
            "count": ("row", np.arange(ROWS) * 0.5, {"units": "mN m"}),
            "q": (("fix", "part"), FIX),
            "tq": ("fix", FIX_TIME, {"units": "s"}),
        },
        coords={"t": ("row", TIME, {"units": "seconds since 2024-01-01 00:00:00"})},
    )
    packed = {"count": {"dtype": "i2", "scale_factor": 0.5, "add_offset": 3.0, "_FillValue": -99}}
    data.to_netcdf(file, engine=engine, encoding=packed)
    assert tables_in(file) == [f"[{ROWS} rows]", f"[{FIXES} rows]"]
    table = read_raw(file, table=f"[{ROWS} rows]")
    np.testing.assert_array_equal(table.stack(RATES), RATE)
    np.testing.assert_array_equal(table.numbers("count"), np.arange(ROWS) * 0.5)
    assert (table.columns["w[0]"].unit, table.columns["count"].unit) == ("rad/s", "mN m")
    stamps = times_to_seconds(table, ["t"], "utc")
    np.testing.assert_array_equal(stamps.seconds_since(stamps.first_ns), TIME)
    fixes = read_raw(file, columns=["tq", *FIXED])
    np.testing.assert_array_equal(fixes.stack(FIXED), FIX)


def test_mat_of_version_5(tmp_path):
    file = tmp_path / "log.mat"
    streams = {"gyro": {"t": TIME, "w": RATE}, "tracker": {"t": FIX_TIME, "q": FIX.T}}
    simulink = {"time": TIME[:, None], "signals": {"values": RATE.T[None], "label": "w"}}
    saved = {"Time": TIME, "Data": RATE, "DataInfo": {"Units": "rad/s"}}
    slews = np.empty(2, dtype=object)
    slews[:] = [{"t": TIME, "w": RATE}, {"t": TIME + 1, "w": RATE}]
    scipy.io.savemat(file, {**streams, "log": simulink, "ts": saved, "slews": slews})
    check_streams(file, "gyro", "tracker")
    table = read_raw(file, table="log")
    np.testing.assert_array_equal(table.stack([f"signals.values[{i}]" for i in range(3)]), RATE)
    assert read_raw(file, table="ts").columns["Data[2]"].unit == "rad/s"
    assert read_raw(file, table="slews(2)").numbers("t")[0] == 1.0


def test_mat_of_version_7_3(tmp_path):
    """As MATLAB writes it: matrices transposed, structs as groups, cells and objects."""
    file = tmp_path / "log.mat"
    with h5py.File(file, "w", userblock_size=512) as store:
        for group, arrays in {
            "gyro": {"t": TIME, "w": RATE},
            "tracker": {"t": FIX_TIME, "q": FIX},
        }.items():
            made = store.create_group(group)
            made.attrs["MATLAB_class"] = np.bytes_("struct")
            for name, values in arrays.items():
                made[name] = np.atleast_2d(values.T)
                made[name].attrs["MATLAB_class"] = np.bytes_("double")
        store["ts"] = np.zeros((1, 6), dtype="u4")
        store["ts"].attrs["MATLAB_class"] = np.bytes_("timeseries")
        store["ts"].attrs["MATLAB_object_decode"] = np.int32(3)
    with file.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124, b" ") + b"\x00\x02IM")
    check_streams(file, "gyro", "tracker")
    (note,) = read_raw(file, table="gyro").notes
    assert re.fullmatch(r"ts is a MATLAB timeseries object( \(mat-io .*\))? and was not read", note)


def test_a_closed_object_alone_says_how_to_open_it(tmp_path):
    with pytest.raises(CampaignError, match=r"was not read; save it as a struct: s ="):
        table_of(FileArrays(closed={"ts": "a MATLAB timeseries object"}), "a.mat")


def test_numpy_of_a_basilisk_recorder(tmp_path):
    file = tmp_path / "recorder.npz"
    times = (TIME * 1e9).astype(np.uint64) + np.uint64(2**60)
    np.savez(file, times=times, sigma_BN=RATE, dcm=np.tile(np.eye(3), (ROWS, 1, 1)), note="demo")
    table = read_raw(file)
    np.testing.assert_array_equal(table.stack([f"sigma_BN[{i}]" for i in range(3)]), RATE)
    assert table.numbers("dcm[1,1]").tolist() == [1.0] * ROWS
    stamps = times_to_seconds(table, ["times"], "ns")
    np.testing.assert_array_equal(stamps.seconds_since(stamps.first_ns), TIME)
    single = tmp_path / "one.npy"
    np.save(single, np.c_[TIME, RATE])
    np.testing.assert_array_equal(read_raw(single).numbers("array[1]"), RATE[:, 0])


def test_python_objects_are_never_loaded(tmp_path):
    file = tmp_path / "evil.npz"
    np.savez(file, t=np.array([{}, {}], dtype=object))
    with pytest.raises(CampaignError, match="Python objects"):
        read_raw(file)


def test_parquet(tmp_path):
    file = tmp_path / "log.parquet"
    stamps = pd.date_range("2016-12-31T23:59:55", periods=ROWS, freq="250ms", tz="UTC")
    columns = {
        "t": pa.array(stamps),
        "ns": pa.array(np.arange(ROWS) + 2**60),
        "w": pa.array(RATE.tolist(), pa.list_(pa.float64(), 3)),
        "st": pa.array([{"x": 1.5, "on": True}] * ROWS),
        "mode": pa.array(["SLEW"] * ROWS).dictionary_encode(),
        "gap": pa.array([None, 1.0] * (ROWS // 2)),
        "half": pa.array(RATE[:, 0].astype("f4")),
    }
    fields = [pa.field(n, a.type, metadata={"units": "rad/s"}) for n, a in columns.items()]
    parquet.write_table(pa.table(list(columns.values()), schema=pa.schema(fields)), file)
    table = read_raw(file)
    np.testing.assert_array_equal(table.stack(RATES), RATE)
    assert table.columns["w[0]"].unit == "rad/s"
    assert table.columns["half"].single
    assert table.columns["ns"].values[3] == 2**60 + 3
    assert table.columns["mode"].values[0] == "SLEW"
    assert (table.numbers("st.x")[0], table.numbers("st.on")[0]) == (1.5, 1.0)
    assert np.isnan(table.numbers("gap")).tolist() == [True, False] * (ROWS // 2)
    read = times_to_seconds(table, ["t"], "utc")
    # The leap second at the end of 2016 is a gap of a second in stamps that cannot write it.
    assert np.diff(read.ns).max() == 1_250_000_000


def test_tables_of_different_lengths_are_listed_with_their_rows():
    arrays = {"t": np.zeros(5), "w": np.zeros((3, 5)), "n": np.float64(1.0), "u": np.zeros(7)}
    assert tables_of(arrays) == ["[7 rows]", "[5 rows]"]
    assert list(table_of(FileArrays(arrays), "a.h5", table="[5 rows]").columns) == ["t", *RATES]


def test_links_lead_nowhere(tmp_path):
    other, file = tmp_path / "other.h5", tmp_path / "log.h5"
    for path in (other, file):
        with h5py.File(path, "w") as store:
            store["t"] = TIME
    with h5py.File(file, "a") as store:
        store["far"] = h5py.ExternalLink(str(other), "/t")
    table = read_raw(file)
    assert list(table.columns) == ["t"]
    assert "far is a link to another file" in table.notes[0]
    with h5py.File(file, "a") as store:
        group = store.create_group("g")
        group["inner"] = group
    with pytest.raises(CampaignError, match="contains itself"):
        read_raw(file)


def test_a_file_that_claims_terabytes_is_refused(tmp_path):
    file = tmp_path / "log.h5"
    with h5py.File(file, "w") as store:
        store.create_dataset("t", shape=(10**12,), dtype="f8", chunks=(1000,))
    with pytest.raises(CampaignError, match="claims more data"):
        read_raw(file)


def test_a_reader_that_hangs_or_crashes_ends_in_one_message(tmp_path, monkeypatch):
    file, program = tmp_path / "log.h5", tmp_path / "program"
    file.write_bytes(b"\x89HDF\r\n\x1a\n")
    limited = "import resource; resource.setrlimit(resource.RLIMIT_CPU, (1, 2))\n"
    first_line = f"#!{sys.executable}\n"
    monkeypatch.setattr(sys, "executable", str(program))
    for text, message in {
        limited + "while True: pass": "cannot be read within 3 s",
        "import os; os.kill(os.getpid(), 11)": "ends with status -11",
        "pass": "left nothing",
    }.items():
        program.write_text(first_line + text)
        program.chmod(0o755)
        with pytest.raises(CampaignError, match=message):
            isolated.read_arrays(file, "hdf5")


def test_the_process_of_a_file_imports_little_of_the_package():
    """Its start is what each file costs."""
    code = "import sys, bayes_inertia.tables.isolated; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    loaded = [name for name in done.stdout.split() if name.startswith("bayes_inertia.")]
    parts = ("array_files", "isolated", "limits")
    assert set(loaded) == {
        "bayes_inertia.errors",
        "bayes_inertia.version",
        "bayes_inertia.tables",
        *(f"bayes_inertia.tables.{name}" for name in parts),
    }
    assert not {"h5py", "scipy", "jax", "matplotlib"} & set(done.stdout.split())


def test_a_plain_script_reads_arrays_without_a_main_guard(tmp_path):
    """Processes of a pool would run the script again, and each would start processes."""
    with h5py.File(tmp_path / "log.h5", "w") as store:
        store["t"] = np.arange(5.0)
    script = tmp_path / "script.py"
    script.write_text(
        "from pathlib import Path\n"
        "from bayes_inertia.tables.isolated import read_arrays\n"
        f"print(read_arrays(Path({str(tmp_path / 'log.h5')!r}), 'hdf5').arrays['t'].sum())\n"
    )
    done = subprocess.run([sys.executable, script], check=True, capture_output=True, text=True)
    assert done.stdout == "10.0\n"


@pytest.mark.parametrize("suffix", [".h5", pytest.param(".nc", marks=pytest.mark.slow), ".mat"])
def test_a_file_that_its_writer_holds_says_so(tmp_path, suffix, monkeypatch):
    file = tmp_path / f"log{suffix}"
    with h5py.File(file, "w") as store:
        store["t"] = np.arange(5.0)
        store.flush()
        with pytest.raises(CampaignError, match="another program holds the file; close it there"):
            read_raw(file)
        monkeypatch.setenv("HDF5_USE_FILE_LOCKING", "FALSE")
        assert read_raw(file).numbers("t").tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
