"""Attitude ephemeris messages: every convention is honoured or refused."""

from __future__ import annotations

import ccsds_ndm
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.stream_readings import AttitudeConvention, to_quaternions
from bayes_inertia.tables.raw_files import read_raw, tables_in
from bayes_inertia.tables.table import StatedAttitude
from bayes_inertia.tables.time_stamps import times_to_seconds

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
    assert tables_in(file) == [""]
    table = read_raw(file)
    assert table.rows == 2 * ROWS
    # Segments stand in any order.
    earlier = body.replace(EPOCHS[0][:5], "2019-")
    assert earlier != body
    file.write_text(one + earlier)
    stamps = [str(cell) for cell in read_raw(file).columns["EPOCH"].values]
    assert stamps == sorted(stamps)
    file.write_text(one + body)
    file.write_text(one + body.replace("EME2000", "ICRF"))
    assert tables_in(file) == ["segment 1", "segment 2"]
    assert read_raw(file, table="segment 2").attitude.from_frame == "ICRF"
    with pytest.raises(CampaignError, match="segments 1 and 2 have different frames"):
        read_raw(file)
    file.write_text(one + body.replace(f"{Q[3, 0]:.9f}", "n/d"))
    with pytest.raises(CampaignError, match=r"two.aem, line \d+, column Q1: 'n/d' is"):
        read_raw(file).numbers("Q1")


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


SPINS = np.array([[268.6 + 0.01 * i, 68.4, 100.5 + 30.0 * i, 30.0] for i in range(ROWS)])


def _spin_xml(kind: str = "SPIN") -> str:
    names = ("SPIN_ALPHA", "SPIN_DELTA", "SPIN_ANGLE", "SPIN_ANGLE_VEL")
    meta = {**BASE, "ATTITUDE_DIR": "A2B", "ATTITUDE_TYPE": kind}
    states = "".join(
        f"<attitudeState><spin><EPOCH>{epoch}</EPOCH>"
        + "".join(f"<{name}>{x}</{name}>" for name, x in zip(names, row, strict=True))
        + "</spin></attitudeState>"
        for epoch, row in zip(EPOCHS, SPINS, strict=True)
    )
    metadata = "".join(f"<{key}>{value}</{key}>" for key, value in meta.items())
    return (
        '<?xml version="1.0"?><aem id="CCSDS_AEM_VERS" version="1.0"><body><segment>'
        f"<metadata>{metadata}</metadata><data>{states}</data></segment></body></aem>"
    )


@pytest.mark.parametrize("form", ["1.0", "2.0", "xml"])
def test_spin_is_a_whole_attitude_its_axis_is_the_z_axis_of_the_body(tmp_path, form):
    meta = {**BASE, "ATTITUDE_TYPE": "SPIN"} | ({"ATTITUDE_DIR": "A2B"} if form == "1.0" else {})
    table = read(tmp_path, _spin_xml() if form == "xml" else kvn(form, meta, SPINS))
    assert table.attitude is not None
    assert (table.attitude.sequence, table.attitude.maps) == ("ZXZ", "inertial_to_body")
    angles = table.stack(table.attitude.names)
    convention = AttitudeConvention(
        "euler", "inertial_to_body", sequence="zxz", radians=np.pi / 180
    )
    body = Rotation.from_quat(to_quaternions(angles, convention))
    alpha, delta = np.radians(SPINS[:, :2].T)
    axis = np.stack([np.cos(alpha) * np.cos(delta), np.sin(alpha) * np.cos(delta), np.sin(delta)])
    np.testing.assert_allclose(body.apply([0.0, 0.0, 1.0]), axis.T, atol=1e-12)
    turned = (body[0].inv() * body[1]).as_rotvec(degrees=True)
    assert turned[2] == pytest.approx(30.0, abs=0.02)
    assert table.columns["SPIN_ANGLE_VEL"].unit == "deg/s"


def test_spin_that_is_no_whole_attitude_says_why(tmp_path):
    with pytest.raises(CampaignError, match="nutation about the momentum"):
        read(tmp_path, _spin_xml("SPIN/NUTATION"))
    with pytest.raises(CampaignError, match="nutation about the momentum"):
        read(tmp_path, kvn("2.0", {**BASE, "ATTITUDE_TYPE": "SPIN/NUTATION_MOM"}, SPINS))
    meta = {**BASE, "ATTITUDE_TYPE": "SPIN", "ATTITUDE_DIR": "B2A"}
    with pytest.raises(CampaignError, match="in which frame the spin axis stands"):
        read(tmp_path, kvn("1.0", meta, SPINS))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "CCSDS_APM_VERS = 2.0\nQUAT_START\nQ1 = 0.5\n",
            "is an APM .*one attitude",
        ),
        (
            "COMMENT\nCCSDS_APM_VERS=2.0\nQUAT_START\n Q1 = 0.1\n",
            "is an APM .*an attitude eph",
        ),
        ("\ufeffCCSDS_OEM_VERS = 2.0\nMETA_START\n", "is an OEM .*holds no attitudes"),
        ('<?xml version="1.0"?>\n<omm id="CCSDS_OMM_VERS" version="2.0">', "is an OMM .*mean"),
        ("CCSDS_TDM_VERS = 1.0\n", "is a TDM .tracking data"),
        ("CCSDS_XYZ_VERS = 1.0\n", "is an XYZ .message of CCSDS"),
        ("stk.v.11.0\nBEGIN Attitude\nAttitudeTimeQuaternions\n0 0 0 0 1\n", "STK attitude .*q4"),
        ("stk.v.12.0\r\n\r\nBEGIN Ephemeris\r\n", "is an STK ephemeris file; it holds no att"),
    ],
)
def test_other_messages_are_named_and_what_to_export_instead(tmp_path, content, message):
    for suffix in (".txt", ".aem", ".xml"):
        file = tmp_path / f"a{suffix}"
        file.write_text(content, encoding="utf-8")
        with pytest.raises(CampaignError, match=message):
            read_raw(file)


