"""The recipe for SPICE: a CK that SPICE itself writes is read back as the same attitudes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bayes_inertia.maths.quaternion import to_body
from bayes_inertia.tables.raw_files import read_raw
from bayes_inertia.tables.time_stamps import times_to_seconds

spiceypy = pytest.importorskip("spiceypy")

SCRIPT = Path(__file__).parents[2] / "docs" / "how_to" / "spice_ck.py"
SPACECRAFT = -82
STRUCTURE = -82000
SECONDS = 0.25 * np.arange(40)
START = "2024-05-01T00:00:00"
LEAP_SECONDS = """KPL/LSK
\\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K = 1.657D-3
DELTET/EB = 1.671D-2
DELTET/M = ( 6.239996D0 1.99096871D-7 )
DELTET/DELTA_AT = ( 36, @2015-JUL-1, 37, @2017-JAN-1 )
"""
# A clock of 1/1000 s that begins in 2024.
CLOCK = """KPL/SCLK
\\begindata
SCLK_KERNEL_ID = ( @2024-01-01 )
SCLK_DATA_TYPE_82 = ( 1 )
SCLK01_TIME_SYSTEM_82 = ( 2 )
SCLK01_N_FIELDS_82 = ( 2 )
SCLK01_MODULI_82 = ( 4294967296 1000 )
SCLK01_OFFSETS_82 = ( 0 0 )
SCLK01_OUTPUT_DELIM_82 = ( 1 )
SCLK_PARTITION_START_82 = ( 0 )
SCLK_PARTITION_END_82 = ( 4.0E+12 )
SCLK01_COEFFICIENTS_82 = ( 0 757382400 1 )
"""


def matrices() -> np.ndarray:
    """From the CK's frame to the structure, (rows, 3, 3): a turn about an axis that is no one's."""
    axis = np.array([0.48, -0.6, 0.64])
    return np.array([spiceypy.axisar(axis, 0.3 + 0.02 * t).T for t in SECONDS])


@pytest.fixture(params=[1, 3])
def kernels(request, tmp_path):
    """Leap seconds, clock, and a CK of type 1 or 3 relative to the ecliptic of J2000."""
    leaps, clock, attitude = (tmp_path / name for name in ("a.tls", "a.tsc", "a.bc"))
    leaps.write_text(LEAP_SECONDS)
    clock.write_text(CLOCK)
    spiceypy.furnsh([str(leaps), str(clock)])
    first = spiceypy.str2et(START)
    ticks = np.array([spiceypy.sce2c(SPACECRAFT, first + t) for t in SECONDS])
    quaternions = np.array([spiceypy.m2q(C) for C in matrices()])
    handle = spiceypy.ckopn(str(attitude), "test", 0)
    named = (ticks[0], ticks[-1], STRUCTURE, "ECLIPJ2000", False, "test", len(ticks))
    rows = (ticks, quaternions, np.zeros((len(ticks), 3)))
    if request.param == 1:
        spiceypy.ckw01(handle, *named, *rows)
    else:
        spiceypy.ckw03(handle, *named, *rows, 1, ticks[:1])
    spiceypy.ckcls(handle)
    spiceypy.kclear()
    return [str(path) for path in (attitude, clock, leaps)]


def written(kernels: list[str], structure: int, out: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, str(SCRIPT), str(out), str(structure), *kernels]
    # SPICE reads no path of more than 80 letters out of a meta-kernel: names are relative.
    return subprocess.run(words, capture_output=True, text=True, check=False, cwd=out.parent)


def test_attitudes_of_a_ck_are_read_as_spice_says_them(tmp_path, kernels):
    out = tmp_path / "tracker.aem"
    assert written(kernels, STRUCTURE, out).returncode == 0
    table = read_raw(out)
    assert (table.attitude.maps, table.attitude.scalar) == ("inertial_to_body", "last")
    axes_N = np.eye(3)
    of_equator = spiceypy.pxform("J2000", "ECLIPJ2000", 0.0)
    for q, to_structure in zip(table.stack(table.attitude.names), matrices(), strict=True):
        expected = (to_structure @ of_equator @ axes_N).T
        np.testing.assert_allclose(to_body(np.tile(q, (3, 1)), axes_N), expected, atol=1e-11)
    time = times_to_seconds(table, table.time_names, table.time_kind).ns * 1e-9
    np.testing.assert_allclose(time - time[0], SECONDS, atol=2e-6)
    assert table.columns["EPOCH"].values[0].startswith(START)


def test_a_meta_kernel_names_the_others(tmp_path, kernels):
    meta = tmp_path / "all.tm"
    listed = ", ".join(f"'{Path(path).name}'" for path in kernels)
    meta.write_text(f"KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( {listed} )\n")
    out, of_each = tmp_path / "meta.aem", tmp_path / "each.aem"
    assert written([str(meta)], STRUCTURE, out).returncode == 0
    assert written(kernels, STRUCTURE, of_each).returncode == 0
    assert out.read_text() == of_each.read_text()


def test_a_kernel_that_is_missing_is_said_in_words(tmp_path, kernels):
    done = written([*kernels[:1], str(tmp_path / "none.tsc")], STRUCTURE, tmp_path / "a.aem")
    assert done.returncode == 1
    assert done.stderr.startswith("SPICE says: ")
    assert "none.tsc" in done.stderr


def test_a_structure_that_the_ck_does_not_hold_is_said(tmp_path, kernels):
    done = written(kernels, -82001, tmp_path / "tracker.aem")
    assert done.returncode == 1
    assert "no attitudes of -82001" in done.stderr
