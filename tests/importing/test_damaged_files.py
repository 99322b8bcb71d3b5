"""Damaged files: whatever is wrong with one, a CampaignError comes out and nothing else."""

from __future__ import annotations

import contextlib
import json

import h5py
import numpy as np
import pyarrow as pa
import pytest
import scipy.io
from pyarrow import parquet

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.raw_files import read_raw, tables_in
from bayes_inertia.tables.time_stamps import times_to_seconds

ROWS = 12
TIME = np.arange(ROWS) * 0.25
DATA = np.random.default_rng(6).normal(size=(ROWS, 4))
STAMPS = [f"2024-05-01T00:00:{t:06.3f}Z" for t in TIME]

CSV = "# head\nt;w;mode;stamp\ns;deg/s;;\n" + "".join(
    f"{t};{w:.9f};SLEW;{stamp}\n".replace(".", ",", 2)
    for t, w, stamp in zip(TIME, DATA[:, 0], STAMPS, strict=True)
)
AEM = (
    "CCSDS_AEM_VERS = 1.0\nMETA_START\nREF_FRAME_A = ICRF\nREF_FRAME_B = SC_BODY\n"
    "ATTITUDE_DIR = A2B\nTIME_SYSTEM = UTC\nATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = LAST\n"
    "META_STOP\nDATA_START\n"
    + "".join(f"{s[:-1]} {' '.join(map(str, q))}\n" for s, q in zip(STAMPS, DATA, strict=True))
    + "DATA_STOP\n"
)
XML = (
    '<aem id="CCSDS_AEM_VERS" version="2.0"><body><segment><metadata><REF_FRAME_A>ICRF'
    "</REF_FRAME_A><REF_FRAME_B>SC_BODY</REF_FRAME_B><TIME_SYSTEM>UTC</TIME_SYSTEM>"
    "<ATTITUDE_TYPE>QUATERNION</ATTITUDE_TYPE></metadata><data>"
    + "".join(
        f"<attitudeState><quaternionEphemeris><EPOCH>{s[:-1]}</EPOCH><quaternion><Q1>{q[0]}</Q1>"
        f"<Q2>{q[1]}</Q2><Q3>{q[2]}</Q3><QC>{q[3]}</QC></quaternion></quaternionEphemeris>"
        "</attitudeState>"
        for s, q in zip(STAMPS, DATA, strict=True)
    )
    + "</data></segment></body></aem>"
)
JSON = "".join(
    json.dumps({"t": t, "w": list(w), "s": s}) + "\n"
    for t, w, s in zip(TIME, DATA, STAMPS, strict=True)
)
PLAIN = "".join(f"{t:f} {w:e}\n" for t, w in zip(TIME, DATA[:, 0], strict=True))
TEXTS = {"log.csv": CSV, "t.aem": AEM, "t.xml": XML, "log.jsonl": JSON, "c.42": PLAIN}


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """The bytes with a few of them changed, cut out, doubled or moved."""
    made = bytearray(data)
    for _ in range(random.integers(1, 5)):
        start, size = int(random.integers(len(made))), int(random.integers(1, 30))
        part = made[start : start + size]
        kind = random.integers(5)
        if kind == 0:
            made[start : start + 1] = random.bytes(1)
        elif kind == 1:
            made[start : start + size] = b""
        elif kind == 2:
            made[start:start] = part
        elif kind == 3:
            made[start : start + size] = random.bytes(size)
        else:
            made[int(random.integers(len(made))) :] = b""
        made = made or bytearray(b"\n")
    return bytes(made)


def use(file) -> bool:
    """Read all that a file holds, as an import would; whether that went well."""
    try:
        tables = [read_raw(file, table=name) for name in tables_in(file)]
    except CampaignError:
        return False
    for table in tables:
        assert all(c.values.size == table.rows for c in table.columns.values())
        for name in table.columns:
            with contextlib.suppress(CampaignError):
                table.numbers(name)
            for kind in ("s", "utc", "unix_s", "jd_utc"):
                with contextlib.suppress(CampaignError):
                    times_to_seconds(table, [name], kind)
    return True


@pytest.mark.parametrize("name", TEXTS)
def test_damaged_text(tmp_path, name):
    random = np.random.default_rng(7)
    file = tmp_path / name
    data = TEXTS[name].encode()
    file.write_bytes(data)
    assert use(file)
    results = []
    for _ in range(80):
        file.write_bytes(damaged(data, random))
        results.append(use(file))
    # Some damage does not show; if none ever did, nothing would have been tested.
    assert 0 < sum(results) < len(results)


def write_binary(file) -> None:
    if file.suffix == ".npz":
        np.savez(file, t=TIME, w=DATA, s=np.array(STAMPS))
    elif file.suffix == ".npy":
        np.save(file, DATA)
    elif file.suffix == ".parquet":
        parquet.write_table(pa.table({"t": TIME, "w": DATA.tolist(), "s": STAMPS}), file)
    elif file.suffix == ".mat":
        scipy.io.savemat(file, {"log": {"t": TIME, "w": DATA}})
    else:
        with h5py.File(file, "w") as store:
            store["t"], store["w"] = TIME, DATA


@pytest.mark.parametrize(
    ("suffix", "times"), [("npz", 60), ("npy", 60), ("parquet", 60), ("h5", 1), ("mat", 1)]
)
def test_damaged_binary(tmp_path, suffix, times):
    random = np.random.default_rng(8)
    file = tmp_path / f"log.{suffix}"
    write_binary(file)
    data = file.read_bytes()
    assert times == 1 or use(file)  # test_array_files reads sound files of the slow formats.
    results = []
    for _ in range(times):
        file.write_bytes(damaged(data, random))
        results.append(use(file))
    assert sum(results) < len(results)
