"""The card on top of a report: one verdict, J and K, the next slew, the origin."""

import json
import re

import numpy as np
import pytest
import xarray as xr

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.report.fit_sections import (
    determination_section,
    parameters_section,
    result_sections,
    standard_sections,
)
from bayes_inertia.report.formatting import number
from bayes_inertia.report.page import page_facts, render, render_page
from bayes_inertia.report.words import phrase

FORECAST = {
    "axis": "y",
    "angle_deg": 60.0,
    "before": (0.0207, 0.02086, 0.02103),
    "after": (3e-5, 6.5e-5, 1.4e-4),
}
HIDDEN = {
    "parameter": "Jxy",
    "shift": 8.7e-4,
    "sd": 1.1e-4,
    "unit": "kg m^2",
    "effect": "wheel_misalignment",
    "unseen": False,
}


def diagnosis_of(verdict: str) -> dict:
    """As much of a diagnosis as its verdict needs."""
    empty = ("named", "ambiguous_with", "disagreement", "steps", "candidates", "skipped", "dirt")
    content = {key: [] for key in empty}
    return content | {"verdict": verdict, "noise": {}, "unknown": None, "could_hide": [HIDDEN]}


def test_the_card_shows_the_tensor_in_rows_with_the_quoted_sds(made):
    posterior = made("good")
    page = render_page("t", result_sections(posterior))
    rows = posterior.summary()["parameters"]
    cells = re.findall(r"<td><b>([^<]*)</b> <span>± ([^<]*)</span></td>", page)
    names = ["Jxx", "Jxy", "Jxz", "Jxy", "Jyy", "Jyz", "Jxz", "Jyz", "Jzz", "K1", "K2", "K3"]
    sds = [rows[name]["quoted_sd"] for name in names]
    means = [rows[name]["mean"] for name in names]
    expected = [(number(m, sd), number(sd, sd)) for m, sd in zip(means, sds, strict=True)]
    assert cells == expected


def test_the_card_shows_the_scale_factors_of_every_rate_sensor(made, monkeypatch):
    posterior = made("good")
    summary = posterior.summary()
    rows = dict.fromkeys(("mems.K1", "mems.K2", "my_effect.K1"), summary["parameters"]["K1"])
    summary |= {"parameters": summary["parameters"] | rows, "effects": ["my_effect"]}
    monkeypatch.setattr(type(posterior), "summary", lambda _: summary)
    card, _ = result_sections(posterior)
    lines = {symbol: len(column) for symbol, column in card.context["matrices"].items()}
    assert lines == {"J / trace J": 0, "J": 3, "K": 3, "K of mems": 2}


@pytest.mark.parametrize(
    ("kind", "status"),
    [("good", "Trusted"), ("one_slew", "Use with care"), ("thrown", "Refused")],
)
def test_a_page_has_one_verdict(pages, kind, status):
    assert re.findall(r'class="status">([^<]*)<', pages[kind]) == [status]
    assert len(re.findall(r'<p class="sentence', pages[kind])) == 1


def test_a_diagnosis_that_finds_nothing_makes_no_refused_fit_green(made):
    card, _ = result_sections(made("thrown"), diagnosis_of("consistent"))
    assert (card.context["level"], card.context["status"]) == ("bad", "Refused")
    assert card.context["quoted"] is False
    page = render_page("t", [card])
    assert "<td><b>" in page
    assert "±" not in page


def test_the_next_slew_is_forecast_of_what_may_be_used_only(made):
    card, _ = result_sections(made("good"), None, FORECAST)
    assert "ends 4,303 arcsec off" in card.pictures[0].caption
    assert "13 arcsec with those of this fit (95 %: below 29)" in card.pictures[0].caption
    assert result_sections(made("thrown"), None, FORECAST)[0].pictures == ()
    assert standard_sections(made("good"), forecast=FORECAST)[0].pictures != ()


