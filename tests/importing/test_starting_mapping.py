"""`import --start` recognises usual columns and asks for everything that it cannot know."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from support.raw_logs import log_columns, write_csv

from bayes_inertia.app.cli import main
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.importing.column_families import families, guessed_clock, stamp_units, time_names
from bayes_inertia.importing.import_logs import import_logs
from bayes_inertia.importing.mapping import parse_mapping
from bayes_inertia.importing.questions import open_questions
from bayes_inertia.importing.starting_mapping import starting_mapping, write_starting_mapping
from bayes_inertia.tables.table import Column, Table

LOOKS = [
    ("imu.csv", "utc gx_dps gy_dps gz_dps flag", ["utc"], [("rate", 3, "deg/s")]),
    ("gyro.csv", "t x y z", ["t"], [("rate", 3, "")]),
    ("a.csv", "t p q r", ["t"], [("rate", 3, "")]),
    ("a.csv", "Timestamp GyroX GyroY GyroZ AccX AccY AccZ", ["Timestamp"], [("rate", 3, "")]),
    ("a.csv", "time wx_deg_s wy_deg_s wz_deg_s", ["time"], [("rate", 3, "deg/s")]),
    ("bsk.npz", "times omega_BN_B[0] omega_BN_B[1] omega_BN_B[2]", ["times"], [("rate", 3, "")]),
    ("bsk.npz", "times sigma_BN[0] sigma_BN[1] sigma_BN[2]", ["times"], [("attitude", 3, "")]),
    ("st.csv", "utc qs qx qy qz", ["utc"], [("attitude", 4, "")]),
    ("st.csv", "utc q0 q1 q2 q3", ["utc"], [("attitude", 4, "")]),
    ("a.csv", "time roll pitch yaw", ["time"], [("attitude", 3, "")]),
    ("a.csv", "t c11 c12 c13 c21 c22 c23 c31 c32 c33", ["t"], [("attitude", 9, "")]),
    (
        "wheels.csv",
        "gps_week gps_tow rw1_rpm rw2_rpm rw1_torque_mNm rw2_torque_mNm",
        ["gps_week", "gps_tow"],
        [("wheel_speed", 2, "rpm"), ("wheel_torque", 2, "mN m")],
    ),
    ("mom.csv", "t h1 h2 h3", ["t"], [("wheel_momentum", 3, "")]),
    ("wheel_mom.csv", "t x y z", ["t"], [("wheel_momentum", 3, "")]),
    ("moments.csv", "t h1 h2 h3", ["t"], []),
    ("hwhl.42", "time Hwhl1 Hwhl2 Hwhl3", ["time"], [("wheel_momentum", 3, "")]),
    ("a.csv", "t_s Bx_N_T By_N_T Bz_N_T", ["t_s"], [("magnetic_field", 3, "T")]),
    ("a.csv", "t_s rx_N_m ry_N_m rz_N_m", ["t_s"], [("position", 3, "m")]),
    ("a.csv", "t_s wheel_radps", ["t_s"], [("wheel_speed", 1, "rad/s")]),
    ("a.csv", "t temperature voltage", ["t"], []),
    (
        "a.csv",
        "TARGET RECEIVED_TIMEFORMATTED PACKET_TIMESECONDS GYRO_X GYRO_Y GYRO_Z",
        ["PACKET_TIMESECONDS"],
        [("rate", 3, "")],
    ),
    (
        "cosmos.txt",
        "TARGET RECEIVED_TIMESECONDS GYRO_X GYRO_Y GYRO_Z",
        ["RECEIVED_TIMESECONDS"],
        [("rate", 3, "")],
    ),
    # ROS: topics as messages are echoed, and as PlotJuggler writes them.
    (
        "imu.csv",
        "time field.orientation.x field.orientation.y field.orientation.z field.orientation.w "
        "field.angular_velocity.x field.angular_velocity.y field.angular_velocity.z "
        "field.linear_acceleration.x field.linear_acceleration.y field.linear_acceleration.z "
        "orientation_covariance[0] orientation_covariance[1] orientation_covariance[2]",
        ["time"],
        [("attitude", 4, ""), ("rate", 3, "")],
    ),
    (
        "a.csv",
        "__time /imu/angular_velocity/x /imu/angular_velocity/y /imu/angular_velocity/z "
        "/imu/orientation/w /imu/orientation/x /imu/orientation/y /imu/orientation/z "
        "/imu/linear_acceleration/x /imu/linear_acceleration/y /imu/linear_acceleration/z",
        ["__time"],
        [("rate", 3, ""), ("attitude", 4, "")],
    ),
    # PX4: a file a message as ulog2csv writes it, and all in one as PlotJuggler does.
    (
        "log_vehicle_angular_velocity_0.csv",
        "timestamp timestamp_sample xyz[0] xyz[1] xyz[2] xyz_derivative[0] xyz_derivative[1] "
        "xyz_derivative[2]",
        ["timestamp_sample"],
        [("rate", 3, "")],
    ),
    (
        "log_vehicle_attitude_0.csv",
        "timestamp q[0] q[1] q[2] q[3] delta_q_reset[0] delta_q_reset[1] delta_q_reset[2] "
        "delta_q_reset[3]",
        ["timestamp"],
        [("attitude", 4, "")],
    ),
    (
        "a.csv",
        "timestamp vehicle_angular_velocity/xyz.00 vehicle_angular_velocity/xyz.01 "
        "vehicle_angular_velocity/xyz.02 vehicle_attitude/q.00 vehicle_attitude/q.01 "
        "vehicle_attitude/q.02 vehicle_attitude/q.03",
        ["timestamp"],
        [("rate", 3, ""), ("attitude", 4, "")],
    ),
    ("log_vehicle_rates_setpoint_0.csv", "timestamp roll pitch yaw", ["timestamp"], []),
    ("a", "t torque_1 torque_2 torque_3 torque_4", ["t"], [("wheel_torque", 4, "")]),
    ("a", "t torque[0] torque[1] torque[2] torque[3]", ["t"], [("wheel_torque", 4, "")]),
    ("a", "t trq0_Nm trq1_Nm trq2_Nm trq3_Nm", ["t"], [("wheel_torque", 4, "N m")]),
    ("a", "t cmd_mNm[0] cmd_mNm[1] cmd_mNm[2]", ["t"], [("wheel_torque", 3, "mN m")]),
    (
        "wheels_joint_states",
        "t position[0] position[1] velocity[0] velocity[1] effort[0] effort[1]",
        ["t"],
        [("wheel_speed", 2, ""), ("wheel_torque", 2, "")],
    ),
    ("a", "t stq1 stq2 stq3 stq4", ["t"], [("attitude", 4, "")]),
    ("log_vehicle_torque_setpoint_0.csv", "timestamp xyz[0] xyz[1] xyz[2]", ["timestamp"], []),
]


@pytest.mark.parametrize(
    ("file", "names", "times", "expected"), LOOKS, ids=[x[1][:60] for x in LOOKS]
)
def test_usual_columns_are_recognised(file, names, times, expected):
    table = Table(file, {name: Column(np.zeros(2)) for name in names.split()})
    assert time_names(table) == times
    seen = [(f.holds, len(f.names), f.unit) for f in families(table, file)]
    assert seen == expected


def test_the_places_of_an_array_that_no_wheel_fills_are_left_out():
    speeds = np.zeros((5, 36))
    speeds[:, :4] = 1.0
    columns = {f"wheelSpeeds[{k}]": Column(speeds[:, k]) for k in range(36)}
    (family,) = families(Table("a", columns), "rw.npz")
    assert family.names == tuple(f"wheelSpeeds[{k}]" for k in range(4))
    # A wheel of four that is off keeps its place.
    columns = {f"speed_{k}_rpm": Column(np.full(5, float(k != 4))) for k in (1, 2, 3, 4)}
    (family,) = families(Table("a", columns), "rw.csv")
    assert len(family.names) == 4


def test_recorders_of_basilisk_are_recognised(tmp_path):
    times = (1e9 * np.arange(5)).astype(np.uint64)
    file = tmp_path / "imu.npz"
    np.savez(file, times=times, AngVelPlatform=0.01 * np.ones((5, 3)))
    write_starting_mapping([file], tmp_path / "mapping.toml")
    text = (tmp_path / "mapping.toml").read_text()
    for line in ('holds = "rate"', 'unit = "rad/s"', 'kind = "ns"'):
        assert line in text


def test_the_scalar_is_suggested_only_where_the_names_say_it():
    def scalar(names: str) -> str:
        table = Table("a", {name: Column(np.zeros(2)) for name in names.split()})
        return families(table, "a")[0].scalar

    assert scalar("qs qx qy qz") == "first"
    # The names are listed in that order, whatever the order in the file.
    assert scalar("q_x q_y q_z q_w") == "first"
    assert scalar("q0 q1 q2 q3") == ""
    assert scalar("q1 q2 q3 q4") == ""


@pytest.fixture
def log(tmp_path):
    return write_csv(tmp_path / "log.csv", log_columns([(40.0, 30.0, 0.5)], 110.0))


ANSWERS = {
    "tensor": "[[3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]",
    "relative_sigma": "0.04",
    "product_sigma": "0.03",
    "includes_wheel_spin": "false",
    "axis": "[1.0, 0.0, 0.0]",
    "spin_inertia": "0.001",
    "boresight": "[0.0, 0.0, 1.0]\nsigma_cross = 2e-5\nsigma_roll = 1e-4",
    "unit": '"deg/s"',
    "acts_on": '"wheel"',
    "scalar": '"last"',
    "maps": '"inertial_to_body"',
    "frame": '"body"',
}


def answered(text: str) -> str:
    """A mapping with its questions answered as a user would."""
    head, *streams = text.split("[[streams]]")
    streams = [
        stream.replace('unit = "?"', 'unit = "mN m"') if "wheel_torque" in stream else stream
        for stream in streams
    ]
    text = "[[streams]]".join([head, *streams])
    for key, answer in ANSWERS.items():
        text = text.replace(f'{key} = "?"', f"{key} = {answer}")
    text = text.replace('epoch = "?"', 'epoch = "campaign"')
    return text.replace("[rate_sensor]", "[rate_sensor]\nsigma = 1e-4")


def test_the_zero_of_clocks_in_several_files_is_asked_once_and_holds_for_every_stream(tmp_path):
    columns = log_columns([(40.0, 30.0, 0.5)], 110.0)
    logs = [write_csv(tmp_path / name, columns) for name in ("gyro_a.csv", "gyro_b.csv")]
    text = write_starting_mapping(logs, tmp_path / "mapping.toml").text
    asked = [path for path in open_questions(tomllib.loads(text)) if "epoch" in path]
    assert asked == [("epoch",)]
    streams = parse_mapping(answered(text), "mapping.toml").streams
    assert len(streams) > 1
    assert {stream.time.epoch for stream in streams} == {"campaign"}


def test_a_started_mapping_asks_and_once_answered_imports(log, tmp_path):
    mapping = tmp_path / "mapping.toml"
    count = write_starting_mapping([log], mapping).questions
    text = mapping.read_text()
    asked = open_questions(tomllib.loads(text))
    assert count == len(asked) == 14
    for key in (
        ("streams", "rate", "unit"),
        ("streams", "rate", "frame"),
        ("streams", "attitude", "scalar"),
        ("streams", "attitude", "maps"),
        ("streams", "wheel_torque", "acts_on"),
        ("inertia", "tensor"),
    ):
        assert key in asked
    with pytest.raises(CampaignError, match="the question is open"):
        import_logs([log], mapping, tmp_path / "c")
    text = answered(text)
    assert not open_questions(tomllib.loads(text))
    mapping.write_text(text)
    campaign = read_campaign(import_logs([log], mapping, tmp_path / "c").folder)
    assert campaign.has_commands
    assert campaign.slews[0].fixes.any()


def test_what_a_file_states_is_not_asked(tmp_path):
    log = write_csv(
        tmp_path / "a.csv",
        {"t": np.arange(4.0), "wx": np.ones(4), "wy": np.ones(4), "wz": np.ones(4)},
    )
    rows = log.read_text().splitlines()
    log.write_text("\n".join([rows[0], "s,deg/s,deg/s,deg/s", *rows[1:]]) + "\n")
    text = starting_mapping([log]).text
    asked = open_questions(tomllib.loads(text))
    assert ("streams", "rate", "unit") not in asked
    assert ("streams", "rate", "frame") in asked
    assert "the file states the unit: deg/s" in text


def test_files_that_differ_in_a_number_are_one_stream(tmp_path):
    columns = {"t_s": np.arange(4.0)} | {f"w{a}_dps": np.ones(4) for a in "xyz"}
    files = [write_csv(tmp_path / f"gyro_{k}.csv", columns) for k in (1, 2, 10)]
    streams = tomllib.loads(starting_mapping(files).text)["streams"]
    assert [stream["files"] for stream in streams] == [["gyro_*.csv"]]


def test_a_mapping_is_never_overwritten(log, tmp_path):
    mapping = tmp_path / "mapping.toml"
    mapping.write_text("mine")
    with pytest.raises(OutputError, match="is there already"):
        write_starting_mapping([log], mapping)
    assert mapping.read_text() == "mine"


def command(capsys, *arguments) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(["import", *map(str, arguments)])
    said = capsys.readouterr()
    return ended.value.code, said.out, said.err


def test_the_command_says_what_it_did_and_what_to_do_next(log, tmp_path, capsys):
    mapping, folder = tmp_path / "m.toml", tmp_path / "c"
    code, said, _ = command(capsys, log, "--start", mapping)
    assert code == 0
    assert "questions to answer" in said
    code, _, error = command(capsys, log, "--using", mapping, "-o", folder)
    assert code == 2
    assert "the question is open" in error
    mapping.write_text(answered(mapping.read_text()))
    code, said, _ = command(capsys, log, "--using", mapping, "-o", folder)
    assert code == 0
    for part in ("slew 1", "rate_sensor.sigma", "slews.svg", "bayes-inertia doctor"):
        assert part in said
    paths = (str(tmp_path), "bayes-inertia")
    assert all(len(line) <= 80 for line in said.splitlines() if not any(p in line for p in paths))


def test_a_mapping_without_a_stream_is_no_success(tmp_path, capsys):
    log = write_csv(tmp_path / "a.csv", {"t": np.arange(9.0), "foo": np.ones(9), "b": np.ones(9)})
    code, _, error = command(capsys, log, "--start", tmp_path / "m.toml")
    assert code == 2
    assert "no stream was recognised (a.csv: foo, b)" in error.splitlines()[-1]
    assert '# files = ["a.csv"]' in (tmp_path / "m.toml").read_text()
    columns = {name: np.ones(9) for name in ("rw1_rpm", "rw2_rpm", "foo")}
    log = write_csv(tmp_path / "b.csv", {"t": np.arange(9.0), **columns})
    code, said, _ = command(capsys, log, "--start", tmp_path / "n.toml")
    assert code == 0
    assert "no stream holds the rates" in said
    assert said.splitlines()[-1] == "not recognised: b.csv: foo"


def test_files_of_px4_say_clock_unit_and_sense(tmp_path):
    stamps = {"timestamp": np.arange(9.0) * 4000 + 81234567}
    rates = {f"xyz[{k}]": np.arange(9.0) for k in range(3)}
    fixes = {f"q[{k}]": np.full(9, float(k == 0)) for k in range(4)}
    files = [
        write_csv(tmp_path / "log_vehicle_angular_velocity_0.csv", {**stamps, **rates}),
        write_csv(tmp_path / "log_vehicle_attitude_0.csv", {**stamps, **fixes}),
    ]
    rate, attitude = tomllib.loads(starting_mapping(files).text)["streams"]
    assert (rate["unit"], rate["frame"], rate["time"]["kind"]) == ("rad/s", "body", "us")
    assert (attitude["scalar"], attitude["maps"]) == ("first", "inertial_to_body")


def test_rows_of_several_packets_are_streams_of_their_own(tmp_path):
    rows = [f"{0.25 * i},GYRO,0.1,0.2,0.3" for i in range(60)]
    rows += [f"{0.25 * i},MAG,1e-5,2e-5,3e-5" for i in range(60)]
    (tmp_path / "a.csv").write_text("\n".join(["t_s,PACKET,x,y,z", *rows]))
    started = starting_mapping([tmp_path / "a.csv"])
    rate, field = tomllib.loads(started.text)["streams"]
    assert (rate["holds"], rate["names"]) == ("rate", ["x", "y", "z"])
    assert rate["valid"] == {"name": "PACKET", "equals": "GYRO"}
    assert (field["holds"], field["valid"]["equals"]) == ("magnetic_field", "MAG")
    assert started.left_over == ()
    rows = [f"{0.25 * i}," + ("100,1,2,3," if i % 2 else "101,,,,7") for i in range(60)]
    (tmp_path / "b.csv").write_text("\n".join(["t_s,apid,gx,gy,gz,u", *rows]))
    (rate,) = tomllib.loads(starting_mapping([tmp_path / "b.csv"]).text)["streams"]
    assert rate["valid"] == {"name": "apid", "equals": 100}


def test_the_command_needs_one_of_its_two_ways(log, capsys):
    code, _, error = command(capsys, log)
    assert code == 2
    assert "--start" in error
    code, _, error = command(capsys, log, "--using", "m.toml")
    assert code == 2
    assert "-o CAMPAIGN" in error


def test_a_column_of_dates_is_the_time_whatever_its_name(tmp_path):
    log = tmp_path / "a.csv"
    rows = [f"2026-03-14T02:00:0{k}.250Z;0,1;0,2;0,3" for k in range(4)]
    log.write_text("\n".join(["Zeit;wx;wy;wz", *rows]) + "\n")
    text = starting_mapping([log]).text
    assert 'time = { names = ["Zeit"], kind = "utc" }' in text


KINDS = [
    ("unix_ms", 1772366400250, "unix_ms"),
    ("unixTimeUs", 1772366400250000, "unix_us"),
    ("epoch_us", 1772366400250000, "unix_us"),
    ("posix", 1772366400.25, "unix_s"),
    ("gps_ms", 1456401618250, "gps_ms"),
    ("gps_time", 1456401618.25, "gps_s"),
    ("tai_ns", 2151144037250000000, "tai_ns"),
    ("t_ms", 250.0, "ms"),
    ("time_us", 2.5e6, "us"),
    ("mjd_utc", 61100.5, "mjd_utc"),
    # More than one clock fits, or none: only the user can know.
    ("timestamp", 1772366400.25, "?"),
    ("time_ms", 1772366400250, "?"),
    ("gps_s", 216018.0, "s"),
    ("mjd", 61100.5, "?"),
]

STAMPS = [
    ({"sec": [1772366400, 1772366401], "nanosec": [0, 5e8]}, "unix_s", ["s", "ns"]),
    ({"hdr.stamp.secs": [1772366400] * 2, "hdr.stamp.nsecs": [0, 5e8]}, "unix_s", ["s", "ns"]),
    ({"gps_sec": [1456401618, 1456401619], "gps_usec": [0, 5e5]}, "gps_s", ["s", "us"]),
    ({"rtcDate": ["2026-03-01"] * 2, "rtcTime": ["12:00:00.25"] * 2}, "?", ["date", "date"]),
    ({"DATE": ["01-Mar-2026"] * 2, "TIME_UTC": ["12:00:00", "12:00:01"]}, "utc", ["date", "date"]),
    ({"coarse": [456789000, 456789001], "fine": [16384, 49152]}, "s", ["s", "s/2^16"]),
    ({"sclk_coarse": [456789000, 456789001], "sclk_fine": [64, 192]}, "s", ["s", "s/2^8"]),
    ({"day": [24896, 24896], "ms_of_day": [43200000, 43200250]}, "cds", ["day", "ms"]),
    ({"day": [24896] * 2, "ms_of_day": [0, 0], "us_of_ms": [1, 501]}, "cds", ["day", "ms", "us"]),
    ({"year": [2026] * 2, "doy": [60] * 2, "hour": [1] * 2, "min": [2] * 2, "sec": [0, 0.25]}, "?",
     ["year", "doy", "h", "min", "s"]),
    # What follows a stamp is not always a part of it.
    ({"t_s": [0, 1], "dt_ms": [3, 4]}, "s", ["s"]),
    ({"time_s": [0.25, 0.5], "time_us": [250000, 500000]}, "s", ["s"]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("columns", "kind", "units"), STAMPS, ids=[" ".join(c) for c, *_ in STAMPS]
)
def test_stamps_in_several_columns_are_seen(columns, kind, units):
    table = Table("a.csv", {n: Column(np.array(v)) for n, v in columns.items()})
    names = time_names(table)
    assert names == list(columns)[: len(units)]
    assert stamp_units(table, names) == units
    assert guessed_clock(table, names).kind == kind


@pytest.mark.parametrize(("name", "first", "kind"), KINDS, ids=[row[0] for row in KINDS])
def test_a_clock_is_suggested_where_name_and_size_leave_one(name, first, kind):
    table = Table("a.csv", {name: Column(np.array([first, first]))})
    assert time_names(table) == [name]
    guess = guessed_clock(table, [name])
    assert guess.kind == kind
    assert bool(guess.hint) == (kind == "?")
    assert ("mjd_utc" in guess.hint) == (kind == "?" and "mjd" in name)


def test_the_question_of_a_clock_says_what_each_answer_would_mean(tmp_path):
    columns = {"time": 1772366400.0 + np.arange(4.0)} | {f"w{a}_dps": np.ones(4) for a in "xyz"}
    text = starting_mapping([write_csv(tmp_path / "gyro.csv", columns)]).text
    words = " ".join(text.replace("#", " ").split())
    assert "2026-03-01T12:00:00Z as unix_s" in words


def test_names_of_simulators_say_frame_and_sense(tmp_path):
    columns = {"t_s": np.arange(4.0)} | {f"omega_BN_B[{k}]": np.ones(4) for k in range(3)}
    columns |= {f"sigma_BN[{k}]": np.ones(4) for k in range(3)}
    text = starting_mapping([write_csv(tmp_path / "sim.csv", columns)]).text
    streams = {stream["holds"]: stream for stream in tomllib.loads(text)["streams"]}
    assert (streams["rate"]["unit"], streams["rate"]["frame"]) == ("rad/s", "body")
    assert streams["attitude"]["maps"] == "inertial_to_body"
    assert text.count("Basilisk's notation") == 4
    # Names of one's own leave order and direction open.
    columns = {"t_s": np.arange(4.0)} | {f"q{k}": np.ones(4) for k in range(4)}
    asked = open_questions(
        tomllib.loads(starting_mapping([write_csv(tmp_path / "a.csv", columns)]).text)
    )
    assert {("streams", "attitude", key) for key in ("scalar", "maps", "frame")} <= set(asked)


def test_wheels_of_one_type_are_described_once(tmp_path):
    columns = {"t_s": np.arange(4.0)} | {f"w{a}_dps": np.ones(4) for a in "xyz"}
    columns |= {f"rw_{a}_rpm": np.ones(4) for a in "xyz"}
    text = starting_mapping([write_csv(tmp_path / "log.csv", columns)]).text
    wheels = tomllib.loads(text)["wheels"]
    assert [wheel["name"] for wheel in wheels] == ["wheel_x", "wheel_y", "wheel_z"]
    assert [wheel.get("same_as") for wheel in wheels] == [None, "wheel_x", "wheel_x"]
    assert wheels[1]["axis"] == [0.0, 1.0, 0.0]
    assert text.count("# max_momentum = ...") == 1


@pytest.mark.parametrize(
    ("date", "asks"), [("01/03/2026 23:50:00.0", True), ("2026-03-01 23:50:00.0", False)]
)
def test_a_date_that_may_be_read_in_two_ways_asks_how_it_is_written(tmp_path, date, asks):
    path = tmp_path / "a.csv"
    path.write_text("utc,wx,wy,wz\n" + 4 * f"{date},0.1,0.2,0.3\n")
    text = starting_mapping([path]).text
    assert ('kind = "utc", format = "?"' in text) is asks
    assert ("%d/%m/%Y" in text) is asks


def test_a_folder_is_no_log(tmp_path):
    with pytest.raises(CampaignError, match=r"is a folder; name the raw logs .* ROS 2 bag"):
        starting_mapping([tmp_path])
