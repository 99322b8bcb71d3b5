"""Numbers, residuals, correlations and limits in words."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.inference.limits import criteria
from bayes_inertia.report.criteria import (
    Criteria,
    channel_verdict,
    contraction,
    criteria_of,
    determination,
    determination_of,
)
from bayes_inertia.report.fit_sections import settings_rows
from bayes_inertia.report.formatting import number
from bayes_inertia.report.section import packaged
from bayes_inertia.report.words import (
    correlation_sentences,
    dirt_sentences,
    phrase,
    sentences,
    templates_in,
)


def page_of(template: str, **context) -> str:
    """The text of a section's body."""
    body = templates_in("").from_string(packaged(template)).render(**context)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", body))


def test_a_number_is_never_written_as_on_a_calculator():
    said = phrase("plans", "gain", "sd of Jxx", "", 1e-6, 1.06e-3, 1.0, True)
    assert "1,060 times smaller" in said
    step = {"added": "wheel_friction", "held_out_before": None}
    step |= {"reduced_chi2_before": {"total": 2.35e5}, "reduced_chi2_after": {"total": 1.0}}
    assert "from 235,000 to 1." in phrase("diagnosis", "step_text", step, [])
    folder = Path(bayes_inertia.__file__).parent / "report"
    for template in (*folder.glob("*.html"), *folder.glob("words/*.txt")):
        assert not re.search(r"\dg\W", template.read_text()), template.name


def test_what_is_said_of_stated_probabilities_is_what_was_measured():
    measured = (
        Path(__file__).parents[2] / "analyses/results/calibration/reliability.md"
    ).read_text()
    said = page_of("answers.html", d={"hypotheses": []})
    campaigns = re.findall(r"\(([\d,]+) campaigns\)", said)
    assert [f"{int(n.replace(',', ''))} campaigns" in measured for n in campaigns] == [True, True]
    claims = re.findall(r"(\d+) % of (\d+)(?: answers)? stated at (\d+) %", said)
    claims += re.findall(r"and (\d+) % of (\d+) stated at (\d+) %", said)
    rows = re.findall(r"\| ([\d.]+) % \| (\d+) \| ([\d.]+) % \|", measured)
    found = {n: np.array([float(t), float(s)]) for s, n, t in rows}
    assert len(claims) >= 4
    for true, n, stated in claims:
        assert np.all(np.abs(found[n] - [float(true), float(stated)]) <= 0.5)


def test_probabilities_beside_a_misfit_are_said_to_compare_answers_only():
    nothing = {"kind": "nothing", "effects": [], "probability": 0.8, "log_prior": -0.7}
    explained = {"hypotheses": [nothing | {"log_evidence": 0.0}], "why_unknown": ""}
    (plain,), (refuted,) = (
        sentences("diagnosis", "probabilities", explained | {"why_unknown": why})
        for why in ("", "misfit")
    )
    assert plain == "How probable each answer is: nothing is missing 80 %."
    assert refuted.startswith("The residuals fit none of the answers that were tried.")
    assert refuted.endswith("nothing is missing 80 %.")
    notes = [page_of("answers.html", d=explained | {"why_unknown": w}) for w in ("", "misfit")]
    assert ["fit none of these answers" in note for note in notes] == [False, True]


def said_of_noise(**probabilities):
    return sentences("diagnosis", "noises", {"noise_probabilities": probabilities})


def test_the_probability_of_the_noise_that_lost_is_said():
    (both,) = said_of_noise(white=0.03, correlated=0.97)
    assert "white 3 %, correlated in time (rate sensor) 97 %." in both
    assert both.endswith("Correlated noise counts unless it is far less probable.")
    (louder,) = said_of_noise(white=0.2, louder=0.8)
    assert "white 20 %, louder than measured (heavy tails, or louder at times) 80 %." in louder
    assert louder.endswith("more probable than something that the model lacks.")
    (three,) = said_of_noise(white=0.1, correlated=0.3, louder=0.6)
    assert re.findall(r"(\d+) %", three) == ["10", "30", "60"]
    assert said_of_noise() == []


