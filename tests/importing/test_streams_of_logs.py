"""Streams keep their rates, frames and wheels on the way from raw files to a campaign."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.campaign_files import assert_teaches
from support.raw_logs import MAPPING, edited_mapping, log_columns, write_csv

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.import_logs import import_logs
from bayes_inertia.importing.logged_stream import LoggedStream, held, in_order

FOLDER = "campaign"


@pytest.fixture
def columns():
    return log_columns([(40.0, 30.0, 0.5)], 110.0)


def campaign_of(tmp_path, files, mapping):
    return read_campaign(import_logs(files, mapping, tmp_path / FOLDER))


def test_rates_of_a_turned_sensor_stay_along_its_axes(tmp_path, columns):
    """K belongs to the sensor's axes, so that the readings must not be rotated."""
    sensor_from_body = Rotation.from_euler("ZYX", [0.4, -0.2, 0.9]).as_matrix()
    names = ["wx", "wy", "wz"]
    body = np.stack([columns[name] for name in names], axis=1)
    columns |= dict(zip(names, (body @ sensor_from_body.T).T, strict=True))
    log = write_csv(tmp_path / "log.csv", columns)
    old = 'unit = "deg/s"\nframe = "body"'
    new = f'unit = "deg/s"\nframe = "sensor"\nmounting = {sensor_from_body.tolist()}'
    campaign = campaign_of(tmp_path, [log], edited_mapping(tmp_path, (old, new)))
    axes = campaign.rate_sensor.axes
    np.testing.assert_allclose(axes, sensor_from_body, atol=1e-15)
    slew = campaign.slews[0]
    back = np.degrees(slew.rate @ axes)  # axes^T w, row by row
    first = round(slew.start / 0.5)
    np.testing.assert_allclose(back, body[first : first + len(slew.time)], atol=1e-12)


def test_attitudes_of_the_tracker_become_those_of_the_body(tmp_path, columns):
    body_from_tracker = Rotation.from_euler("XYZ", [0.3, 1.1, -0.4]).as_matrix()
    names = ["q1", "q2", "q3", "q4"]
    body = Rotation.from_quat(np.stack([columns[name] for name in names], axis=1))
    # C_T = R^T C_B; scipy's rotations are the transposes.
    tracker = body * Rotation.from_matrix(body_from_tracker)
    columns |= dict(zip(names, tracker.as_quat().T, strict=True))
    log = write_csv(tmp_path / "log.csv", columns)
    old = 'maps = "inertial_to_body"\nframe = "body"'
    new = (
        'maps = "inertial_to_body"\nframe = "tracker"\n'
        f"body_from_tracker = {body_from_tracker.tolist()}"
    )
    slew = campaign_of(tmp_path, [log], edited_mapping(tmp_path, (old, new))).slews[0]
    first = round(slew.start / 0.5)
    fixes = slew.fixes
    expected = body[first : first + len(slew.time)][fixes]
    errors = (Rotation.from_quat(slew.attitude[fixes]) * expected.inv()).magnitude()
    assert len(errors) > 20
    assert errors.max() < 1e-7


def test_wheels_may_come_in_files_of_their_own(tmp_path, columns):
    log = write_csv(tmp_path / "log.csv", columns)
    times = {"x": columns["t_ms"][::2], "y": columns["t_ms"][1::2] + 100.0}
    files = [
        write_csv(tmp_path / f"rw_{name}.csv", {"t_ms": t, "speed": 100.0 + t / 1e3})
        for name, t in times.items()
    ]
    second = '[[wheels]]\nname = "y"\naxis = [0.0, 1.0, 0.0]\nspin_inertia = 0.002\n\n'
    text = MAPPING.replace("[rate_sensor]", second + "[rate_sensor]")
    text = text.replace('acts_on = "wheel"', 'acts_on = "wheel"\nwheels = ["x"]')
    head = text[: text.index('[[streams]]\nholds = "wheel_torque"')]
    tail = text[text.index('[[streams]]\nholds = "attitude"') :]
    for name in times:
        head += f"""[[streams]]
holds = "wheel_speed"
files = ["rw_{name}.csv"]
time = {{ names = ["t_ms"], kind = "ms", epoch = "campaign" }}
names = ["speed"]
wheels = ["{name}"]
unit = "rpm"
relative_to = "body"

"""
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(head + tail)
    slew = campaign_of(tmp_path, [log, *files], mapping).slews[0]
    stamps = 1e3 * (slew.start + slew.time)
    for k, (name, inertia) in enumerate((("x", 0.001), ("y", 0.002))):
        read = np.isfinite(slew.wheel_momentum[:, k])
        inside = (times[name] >= stamps[0]) & (times[name] <= stamps[-1])
        np.testing.assert_allclose(stamps[read], times[name][inside], atol=1e-5)
        speed = (100.0 + times[name][inside] / 1e3) * 2.0 * np.pi / 60.0
        np.testing.assert_allclose(slew.wheel_momentum[read, k], inertia * speed, rtol=1e-12)


