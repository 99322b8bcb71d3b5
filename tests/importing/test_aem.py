"""Attitude ephemeris messages: every convention is honoured or refused."""

from __future__ import annotations

import ccsds_ndm
import numpy as np
import pytest

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.raw_files import read_raw, tables_in
from bayes_inertia.importing.raw_table import StatedAttitude
from bayes_inertia.importing.time_stamps import times_to_seconds

ROWS = 6
Q = np.random.default_rng(5).normal(size=(ROWS, 4))
Q = np.round(Q / np.linalg.norm(Q, axis=1)[:, None], 9)
EPOCHS = [f"2024-05-01T00:00:0{i}.250" for i in range(ROWS)]
BASE = {
    "OBJECT_NAME": "DEMO",
    "OBJECT_ID": "2024-001A",
    "REF_FRAME_A": "EME2000",
    "REF_FRAME_B": "SC_BODY_1",
    "TIME_SYSTEM": "UTC",
    "START_TIME": EPOCHS[0],
    "STOP_TIME": EPOCHS[-1],
    "ATTITUDE_TYPE": "QUATERNION",
}
OLD = {**BASE, "ATTITUDE_DIR": "A2B", "QUATERNION_TYPE": "LAST"}
NAMES = ("Q1", "Q2", "Q3", "QC")


def kvn(version: str, metadata: dict, numbers=Q) -> str:
    head = f"CCSDS_AEM_VERS = {version}\nCREATION_DATE = 2024-05-01T00:00:00\nORIGINATOR = DEMO\n"
    meta = "".join(f"{key} = {value}\n" for key, value in metadata.items() if value)
    rows = "".join(
        f"{epoch} {' '.join(f'{x:.9f}' for x in row)}\n"
        for epoch, row in zip(EPOCHS, numbers, strict=True)
    )
    return f"{head}\nMETA_START\nCOMMENT a = b\n{meta}META_STOP\n\nDATA_START\n{rows}DATA_STOP\n"


def read(tmp_path, text: str):
    file = tmp_path / "tracker.aem"
    file.write_text(text)
    return read_raw(file)


@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_version_2_as_the_library_of_the_format_writes_it(tmp_path, form):
    meta = ccsds_ndm.AemMetadata(
        object_name="DEMO",
        object_id="2024-001A",
        ref_frame_a="EME2000",
        ref_frame_b="SC_BODY_1",
        time_system="UTC",
        start_time=EPOCHS[0],
        stop_time=EPOCHS[-1],
        attitude_type="QUATERNION",
    )
    data = ccsds_ndm.AemData.from_numpy(EPOCHS, Q, "QUATERNION")
    header = ccsds_ndm.AdmHeader("2024-05-01T00:00:00", "DEMO")
    message = ccsds_ndm.Aem(header, [ccsds_ndm.AemSegment(meta, data)])
    table = read(tmp_path, message.to_str(form))
    np.testing.assert_allclose(table.stack(NAMES), Q, atol=1e-9)
    assert table.attitude == StatedAttitude(NAMES, "last", "EME2000", "SC_BODY_1")
    assert table.attitude.maps == "inertial_to_body"
    assert (table.time_names, table.time_kind) == (("EPOCH",), "utc")
    stamps = times_to_seconds(table, table.time_names, table.time_kind)
    np.testing.assert_array_equal(stamps.seconds_since(stamps.first_ns), np.arange(ROWS))


def test_version_1_in_every_order_and_direction(tmp_path):
    first = Q[:, [3, 0, 1, 2]]
    for scalar, numbers in {"LAST": Q, "FIRST": first, "last": Q}.items():
        for direction in ("A2B", "B2A"):
            meta = {**OLD, "QUATERNION_TYPE": scalar, "ATTITUDE_DIR": direction}
            table = read(tmp_path, kvn("1.0", meta, numbers))
            np.testing.assert_array_equal(table.stack(NAMES), Q)
            assert table.attitude is not None
            assert table.attitude.scalar == "last"
            forward = direction == "A2B"
            assert table.attitude.maps == ("inertial_to_body" if forward else "body_to_inertial")
    swapped = {**OLD, "REF_FRAME_A": "SC_BODY_1", "REF_FRAME_B": "ICRF"}
    attitude = read(tmp_path, kvn("1.0", swapped)).attitude
    assert attitude is not None
    assert attitude.maps == "body_to_inertial"