@pytest.mark.parametrize(
    ("reduced", "interval", "p_white", "expected"),
    [
        (None, None, None, "no data"),
        (1.0, (0.9, 1.1), None, "as predicted"),
        (1.11, (0.9, 1.1), 0.2, "borderline"),
        (1.3, (0.9, 1.1), 0.2, "too large"),
        (1.3, (0.9, 1.1), 1e-8, "too large and structured in time"),
        (1.0, (0.9, 1.1), 1e-8, "structured in time"),
        (0.5, (0.9, 1.1), 0.2, "smaller than the stated noise"),
    ],
)
def test_channel_verdicts(reduced, interval, p_white, expected):
    fit = {
        "reduced_chi2": {"rate": reduced},
        "interval_99": {"rate": interval},
        "p_white": {"rate": p_white},
    }
    assert channel_verdict(fit, "rate", Criteria()) == expected


@pytest.mark.parametrize(
    ("value", "sd", "power", "expected"),
    [
        (-0.01180, 8.6e-5, 0, "−0.011800"),
        (99.96, 1.2, 0, "100.0"),
        (1.6886e-3, 1.4e-5, -3, "1.689"),
        (0.0, 1.8e-4, -6, "0"),
        (5.0, 0.0, 0, "5"),
        (1.0, float("nan"), 0, "1"),
    ],
)
def test_numbers_are_rounded_by_their_uncertainty(value, sd, power, expected):
    assert number(value, sd, power) == expected


@pytest.mark.parametrize(
    ("drive", "effects", "channels", "wheels", "slews", "says", "does_not_say"),
    [
        (
            "measured",
            [],
            [],
            3,
            1,
            [
                "momentum is the input",
                "slower than the rates",
                "no star-tracker fixes",
                "has 1 slew:",
                "common gain",
            ],
            ["its momentum residuals"],
        ),
        (
            "commanded",
            ["wheel_torque_gain"],
            ["attitude", "momentum"],
            3,
            8,
            ["commanded torques are the input", "comes from their prior", "its momentum residuals"],
            ["star-tracker"],
        ),
        (
            "commanded",
            [],
            ["attitude"],
            3,
            8,
            ["there are no tachometers"],
            ["its momentum residuals", "late by one time"],
        ),
        (
            "commanded",
            ["star_tracker_time_offset", "rate_sensor_delay"],
            ["attitude"],
            3,
            8,
            ["late by one time", "no number here shows"],
            [],
        ),
        (
            "commanded",
            ["star_tracker_time_offset", "rate_sensor_delay"],
            ["attitude", "momentum"],
            3,
            8,
            ["its momentum residuals"],
            ["late by one time"],
        ),
        (
            "commanded",
            [],
            ["attitude"],
            0,
            8,
            ["Nothing of known size turns the body", "ratios"],
            ["common gain", "commanded torques", "wheel"],
        ),
        (
            "commanded",
            ["inertia_change"],
            ["attitude", "momentum"],
            3,
            8,
            ["J is the tensor before its change"],
            [],
        ),
    ],
)
def test_limits(drive, effects, channels, wheels, slews, says, does_not_say):
    said = page_of(
        "limits.html",
        drive=drive,
        effects=effects,
        changes=[effect for effect in effects if effect == "inertia_change"],
        channels=channels,
        wheels=wheels,
        n_slews=slews,
        ties=[],
        free_momenta=3 * (drive == "measured"),
        angle_sensors=[],
        scale_factors=["K1", "K2", "K3"],
    )
    assert [s for s in says if s not in said] == []
    assert [s for s in does_not_say if s in said] == []


@pytest.mark.parametrize(
    ("angle_sensors", "scale_factors", "doubted"),
    [([], ["K1"], True), (["sun", "magnetometer"], ["K1"], False), ([], [], False)],
)
def test_scale_factors_are_doubted_where_nothing_measures_angles(
    angle_sensors, scale_factors, doubted
):
    said = page_of(
        "limits.html",
        drive="commanded",
        effects=[],
        changes=[],
        channels=[],
        wheels=0,
        n_slews=8,
        ties=[],
        free_momenta=0,
        angle_sensors=angle_sensors,
        scale_factors=scale_factors,
    )
    assert ("K rests mostly on its prior" in said) is doubted


def test_limits_say_which_device_ties_the_size_of_the_tensor():
    ties = ["thrust times arm of jets, known to 2 % before the fit (gain after it 0.99 ± 0.015)"]
    rest = {"drive": "commanded", "effects": [], "channels": ["attitude"], "n_slews": 8}
    rest |= {"free_momenta": 0, "changes": []}
    said = page_of("limits.html", wheels=0, ties=ties, **rest)
    assert "tied by the thrust times arm of jets, known to 2 %" in said
    assert "The sds contain what it is known to" in said
    assert "only the ratios" not in said
    assert "disagree" not in said