ACM_HEAD = """CCSDS_ACM_VERS = 2.0
CREATION_DATE = 2024-05-01T00:00:00
ORIGINATOR = DEMO
META_START
OBJECT_NAME = DEMO
TIME_SYSTEM = {system}
EPOCH_TZERO = {zero}
META_STOP
"""
ACM_BLOCK = """ATT_START
COMMENT relative times, then a date
ATT_ID = 1
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
NUMBER_STATES = {states}
ATT_TYPE = {kind}
{more}{rows}
ATT_STOP
PHYS_START
WET_MASS = 50.0 [kg]
PHYS_STOP
"""


def acm(rows: str, kind="QUATERNION", more="", states=4, system="UTC", zero="2024-05-01T00:00:00"):
    head = ACM_HEAD.format(system=system, zero=zero)
    return head + ACM_BLOCK.format(kind=kind, more=more, states=states, rows=rows)


def test_attitudes_of_a_comprehensive_message_as_the_library_of_the_format_writes_it(tmp_path):
    meta = ccsds_ndm.AcmMetadata(
        object_name="DEMO", time_system="UTC", epoch_tzero="2024-05-01T00:00:00"
    )
    lines = [[0.25 + i, *q] for i, q in enumerate(Q.tolist())]
    block = ccsds_ndm.AcmAttitudeState("EME2000", "SC_BODY_1", "QUATERNION", lines)
    block.number_states = 4
    header = ccsds_ndm.AdmHeader("2024-05-01T00:00:00", "DEMO")
    data = ccsds_ndm.AcmData(att=[block])
    message = ccsds_ndm.Acm(header, ccsds_ndm.AcmSegment(meta, data))
    table = read(tmp_path, message.to_str("kvn"))
    np.testing.assert_allclose(table.stack(NAMES), Q, atol=1e-9)
    assert table.attitude == StatedAttitude(NAMES, "last", "EME2000", "SC_BODY_1")
    assert [str(stamp)[:23] for stamp in table.columns["EPOCH"].values] == EPOCHS


def test_times_of_a_comprehensive_message_count_a_leap_second(tmp_path):
    rows = "-1.5 0 0 0 1\n0.5 0 0 0 1\n2017-01-01T00:00:00.5 0 0 0 1"
    zero = "2016-12-31T23:59:59"
    table = read(tmp_path, acm(rows, zero=zero))
    stamps = times_to_seconds(table, table.time_names, table.time_kind)
    np.testing.assert_allclose(stamps.seconds_since(stamps.first_ns), [0.0, 2.0, 4.0])
    after = read(tmp_path, acm("2.5 0 0 0 1", zero=zero))
    assert str(after.columns["EPOCH"].values[0]).startswith("2017-01-01T00:00:00.5")


def test_angles_and_rates_of_a_comprehensive_message(tmp_path):
    more = "EULER_ROT_SEQ = ZYX\nRATE_TYPE = ANGVEL\n"
    table = read(tmp_path, acm("0.0 10 20 30 0.1 0.2 0.3", "EULER_ANGLES", more, 6))
    assert table.attitude.sequence == "ZYX"
    assert table.stack(table.attitude.names).tolist() == [[10.0, 20.0, 30.0]]
    assert table.columns["ANGVEL_X"].unit == "deg/s"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            acm("0.0 1 0 0 0 1 0 0 0 1", "DCM", states=9),
            "ATT_TYPE = DCM is not read; export QUATERNION or EULER_ANGLES",
        ),
        (acm("0.0 0 0 0 1 0 0 0", more="RATE_TYPE = GYRO_BIAS\n"), "GYRO_BIAS is not read"),
        (acm("0.0 0 0 0 1", more="TURNED = TRUE\n"), "TURNED is not one of an AEM"),
        (acm("0.0 0 0 0 1", zero=""), "lack EPOCH_TZERO"),
        (acm("0.0 0 0 0 1").replace("ATT_STOP\n", ""), "PHYS_START does not belong here"),
        (acm("").split("ATT_START")[0], "holds no segment of attitudes"),
    ],
)
def test_what_a_comprehensive_message_may_not_say(tmp_path, text, says):
    with pytest.raises(CampaignError, match=says):
        read(tmp_path, text)
