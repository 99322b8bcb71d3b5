"""What the report says of a diagnosis."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.app.diagnosed_fit import Investigation
from bayes_inertia.app.diagnosis_json import to_json
from bayes_inertia.diagnosis.residuals import Window, scan_residuals
from bayes_inertia.diagnosis.unexplained import unexplained_signal
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.report.fit_sections import diagnosis_sections
from bayes_inertia.report.verdict import diagnosis_verdict, headline


def test_noise_is_worded_as_noise():
    louder = Dirt("noise_level", "rate", "", (), "modelled", "3 times what is stated").json()
    content = {"verdict": "consistent", "named": [], "ambiguous_with": [], "dirt": [louder]}
    assert headline(content) == (
        "Nothing is missing that these slews show: "
        "without the dirt in the telemetry the model explains the data."
    )


def test_ambiguity_is_worded_as_such():
    content = {
        "verdict": "ambiguous",
        "named": ["rate_bias", "wheel_friction"],
        "ambiguous_with": [["wheel_friction", "viscous_torque"]],
    }
    assert (
        headline(content) == "Something is missing: either wheel friction or viscous torque. "
        "This campaign cannot tell. Besides: rate bias."
    )
    weak = content | {"named": ["rate_bias"], "ambiguous_with": [["rate_bias", "nothing"]]}
    expected = "Something may be missing: either rate bias or nothing. This campaign cannot tell."
    assert headline(weak) == expected


@pytest.mark.slow
def test_times_from_an_epoch_are_shown_from_each_slews_start(pumped_for_few):
    """Telemetry may count its seconds from 1980."""
    pumped = pumped_for_few
    where, unknown, late = scan_residuals(pumped.base), unexplained_signal(pumped.base), 1.4e9
    shifted = replace(
        where,
        windows=tuple(
            replace(w, t_start=w.t_start + late, t_end=w.t_end + late) for w in where.windows
        ),
        cells={
            name: replace(cells, edges=cells.edges + late) for name, cells in where.cells.items()
        },
    )
    torque = replace(unknown, torque=replace(unknown.torque, time=unknown.torque.time + late))
    now, then = (
        to_json(Investigation(pumped, seen, unexplained=signal))
        for seen, signal in ((where, unknown), (shifted, torque))
    )
    assert [w["t_start"] for w in then["disagreement"]] == [w.t_start for w in shifted.windows]
    for a, b in (
        (c["pictures"]["before"]["channels"]["rate"]["edges"], c["pictures"]["torque"]["time"])
        for c in (now, then)
    ):
        assert np.all(np.diff(a, axis=1) > 0.0)
        assert np.asarray(b)[:, 0].tolist() == [0.0] * 3
    assert diagnosis_verdict(now).sentences[0] == diagnosis_verdict(then).sentences[0]
    assert "e+09" not in diagnosis_verdict(then).sentences[0]


@pytest.mark.slow
def test_a_conspicuous_stretch_of_a_consistent_campaign_is_not_called_a_disagreement(
    clean_diagnosis,
):
    found = clean_diagnosis
    where = scan_residuals(found.base)
    window = Window("rate", where.slews[0], "axis 1", 3.0, 9.0, "shift", 20.0, 0.04)
    said = diagnosis_verdict(
        to_json(Investigation(found, replace(where, windows=(window,))))
    ).sentences[0]
    assert "one campaign of 25" in said
    assert "disagrees" not in said


@pytest.mark.slow
def test_the_report_says_and_draws_it(lagging, pumped_for_few, content_of):
    content = content_of(lagging)
    sections = diagnosis_sections(content)
    assert [s.title for s in sections] == [
        "Where does the base model disagree?",
        "Candidates",
        "How probable each answer is",
        "What adding effects changes",
        "J and K, whichever it is",
    ]
    assert diagnosis_verdict(content).title == "Found what is missing: wheel command lag."
    assert [len(s.pictures) for s in sections] == [2, 1, 0, 2, 0]
    unknown = unexplained_signal(pumped_for_few.base)
    last = diagnosis_sections(content_of(pumped_for_few, unexplained=unknown))[-1]
    assert last.title == "What nothing explains"
    assert len(last.pictures) >= 1


@pytest.mark.slow
def test_a_name_that_something_without_one_matches_is_called_likely(lagging, content_of):
    content = content_of(lagging)
    sure, tied = (
        diagnosis_verdict(content | {"nameless_lead": lead}).sentences
        for lead in (content["nameless_lead"], 0.0)
    )
    assert len(tied) == len(sure) + 1
    assert any("likely, not proven" in s for s in tied)
    assert not any("likely, not proven" in s for s in sure)
