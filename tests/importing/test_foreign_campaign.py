"""A campaign written as raw logs of another mission comes back with the native numbers."""

from __future__ import annotations

import importlib
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.app.cli import main
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.importing.import_logs import import_logs

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """The example campaign as raw logs, by how the star tracker writes."""
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(ROOT))
        write = importlib.import_module("analyses.imports.foreign_logs").write_foreign_logs
    campaign = read_campaign(EXAMPLE)
    return {
        tracker: write(campaign, tmp_path_factory.mktemp(tracker), tracker=tracker)
        for tracker in ("aem", "csv")
    }


@pytest.fixture(scope="module")
def at_rests(logs, tmp_path_factory):
    """The log with the AEM, cut at its rests."""
    foreign = logs["aem"]
    folder = tmp_path_factory.mktemp("cut") / "c"
    return import_logs(foreign.files, foreign.mapping_to_cut, folder)


@pytest.mark.parametrize("tracker", ["aem", "csv"])
def test_the_imported_numbers_are_the_native_ones(logs, tracker, tmp_path):
    foreign = logs[tracker]
    imported = read_campaign(import_logs(foreign.files, foreign.mapping, tmp_path / "c"))
    for native, slew in zip(foreign.native.slews, imported.slews, strict=True):
        assert slew.name == native.name
        assert slew.start == pytest.approx(native.start, abs=1e-9)
        assert slew.angle == pytest.approx(native.angle, rel=1e-12)
        np.testing.assert_allclose(slew.axis_B, native.axis_B, rtol=1e-12)
        np.testing.assert_allclose(slew.time, native.time, rtol=0.0, atol=1e-9)
        for channel in ("rate", "wheel_torque", "wheel_momentum", "attitude"):
            np.testing.assert_allclose(
                getattr(slew, channel), getattr(native, channel), rtol=1e-12, atol=1e-16
            )
    assert imported.inertia == foreign.native.inertia
    assert imported.rate_sensor == foreign.native.rate_sensor
    assert imported.star_tracker == foreign.native.star_tracker


def test_units_and_senses_stay_those_of_the_mapping(logs, tmp_path):
    """What doctor says of a key of campaign.toml then holds for the same key of the mapping."""
    foreign = logs["csv"]
    folder = import_logs(foreign.files, foreign.mapping, tmp_path / "c").folder
    columns = tomllib.loads((folder / "campaign.toml").read_text())["columns"]
    assert columns["rate"]["unit"] == "deg/s"
    assert columns["wheel_torque"]["unit"] == "mN m"
    assert columns["wheel_torque"]["acts_on"] == "body"
    assert columns["wheel_speed"]["unit"] == "rpm"
    assert columns["attitude"]["scalar"] == "first"
    assert columns["attitude"]["maps"] == "body_to_inertial"
    raw = foreign.files[0].read_text().splitlines()[1].split(",")
    first = (folder / "slew_01_rate.csv").read_text().splitlines()[1].split(",")
    assert [float(x) for x in first[1:]] == pytest.approx([float(x) for x in raw[1:]], rel=1e-14)


def test_doctor_quotes_the_line_of_the_mapping(logs, tmp_path, capsys):
    foreign, line = logs["csv"], 'maps = "inertial_to_body"'
    wrong = tmp_path / "mapping.toml"
    text = foreign.mapping.read_text().replace('maps = "body_to_inertial"', line)
    wrong.write_text(text)
    folder = import_logs(foreign.files, wrong, tmp_path / "c").folder
    with pytest.raises(SystemExit) as stop:
        main(["doctor", str(folder)])
    assert stop.value.code == 2
    quoted = f"mapping.toml, line {text.splitlines().index(line) + 1}: {line}"
    assert quoted in capsys.readouterr().out


