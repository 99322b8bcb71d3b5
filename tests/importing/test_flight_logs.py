"""Logs of PX4 and ROS are imported as they are: one small file of each real format."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from bayes_inertia import CampaignError
from bayes_inertia.importing.starting_mapping import write_starting_mapping
from bayes_inertia.tables.raw_files import read_raw, tables_in

TIME = np.arange(40) * 0.25
RATE = np.stack([0.01 * np.sin(TIME), 0.02 * np.cos(TIME), 0.03 * np.sin(2.0 * TIME)], axis=1)
ZERO_NS = 1_772_366_400_000_000_000


def ulog(path: Path, topic: bytes = b"sensor_combined", field: bytes = b"gyro_rad") -> Path:
    """A ULog (docs.px4.io, "ULog file format") with one topic."""

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    fields = topic + b":uint64_t timestamp;float[3] " + field + b";"
    parts = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", 0)]
    parts += [message("B", bytes(40)), message("F", fields)]
    parts.append(message("A", struct.pack("<BH", 0, 0) + topic))
    for t, rate in zip(TIME, RATE, strict=True):
        parts.append(message("D", struct.pack("<HQ3f", 0, int(1e6 * t) + 5_000_000, *rate)))
    path.write_bytes(b"".join(parts))
    return path


def bag(path: Path, kind: str, topics=("/imu/data",), orientation: float = 0.0) -> Path:
    """A bag with topics of IMU messages."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    imu = "sensor_msgs/msg/Imu"
    if kind == "ros1":
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        for topic in topics:
            connection = writer.add_connection(topic, imu, typestore=store)
            for row, (t, rate) in enumerate(zip(TIME, RATE, strict=True)):
                stamp_ns = ZERO_NS + int(1e9 * t)
                message = _imu(store, stamp_ns, rate, row, orientation)
                serialize = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
                writer.write(connection, stamp_ns + 1000, serialize(message, imu))
    return path if kind == "ros1" else next(p for p in path.iterdir() if p.suffix != ".yaml")


def _imu(store, stamp_ns: int, rate: np.ndarray, row: int, orientation: float):
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"]
    named = {"stamp": stamp, "frame_id": "imu"}
    if "seq" in header.__dataclass_fields__:
        named["seq"] = row
    none = np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header=header(**named),
        orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        orientation_covariance=np.array([orientation, *none[1:]]),
        angular_velocity=vector(*rate.tolist()),
        angular_velocity_covariance=none,
        linear_acceleration=vector(0.0, 0.0, 0.0),
        linear_acceleration_covariance=none,
    )


def test_topics_of_a_ulog_are_tables(tmp_path):
    log = ulog(tmp_path / "flight.ulg")
    assert tables_in(log) == ["sensor_combined"]
    table = read_raw(log, table="sensor_combined")
    assert table.columns["timestamp"].unit == "us"
    np.testing.assert_allclose(table.stack(["timestamp"])[:, 0], 1e6 * TIME + 5e6)
    read = table.stack([f"gyro_rad[{k}]" for k in range(3)])
    np.testing.assert_allclose(read, RATE, rtol=1e-6)


@pytest.mark.parametrize("kind", ["ros1", "ros2", "mcap"])
def test_topics_of_a_bag_are_tables(tmp_path, kind):
    log = bag(tmp_path / ("log.bag" if kind == "ros1" else "log"), kind)
    assert tables_in(log) == ["imu_data"]
    table = read_raw(log, table="imu_data")
    read = table.stack([f"angular_velocity.{axis}" for axis in "xyz"])
    np.testing.assert_array_equal(read, RATE)
    sec, nanosec = table.stack(["header.stamp.sec", "header.stamp.nanosec"]).T
    np.testing.assert_allclose(sec - ZERO_NS // 10**9 + 1e-9 * nanosec, TIME)


def test_the_topic_of_a_ulog_says_what_its_fields_hold(tmp_path):
    log = ulog(tmp_path / "f.ulg", b"vehicle_angular_velocity", b"xyz")
    write_starting_mapping([log], tmp_path / "mapping.toml")
    text = (tmp_path / "mapping.toml").read_text()
    assert 'holds = "rate"' in text
    assert 'unit = "rad/s"' in text


def test_an_imu_without_orientation_has_none(tmp_path):
    """A covariance of -1 says so (sensor_msgs/Imu)."""
    log = bag(tmp_path / "log", "mcap", orientation=-1.0)
    table = read_raw(log, table="imu_data")
    assert not [name for name in table.columns if name.startswith("orientation")]
    assert "/imu/data/orientation is without a reading" in table.notes[0]
    write_starting_mapping([log], tmp_path / "mapping.toml")
    assert 'holds = "attitude"' not in (tmp_path / "mapping.toml").read_text()


def test_topics_whose_names_differ_in_a_slash_alone_are_two_tables(tmp_path):
    log = bag(tmp_path / "log", "ros2", topics=("/imu/data", "/imu_data"))
    assert tables_in(log) == ["imu.data", "imu_data"]
    assert [read_raw(log, table=name).rows for name in tables_in(log)] == [len(TIME)] * 2


@pytest.mark.parametrize("kind", ["ulog", "mcap"])
def test_a_mapping_is_started_from_a_log(tmp_path, kind):
    log = ulog(tmp_path / "f.ulg") if kind == "ulog" else bag(tmp_path / "log", kind)
    mapping = tmp_path / "mapping.toml"
    write_starting_mapping([log], mapping)
    text = mapping.read_text()
    assert 'holds = "rate"' in text
    assert ("gyro_rad[0]" if kind == "ulog" else "angular_velocity.x") in text


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("log.ulg", b"ULog\x01\x12\x35\x01\0\0", "cannot be read as a ULog"),
        ("log.bag", b"#ROSBAG V2.0\n", "cannot be read as a ROS bag"),
        ("log.db3", b"SQLite format 3\0", "cannot be read as a ROS bag"),
        ("log.mcap", b"\x89MCAP0\r\n\x01", "cannot be read as a ROS bag"),
    ],
)
def test_a_damaged_log_is_said_in_one_sentence(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CampaignError, match=says):
        read_raw(tmp_path / name)