def test_a_bound_stands_once_below_the_verdict_with_its_condition_and_unit(made):
    page = render_page("t", result_sections(made("good"), diagnosis_of("consistent")))
    said = "If there is wheel misalignment, too weak to be found, Jxy may be off by up to"
    assert page.count(said) == 1
    assert "8.7 × 10⁻⁴ kg m² (7.9 times the model's sd)" in phrase(
        "diagnosis", "could_hide", [HIDDEN]
    )
    assert page.index('class="sentence') < page.index(said) < page.index('class="matrices')


@pytest.mark.slow
def test_the_head_says_where_a_result_comes_from_and_leaves_out_what_is_not_known(made):
    mission = {"name": "MOST", "operator": "an <operator>", "document": "AOCS-12"}
    facts = page_facts(mission, sha256="0123456789abcdef", version="0.5.0")
    assert list(facts) == ["mission", "operator", "document", "SHA-256", "bayes-inertia"]
    assert facts["SHA-256"] == "0123456789ab"
    page = render(made("good"), origin={"date": "2026-11-26", "data": "campaign_3"})
    head = re.search(r'<p class="facts">(.*?)</p>', page)[1]
    assert re.findall(r"<b>([^<]*)</b>", head) == ["2026-11-26", "campaign_3", "0.1.0"]
    assert "an &lt;operator&gt;" in render_page("t", [], facts)


def test_of_a_tensor_without_a_size_only_ratios_are_said(posteriors):
    posterior = Posterior(posteriors["good"].tree.copy(deep=True))
    attributes = posterior.attributes | {"scale_of_J": []}
    posterior.tree.attrs["bayes_inertia"] = json.dumps(attributes)
    assert [row["quoted_sd"] for row in posterior.summary()["derived"].values()] == [None] * 3
    page = render_page("t", [parameters_section(posterior)])
    lines = re.findall(r'<tr><th scope="row">(.*?)<small.*?</th>(.*?)</tr>', page, re.S)
    rows = {name: re.findall(r"<td[^>]*>(.*?)</td>", cells, re.S) for name, cells in lines}
    assert list(rows)[:2] == ["Jxx/trace", "Jyy/trace"]
    assert ">determined</span>" in rows["Jxx/trace"][-1]
    # The quoted sd, and the model's.
    assert {(rows[n][2], rows[n][4]) for n in (*ELEMENTS, "I1", "I2", "I3")} == {("–", "–")}
    section = determination_section(posterior)
    groups = section.context["groups"]
    told = "J is drawn at its mean trace"
    assert told in section.pictures[0].caption
    assert told not in determination_section(posteriors["good"]).pictures[0].caption
    assert "Jxx/trace" in groups["determined"]
    assert not set(ELEMENTS) & {name for names in groups.values() for name in names}


@pytest.mark.slow
def test_the_page_of_a_refused_fit_says_that_it_may_determine_nothing(made):
    said = "would hold if the fit could be trusted"
    pages = {
        kind: render_page("t", [f(made(kind)) for f in (determination_section, parameters_section)])
        for kind in ("thrown", "good")
    }
    assert [said in pages[kind] for kind in ("thrown", "good")] == [True, False]
    # It has no such column to explain.
    assert ["Contraction" in pages[kind] for kind in ("thrown", "good")] == [False, True]


def test_what_is_known_by_its_logarithm_is_judged_by_its_logarithm(made):
    posterior = made("good")
    told, sd = posterior.summary()["parameters"], posterior.samples.std(axis=0, ddof=1)
    # K1 by its logarithm, twice as uncertain before; the others by their own sds.
    before = np.where(
        np.array(posterior.names) == "K1", 2.0 * sd / posterior.samples.mean(0), np.nan
    )
    estimate = posterior.tree["estimate"].to_dataset().assign(prior_log_sd=("parameter", before))
    posterior.tree["estimate"] = xr.DataTree(estimate)
    rows = Posterior(posterior.tree).summary()["parameters"]
    assert rows["K1"]["contraction"] == pytest.approx(0.75, abs=1e-3)
    assert rows["K2"] == told["K2"]
