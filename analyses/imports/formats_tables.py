"""Writers of tables: text, Parquet, HDF5, netCDF and MAT, by the libraries of these formats.

Every writer returns its files and the `[[streams]]` of the mapping that reads them.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import scipy.io
import xarray

from analyses.imports.formats_base import (
    DEG,
    QUATERNION,
    UNITS,
    LogChannels,
    StreamText,
    Written,
    free_time,
    gps_seconds,
    indexed,
    named,
    plain_frame,
    three,
    utc_texts,
)


def write_csv(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Commas, ISO dates, quaternions scalar first that map body to inertial."""
    frame, file = plain_frame(log), folder / "log.csv"
    names = named(frame)
    frame[["q1", "q2", "q3"]] *= -1.0
    frame.insert(0, "utc", [f"{text}Z" for text in utc_texts(log.time, first)])
    frame.to_csv(file, index=False)
    source = StreamText(file.name, '{ names = ["utc"], kind = "utc" }')
    swapped = QUATERNION.replace("last", "first").replace("inertial_to_body", "body_to_inertial")
    attitude = source.text("attitude", [names["attitude"][i] for i in (3, 0, 1, 2)], swapped)
    what = "UTC; deg/s, mN m; scalar first, body to inertial"
    return Written([file], three(source, names, UNITS) + attitude, what)


