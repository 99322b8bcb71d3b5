"""Hidden effects are named, nothing where nothing is missing, and outsiders stay unknown."""

from dataclasses import asdict, dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.app.diagnosis_json import next_fit_from
from bayes_inertia.diagnosis.limits import Rules
from bayes_inertia.diagnosis.quoted_parameters import fitted_effects
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.diagnosis.unexplained import unexplained_signal
from bayes_inertia.inference.treatment import with_measured_noise
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.named_effects import remainders
from bayes_inertia.report.verdict import diagnosis_verdict, headline


@dataclass(frozen=True)
class Leak(Effect):
    """Outside the library: a thruster that leaks for ten seconds in each slew, which several
    effects together can imitate.
    """

    name: ClassVar[str] = "leak"

    def body_torque(self, p, slew, t, state):
        return p["size"] * jnp.array([0.3, -1.0, 0.0]) * jnp.exp(-(((t - 50.0) / 6.0) ** 2))


@pytest.mark.slow
def test_nothing_is_named_in_a_clean_campaign(clean_diagnosis, content_of, check_contract):
    found = clean_diagnosis
    assert (found.verdict, found.named, found.ambiguous_with, found.steps) == (
        "consistent",
        (),
        (),
        (),
    )
    content = content_of(found)
    check_contract(content)
    assert content["disagreement"] == []
    assert headline(content).startswith(
        "Nothing is missing that these slews show: the model explains"
    )


@pytest.mark.slow
def test_a_lag_is_named_and_measured(lagging, content_of, check_contract):
    assert (lagging.verdict, lagging.named) == ("named", ("wheel_command_lag",))
    content = content_of(lagging)
    check_contract(content)
    tau = next(c for c in content["candidates"] if c["effect"] == "wheel_command_lag")[
        "parameters"
    ]["tau"]
    assert abs(tau["mean"] - 0.1) < 4.0 * tau["sd"]
    assert tau["q025"] < tau["mean"] < tau["q975"]
    assert tau["unit"] == "s"
    (step,) = content["steps"]
    assert step["reduced_chi2_before"]["total"] > 10.0 > 1.2 > step["reduced_chi2_after"]["total"]
    # Three slews: two alone leave J so open that the third is predicted badly even by a perfect
    # model.
    assert step["held_out_before"] > step["held_out_after"]
    assert {w["channel"] for w in content["disagreement"]} >= {"momentum"}
    assert content["disagreement_after"] == []
    assert [e.name for e in next_fit_from(content).effects] == ["wheel_command_lag"]


@pytest.mark.long
@pytest.mark.slow
def test_a_drift_of_its_own_in_each_slew_is_named_and_measured(
    clean, content_of, check_contract, rigid_library
):
    """It has no fixed shape, and no nameless error of the rates explains it as well."""
    drifts = 1e-6 * np.random.default_rng(4).normal(size=(len(clean.slews), 3))
    slews = [
        replace(s, rate=s.rate + (s.time - s.time[0])[:, None] * drift)
        for s, drift in zip(clean.slews, drifts, strict=True)
    ]
    found = diagnose(replace(clean, slews=tuple(slews)), library=rigid_library)
    assert (found.verdict, found.named) == ("named", ("rate_bias_slew_drift",))
    assert found.steps[-1].stochastic
    assert found.nameless_lead < -found.rules.log_evidence_margin
    content = content_of(found)
    check_contract(content, rigid_library)
    rows = {c["effect"]: c["parameters"] for c in content["candidates"]}
    assert 0.5 < rows["rate_bias_slew_drift"]["sd"]["mean"] / np.sqrt(np.mean(drifts**2)) < 2.0
    assert [e.name for e in next_fit_from(content).effects] == ["rate_bias_slew_drift"]


@pytest.mark.long
@pytest.mark.slow
def test_loud_noise_is_measured_and_nothing_physical_is_named(
    clean, few_candidates, content_of, check_contract
):
    quieter = with_measured_noise(clean, dict.fromkeys(("rate", "attitude", "momentum"), 1.0 / 1.5))
    found = diagnose(quieter, library=few_candidates)
    # What is wrong is the stated noise: a record of dirt, and nothing remains.
    assert (found.steps, found.verdict, found.named) == ((), "consistent", ())
    assert {(d.kind, d.channel) for d in found.dirt} == {
        ("noise_level", channel) for channel in ("rate", "attitude", "momentum")
    }
    for channel in ("rate", "momentum"):
        n = sum(len(x) * 3 for x in found.base.residual_series[channel])
        # Median of squared second differences: see `noise`. The sd of the factor is half that of
        # the power.
        assert found.noise[channel] == pytest.approx(
            1.5, abs=4.0 * 0.5 * 1.5 * np.sqrt(1.4 * 3.9 / n)
        )
    content = content_of(
        found, unexplained=unexplained_signal(found.base) if found.verdict == "unknown" else None
    )
    check_contract(content, few_candidates)
    assert next_fit_from(content).effects == ()
    assert {w["kind"] for w in content["disagreement"]} == {"energy"}
    assert {w["channel"] for w in content["disagreement"]} == {"rate", "attitude", "momentum"}


def _is_unknown(found, library, content, check_contract):
    assert (found.verdict, found.named) == ("unknown", ())
    check_contract(content, library)
    # The fit after it holds shapes that are free, in the place of everything that was tried.
    assert fitted_effects(found) == remainders("both")
    assert next_fit_from(content).effects == remainders("both")
    assert diagnosis_verdict(content).level == "bad"


@pytest.mark.slow
def test_what_no_candidate_explains_is_unknown(
    pumped_for_few, content_of, check_contract, few_candidates
):
    unexplained = unexplained_signal(pumped_for_few.base)
    content = content_of(pumped_for_few, unexplained=unexplained)
    _is_unknown(pumped_for_few, few_candidates, content, check_contract)


@pytest.mark.long
@pytest.mark.slow
def test_what_the_library_does_not_explain_is_unknown_and_described(
    pumped, content_of, check_contract, rigid_library
):
    content = content_of(pumped, unexplained=unexplained_signal(pumped.base))
    _is_unknown(pumped, rigid_library, content, check_contract)
    assert content["unknown"]["frequency_hz"] == pytest.approx(0.3, abs=0.01)
    assert abs(content["unknown"]["axis"][1]) > 0.97
    assert any("0.3 Hz ringing about y" in s for s in diagnosis_verdict(content).sentences)


@pytest.mark.xfail(strict=True, reason="a formula imitates a pulse of alike slews: docs/limits.md")
@pytest.mark.long
@pytest.mark.slow
def test_effects_that_only_imitate_another_are_not_named(
    flight, lagging, content_of, check_contract, rigid_library
):
    rules = Rules(max_refits=3)
    campaign = flight((Leak(),), {"leak": {"size": np.array(7e-6)}})
    stages = []
    found = diagnose(
        campaign, library=rigid_library, rules=rules, progress=lambda *a: stages.append(a[0])
    )
    assert stages[0] == "fitting J and K, measuring the noise"
    assert any(s.startswith("weighing ") for s in stages)
    assert (found.verdict, found.named) == ("unknown", ())
    assert found.steps
    assert found.nameless_source.startswith("body torque")
    assert found.nameless_lead > rules.log_evidence_margin
    assert lagging.nameless_lead < -rules.log_evidence_margin
    content = content_of(found, unexplained=unexplained_signal(found.base)) | {
        "why_unknown": "imitation"
    }
    check_contract(content, rigid_library)
    assert content["rules"] == asdict(rules)
    assert any("the name would be an imitation" in s for s in diagnosis_verdict(content).sentences)
