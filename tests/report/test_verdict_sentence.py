"""The answer of a run in one sentence, for every kind of answer."""

import json

import pytest

from bayes_inertia.app.cli import main
from bayes_inertia.app.commands.runs import show_run
from bayes_inertia.report.verdict import verdict_sentence, with_verdict_sentence

NUMBERS = (
    "J to 0.080 %, products of inertia to 1.3 × 10⁻⁴ kg m², K to 0.012 % (1 sd, the worst of each)"
)
ROWS = {
    "Jxx": {"mean": 2.5, "sd": 1e-3, "quoted_sd": 2e-3, "prior_sd": 0.1, "unit": "kg m^2"},
    "Jyy": {"mean": 2.5, "sd": 1e-3, "quoted_sd": 1e-3, "prior_sd": 0.1, "unit": "kg m^2"},
    "Jxy": {"mean": 0.0, "sd": 1.3e-4, "quoted_sd": 1.3e-4, "prior_sd": 0.03, "unit": "kg m^2"},
    "K1": {"mean": 1.0, "sd": 1.1e-4, "quoted_sd": 1.2e-4, "prior_sd": 0.03, "unit": ""},
}
FIT = {
    "reduced_chi2": {"rate": 9.0, "attitude": 1.0, "momentum": None, "total": 5.0},
    "interval_99": {"rate": [0.9, 1.1], "attitude": [0.8, 1.2], "momentum": None, "total": None},
    "p_white": {"rate": 0.3, "attitude": None, "momentum": None, "total": None},
    "starts_agreeing": [3, 3],
}
# As large as predicted, and no white noise.
TOO_MANY = {"kind": "outliers", "channel": "rate", "slew": "", "rows": [], "treated": "ignored"}
STRUCTURED = FIT | {
    "reduced_chi2": FIT["reduced_chi2"] | {"rate": 1.02},
    "p_white": FIT["p_white"] | {"rate": 9e-4},
}


def summary(*, failed: str = "", says: str = "it says", **changes) -> dict:
    """A summary of which one gate may have failed."""
    gates = [
        {"name": name, "passed": name != failed, "says": says}
        for name in ("converged", "explained", "prior", "diagnosed")
    ]
    diagnostics = {"nested_rhat_max": 1.2, "ess_bulk_min": 50.0, "ess_tail_min": 1234.0}
    content = {"parameters": ROWS, "fit": FIT, "gates": gates, "effects": []}
    return content | {"diagnostics": diagnostics} | changes


def undetermined(name: str) -> dict:
    row = ROWS[name]
    return {
        "parameters": ROWS | {name: row | {"sd": row["prior_sd"], "quoted_sd": row["prior_sd"]}}
    }


TIES = [{"device": "jets", "relative_sd": 0.02}, {"device": "pulses", "relative_sd": 0.0}]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, f"{NUMBERS}; the model explains the data."),
        (
            {"wheels": 3},
            f"{NUMBERS[:-1]}; J on the scale of the stated wheels); the model explains the data.",
        ),
        (
            {"scale_of_J": TIES},  # of the jets the sd counts how well they are known
            f"{NUMBERS[:-1]}; J on the scale of the stated “pulses”); the model explains the data.",
        ),
        (
            # Each rate sensor has its own K: the finest must not answer for the others.
            {"parameters": ROWS | {"mems.K1": ROWS["K1"] | {"quoted_sd": 5e-4}}},
            NUMBERS.replace("K to 0.012 %", "K to 0.012 %, K of mems to 0.050 %")
            + "; the model explains the data.",
        ),
        (
            {"effects": ["rate_bias"]},
            f"{NUMBERS}; the model, with rate bias fitted along, explains the data.",
        ),
        (
            {"verdict": "consistent"},
            f"{NUMBERS}; nothing is missing that these slews show: the model explains the data.",
        ),
        (
            {"verdict": "named", "effects": ["wheel_command_lag"]},
            f"{NUMBERS}; wheel command lag was missing, and with it the model explains the data.",
        ),
        (
            {"failed": "converged"},
            "Do not use this result as it stands: the sampler has not converged "
            "(nested R-hat 1.200, 50 effective samples).",
        ),
        (
            {"failed": "explained"},
            "Do not use this result as it stands: the model does not explain the data, rate sensor "
            "(reduced χ² 9). Run “bayes-inertia diagnose” to find what is missing.",
        ),
        (
            {"failed": "explained", "fit": STRUCTURED},
            "Do not use this result as it stands: the model does not explain the data, rate sensor "
            "(residuals structured in time, p = 9 × 10⁻⁴). Run “bayes-inertia diagnose” to find "
            "what is missing.",
        ),
        (
            {"failed": "explained", "fit": STRUCTURED, "dirt": [TOO_MANY]},
            "Do not use this result as it stands: the model does not explain the data, rate sensor "
            "(residuals structured in time, p = 9 × 10⁻⁴). Outliers of the rate sensor are too "
            "many to be left out: fit with “--noise rate=student_t”, which models them.",
        ),
        (
            {"failed": "explained", "fit": STRUCTURED, "verdict": "consistent"},
            "Do not use this result as it stands: the model does not explain the data, rate sensor "
            "(residuals structured in time, p = 9 × 10⁻⁴). The diagnosis found no effect that "
            "explains it.",
        ),
        (
            {"failed": "prior", "says": "it contradicts: K1 = 0.0174. Check `units`."},
            "Do not use this result as it stands: it contradicts: K1 = 0.0174.",
        ),
        (
            {"failed": "diagnosed"},
            "Do not use this result as it stands: something is missing that no candidate explains, "
            "and J and K may be off by more than any uncertainty here.",
        ),
        (
            {"failed": "diagnosed", "effects": ["torque_remainder"]},
            "Do not use this result as it stands: something is missing that no candidate explains; "
            f"with a disturbance of free shape allowed for, {NUMBERS}.",
        ),
        (
            undetermined("K1"),
            "J to 0.080 %, products of inertia to 1.3 × 10⁻⁴ kg m² (1 sd, the worst of each); "
            "the model explains the data; K1 is not determined.",
        ),
    ],
)
def test_sentences(changes, sentence):
    assert verdict_sentence(summary(**changes)) == sentence


