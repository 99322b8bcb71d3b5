"""Time stamps of every clock against astropy, leap seconds and lost digits included."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from astropy.time import Time
from astropy.utils import iers

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.stamp_parts import SECOND
from bayes_inertia.tables.table import Column, Table
from bayes_inertia.tables.text_cells import TextOptions
from bayes_inertia.tables.text_table import parse_text
from bayes_inertia.tables.time_stamps import TIME_KINDS, times_to_seconds

DAY = 86400 * SECOND


@pytest.fixture(scope="module")
def moments():
    """Moments from 1980 to 2028 that lie on no day with a leap second, with their TAI."""
    with warnings.catch_warnings(), iers.conf.set_temp("auto_download", False):
        warnings.simplefilter("ignore")
        mjd = np.random.default_rng(3).uniform(44250.0, 61800.0, 400)
        leaps = iers.LeapSeconds.open(iers.IERS_LEAP_SECOND_FILE)["mjd"]
        mjd = mjd[~np.isin(np.floor(mjd) + 1, leaps)]
        time = Time(np.round(mjd, 9), format="mjd", scale="utc", precision=9)
        since = time.tai - Time("1958-01-01", scale="tai")
        ns = np.array(
            [round(a * DAY) + round(b * DAY) for a, b in zip(since.jd1, since.jd2, strict=True)]
        )
        yield time, ns


def table(*columns) -> Table:
    made = [
        c if isinstance(c, Column) else Column(np.asarray(c), single=_single(c)) for c in columns
    ]
    return Table("log.csv", {f"t{i}": column for i, column in enumerate(made)})


def _single(values) -> bool:
    return np.asarray(values).dtype == np.float32


def ns_of(kind: str, *columns) -> np.ndarray:
    made = table(*columns)
    return times_to_seconds(made, list(made.columns), kind).ns


def test_every_kind_of_stamp_gives_the_moment_that_astropy_gives(moments):
    time, ns = moments
    day_of_year = [f"{t[:4]}-{t[5:8]}T{t[9:]}" for t in time.yday]
    week, seconds = np.divmod(time.gps, 604800.0)
    given = {
        "utc": [time.isot],
        "tai": [time.tai.isot],
        "gps": [[f"{t}" for t in (time.tai - 19.0 / 86400.0).isot]],
        "tt": [time.tt.isot],
        "gps_s": [time.gps],
        "gps_ms": [time.gps * 1e3],
        "gps_week": [week, seconds],
        "unix_s": [time.unix],
        "unix_ms": [np.round(time.unix * 1e3)],
        "unix_us": [np.round(time.unix * 1e6).astype(np.int64)],
        "mjd_utc": [time.mjd],
        "mjd_tai": [time.tai.mjd],
        "jd_tt": [time.tt.jd],
        "jd_utc": [time.jd],
    }
    # Steps of 64-bit floats at these sizes, and half of what is rounded away above.
    allowed = {"jd_tt": 30e-6, "jd_utc": 30e-6, "unix_ms": 0.6e-3, "unix_us": 0.8e-6}
    for kind, columns in given.items():
        error = np.abs(ns_of(kind, *columns) - ns).max() / SECOND
        assert error < allowed.get(kind, 1e-6), kind
    assert np.abs(ns_of("utc", day_of_year) - ns).max() <= 1
    assert np.abs(ns_of("utc", [f"{t}Z" for t in time.isot]) - ns).max() <= 1


def test_a_leap_second_is_counted_on_every_clock():
    utc = ["2016-12-31T23:59:59.5", "2016-12-31T23:59:60.25Z", "2017-01-01T00:00:00+00:00"]
    assert np.diff(ns_of("utc", utc)).tolist() == [750_000_000, 750_000_000]
    assert np.diff(ns_of("gps_s", [1167264016.5, 1167264018.0])).tolist() == [1_500_000_000]
    assert np.diff(ns_of("unix_s", [1483228799.5, 1483228800.0])).tolist() == [1_500_000_000]
    # The same second in a zone east of Greenwich, and by day of year.
    for text in ("2017-01-01T00:59:60.25+01:00", "2016-366T23:59:60.25"):
        assert ns_of("utc", [text])[0] == ns_of("utc", utc)[1]


def test_clocks_line_up():
    """The first second of 2024, as a gyro, wheels and a star tracker write it."""
    same = [
        ns_of("utc", ["2024-01-01T00:00:00Z"])[0],
        ns_of("utc", ["2024-001T00:00:00.000"])[0],
        ns_of("utc", ["2024-01-01 01:00:00+0100"])[0],
        ns_of("tai", ["2024-01-01T00:00:37"])[0],
        ns_of("gps", ["2024-01-01T00:00:18"])[0],
        ns_of("tt", ["2024-01-01T00:01:09.184"])[0],
        ns_of("gps_s", [1388102418])[0],
        ns_of("gps_week", [2295], [86418.0])[0],
        ns_of("unix_ns", np.array([1704067200 * SECOND]))[0],
        ns_of("tai_s", [1704067237 + 4383 * 86400])[0],
        ns_of("mjd_utc", [60310.0])[0],
        ns_of("jd_utc", [2460310.5])[0],
    ]
    assert set(same) == {same[0]}


def test_weeks_of_ten_bits_are_counted_on_where_the_mapping_says_how_often():
    short = table(np.array([247]), np.array([86418.0]))
    assert (
        times_to_seconds(short, ["t0", "t1"], "gps_week", gps_rollovers=2).ns
        == ns_of("gps_s", [1388102418])
    ).all()


def test_digits_of_text_survive_where_a_float_rounds_them():
    text = "t,w\n1704067200.123456789,1\n1704067200.373456789,2\n1704067200.623456789,3\n"
    made = parse_text(text, "a.csv", TextOptions())
    stamps = times_to_seconds(made, ["t"], "unix_s")
    assert np.diff(stamps.ns).tolist() == [250_000_000, 250_000_000]
    assert stamps.ns[0] % SECOND == 123_456_789
    rounded = times_to_seconds(table(made.columns["t"].values), ["t0"], "unix_s")
    assert rounded.ns[0] % SECOND != 123_456_789


def test_seconds_since_the_first_stamp_keep_the_decimals_of_the_file():
    seconds = np.round(np.arange(400) * 0.1, 1)
    stamps = times_to_seconds(table(seconds), ["t0"], "s")
    assert not stamps.absolute
    assert stamps.seconds_since(0).tolist() == seconds.tolist()
    late = times_to_seconds(table([f"2024-05-01T00:00:{s:04.1f}" for s in seconds]), ["t0"], "utc")
    assert late.absolute
    assert late.seconds_since(late.first_ns).tolist() == seconds.tolist()


def test_the_clocks_own_zero_in_any_unit():
    for kind, one in {"ns": 1, "us": 10**3, "ms": 10**6, "min": 60 * SECOND}.items():
        assert ns_of(kind, [0.0, 1.0, 2.5]).tolist() == [0, one, round(2.5 * one)]


def test_rows_without_a_stamp_are_marked():
    texts = ["2024-01-01T00:00:00", "", "2024-01-01T00:00:01", "n/a"]
    assert times_to_seconds(table(texts), ["t0"], "utc").missing.tolist() == [0, 1, 0, 1]
    stamps = times_to_seconds(table([0.0, np.nan, 1.0]), ["t0"], "s")
    assert stamps.missing.tolist() == [False, True, False]
    assert np.isnan(stamps.seconds_since(0)[1])
    assert times_to_seconds(table([np.nan, np.nan]), ["t0"], "utc").missing.all()


@pytest.mark.parametrize("kind", ["utc", "tai"])
@pytest.mark.parametrize(
    "cell",
    [
        "yesterday",
        "2024-13-01T00:00:00",
        "2024-02-30T00:00:00",
        "2023-366T00:00:00",
        "2024-01-01T24:00:00",
        "2024-01-01T00:60:00",
        "2024-01-01T00:00:61",
        "2015-12-31T23:59:60",
        "2016-12-31T22:59:60",
        "0000-01-01T00:00:00",
        "1971-12-31T00:00:00",
        "2024-01-01",
    ],
)
def test_what_is_no_time_is_refused_by_its_row(kind, cell):
    with pytest.raises(CampaignError, match=r"log\.csv, row 2, column t0"):
        ns_of(kind, ["2024-01-01T00:00:00", cell])


def test_leap_seconds_and_zones_belong_to_utc_alone():
    with pytest.raises(CampaignError, match="no time of the day"):
        ns_of("tai", ["2016-12-31T23:59:60"])
    with pytest.raises(CampaignError, match="its clock is not UTC"):
        ns_of("gps", ["2024-01-01T00:00:00Z"])


def test_a_wrong_unit_of_a_clock_is_recognised_by_the_year():
    with pytest.raises(CampaignError, match="no time of this kind"):
        ns_of("unix_s", np.array([1.7e12, 1.7e12 + 1]))
    with pytest.raises(CampaignError, match="lies in the year 1967"):
        ns_of("gps_s", np.array([-4e8]))
    with pytest.raises(CampaignError, match="lies in the year 1970"):
        ns_of("unix_s", np.array([0.0, 0.25]))
    with pytest.raises(CampaignError, match="is no part of one of the column before"):
        ns_of("gps_week", np.array([86418.0]), np.array([2295.5e6]))
    with pytest.raises(CampaignError, match="no kind of time stamp"):
        ns_of("UTC", ["2024-01-01T00:00:00"])
    with pytest.raises(CampaignError, match="name two columns"):
        ns_of("gps_week", [1.0])
    with pytest.raises(CampaignError, match="holds numbers, not the dates"):
        ns_of("utc", [1.0])


def test_32_bit_floats_that_lose_the_steps_are_refused():
    steps = np.arange(100) * 0.25
    with pytest.raises(CampaignError, match=r"32-bit floats.*64-bit floats, integers or text"):
        ns_of("unix_s", (1.7e9 + steps).astype(np.float32))
    with pytest.raises(CampaignError, match="32-bit"):
        ns_of("s", (4e5 + steps).astype(np.float32))
    # From the first row on, 32 bits suffice.
    assert ns_of("s", steps.astype(np.float32)).tolist() == (steps * SECOND).tolist()
    with pytest.raises(CampaignError, match="this kind of number"):
        ns_of("jd_utc", 2460310.5 + np.arange(100) * 1e-4 / 86400.0)


def test_dates_written_alike_are_read_as_each_by_itself():
    random = np.random.default_rng(9)
    for texts in (
        [f"20{random.integers(10, 40)}-0{m}-1{m}T0{m}:1{m}:5{m}.{m}5" for m in range(1, 10)],
        [f"2016-12-31 23:59:5{s}Z" for s in range(10)],
    ):
        # One stamp by day of year makes all be read one by one.
        mixed = ns_of("utc", [*texts, "2024-001T00:00:00"])[:-1]
        assert ns_of("utc", texts).tolist() == mixed.tolist()
    for damaged in ("2024-02-30T00:00:00", "2024-01-01T00:00:60", "2024-01-01T0:00:000"):
        with pytest.raises(CampaignError, match="row 2"):
            ns_of("utc", ["2024-01-01T00:00:00", damaged])


def test_no_network_is_asked(monkeypatch):
    import socket

    def refuse(*_):
        raise AssertionError("a network was asked")

    monkeypatch.setattr(socket, "create_connection", refuse)
    monkeypatch.setattr(socket.socket, "connect", refuse)
    from bayes_inertia.tables import stamp_parts

    stamp_parts.leap_table.cache_clear()
    assert ns_of("utc", ["2024-01-01T00:00:00"]).size == 1


def test_all_kinds_are_named_once():
    assert len(set(TIME_KINDS)) == len(TIME_KINDS)


MONTHS = [
    "01 Mar 2026 12:00:00.250",  # GMAT
    "1 Mar 2026 12:00:00.250000",  # STK
    "01-Mar-2026 12:00:00.250",  # MATLAB
    "2026 MAR 01 12:00:00.250 UTC",  # SPICE
    "Mar 01, 2026 12:00:00.25",
    "2026-060 // 12:00:00.25",
]


@pytest.mark.parametrize("text", MONTHS)
def test_dates_with_names_of_months_are_read(text):
    assert ns_of("utc", [text, text])[1] == ns_of("utc", ["2026-03-01T12:00:00.25Z"])[0]


def test_a_month_that_is_none_is_refused_by_its_row():
    with pytest.raises(CampaignError, match=r"row 2, column t0.*no day of the calendar"):
        ns_of("utc", ["01 Mar 2026 12:00:00", "01 Mrz 2026 12:00:00"])


FORMATS = [
    ("%m/%d/%Y %I:%M:%S.%f %p", ["03/01/2026 12:00:00.25 PM"]),
    ("%d.%m.%y %H:%M:%S.%f", ["01.03.26 12:00:00.25"]),
    ("%Y%m%dT%H%M%S.%f", ["20260301T120000.25"]),
    ("%a %b %d %H:%M:%S.%f %Y", ["Sun Mar  1 12:00:00.25 2026"]),
    ("%d%m%Y %H%M%S.%f", [1032026.0, 120000.25]),
    ("%Y%j %H:%M:%S.%f", [2026060.0, "12:00:00.25"]),
]


@pytest.mark.parametrize(("form", "cells"), FORMATS, ids=[form for form, _ in FORMATS])
def test_a_format_reads_any_other_form(form, cells):
    made = table(*([cell] for cell in cells))
    stamps = times_to_seconds(made, list(made.columns), "utc", form=form)
    assert stamps.ns[0] == ns_of("utc", ["2026-03-01T12:00:00.25"])[0]


def test_a_format_that_does_not_fit_says_the_row_or_the_directive():
    made = table(["2026-03-01"])
    for form, what in (("%d/%m/%Y", "row 1"), ("%Q", "%Q is unknown"), ("%H:%M", "no day")):
        with pytest.raises(CampaignError, match=what):
            times_to_seconds(made, ["t0"], "utc", form=form)


SECOND_COLUMNS = [
    ("unix_s", {"sec": 1772366400, "nanosec": 250000000}, ()),
    ("unix_s", {"tv_sec": 1772366400, "tv_usec": 250000}, ()),
    ("unix_s", {"secs": 1772366400, "msec": 250}, ()),
    ("utc", {"date": "2026-03-01", "time": "12:00:00.25"}, ()),
    ("utc", {"date": "01-Mar-2026", "ms_of_day": 43200250}, ()),
    ("utc", {"year": 2026, "doy": 60, "h": 12, "min": 0, "s": 0.25}, ()),
    ("utc", {"y": 2026, "m": 3, "d": 1, "sod": 43200.25}, ("year", "month", "day", "s")),
    ("cds", {"day": 24896, "ms_of_day": 43200250}, ()),
    ("cds", {"day": 24896, "ms_of_day": 43200249, "us_of_ms": 999.999}, ()),
    ("mjd_utc", {"mjd": 61100, "sec": 43200.25}, ()),
    ("tai_s", {"coarse": 2151057637, "fine": 16384}, ("s", "s/65536")),
    ("tai_s", {"coarse": 2151057637, "fine": 64}, ("s", "s/2^8")),
    ("gps_week", {"week": 2408, "iTOW": 43218250}, ()),
]


@pytest.mark.parametrize(("kind", "cells", "units"), SECOND_COLUMNS, ids=lambda x: str(x))
def test_stamps_in_several_columns_are_added(kind, cells, units):
    made = Table("log.csv", {k: Column(np.array([v])) for k, v in cells.items()})
    stamps = times_to_seconds(made, list(cells), kind, units=units)
    assert abs(stamps.ns[0] - ns_of("utc", ["2026-03-01T12:00:00.25"])[0]) <= 1


def test_a_second_column_of_no_known_unit_or_too_much_is_refused():
    for cells, what in (
        ({"sec": 7.0, "part": 5.0}, "which unit it counts"),
        ({"sec": 7.0, "nanosec": 1e9}, "no part of one"),
        ({"sec": 7.5, "nanosec": 0.0}, "is not whole"),
    ):
        made = Table("log.csv", {k: Column(np.array([v])) for k, v in cells.items()})
        with pytest.raises(CampaignError, match=what):
            times_to_seconds(made, list(cells), "s")


def test_a_week_of_ten_bits_is_never_taken_for_one_of_1984():
    with pytest.raises(CampaignError, match=r"week 247 lies in 1984.*add gps_rollovers"):
        ns_of("gps_week", np.array([247]), np.array([86418.0]))