def write_spreadsheet(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Semicolons, decimal commas, UTF-16, metadata, comments and a row of units."""
    frame, file = plain_frame(log), folder / "log.csv"
    names = named(frame)
    frame.insert(0, "gps", gps_seconds(log.time, first))
    units = ["s", *["deg/s"] * 3, *["mNm"] * len(names["torque"])]
    units += [*["mNms"] * len(names["momentum"]), *[""] * 4]
    head = f"# exported\n{';'.join(frame.columns)}\n{';'.join(units)}\n"
    body = frame.to_csv(index=False, header=False, sep=";", decimal=",")
    file.write_bytes((head + body).encode("utf-16"))
    source = StreamText(file.name, '{ names = ["gps"], kind = "gps_s" }')
    attitude = source.text("attitude", names["attitude"], QUATERNION)
    what = "GPS seconds; units from the row of units"
    return Written([file], three(source, names, ("", "", "")) + attitude, what)


def write_tsv(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Tabs, a byte-order mark, GPS week and seconds of the week, counts for torques."""
    frame, file = plain_frame(log), folder / "log.tsv"
    names = named(frame)
    seconds = gps_seconds(log.time, first)
    frame[names["torque"]] = frame[names["torque"]] / 0.01 + 2048.0
    frame.insert(0, "tow", seconds % 604800.0)
    frame.insert(0, "week", (seconds // 604800.0).astype(int))
    frame.to_csv(file, index=False, sep="\t", encoding="utf-8-sig")
    source = StreamText(file.name, '{ names = ["week", "tow"], kind = "gps_week" }')
    texts = three(source, names, UNITS)
    texts = texts.replace('acts_on = "wheel"', 'scale = 0.01\noffset = -20.48\nacts_on = "wheel"')
    attitude = source.text("attitude", names["attitude"], QUATERNION)
    return Written([file], texts + attitude, "GPS week and seconds; torques as counts")


def write_parquet(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Time stamps with a zone, vectors as lists."""
    file = folder / "log.parquet"
    stamps = pd.DatetimeIndex(first + np.rint(log.time * 1e9).astype("m8[ns]"), tz="UTC")
    lists = {"w": log.rate, "u": log.torque, "h": log.momentum, "q": log.attitude}
    frame = pd.DataFrame({"t": stamps, **{key: list(value) for key, value in lists.items()}})
    frame.to_parquet(file)
    names = {
        key: indexed(short, lists[short].shape[1])
        for key, short in (("rate", "w"), ("torque", "u"), ("momentum", "h"))
    }
    source = StreamText(file.name, '{ names = ["t"], kind = "utc" }')
    attitude = source.text("attitude", indexed("q", 4), QUATERNION)
    streams = three(source, names, ("rad/s", "N m", "N m s")) + attitude
    return Written([file], streams, "Arrow time stamps in UTC; SI units; lists")


def stream_arrays(log: LogChannels) -> dict[str, dict[str, np.ndarray]]:
    """Three groups: gyro, wheels, and a tracker that has its fixes alone."""
    fixed = log.fixed
    return {
        "gyro": {"t": log.time, "w": log.rate},
        "wheels": {"t": log.time, "u": log.torque, "h": log.momentum},
        "tracker": {"t": log.time[fixed], "q": log.attitude[fixed]},
    }


def group_streams(file: str, time: str, wheels: int) -> str:
    """The streams of `stream_arrays`."""
    gyro, wheel, tracker = (
        StreamText(file, time, group) for group in ("gyro", "wheels", "tracker")
    )
    return (
        gyro.text("rate", indexed("w", 3), 'unit = "rad/s"\nframe = "body"')
        + wheel.text("wheel_torque", indexed("u", wheels), 'unit = "N m"\nacts_on = "wheel"')
        + wheel.text("wheel_momentum", indexed("h", wheels), 'unit = "N m s"\nrelative_to = "body"')
        + tracker.text("attitude", indexed("q", 4), QUATERNION)
    )


def write_hdf5(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Groups at their own rates, UNIX nanoseconds."""
    file = folder / "log.h5"
    zero = (first - np.datetime64("1970-01-01", "ns")).astype(np.int64)
    with h5py.File(file, "w") as store:
        for group, arrays in stream_arrays(log).items():
            for name, values in arrays.items():
                kept = zero + np.rint(values * 1e9).astype(np.int64) if name == "t" else values
                store[f"{group}/{name}"] = kept
    time = '{ names = ["t"], kind = "unix_ns" }'
    streams = group_streams(file.name, time, log.torque.shape[1])
    return Written([file], streams, "UNIX nanoseconds; groups at their own rates")


def _netcdf(log: LogChannels, file: Path, first: np.datetime64, engine: str) -> Written:
    since = f"seconds since {np.datetime_as_string(first, unit='s').replace('T', ' ')}"
    fixed = log.fixed
    data = xarray.Dataset(
        {
            "w": (("time", "axis"), log.rate * DEG, {"units": "degrees/s"}),
            "u": (("time", "wheel"), log.torque, {"units": "N m"}),
            "h": (("time", "wheel"), log.momentum, {"units": "kg m2 s-1"}),
            "q": (("fix", "part"), log.attitude[fixed]),
            "fix": ("fix", log.time[fixed], {"units": since}),
        },
        coords={"time": ("time", log.time, {"units": since})},
    )
    data.to_netcdf(file, engine=engine)
    wheels = log.torque.shape[1]
    names = {
        "rate": indexed("w", 3),
        "torque": indexed("u", wheels),
        "momentum": indexed("h", wheels),
    }
    source = StreamText(file.name, '{ names = ["time"], kind = "utc" }')
    tracker = StreamText(file.name, '{ names = ["fix"], kind = "utc" }')
    streams = three(source, names, ("", "", ""))
    streams += tracker.text("attitude", indexed("q", 4), QUATERNION)
    return Written([file], streams, "CF seconds since a date; units from the attributes")


def write_netcdf4(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """netCDF 4, CF time."""
    return _netcdf(log, folder / "log.nc", first, "h5netcdf")


def write_netcdf3(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """netCDF 3, CF time."""
    return _netcdf(log, folder / "log.nc", first, "scipy")


def write_mat5(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Structs of version 5; seconds from a stated date."""
    file = folder / "log.mat"
    scipy.io.savemat(file, stream_arrays(log))
    streams = group_streams(file.name, free_time(first), log.torque.shape[1])
    return Written([file], streams, "seconds from a stated date; structs")


def write_mat73(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """As MATLAB writes version 7.3: matrices transposed, structs as groups, its own header."""
    file = folder / "log.mat"
    with h5py.File(file, "w", userblock_size=512) as store:
        for group, arrays in stream_arrays(log).items():
            store.create_group(group).attrs["MATLAB_class"] = np.bytes_("struct")
            for name, values in arrays.items():
                store[group][name] = np.atleast_2d(values.T)
                store[group][name].attrs["MATLAB_class"] = np.bytes_("double")
    with file.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124, b" ") + b"\x00\x02IM")
    streams = group_streams(file.name, free_time(first), log.torque.shape[1])
    return Written([file], streams, "seconds from a stated date; structs")


def write_timeseries(log: LogChannels, folder: Path, first: np.datetime64) -> Written:
    """Fields of MATLAB timeseries, saved as structs, with their units; ms."""
    file = folder / "log.mat"
    groups = {"w": (log.rate * DEG, "deg/s"), "u": (log.torque * 1e3, "mN*m")}
    groups["h"] = (log.momentum * 1e3, "mN*m*s")
    structs = {
        name: {"Time": log.time * 1e3, "Data": values, "DataInfo": {"Units": unit}}
        for name, (values, unit) in groups.items()
    }
    fixed = log.fixed
    structs["q"] = {"Time": log.time[fixed] * 1e3, "Data": log.attitude[fixed].T[None]}
    scipy.io.savemat(file, structs)
    time = free_time(first).replace('"t"', '"Time"').replace('"s"', '"ms"')
    wheels = log.torque.shape[1]
    rate, torque, momentum, attitude = (StreamText(file.name, time, name) for name in "wuhq")
    streams = (
        rate.text("rate", indexed("Data", 3), 'frame = "body"')
        + torque.text("wheel_torque", indexed("Data", wheels), 'acts_on = "wheel"')
        + momentum.text("wheel_momentum", indexed("Data", wheels), 'relative_to = "body"')
        + attitude.text("attitude", indexed("Data", 4), QUATERNION)
    )
    return Written([file], streams, "milliseconds; units from DataInfo")
