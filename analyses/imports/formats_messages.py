"""Writers of messages and of simulators: CCSDS AEM, JSON lines, Basilisk recorders, NASA 42.

Every writer returns its files and the `[[streams]]` of the mapping that reads them. An AEM holds
attitudes alone: the other channels then come as Parquet.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import ccsds_ndm
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from analyses.imports.formats_base import (
    QUATERNION,
    LogChannels,
    StreamText,
    Written,
    free_time,
    indexed,
    three,
    utc_texts,
)
from analyses.imports.formats_tables import write_parquet


def write_json(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """One object a line, nested; TAI dates."""
    file = folder / "log.jsonl"
    tai = utc_texts(log.time + 37.0, first)
    with file.open("w", encoding="utf-8") as lines:
        for i, stamp in enumerate(tai):
            fix = log.attitude[i].tolist() if log.fixed[i] else None
            wheels = {"u": log.torque[i].tolist(), "h": log.momentum[i].tolist()}
            record = {"tai": stamp, "gyro": {"w": log.rate[i].tolist()}, "wheels": wheels}
            lines.write(json.dumps(record | ({"q": fix} if fix else {})) + "\n")
    wheels_count = log.torque.shape[1]
    names = {
        "rate": indexed("gyro.w", 3),
        "torque": indexed("wheels.u", wheels_count),
        "momentum": indexed("wheels.h", wheels_count),
    }
    source = StreamText(file.name, '{ names = ["tai"], kind = "tai" }')
    streams = three(source, names, ("rad/s", "N m", "N m s"))
    streams += source.text("attitude", indexed("q", 4), QUATERNION)
    return Written([file], streams, "TAI dates; nested keys; fixes where there are any")


def write_basilisk(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Recorders of Basilisk: nanoseconds, modified Rodrigues parameters, motor torques."""
    file = folder / "log.npz"
    mrp = np.full((log.time.size, 3), np.nan)
    # scipy's rotation of (q1, q2, q3, q4) is body to inertial; Basilisk's sigma_BN its attitude.
    mrp[log.fixed] = Rotation.from_quat(log.attitude[log.fixed]).as_mrp()
    np.savez(
        file,
        times=np.rint(log.time * 1e9).astype(np.uint64),
        omega_BN_B=log.rate,
        sigma_BN=mrp,
        motorTorque=log.torque,
        momentum=log.momentum,
    )
    epoch = f"{np.datetime_as_string(first, unit='s')}Z"
    source = StreamText(file.name, f'{{ names = ["times"], kind = "ns", epoch = "{epoch}" }}')
    wheels = log.torque.shape[1]
    names = {
        "rate": indexed("omega_BN_B", 3),
        "torque": indexed("motorTorque", wheels),
        "momentum": indexed("momentum", wheels),
    }
    attitude = 'form = "mrp"\nmaps = "inertial_to_body"\nframe = "body"'
    streams = three(source, names, ("rad/s", "N m", "N m s"))
    streams += source.text("attitude", indexed("sigma_BN", 3), attitude)
    return Written([file], streams, "nanoseconds as integers; sigma_BN")


