"""Logs of a slow sensor that was polled faster: noise and cuts count each reading once."""

from __future__ import annotations

import numpy as np
import pytest
from support.raw_logs import NOISE, STEP, edited_mapping, log_columns, write_csv

from bayes_inertia.importing.import_logs import import_logs

RATES, FIX = ("wx", "wy", "wz"), ("q1", "q2", "q3", "q4")
TURNS = [(60.0, 20.0, 0.5), (150.0, 20.0, 0.7)]


def imported(folder, names, factor: int):
    """The import of a log in which some columns stand `factor` times."""
    columns = log_columns(TURNS, 240.0)
    rng = np.random.default_rng(4)
    for name in FIX:
        columns[name] = columns[name] + 1e-6 * rng.normal(size=len(columns[name]))
    kept = np.arange(len(columns["t_ms"])) // factor * factor
    columns |= {name: columns[name][kept] for name in names}
    log = write_csv(folder / "log.csv", columns)
    return import_logs([log], edited_mapping(folder), folder / f"c{factor}")


@pytest.mark.parametrize("factor", [2, 5])
def test_held_rates_count_once(tmp_path, factor):
    result = imported(tmp_path, RATES, factor)
    rate = result.logs.streams["rate"]
    assert rate.step == pytest.approx(factor * STEP)
    assert any("each reading stands" in note for note in rate.notes)
    (noise,) = [n for n in result.noises if n.key == "rate_sensor.sigma"]
    assert noise.seen == pytest.approx([NOISE] * 3, rel=0.25)
    assert {(d.kind, d.channel) for d in result.campaign.dirt} >= {("duplicate", "rate")}
    table = (result.folder / "slew_01_rate.csv").read_text().splitlines()
    written = len(result.campaign.slews[0].time)
    assert len(table) - 1 == pytest.approx(written, abs=1)


def test_held_fixes_count_once(tmp_path):
    result = imported(tmp_path, FIX, 4)
    fixes = sum(slew.fixes.sum() for slew in result.campaign.slews)
    assert result.logs.streams["attitude"].step == pytest.approx(4 * STEP)
    assert fixes <= len(result.logs.streams["attitude"].time) + len(result.campaign.slews)
    (window, *_) = result.cut.windows
    assert window.fixes is not None
    assert window.fixes[0] == pytest.approx((window.motion[0] - window.start) / (4 * STEP), abs=2)


def test_commands_are_held_by_nature(tmp_path):
    result = imported(tmp_path, ("torque",), 4)
    assert not [d for d in result.campaign.dirt if d.kind == "duplicate"]
    assert result.logs.streams["wheel_torque"].step == pytest.approx(STEP)