@pytest.mark.parametrize(("sigma", "said"), [([1e-5] * 3, False), (None, True)])
def test_the_check_says_that_a_campaign_has_no_rate_sensor(sigma, said):
    c = {"slews": [], "wheels": [], "devices": [], "principal_moments_kgm2": [1.0, 2.0, 2.5]}
    told = {"devices": False, "angles": True, "prior": (), "dirt": []}
    lines = sentences("commands", "campaign", c | {"rate_sigma_radps": sigma}, 5, told)
    assert any(line.startswith("no rate sensor: J comes from attitudes") for line in lines) is said


@pytest.mark.parametrize(("name", "advised"), [("Jxy", True), ("jets.gain", False)])
def test_slews_are_advised_for_what_slews_determine(name, advised):
    groups = {"determined": ["K1"], "partly determined": [], "not determined": [name]}
    said = page_of("determination.html", groups=groups, correlations=[], trusted=True)
    assert ("Fly slews that turn about" in said) is advised


def test_a_parameter_of_logarithmic_prior_is_judged_by_its_logarithm():
    # Of a prior 6.0 times or over e^0.8 the data leave 71 ± 29: its sd has grown in its own unit.
    row = {"sd": 29.0, "quoted_sd": 29.0, "prior_sd": 7.8, "contraction": 0.75}
    assert contraction(row) == 0.75
    assert contraction(row | {"quoted_sd": 43.5}) == pytest.approx(1.0 - 0.25 * 2.25)
    assert determination_of(row, Criteria()) == "partly determined"


@pytest.mark.parametrize(
    ("r", "expected"),
    [
        (0.5, None),
        (-0.95, "−0.95): raising one while"),
        (0.9871, "+0.987): raising or lowering both"),
        (-0.99999, "beyond −0.999"),
    ],
)
def test_correlation_sentences(r, expected):
    said = correlation_sentences(["Jxx", "K1"], [[1.0, r], [r, 1.0]])
    assert [expected in s for s in said] == ([True] if expected else [])


def test_the_limits_that_were_used_decide_what_counts_as_determined():
    strict = criteria_of({"criteria": {"determined_above": 0.99, "observable_above": 0.95}})
    assert determination(0.93, Criteria()) == "determined"
    assert determination(0.97, strict) == "partly determined"
    assert determination(0.93, strict) == "not determined"


def test_the_rules_of_the_search_decide_what_the_report_doubts():
    content = {"nameless_lead": -3.5, "alike": []}
    strict = content | {"rules": {"log_evidence_margin": 4.0, "imitation_correlation": 0.8}}
    assert phrase("diagnosis", "nameless", content) == ""
    assert "likely, not proven" in phrase("diagnosis", "nameless", strict)
    assert "correlation of 0.6" in sentences("diagnosis", "alike", content, 8)[0]
    assert "correlation of 0.8" in sentences("diagnosis", "alike", strict, 8)[0]


def test_the_report_knows_every_limit_of_the_gates():
    limits = criteria()
    assert vars(criteria_of({"criteria": limits})) == limits | {
        "determined_above": Criteria().determined_above
    }


def test_a_body_without_wheels_has_no_drive_to_speak_of(made):
    posterior = made("good")
    assert dict(settings_rows(posterior))["drive"].startswith("commanded")
    posterior.tree.attrs["bayes_inertia"] = json.dumps(posterior.attributes | {"wheels": 0})
    assert dict(settings_rows(posterior))["drive"] == "there are no wheels"


def test_noise_below_what_is_stated_is_not_called_larger():
    note = "0.44 times the stated one (or it is filtered, and not white)"
    record = {"kind": "noise_level", "channel": "rate", "treated": "ignored", "note": note}
    (said,) = dirt_sentences([record | {"slew": "", "rows": []}])
    assert said == f"Noise of another size than stated of the rate sensor ({note}), left as it is."


def test_a_slew_with_two_records_of_one_kind_is_counted_once():
    record = {"kind": "outliers", "channel": "rate", "treated": "masked", "slew": "a"}
    (said,) = dirt_sentences([record | {"rows": [3, 9]}, record | {"rows": [4]}])
    assert said == "Outliers of the rate sensor: 3 rows (a), left out."
    stamps = {"kind": "clock", "channel": "time", "slew": "a", "treated": "modelled", "rows": [3]}
    (said,) = dirt_sentences([stamps])
    assert said.startswith("Errors of the time stamps")
