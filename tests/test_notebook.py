"""What results show of themselves at a prompt and in a notebook, and one first argument for all."""

from __future__ import annotations

import sys
from dataclasses import replace
from datetime import UTC, datetime
from html import escape
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from astropy.time import Time

import bayes_inertia as bi
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.progress import progress_bar


@pytest.fixture(scope="module")
def campaign():
    return small_campaign()


@pytest.fixture(scope="module")
def estimate(campaign):
    return bi.estimate(campaign)


@pytest.fixture(scope="module")
def diagnosis(estimate):
    row = bi.Hypothesis("effects", ("rate_bias",), -2.0, 20.0, 0.97)
    candidate = bi.Candidate("rate_bias", 3, 40.0, 1e-8, 15.0)
    values = ("named", ("rate_bias",), (), (candidate,), 0.05, (), estimate, estimate, {}, {})
    return bi.Diagnosis(*values, bi.Rules(), hypotheses=(row,))


@pytest.fixture(scope="module")
def design():
    plan = bi.paper_like_plan()
    margins = ((), (), ())
    numbers = (1e-4, 3e-4, 2e-4, 900)
    sds = ({}, {}, {}, {})
    goal, limits = bi.Goal("cross_terms"), bi.Limits()
    return bi.Design(plan, goal, limits, 0, plan, *numbers, *sds, *margins, (), 1.0)


@pytest.fixture(scope="module")
def shown(campaign, estimate, diagnosis, design):
    return {
        "Campaign": campaign,
        "Slew": campaign.slews[0],
        "Estimate": estimate,
        "Diagnosis": diagnosis,
        "Design": design,
        "Observability": bi.observe(estimate),
        "Model": estimate.model,
        "LogDensity": bi.log_density(estimate),
        "GaussianPrior": bi.GaussianPrior.of_principal_moments([3.3, 2.2, 1.8], 0.05, 2.0),
        "Plan": bi.paper_like_plan(),
        "Mission": bi.Mission.of(campaign),
    }


@pytest.mark.parametrize(
    ("name", "cell"),
    [
        ("Campaign", "<th>fixes</th>"),
        ("Slew", "<td>rate</td>"),
        ("Estimate", "<td>Jyz</td>"),
        ("Diagnosis", "<td>97.0%</td>"),
        ("Design", "<th>angle [deg]</th>"),
        ("Observability", "<td>determined</td>"),
        ("Model", "<td>Jyz</td>"),
        ("LogDensity", "<td>Jyz</td>"),
        ("GaussianPrior", "<td>log Jyy</td>"),
        ("Plan", "<th>angle [deg]</th>"),
        ("Mission", "<td>Jyz</td>"),
    ],
)
def test_an_object_prints_in_three_lines_and_as_a_table(shown, name, cell):
    text, page = repr(shown[name]), shown[name]._repr_html_()
    assert text.startswith(f"{name} ")
    assert text.count("\n") < 3
    assert not {"array", "[["} & set(text.split())
    assert max(map(len, text.splitlines())) < 120
    assert cell in page
    assert escape(text.splitlines()[0]) in page


def test_names_of_a_campaign_are_escaped(campaign):
    page = replace(campaign, name="<script>alert(1)</script>")._repr_html_()
    assert "<script>" not in page


def test_tables_are_data_frames(shown, diagnosis):
    seen = shown["Observability"]
    table = seen.to_dataframe()
    assert list(table.index) == list(seen.names)
    assert table.loc["Jxy", "sd"] == seen["Jxy"].sd
    assert table["verdict"].isin(["determined", "partly", "weakly", "prior"]).all()
    assert diagnosis.to_dataframe().loc["rate_bias", "named"]


@pytest.mark.slow
def test_a_campaign_its_model_and_its_estimate_are_one_first_argument(campaign, estimate):
    of_all = [bi.observe(x) for x in (campaign, bi.Model(campaign), estimate)]
    assert [seen.names for seen in of_all] == [of_all[0].names] * 3
    np.testing.assert_array_equal(bi.estimate(bi.Model(campaign)).theta, estimate.theta)
    with pytest.raises(bi.CampaignError, match="a str was given"):
        bi.observe("my_campaign")


def test_a_design_begins_where_the_campaign_ended(campaign):
    limits = bi.Limits(total_time=1.0)
    for source in (campaign, bi.Model(campaign), bi.Mission.of(campaign)):
        with pytest.raises(bi.DesignError, match="1 s allowed"):
            bi.design_plan(source, limits=limits)


STAMPS = pd.date_range("2026-03-01T12:00:00", periods=4, freq="250ms")


OF_ASTROPY = Time(STAMPS.to_numpy(), scale="utc")


