"""Can I trust it? The verdict on a summary."""

import pytest

from bayes_inertia.report.verdict import fit_verdict

LARGE = {"rate": 2.0, "attitude": 1.0, "momentum": 1.0, "total": 1.5}


SMALL = {"rate": 0.5, "attitude": 1.0, "momentum": 1.0, "total": 0.8}


ONLY_TOTAL = {"rate": 1.04, "attitude": 1.04, "momentum": 1.04, "total": 1.08}


AGREE = {"ratio": 0.81, "dof": 48.0, "p_value": 0.8, "factor": 1.0}
DISAGREE = {"ratio": 4.0, "dof": 48.0, "p_value": 1e-9, "factor": 2.0}


@pytest.fixture
def summary_of(attributes):
    """A function that makes a summary of two parameters, changed."""
    return lambda **changes: _changed(attributes("good"), **changes)


def _changed(summary: dict, **changes) -> dict:
    row = {"mean": 1.0, "sd": 1e-3, "quoted_sd": 1.1e-3, "prior_sd": 0.1}
    summary["parameters"] = {"Jxx": row, "K1": row}
    passed = {gate["name"]: gate["passed"] for gate in summary["gates"]} | changes.pop("passed", {})
    summary["gates"] = [
        {"name": name, "passed": value, "says": "it says"} for name, value in passed.items()
    ]
    of_K1 = {
        key: changes[key]
        for key in ("sd", "quoted_sd", "decisive_slew", "sd_without_it", "sd_with_it_again")
        if key in changes
    }
    summary["parameters"] = summary["parameters"] | {"K1": row | of_K1}
    summary["fit"] = summary["fit"] | {
        key: changes[key]
        for key in ("reduced_chi2", "p_white", "starts_agreeing", "dispersion")
        if key in changes
    }
    summary["diagnostics"] = summary["diagnostics"] | changes.get("diagnostics", {})
    return summary


@pytest.mark.parametrize(("of_J", "level"), [(1e-3, "good"), (0.05, "caution")])
def test_a_gain_at_its_prior_counts_where_J_cannot_be_told_from_it(summary_of, of_J, level):
    """Torquers beside wheels leave J alone; the gain of thrusters alone is the size of J."""
    summary = summary_of()
    row = summary["parameters"]["Jxx"]
    gain = row | {"sd": 0.095, "quoted_sd": 0.095}
    J = row | {"sd": of_J, "quoted_sd": of_J}
    summary["parameters"] = summary["parameters"] | {"Jxx": J, "thrusters.gain": gain}
    verdict = fit_verdict(summary, n_slews=5)
    assert verdict.level == level
    assert "Not determined by this campaign: thrusters" in " ".join(verdict.sentences)


@pytest.mark.parametrize(
    ("changes", "level", "says"),
    [
        ({"dispersion": AGREE}, "good", "The slews agree: they scatter 0.90 times"),
        (
            {"dispersion": DISAGREE},
            "good",
            "The slews disagree: they scatter 2.00 times as much as noise makes them",
        ),
        (
            {"decisive_slew": "slew 4", "sd_without_it": 9e-3, "sd_with_it_again": 7e-4},
            "good",
            "K1 rests on slew 4 alone: no other slew checks it, and an error of that slew would "
            "not show. Fly slew 4 once more: then two slews check each other, and the sd shrinks "
            "by 30 %.",
        ),
        ({"sd": 0.09, "quoted_sd": 0.09}, "caution", "Not determined by this campaign: K1"),
        ({"starts_agreeing": [1, 3]}, "caution", "Only 1 of 3 starts"),
        (
            {"passed": {"converged": False}, "diagnostics": {"nested_rhat_max": 1.3}},
            "bad",
            "disagree (nested R-hat 1.300",
        ),
        (
            {"passed": {"converged": False}, "diagnostics": {"ess_tail_min": 120.0}},
            "bad",
            "only 120 effective samples",
        ),
        (
            {"passed": {"converged": False}, "diagnostics": {"tau_max": 40.0}},
            "bad",
            "50 kept steps are too few",
        ),
        (
            {"passed": {"explained": False}, "reduced_chi2": LARGE},
            "bad",
            "residuals (rate) are larger",
        ),
        (
            {
                "passed": {"explained": False},
                "p_white": {"rate": 0.3, "attitude": None, "momentum": 1e-9, "total": None},
            },
            "bad",
            "residuals (momentum)",
        ),
        (
            {"passed": {"explained": False}, "reduced_chi2": ONLY_TOTAL},
            "bad",
            "all channels together",
        ),
        (
            {"passed": {"explained": False}, "reduced_chi2": SMALL},
            "bad",
            "smaller than the stated noise",
        ),
        ({"passed": {"another": False}}, "bad", "It says."),
    ],
)
def test_verdicts(summary_of, changes, level, says):
    verdict = fit_verdict(summary_of(**changes), n_slews=5)
    assert verdict.level == level
    assert says in " ".join(verdict.sentences)


def test_a_misfit_leaves_no_sd_to_quote(summary_of):
    verdict = fit_verdict(summary_of(passed={"explained": False}, reduced_chi2=LARGE), n_slews=5)
    assert verdict.title.startswith("Do not use these numbers")
    assert "No sd is quoted" in " ".join(verdict.sentences)


def test_the_limits_that_were_used_are_named(summary_of):
    summary = summary_of(passed={"converged": False}, diagnostics={"nested_rhat_max": 1.3})
    said = fit_verdict(summary | {"criteria": {"nested_rhat_below": 1.05}}, n_slews=5)
    assert "wanted below 1.05" in said.sentences[0]
    assert "wanted below 1.01" in fit_verdict(summary, n_slews=5).sentences[0]


def test_after_a_diagnosis_nobody_is_sent_to_diagnose(summary_of):
    plain, diagnosed = (
        " ".join(fit_verdict(summary_of(passed=gates, reduced_chi2=LARGE), n_slews=5).sentences)
        for gates in ({"explained": False}, {"explained": False, "diagnosed": False})
    )
    assert "Run “bayes-inertia diagnose”" in plain
    assert "bayes-inertia diagnose" not in diagnosed
    assert "an effect is missing" in diagnosed


def test_nothing_is_said_of_scale_factors_that_a_spacecraft_without_gyros_has_not(summary_of):
    of = [{"effects": [], "probability": 0.9}, {"effects": ["wheel_friction"], "probability": 0.1}]
    with_gyros = summary_of() | {"averaged_over": of}
    without = with_gyros | {"parameters": {"Jxx": with_gyros["parameters"]["Jxx"]}}
    for summary, says in ((with_gyros, "J, K and the quoted sd"), (without, "J and the quoted sd")):
        assert any(s.startswith(says) for s in fit_verdict(summary, 5).sentences)
