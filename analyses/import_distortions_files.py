"""Distortions of the clocks and of the files of a raw log."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from import_distortions_log import (
    FIRST,
    Columns,
    RawLog,
    a_file_each,
    csv_text,
    utc_clock,
)
from import_distortions_readings import Distorted, Kind
from import_formats_base import gps_seconds, utc_texts

_UNIX = FIRST.astype("datetime64[s]").astype(int)
_CDS_DAY = int((FIRST.astype("M8[D]") - np.datetime64("1958-01-01", "D")).astype(int))
_COUNTERS = {"ms": 1e3, "us": 1e6, "s": 1.0}
_PAUSE_S = 300.0  # Between the slews of the example.
_GAP_S = 1.0  # Longer steps divide sessions.
Written = tuple[list[Path], dict[str, dict[str, Any]]]


def _ints(values: np.ndarray) -> np.ndarray:
    return np.rint(values).astype(np.int64).astype(str)


def sec_nanosec(time: np.ndarray) -> tuple[Columns, dict[str, Any]]:
    """A ROS 2 stamp."""
    whole = np.floor(time + 1e-9)
    columns = {"sec": _ints(_UNIX + whole), "nanosec": _ints(np.maximum(time - whole, 0.0) * 1e9)}
    return columns, {"names": ["sec", "nanosec"], "kind": "unix_s"}


def date_and_time(time: np.ndarray) -> tuple[Columns, dict[str, Any]]:
    """A date and a time of the day."""
    texts = [text.split("T") for text in utc_texts(time, FIRST).tolist()]
    columns = {"date": np.array([t[0] for t in texts]), "time": np.array([t[1] for t in texts])}
    return columns, {"names": ["date", "time"], "kind": "utc"}


def cds(time: np.ndarray) -> tuple[Columns, dict[str, Any]]:
    """Day since 1958 and milliseconds of the day."""
    ms = np.rint((time + 43200.0) * 1e3)
    columns = {"day": _ints(_CDS_DAY + ms // 86400000), "ms_of_day": _ints(ms % 86400000)}
    return columns, {"names": ["day", "ms_of_day"], "kind": "cds"}


def cuc(time: np.ndarray) -> tuple[Columns, dict[str, Any]]:
    """Coarse seconds and fine 2^-16 s from a zero of its own."""
    counts = np.rint((time + 456789000.0) * 65536.0).astype(np.int64)
    columns = {"coarse": (counts // 65536).astype(str), "fine": (counts % 65536).astype(str)}
    said = {"names": ["coarse", "fine"], "kind": "s", "units": ["s", "s/65536"]}
    return columns, {**said, "epoch": "campaign"}


def gps_week(time: np.ndarray, *, bits: bool, told: bool) -> tuple[Columns, dict[str, Any]]:
    """GPS week, perhaps of ten bits, and seconds of the week."""
    seconds = gps_seconds(time, FIRST)
    week = seconds // 604800.0
    tow = np.array([f"{s:.3f}" for s in seconds % 604800.0])
    said: dict[str, Any] = {"names": ["week", "tow"], "kind": "gps_week"}
    more = {"gps_rollovers": 2} if bits and told else {}
    return {"week": _ints(week % 1024 if bits else week), "tow": tow}, said | more


_MONTHS = {
    "GMAT": lambda y, m, d, t: f"{d:02} {m} {y} {t}",
    "STK": lambda y, m, d, t: f"{d} {m} {y} {t}",
    "MATLAB": lambda y, m, d, t: f"{d:02}-{m}-{y} {t}",
    "SPICE": lambda y, m, d, t: f"{y} {m.upper()} {d:02} {t}",
    "day of year": lambda y, m, d, t: f"{y}-{d + 59:03}T{t}",
}


def month_names(time: np.ndarray, *, form: str) -> tuple[Columns, dict[str, Any]]:
    """Dates as other programs write them; all are of one day in March."""
    texts = [text.split("T") for text in utc_texts(time, FIRST).tolist()]
    cells = [_MONTHS[form](day[:4], "Mar", int(day[8:]), clock[:12]) for day, clock in texts]
    return {"utc": np.array(cells)}, {"names": ["utc"], "kind": "utc"}


def counter(time: np.ndarray, *, unit: str, start: float, period: float):
    """A counter that begins anew after a period [counts]."""
    counts = np.rint(time * _COUNTERS[unit] * 1e6) / 1e6 + period - start
    said = {"names": [f"t_{unit}"], "kind": unit, "epoch": "campaign"}
    texts = [f"{c:.3f}" for c in counts % period] if unit == "s" else _ints(counts % period)
    return {f"t_{unit}": np.array(texts)}, said


def coarse(time: np.ndarray, *, step: float) -> tuple[Columns, dict[str, Any]]:
    """Stamps in steps."""
    columns, said = utc_clock(np.floor(time / step + 1e-9) * step)
    return columns, said


def _of(rng: np.random.Generator, choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _clocked(clock: Callable, words: str = "") -> Kind:
    return lambda log, rng: (replace(log, clock=clock), words)


def wraps(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A counter wraps at 2^16, 2^24, 2^31 or 2^32, or once a day, at any moment of the log."""
    unit, period, name = _of(
        rng,
        (
            ("ms", 2.0**32, "2^32 ms"),
            ("us", 2.0**32, "2^32 us"),
            ("ms", 2.0**31, "2^31 ms"),
            ("ms", 2.0**24, "2^24 ms"),
            ("ms", 2.0**16, "2^16 ms"),
            ("s", 86400.0, "86400 s"),
        ),
    )
    end = float(log.streams["rate"].time[-1])
    at = float(rng.uniform(0.0, end))
    clock = partial(counter, unit=unit, start=at * _COUNTERS[unit], period=period)
    return replace(log, clock=clock), f"{name}, after {at:.0f} s"