def test_a_wrong_offset_is_seen_by_that_comparison(logs, tmp_path):
    foreign = logs["csv"]
    wrong = tmp_path / "mapping.toml"
    wrong.write_text(foreign.mapping.read_text().replace("offset_s = -0.75", "offset_s = 0.25"))
    imported = read_campaign(import_logs(foreign.files, wrong, tmp_path / "c").folder)
    native = foreign.native.slews[0]
    assert not np.array_equal(imported.slews[0].fixes[: len(native.time)], native.fixes)


def test_the_log_is_cut_at_its_rests(logs, at_rests):
    foreign, imported = logs["aem"], at_rests
    campaign = read_campaign(imported)
    assert len(campaign.slews) == len(foreign.native.slews)
    for native, slew, window in zip(
        foreign.native.slews, campaign.slews, imported.cut.windows, strict=True
    ):
        moving = np.linalg.norm(native.rate, axis=1) > 10 * native.rate[:20].std()
        start, end = native.start + native.time[[moving.argmax(), -moving[::-1].argmax() - 1]]
        assert window.motion[0] == pytest.approx(start, abs=3.0)
        assert end - 3.0 < window.motion[1] < end + 30.0  # the slew settles first
        assert window.turned == pytest.approx(native.angle, rel=0.05)
        assert 8.0 <= window.motion[0] - window.start < 20.0
        fixes = slew.start + slew.time[slew.fixes]
        assert (fixes < window.motion[0]).sum() >= 3
        assert (fixes > window.motion[1]).sum() >= 3
    assert {part.reason for part in imported.cut.dropped} == {"rest that no slew needs"}


def test_the_noise_of_the_rests_is_that_of_the_sensors(at_rests):
    seen = {noise.key: noise for noise in at_rests.noises}
    assert set(seen) == {
        "rate_sensor.sigma",
        "star_tracker.sigma_cross",
        "star_tracker.sigma_roll",
        *(f"wheels.wheel_{axis}.momentum_sigma" for axis in "xyz"),
    }
    for noise in seen.values():
        for fit, stated in zip(noise.fits, noise.stated, strict=True):
            # Five standard errors, and the two digits of the example's own sigmas.
            assert abs(np.log(fit.white / stated)) < 5.0 * fit.white_error + 0.02
        assert not noise.differs


def test_a_missing_noise_is_quoted_and_not_taken(logs, tmp_path):
    foreign = logs["csv"]
    mapping = tmp_path / "mapping.toml"
    text = foreign.mapping_to_cut.read_text()
    mapping.write_text(text.replace("sigma = [2e-05, 2e-05, 2e-05]", ""))
    with pytest.raises(CampaignError, match=r"rate_sensor\.sigma: missing key.*sigma = 2e-05"):
        import_logs(foreign.files, mapping, tmp_path / "c")
    assert not (tmp_path / "c").exists()


def test_a_folder_is_never_overwritten(logs, at_rests):
    folder = at_rests.folder
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    foreign = logs["aem"]
    import_logs(foreign.files, foreign.mapping_to_cut, folder)  # the same import, the same bytes
    with pytest.raises(OutputError, match="would overwrite another campaign"):
        import_logs(foreign.files, foreign.mapping, folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_the_record_names_what_was_read_and_cut(logs, at_rests):
    foreign, folder = logs["aem"], at_rests.folder
    record = json.loads((folder / "import.json").read_text())
    assert record["format"] == "bayes-inertia-import/1"
    assert set(record["raw_files"]) == {path.name for path in foreign.files}
    assert record["clock"]["zero"] == "2026-03-01T12:00:00Z"
    campaign = read_campaign(folder)
    assert campaign.mission == (("epoch", "2026-03-01T12:00:00Z"),)
    assert campaign.begin_utc == str(
        np.datetime64("2026-03-01T12:00:00.000")
        + np.timedelta64(round(1e3 * campaign.span[0]), "ms")
    )
    assert [slew["name"] for slew in record["cut"]["slews"]] == [f"slew {k}" for k in range(1, 6)]
    assert "slew 3" in (folder / "slews.svg").read_text()