def test_what_could_hide_is_no_part_of_the_verdict():
    hidden = [{"parameter": "K2", "shift": 1e-3, "sd": 1e-4, "effect": "star_tracker_shift"}]
    diagnosis = {"verdict": "consistent", "could_hide": hidden}
    said = verdict_sentence(summary(verdict="consistent"), diagnosis)
    assert said.endswith("nothing is missing that these slews show: the model explains the data.")


def test_an_ambiguous_set_is_said_with_its_names():
    diagnosis = {"verdict": "ambiguous", "ambiguous_with": [["a_lag", "a_delay"]]}
    content = summary(effects=["a_lag"], verdict="ambiguous")
    assert "either a lag or a delay is missing" in verdict_sentence(content, diagnosis)
    rows = [{"effects": [name], "probability": 0.5} for name in ("a_lag", "a_delay")]
    said = verdict_sentence(content | {"averaged_over": rows})
    assert "what is missing this campaign cannot tell (a lag 50 %, a delay 50 %)" in said


@pytest.mark.parametrize(
    ("names", "begin"),
    [(["a_lag", "nothing"], "a lag"), (["a_lag", "a_delay", "nothing"], "either a lag or a delay")],
)
def test_where_nothing_may_be_missing_no_model_holds_nothing(names, begin):
    diagnosis = {"verdict": "ambiguous", "ambiguous_with": [names]}
    said = verdict_sentence(summary(effects=["a_lag"], verdict="ambiguous"), diagnosis)
    rest = (
        "may be missing, or nothing: this campaign cannot tell, and with a lag the model explains"
    )
    assert f"; {begin} {rest} the data." in said


def test_the_sentence_stands_before_the_numbers_of_a_summary():
    content = with_verdict_sentence({"format": "x", "campaign": "c"} | summary())
    assert list(content)[:3] == ["format", "campaign", "verdict_sentence"]
    assert content["parameters"] == ROWS


def test_terminal_page_and_machine_say_the_same(made, tmp_path, capsys):
    posterior = made("one_slew")
    posterior.save(tmp_path / "posterior.nc")
    expected = verdict_sentence(posterior.summary())
    assert "not determined" in expected
    show_run(posterior, tmp_path, report=True)
    assert " ".join(capsys.readouterr().out.split()).startswith(expected)
    show_run(posterior, tmp_path, report=True, as_json=True)
    assert json.loads(capsys.readouterr().out)["summary"]["verdict_sentence"] == expected
    with pytest.raises(SystemExit):
        main(["report", str(tmp_path)])
    assert " ".join(capsys.readouterr().out.split()).startswith(expected)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f'<p class="sentence caution"><b class="status">Use with care</b> {expected}</p>' in page