def dates_alone(time: np.ndarray) -> tuple[Columns, dict[str, Any]]:
    """Dates that do not say of which clock they are."""
    return {"date": utc_texts(time, FIRST)}, {"names": ["date"], "kind": "utc"}


def second_session(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A second session, from a slew on or in the middle of one, starts at zero again."""
    rate = log.streams["rate"].time
    starts = rate[1:][np.diff(rate) > _GAP_S]
    inside, which = bool(rng.integers(2)), _of(rng, ("all", "all", *log.streams))
    at = float(rng.uniform(rate[0], rate[-1])) if inside else float(_of(rng, starts))
    for holds in log.streams if which == "all" else (which,):
        time = log.streams[holds].time
        log = log.changed(holds, time=np.where(time >= at, time - at, time))
    return log, f"{which}, after {at:.0f} s"


def wrong_clock(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A stream's clock is stated as another one."""
    holds = _of(rng, tuple(log.streams))
    what = _of(rng, ("gps for utc", "tai for utc", "ms for s"))

    def write(log: RawLog, folder: Path) -> Written:
        files, entries = a_file_each(log, folder)
        time = entries[holds]["time"]
        said = time | ({"kind": what.split()[0]})
        return files, entries | {holds: {**entries[holds], "time": said}}

    if what != "ms for s":
        log = replace(log, clock=dates_alone)
    return replace(log, write=write), f"{holds}, {what}"


def no_time(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Files of one slew each, of one row every 0.25 s without a stamp; a rate is stated."""
    rate = _of(rng, (4.0, 4.0, 5.0, 1.0))

    def write(log: RawLog, folder: Path) -> Written:
        grid = log.streams["rate"].time
        sessions = np.split(np.arange(len(grid)), np.flatnonzero(np.diff(grid) > _GAP_S) + 1)
        files = []
        for k, rows in enumerate(sessions, 1):
            columns: Columns = {}
            for stream in log.streams.values():
                at = np.searchsorted(stream.time, grid[rows] - 1e-6)
                at = np.minimum(at, len(stream.time) - 1)
                same = np.abs(stream.time[at] - grid[rows]) < 1e-3
                columns |= {n: np.where(same, c[at], "") for n, c in stream.cells().items()}
            files.append(folder / f"log_{k}.csv")
            files[-1].write_text(csv_text(columns), encoding="utf-8")
        said = {"files": ["log_*.csv"], "time": {"rate_hz": rate, "epoch": "file"}}
        return files, dict.fromkeys(log.streams, said)

    return replace(log, write=write, more={"cut": {"between_files_s": _PAUSE_S}}), f"{rate:g} Hz"


def damaged(log: RawLog, rng: np.random.Generator, name: str, damage: Callable) -> Distorted:
    """The bytes of one file are changed after it was written."""
    holds = _of(rng, tuple(log.streams))

    def write(log: RawLog, folder: Path) -> Written:
        files, entries = a_file_each(log, folder)
        file = folder / entries[holds]["files"][0]
        file.write_bytes(damage(file.read_bytes()))
        return files, entries

    return replace(log, write=write), f"{log.streams[holds].file}.csv, {name}"


def loss_of_power(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Zero bytes after the last line, and perhaps a line that breaks off before them."""
    zeros, cut = int(rng.integers(1, 9000)), int(rng.integers(0, 30))
    words = f"{zeros} zero bytes after the last line less {cut} bytes"
    return damaged(log, rng, words, lambda data: data[: len(data) - cut] + b"\0" * zeros)


def truncated(log: RawLog, rng: np.random.Generator) -> Distorted:
    """A download that broke off."""
    share = float(rng.uniform(0.2, 0.99))
    words = f"{share:.0%} of its bytes"
    return damaged(log, rng, words, lambda data: data[: int(share * len(data))])


def text_file(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Other text files: a trailing delimiter in the head, semicolons, comments, byte-order mark."""
    form = _of(rng, ("tab after the names", "comma after the names", "semicolons", "comments"))

    def write(log: RawLog, folder: Path) -> Written:
        files, entries = a_file_each(log, folder)
        for file, holds in zip(files, log.streams, strict=True):
            columns = log.table(holds)
            if form == "semicolons":
                text = csv_text({n: np.char.replace(c, ".", ",") for n, c in columns.items()}, ";")
                file.write_bytes(text.encode("utf-8-sig"))
            elif form == "comments":
                file.write_text(f"# made by a logger\n#\n# {csv_text(columns)}", encoding="latin-1")
            else:
                delimiter = "\t" if form.startswith("tab") else ","
                file.write_text(csv_text(columns, delimiter, delimiter), encoding="utf-8")
        return files, entries

    return replace(log, write=write), form


def long_form(log: RawLog, rng: np.random.Generator) -> Distorted:
    """One row a parameter, all streams in one file or one file each."""
    together, head = bool(rng.integers(2)), _of(rng, ("parameter,value", "name,eng_value"))

    def write(log: RawLog, folder: Path) -> Written:
        texts: dict[str, list[str]] = {}
        for holds, stream in log.streams.items():
            stamps = [
                ",".join(row) for row in zip(*log.clock(stream.time)[0].values(), strict=True)
            ]
            for name, cells in stream.cells().items():
                rows = zip(stamps, cells.tolist(), strict=True)
                lines = [f"{t},{name},{cell}\n" for t, cell in rows if cell]
                texts.setdefault("log" if together else log.streams[holds].file, []).extend(lines)
        stamp, said = log.clock(log.streams["rate"].time)
        files = [folder / f"{stem}.csv" for stem in texts]
        for file, lines in zip(files, texts.values(), strict=True):
            file.write_text(f"{','.join(stamp)},{head}\n{''.join(lines)}", encoding="utf-8")
        stems = {h: "log" if together else s.file for h, s in log.streams.items()}
        return files, {h: {"files": [f"{stems[h]}.csv"], "time": said} for h in log.streams}

    words = "all in one file" if together else "a file each"
    return replace(log, write=write, clock=utc_clock), f"{head}, {words}"


def _numbers(cells: np.ndarray, empty: float | None) -> list:
    """Cells as numbers; texts where they are none."""
    try:
        return [float(cell) if cell else empty for cell in cells.tolist()]
    except ValueError:
        return cells.tolist()


def arrays_by_name(log: RawLog, rng: np.random.Generator) -> Distorted:
    """One JSON document of arrays by name for each stream."""

    def write(log: RawLog, folder: Path) -> Written:
        files, entries = [], {}
        for holds, stream in log.streams.items():
            arrays = {name: _numbers(cells, None) for name, cells in log.table(holds).items()}
            files.append(folder / f"{stream.file}.json")
            files[-1].write_text(json.dumps(arrays), encoding="utf-8")
            entries[holds] = {"files": [files[-1].name], "time": log.clock(stream.time)[1]}
        return files, entries

    return replace(log, write=write), ""


def overlap(log: RawLog, rng: np.random.Generator) -> Distorted:
    """Downloads that overlap: each file repeats the end of the one before."""
    count, share = int(rng.integers(2, 5)), float(rng.uniform(0.02, 0.5))
    cuts = np.sort(rng.uniform(0.1, 0.9, count - 1))

    def write(log: RawLog, folder: Path) -> Written:
        files, entries = [], {}
        for holds, stream in log.streams.items():
            columns = log.table(holds)
            span = float(np.ptp(log.streams["rate"].time))
            edges = [-np.inf, *(cuts * span).tolist(), np.inf]
            for k in range(count):
                first = edges[k] - share * span / count
                rows = (stream.time >= first) & (stream.time < edges[k + 1])
                files.append(folder / f"{stream.file}_{k + 1}.csv")
                cells = {name: column[rows] for name, column in columns.items()}
                files[-1].write_text(csv_text(cells), encoding="utf-8")
            said = {"files": [f"{stream.file}_*.csv"], "time": log.clock(stream.time)[1]}
            entries[holds] = said
        return files, entries

    return replace(log, write=write), f"{count} files, {share / count:.0%} of the log twice"


def broken_hdf5(log: RawLog, rng: np.random.Generator) -> Distorted:
    """HDF5 that was cut off, whose writer holds it, or that is whole."""
    what = _of(rng, ("cut off", "held by its writer", "whole"))
    share = float(rng.uniform(0.3, 0.99))

    def write(log: RawLog, folder: Path) -> Written:
        file = folder / "log.h5"
        with h5py.File(file, "w") as made:
            for holds, stream in log.streams.items():
                for name, cells in log.table(holds).items():
                    made[f"{stream.file}/{name}"] = _numbers(cells, np.nan)
        if what == "cut off":
            file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
        said = log.clock(log.streams["rate"].time)[1]
        entry = {"files": [file.name], "time": said}
        return [file], {h: {**entry, "table": s.file} for h, s in log.streams.items()}

    return replace(log, write=write, locked=what == "held by its writer"), what


CLOCKS: dict[str, Kind] = {
    "seconds and nanoseconds": _clocked(sec_nanosec),
    "date and time of the day": _clocked(date_and_time),
    "CDS": _clocked(cds),
    "CUC": _clocked(cuc),
    "counter wraps": wraps,
    "second session from zero": second_session,
    "wrong clock": wrong_clock,
    "stamps in steps": lambda log, rng: _in_steps(log, rng),
    "GPS week": lambda log, rng: _weeks(log, rng),
    "dates with names of months": lambda log, rng: _named_months(log, rng),
}
"""Distortions of clocks by name."""

FILES: dict[str, Kind] = {
    "no time column": no_time,
    "loss of power": loss_of_power,
    "broken off": truncated,
    "other text": text_file,
    "one row a parameter": long_form,
    "arrays by name": arrays_by_name,
    "overlapping downloads": overlap,
    "HDF5": broken_hdf5,
}
"""Distortions of files by name."""


def _in_steps(log: RawLog, rng: np.random.Generator) -> Distorted:
    step = _of(rng, (0.05, 0.1, 0.5, 1.0))
    return replace(log, clock=partial(coarse, step=step)), f"{step} s"


def _weeks(log: RawLog, rng: np.random.Generator) -> Distorted:
    bits, told = bool(rng.integers(4)), bool(rng.integers(2))
    words = f"ten bits{', told' if told else ''}" if bits else "whole"
    return replace(log, clock=partial(gps_week, bits=bits, told=told)), words


def _named_months(log: RawLog, rng: np.random.Generator) -> Distorted:
    form = _of(rng, tuple(_MONTHS))
    return replace(log, clock=partial(month_names, form=form)), form