def write_42(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Outputs of NASA 42, six decimals as it prints them; torques, which it does not, as CSV."""
    for name, form, values in (
        ("time", "%f", log.time[:, None]),
        ("wbn", "%e", log.rate),
        ("qbn", "%e", log.attitude),
        ("Hwhl", "%f", log.momentum),
    ):
        np.savetxt(folder / f"{name}.42", values, fmt=form)
    wheels = log.torque.shape[1]
    torques = [f"u{i + 1}" for i in range(wheels)]
    table = pd.DataFrame(log.torque, columns=torques)
    table.insert(0, "t", log.time)
    table.to_csv(folder / "torque.csv", index=False)
    epoch = f'{{ epoch = "{np.datetime_as_string(first, unit="s")}Z" }}'
    streams = (
        StreamText("wbn.42", epoch).text("rate", indexed("wbn", 3), 'frame = "body"')
        + StreamText("Hwhl.42", epoch).text(
            "wheel_momentum", indexed("Hwhl", wheels), 'relative_to = "body"'
        )
        + StreamText("torque.csv", free_time(first)).text(
            "wheel_torque", torques, 'unit = "N m"\nacts_on = "wheel"'
        )
        + StreamText("qbn.42", epoch).text("attitude", [], 'frame = "body"')
    )
    files = [folder / name for name in ("wbn.42", "Hwhl.42", "qbn.42", "torque.csv")]
    return Written(files, streams, "seconds; units and quaternion known; six decimals")


def _beside_parquet(
    log: LogChannels, folder: Path, first: np.datetime64, file: Path, what: str
) -> Written:
    """A log whose attitudes are in a message that states its own conventions."""
    rest = write_parquet(log, folder, first)
    others = rest.streams[: rest.streams.index('\n[[streams]]\nholds = "attitude"')]
    attitude = StreamText(file.name, "").text("attitude", [], 'frame = "body"')
    return Written([*rest.files, file], others + attitude, what)


def _epochs(log: LogChannels, first: np.datetime64, ahead: float) -> list[str]:
    return utc_texts(log.time[log.fixed] + ahead, first).tolist()


def _library_message(log: LogChannels, epochs: list[str], form: str) -> str:
    meta = ccsds_ndm.AemMetadata(
        object_name="DEMO",
        object_id="2026-001A",
        ref_frame_a="EME2000",
        ref_frame_b="SC_BODY_1",
        time_system="UTC",
        start_time=epochs[0],
        stop_time=epochs[-1],
        attitude_type="QUATERNION",
    )
    data = ccsds_ndm.AemData.from_numpy(epochs, log.attitude[log.fixed], "QUATERNION")
    header = ccsds_ndm.AdmHeader("2026-03-02T00:00:00", "DEMO")
    return ccsds_ndm.Aem(header, [ccsds_ndm.AemSegment(meta, data)]).to_str(form)


def write_aem2(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """AEM 2.0, keywords and values, by the library of the format."""
    file = folder / "tracker.aem"
    file.write_text(_library_message(log, _epochs(log, first, 0.0), "kvn"))
    return _beside_parquet(log, folder, first, file, "UTC; the file states all conventions")


def write_aem2_xml(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """AEM 2.0 as XML, by the library of the format."""
    file = folder / "tracker.xml"
    file.write_text(_library_message(log, _epochs(log, first, 0.0), "xml"))
    return _beside_parquet(log, folder, first, file, "UTC; the file states all conventions")


_OLD: Mapping[str, str] = {
    "OBJECT_NAME": "DEMO",
    "OBJECT_ID": "2026-001A",
    "REF_FRAME_A": "EME2000",
    "REF_FRAME_B": "SC_BODY_1",
    "ATTITUDE_DIR": "B2A",
    "TIME_SYSTEM": "GPS",
    "ATTITUDE_TYPE": "QUATERNION",
    "QUATERNION_TYPE": "FIRST",
}


def write_aem1(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """AEM 1.0 with the scalar first, from body to inertial, days of the year of GPS."""
    file = folder / "tracker.aem"
    fixes = log.attitude[log.fixed] * [-1.0, -1.0, -1.0, 1.0]
    dates = [np.datetime64(epoch) for epoch in _epochs(log, first, 18.0)]
    days = [int((d - d.astype("M8[Y]")) / np.timedelta64(1, "D")) + 1 for d in dates]
    rows = [
        f"{str(date)[:4]}-{day:03}{str(date)[10:]} {q[3]!r} {q[0]!r} {q[1]!r} {q[2]!r}"
        for date, day, q in zip(dates, days, fixes.tolist(), strict=True)
    ]
    meta = [f"{key} = {value}" for key, value in _OLD.items()]
    head = ["CCSDS_AEM_VERS = 1.0", "CREATION_DATE = 2026-061T00:00:00", "ORIGINATOR = DEMO"]
    lines = [*head, "META_START", *meta, "META_STOP", "DATA_START", *rows, "DATA_STOP"]
    file.write_text("\n".join(lines) + "\n")
    what = "GPS by day of year; scalar first, B2A, as the file states"
    return _beside_parquet(log, folder, first, file, what)


def write_aem1_xml(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """AEM 1.0 as XML."""
    file = folder / "tracker.xml"
    meta = "".join(f"<{key}>{value}</{key}>" for key, value in _OLD.items())
    fixes = (log.attitude[log.fixed] * [-1.0, -1.0, -1.0, 1.0]).tolist()
    states = "".join(
        f"<attitudeState><quaternionState><EPOCH>{epoch}</EPOCH><quaternion><QC>{q[3]!r}</QC>"
        f"<Q1>{q[0]!r}</Q1><Q2>{q[1]!r}</Q2><Q3>{q[2]!r}</Q3></quaternion></quaternionState>"
        "</attitudeState>\n"
        for epoch, q in zip(_epochs(log, first, 18.0), fixes, strict=True)
    )
    file.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<aem id="CCSDS_AEM_VERS" version="1.0"><body>'
        f"<segment><metadata>{meta}</metadata><data>{states}</data></segment></body></aem>\n"
    )
    return _beside_parquet(log, folder, first, file, "GPS; B2A, as the file states")