def test_a_file_of_version_2_that_uses_keywords_of_version_1_is_believed(tmp_path):
    meta = {**BASE, "ATTITUDE_DIR": "B2A", "QUATERNION_TYPE": "FIRST"}
    table = read(tmp_path, kvn("2.0", meta, Q[:, [3, 0, 1, 2]]))
    np.testing.assert_array_equal(table.stack(NAMES), Q)
    assert table.attitude is not None
    assert table.attitude.maps == "body_to_inertial"
    assert len(table.notes) == 2
    assert "QUATERNION_TYPE = FIRST" in table.notes[1]


def test_time_systems(tmp_path):
    start = {}
    for system in ("UTC", "TAI", "GPS", "TT"):
        table = read(tmp_path, kvn("2.0", {**BASE, "TIME_SYSTEM": system}))
        start[system] = times_to_seconds(table, ("EPOCH",), table.time_kind).first_ns / 1e9
    ahead = {system: round(start["UTC"] - value, 3) for system, value in start.items()}
    assert ahead == {"UTC": 0.0, "TAI": 37.0, "GPS": 18.0, "TT": 69.184}


def test_rates_beside_quaternions(tmp_path):
    numbers = np.c_[Q, 0.1 * Q[:, :3]]
    meta = {**BASE, "ATTITUDE_TYPE": "QUATERNION/ANGVEL", "ANGVEL_FRAME": "SC_BODY_1"}
    table = read(tmp_path, kvn("2.0", meta, numbers))
    assert table.columns["ANGVEL_Y"].unit == "deg/s"
    np.testing.assert_allclose(table.numbers("ANGVEL_Y"), numbers[:, 5], atol=1e-9)
    assert table.notes == ("angular velocities are in the frame SC_BODY_1",)


def test_euler_angles(tmp_path):
    meta = {**BASE, "ATTITUDE_TYPE": "EULER_ANGLE", "EULER_ROT_SEQ": "ZYX"}
    attitude = read(tmp_path, kvn("2.0", meta, Q[:, :3])).attitude
    assert attitude is not None
    assert attitude.names == ("ANGLE_1", "ANGLE_2", "ANGLE_3")
    assert (attitude.sequence, attitude.angle_unit, attitude.scalar) == ("ZYX", "deg", "")
    # Version 1.0 names the angles by their axes, whatever the sequence.
    old = {**OLD, "ATTITUDE_TYPE": "EULER_ANGLE", "EULER_ROT_SEQ": "321", "QUATERNION_TYPE": ""}
    attitude = read(tmp_path, kvn("1.0", old, Q[:, :3])).attitude
    assert attitude is not None
    assert attitude.names == ("Z_ANGLE", "Y_ANGLE", "X_ANGLE")
    with pytest.raises(CampaignError, match="cannot be those of the sequence ZXZ"):
        read(tmp_path, kvn("1.0", {**old, "EULER_ROT_SEQ": "313"}, Q[:, :3]))


XML_1 = """<?xml version="1.0" encoding="UTF-8"?>
<aem xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" id="CCSDS_AEM_VERS" version="1.0">
 <header><CREATION_DATE>2024-05-01T00:00:00</CREATION_DATE></header>
 <body><segment><metadata>{meta}</metadata><data>{states}</data></segment></body></aem>"""