@pytest.mark.parametrize(
    "time",
    [
        STAMPS,
        OF_ASTROPY,
        OF_ASTROPY.tai,
        list(OF_ASTROPY),
        OF_ASTROPY - OF_ASTROPY[0],
        STAMPS.tz_localize("Europe/Berlin"),
        pd.Series(STAMPS),
        STAMPS.to_numpy(),
        [stamp.to_pydatetime() for stamp in STAMPS],
        STAMPS - STAMPS[0],
    ],
    ids=[
        "index",
        "Time",
        "TAI",
        "list of Time",
        "TimeDelta",
        "with a zone",
        "series",
        "datetime64",
        "datetime",
        "timedelta",
    ],
)
def test_datetimes_are_seconds_from_the_first_row(time):
    slew = bi.Slew("a", 0.0, time, rate=np.zeros((4, 3)))
    np.testing.assert_allclose(slew.time, [0.0, 0.25, 0.5, 0.75], atol=1e-12)


def test_a_start_may_be_a_datetime():
    moment = datetime(1970, 1, 2, tzinfo=UTC)
    of_astropy = Time(moment, scale="utc").tt  # of another scale
    for start in (moment, pd.Timestamp(moment), np.datetime64("1970-01-02"), of_astropy):
        assert bi.Slew("a", start, np.arange(2.0), rate=np.zeros((2, 3))).start == 86400.0
        assert bi.Change("fuel", start).time == 86400.0


def test_a_time_without_a_zone_is_refused():
    with pytest.raises(bi.CampaignError, match="its scale is local, which has no zone; give"):
        bi.Slew("a", Time("2026-01-01", scale="local"), np.arange(2.0), rate=np.zeros((2, 3)))


@pytest.mark.parametrize("start", [datetime(1601, 1, 1), np.datetime64("9999-01-01")])
def test_a_date_that_nanoseconds_cannot_count_is_refused(start):
    with pytest.raises(bi.CampaignError, match="a date is before 1678 or after 2261; give"):
        bi.Slew("a", start, np.arange(2.0), rate=np.zeros((2, 3)))


def test_masked_times_of_astropy_are_no_dates():
    masked = Time(STAMPS.to_numpy(), scale="utc")
    masked[1] = np.ma.masked
    for time in (masked, masked - masked[0]):
        with pytest.raises(bi.CampaignError, match="a time is not a number"):
            bi.Slew("a", 0.0, time, rate=np.zeros((4, 3)))


def test_missing_cells_of_a_data_frame_are_readings_that_are_not_there():
    """Of pandas' own kinds of columns, which hold `NA`."""
    rates = pd.DataFrame({"x": [0.1, None, 0.3], "y": [1, 2, None], "z": [0.0, 0.0, 0.0]})
    rates = rates.astype({"x": "Float64", "y": "Int64"})
    slew = bi.Slew("a", 0.0, pd.Series([0, 1, 2], dtype="Int64"), rate=rates)
    np.testing.assert_array_equal(slew.rate, [[0.1, 1, 0], [np.nan, 2, 0], [0.3, np.nan, 0]])
    with pytest.raises(bi.CampaignError, match="a time or a value is not a finite number"):
        bi.InputStream(np.arange(3.0), rates["x"])
    with pytest.raises(bi.CampaignError, match="a time is not a number"):
        bi.Slew("a", 0.0, pd.Series([0, None, 2], dtype="Int64"), rate=rates)


@pytest.mark.parametrize("library", ["pandas", "astropy.time"])
def test_a_library_that_another_thread_is_importing_is_no_trouble(library, monkeypatch):
    """`fit` imports in a thread; a module stands in `sys.modules` before it has its names."""
    monkeypatch.setitem(sys.modules, library, ModuleType(library))
    rate = np.array([[0.1, None, 0.3], [1, 2, 3]], dtype=object)
    slew = bi.Slew("a", datetime(1970, 1, 2), np.arange(2.0), rate=rate)
    np.testing.assert_array_equal(slew.rate[0], [0.1, np.nan, 0.3])


def test_a_missing_time_is_refused():
    time = [np.datetime64("2026-01-01"), np.datetime64("NaT", "D")]
    with pytest.raises(bi.CampaignError, match="a time is not a number"):
        bi.Slew("a", 0.0, np.array(time), rate=np.zeros((2, 3)))


def test_a_bar_is_shown_where_it_is_asked_for(campaign, monkeypatch):
    stages = []
    monkeypatch.setattr("bayes_inertia.progress._on_terminal", lambda console: _recording(stages))
    monkeypatch.setenv("FORCE_COLOR", "1")
    bi.observe(campaign, progress=True)
    assert "asking each slew what it tells" in stages
    assert "finding the optimum" in stages
    stages.clear()
    bi.observe(campaign, progress=False)
    assert stages == []


class _recording:
    def __init__(self, stages):
        self.stages = stages

    def __enter__(self):
        return lambda stage, done, of: self.stages.append(stage)

    def __exit__(self, *error):
        return None


def test_the_bar_of_a_notebook_needs_no_widgets(monkeypatch):
    from rich.console import Console

    lines = []

    class Line:
        def update(self, content, raw):
            lines.append(content["text/plain"])

    monkeypatch.setattr("IPython.display.display", lambda *content, **how: Line())
    with progress_bar(Console(force_jupyter=True)) as progress:
        progress("sampling, steps", 0, 10)
        progress("sampling, steps", 5, 10)
        progress("predicting", 0, 0)
    assert lines[0].endswith("sampling, steps 0/10")
    assert lines[-2].endswith("predicting")
    assert lines[-1] == ""