def test_wheels_of_one_file_in_streams_of_their_own_are_in_order(tmp_path, columns):
    """Nearly all their rows were said to be out of order."""
    columns["other"] = -columns["torque"]
    second = '[[wheels]]\nname = "y"\naxis = [0.0, 1.0, 0.0]\nspin_inertia = 0.002\n\n'
    first, last = (MAPPING.index(f'[[streams]]\nholds = "{h}') for h in ("wheel", "attitude"))
    of_x = MAPPING[first:last] + 'wheels = ["x"]\n'
    of_y = of_x.replace('"torque"', '"other"').replace('"x"', '"y"')
    text = MAPPING[:first] + of_x + of_y + MAPPING[last:]
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(text.replace("[rate_sensor]", second + "[rate_sensor]"))
    log = write_csv(tmp_path / "log.csv", columns)
    commands = import_logs([log], mapping, tmp_path / FOLDER).logs.streams["wheel_torque"]
    assert commands.notes == ()
    np.testing.assert_array_equal(commands.values[:, 1], -commands.values[:, 0])


@pytest.mark.parametrize(
    ("holds", "unit", "size"), [("wheel_momentum", "N m s", 0.001), ("wheel_speed", "rad/s", 1.0)]
)
def test_momenta_in_inertial_space_become_relative_to_the_body(
    tmp_path, columns, holds, unit, size
):
    """H = h + Js g.w; the wheel of this log turns about x, and w = K w_meas - b."""
    rate = 1.25 * np.radians(columns["wx"]) - 1e-3
    relative = size * (100.0 + 0.01 * columns["t_ms"] / 1e3)
    columns["H"] = relative + size * rate
    log = write_csv(tmp_path / "log.csv", columns)
    stream = f"""
[[streams]]
holds = "{holds}"
files = ["log.csv"]
time = {{ names = ["t_ms"], kind = "ms", epoch = "campaign" }}
names = ["H"]
unit = "{unit}"
relative_to = "inertial"
"""
    sensor = ("sigma = 1e-4\n", "sigma = 1e-4\nscale_factor = 1.25\nbias = 1e-3\n")
    imported = import_logs([log], edited_mapping(tmp_path, sensor, more=stream), tmp_path / FOLDER)
    read = imported.logs.streams[holds]
    np.testing.assert_allclose(read.values[:, 0], relative, rtol=1e-12)
    assert "the body's turning was taken out" in " ".join(read.notes)


def test_streams_of_other_files_keep_their_own_rates(tmp_path, columns):
    names = ("t_ms", "q1", "q2", "q3", "q4")
    fixes = {name: columns[name][::5] for name in names}
    fixes["t_ms"] = fixes["t_ms"] + 70.0
    files = [write_csv(tmp_path / "log.csv", columns), write_csv(tmp_path / "st.csv", fixes)]
    place = MAPPING.index('[[streams]]\nholds = "attitude"')
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(MAPPING[:place] + MAPPING[place:].replace("log*.csv", "st.csv"))
    slew = campaign_of(tmp_path, files, mapping).slews[0]
    has_rate = np.isfinite(slew.rate).all(axis=1)
    assert not (has_rate & slew.fixes).any()
    stamps = 1e3 * (slew.start + slew.time[slew.fixes])
    np.testing.assert_allclose(stamps % 2500.0, 70.0, atol=1e-5)
    np.testing.assert_allclose(np.diff(slew.time[has_rate]), 0.5, atol=1e-8)