def test_xml_of_version_1_names_every_number(tmp_path):
    meta = "".join(f"<{key}>{value}</{key}>" for key, value in OLD.items())
    states = "".join(
        f"<attitudeState><quaternionState><EPOCH>{epoch}</EPOCH><quaternion><QC>{q[3]}</QC>"
        f"<Q1>{q[0]}</Q1><Q2>{q[1]}</Q2><Q3>{q[2]}</Q3></quaternion></quaternionState>"
        "</attitudeState>"
        for epoch, q in zip(EPOCHS, Q, strict=True)
    )
    table = read(tmp_path, XML_1.format(meta=meta, states=states))
    np.testing.assert_array_equal(table.stack(NAMES), Q)
    assert table.attitude is not None
    assert table.attitude.maps == "inertial_to_body"
    angles = "".join(
        f"<attitudeState><eulerAngle><EPOCH>{epoch}</EPOCH>"
        + "".join(
            f'<rotation{i + 1} angle="{axis}_ANGLE" units="deg">{q[i]}</rotation{i + 1}>'
            for i, axis in enumerate("ZYX")
        )
        + "</eulerAngle></attitudeState>"
        for epoch, q in zip(EPOCHS, Q, strict=True)
    )
    meta = meta.replace("QUATERNION</", "EULER_ANGLE</") + "<EULER_ROT_SEQ>321</EULER_ROT_SEQ>"
    table = read(tmp_path, XML_1.format(meta=meta, states=angles))
    assert table.attitude is not None
    assert table.attitude.names == ("Z_ANGLE", "Y_ANGLE", "X_ANGLE")
    np.testing.assert_array_equal(table.stack(table.attitude.names), Q[:, :3])


def test_segments_are_joined_only_where_they_mean_the_same(tmp_path):
    one = kvn("2.0", BASE)
    body = one[one.index("META_START") :]
    file = tmp_path / "two.aem"
    file.write_text(one + body)
    assert tables_in(file) == ["segment 1", "segment 2"]
    assert read_raw(file).rows == 2 * ROWS
    file.write_text(one + body.replace("EME2000", "ICRF"))
    assert read_raw(file, table="segment 2").attitude.from_frame == "ICRF"
    with pytest.raises(CampaignError, match="segments 1 and 2 have different frames"):
        read_raw(file)


@pytest.mark.parametrize(
    ("version", "meta", "message"),
    [
        ("3.0", BASE, "version '3.0'"),
        ("1.0", BASE, "lack ATTITUDE_DIR"),
        ("1.0", {**OLD, "QUATERNION_TYPE": ""}, "lack QUATERNION_TYPE"),
        ("1.0", {**OLD, "QUATERNION_TYPE": "MIDDLE"}, "neither FIRST nor LAST"),
        ("1.0", {**OLD, "ATTITUDE_DIR": "FORTH"}, "neither A2B nor B2A"),
        ("2.0", {**BASE, "REF_FRAME_A": ""}, "lack REF_FRAME_A"),
        ("2.0", {**BASE, "REF_FRAME_A": "ITRF2000"}, "turns in inertial space"),
        ("2.0", {**BASE, "TIME_SYSTEM": "MET"}, "cannot be put beside other clocks"),
        ("2.0", {**BASE, "ATTITUDE_TYPE": "SPIN"}, "a spin axis alone is no attitude"),
        ("2.0", {**BASE, "ATTITUDE_TYPE": "EULER_ANGLE"}, "names no three rotations"),
        ("2.0", {**BASE, "ATTITUDE_TYPE": "QUATERNION/ANGVEL"}, "4 numbers, but"),
        ("2.0", {**BASE, "QUATERNION_SIGN": "JPL"}, "could change what the numbers mean"),
    ],
)
def test_conventions_that_are_missing_or_of_no_use_are_refused(tmp_path, version, meta, message):
    numbers = Q[:, :3] if meta["ATTITUDE_TYPE"] == "EULER_ANGLE" else Q
    with pytest.raises(CampaignError, match=message):
        read(tmp_path, kvn(version, meta, numbers))


def test_a_message_that_ends_early_or_hides_entities_is_refused(tmp_path):
    text = kvn("2.0", BASE)
    with pytest.raises(CampaignError, match="ends within a segment"):
        read(tmp_path, text.replace("DATA_STOP", ""))
    with pytest.raises(CampaignError, match=r"line 6: META_START does not belong here"):
        read(tmp_path, text.replace("META_START\n", "META_START\nMETA_START\n"))
    with pytest.raises(CampaignError, match="declares entities"):
        read(tmp_path, '<!DOCTYPE a [<!ENTITY b "c">]><aem id="CCSDS_AEM_VERS"></aem>')
