"""A campaign written in every format that `import` reads comes back with the native numbers."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.campaign.reader import read_campaign

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
ROOT = Path(__file__).parents[2]
# Relative to the largest reading of a channel: 42 prints six decimals.
ALLOWED = {"text of NASA 42": 1e-5}
# One of each kind of file; the others take two seconds each, and their readers have own tests.
QUICK = (
    "CSV of a spreadsheet (semicolons, decimal commas, UTF-16)",
    "HDF5",
    "AEM 1.0 KVN",
    "npz of Basilisk recorders",
    "text of NASA 42",
)


def two_slews():
    """The first slews of the example."""
    campaign = read_campaign(EXAMPLE)
    return replace(campaign, slews=campaign.slews[:2])


@pytest.fixture(scope="module")
def script():
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(ROOT))
        yield importlib.import_module("analyses.imports.formats")


NAMES = [
    "CSV",
    "CSV of a spreadsheet (semicolons, decimal commas, UTF-16)",
    "TSV",
    "Parquet",
    "HDF5",
    "netCDF 4",
    "netCDF 3",
    "MAT 5, structs",
    "MAT 7.3, structs",
    "MAT 5, timeseries saved as structs",
    "AEM 1.0 KVN",
    "AEM 1.0 XML",
    "AEM 2.0 KVN",
    "AEM 2.0 XML",
    "JSON lines",
    "npz of Basilisk recorders",
    "text of NASA 42",
]


def test_every_format_is_tried(script):
    assert list(script.FORMATS) == NAMES


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in NAMES]
)
def test_the_native_numbers_come_back(script, tmp_path, name):
    campaign = two_slews()
    result = script.compared(name, script.FORMATS[name], campaign, tmp_path / "log")
    assert result.time_s < 1e-9
    assert max(result.relative.values()) < ALLOWED.get(name, 1e-12)
    assert [slew.name for slew in result.campaign.slews] == [s.name for s in campaign.slews]


@pytest.mark.slow
def test_a_wrong_unit_and_a_wrong_order_are_seen_by_that_comparison(script, tmp_path):
    campaign = two_slews()
    right = script.FORMATS["CSV"]
    for number, (old, new) in enumerate(
        {'"deg/s"': '"arcmin/s"', 'scalar = "first"': 'scalar = "last"'}.items()
    ):

        def wrong(log, folder, first, old=old, new=new):
            written = right(log, folder, first)
            assert old in written.streams
            return replace(written, streams=written.streams.replace(old, new))

        result = script.compared("wrong", wrong, campaign, tmp_path / str(number))
        assert np.max(list(result.relative.values())) > 0.1