@pytest.mark.parametrize(("row", "off"), [(25, 40_200.0), (25, 1e9), (180, -30_100.0)])
def test_a_single_wrong_stamp_moves_no_reading_to_another_time(tmp_path, columns, row, off):
    right = import_logs([write_csv(tmp_path / "log.csv", columns)], edited_mapping(tmp_path),
                        tmp_path / "right")  # fmt: skip
    columns["t_ms"] = columns["t_ms"] + off * (np.arange(len(columns["t_ms"])) == row)
    log = write_csv(tmp_path / "log.csv", columns)
    mended = import_logs([log], edited_mapping(tmp_path), tmp_path / FOLDER)
    for stream, other in zip(
        right.logs.streams.values(), mended.logs.streams.values(), strict=True
    ):
        np.testing.assert_allclose(other.time, stream.time, atol=1e-6)
        np.testing.assert_array_equal(other.values, stream.values)
    assert "1 row with a wrong stamp" in mended.logs.streams["attitude"].notes[0]


def test_a_unit_is_written_as_the_campaign_format_spells_it(tmp_path, columns):
    log = write_csv(tmp_path / "log.csv", columns)
    spelled = (('unit = "mN m"', 'unit = "mNm"'), ('unit = "deg/s"', 'unit = "arcmin/s"'))
    import_logs([log], edited_mapping(tmp_path, *spelled), tmp_path / FOLDER)
    text = (tmp_path / FOLDER / "campaign.toml").read_text()
    assert 'unit = "mN m"' in text
    assert 'unit = "rad/s"' in text  # the campaign format has no arcmin/s


def test_a_file_that_no_stream_names_is_said(tmp_path, columns):
    log = write_csv(tmp_path / "log.csv", columns)
    other = write_csv(tmp_path / "temperatures.csv", {"t": np.arange(3.0)})
    imported = import_logs([log, other], edited_mapping(tmp_path), tmp_path / FOLDER)
    assert imported.logs.unused == ("temperatures.csv",)


def test_overlapping_downloads_are_one_log(tmp_path, columns):
    whole = import_logs(
        [write_csv(tmp_path / "log.csv", columns)], edited_mapping(tmp_path), tmp_path / "whole"
    )
    parts = [
        write_csv(tmp_path / f"log{k}.csv", {name: v[rows] for name, v in columns.items()})
        for k, rows in enumerate((slice(0, 150), slice(120, None)))
    ]
    imported = import_logs(parts, edited_mapping(tmp_path), tmp_path / "parts")
    (one,), (other,) = whole.campaign.slews, imported.campaign.slews
    np.testing.assert_array_equal(one.time, other.time)
    np.testing.assert_array_equal(one.rate, other.rate)
    assert "30 rows repeated a time and were left out" in imported.logs.streams["rate"].notes


def test_a_row_that_is_no_attitude_is_refused_with_its_line(tmp_path, columns):
    columns["q4"][30] = 0.2
    log = write_csv(tmp_path / "log.csv", columns)
    with pytest.raises(CampaignError) as caught:
        import_logs([log], edited_mapping(tmp_path), tmp_path / FOLDER)
    assert_teaches(caught.value, ["log.csv, line 32", "column q1 to q4", "length"])


def stream(time, values) -> LoggedStream:
    count = len(time)
    return LoggedStream(
        "wheel_torque", np.array(time, float), np.array(values), np.zeros(count, int), ("a",)
    )


def test_commands_are_held_wheel_by_wheel():
    nan = np.nan
    commands = held(stream([0, 1, 2, 3], [[1.0, nan], [nan, 5.0], [2.0, nan], [nan, nan]]))
    assert commands.time.tolist() == [1.0, 2.0, 3.0]
    assert commands.values.tolist() == [[1.0, 5.0], [2.0, 5.0], [2.0, 5.0]]


def test_rows_of_one_time_are_filled_up_and_never_averaged():
    nan = np.nan
    rows = in_order(
        stream([0, 1, 1, 2, 2], [[1.0, 1.0], [2.0, nan], [nan, 3.0], [4.0, 4.0], [9.0, 9.0]])
    )
    assert rows.values.tolist() == [[1.0, 1.0], [2.0, 3.0], [4.0, 4.0]]
    assert rows.notes == (
        "1 of 5 rows repeat the time of another with other readings and are left out",
    )
