"""Without an extra: one sentence on what is missing, where, and what installs it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from test_package import PROJECT

from bayes_inertia.app.many_folder import fit_many
from bayes_inertia.campaign.environment import with_orbit
from bayes_inertia.errors import BayesInertiaError, OutputError
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.tables.raw_files import read_raw

EXTRAS = PROJECT["project"]["optional-dependencies"]
LINE_1 = "1 25544U 98067A   20336.50000000  .00000000  00000-0  00000-0 0    08"
LINE_2 = "2 25544  51.6000  10.0000 0001000  10.0000  10.0000 15.49000000    05"


def orbit(folder: Path) -> None:
    (folder / "orbit.tle").write_text(f"{LINE_1}\n{LINE_2}\n")
    with_orbit(small_campaign(), folder / "orbit.tle", "2020-12-01")


def table(name: str, head: bytes):
    def read(folder: Path) -> None:
        (folder / name).write_bytes(head)
        read_raw(folder / name)

    return read


@pytest.mark.parametrize(
    ("module", "extra", "place", "task"),
    [
        ("sgp4.api", "orbit", "orbit.tle", orbit),
        ("pyulog.core", "logs", "log.ulg", table("log.ulg", b"ULog\x01\x12\x35\x01\0\0")),
        ("rosbags.highlevel", "logs", "log.bag", table("log.bag", b"#ROSBAG V2.0\n")),
        ("pyarrow.parquet", "parquet", "log.parquet", table("log.parquet", b"PAR1")),
    ],
)
def test_what_is_missing_where_and_what_installs_it(
    tmp_path, monkeypatch, module, extra, place, task
):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(BayesInertiaError) as error:
        task(tmp_path)
    package = module.partition(".")[0]
    assert error.value.what == f"needs the package {package}, which is not installed"
    assert error.value.where.endswith(place)
    assert f"pip install 'bayes-inertia[{extra}]'" in error.value.advice
    assert any(line.startswith(package) for line in EXTRAS[extra])


def test_many_fits_are_refused_before_the_first_of_them(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(OutputError, match=r"fits\.parquet.*bayes-inertia\[parquet\]"):
        fit_many(tmp_path / "none", tmp_path / "out")
    assert not (tmp_path / "out").exists()
