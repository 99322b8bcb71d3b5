"""J and K where it is not known which effect is the true one."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from support.refits import fitted_with, refitted

from bayes_inertia.app.diagnosed_fit import next_fit
from bayes_inertia.app.diagnosis_json import next_fit_from
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.app.investigation import Investigation
from bayes_inertia.diagnosis.model_averaging import (
    AlternativeParameters,
    alternative_parameters,
    averaged_posterior,
)
from bayes_inertia.diagnosis.residual_scan import scan_residuals
from bayes_inertia.diagnosis.result import AlternativeEffect, Step
from bayes_inertia.diagnosis.stochastic_candidates import STOCHASTIC_CANDIDATES
from bayes_inertia.inference.optimizer import move_to
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.settings import Settings
from bayes_inertia.physics.effects import ConstantTorque
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.diagnosis_sections import diagnosis_sections
from bayes_inertia.report.diagnosis_verdict import diagnosis_verdict
from bayes_inertia.report.fit_sections import standard_sections


@pytest.mark.long
@pytest.mark.slow
def test_each_member_of_an_ambiguous_set_has_its_own_J_and_K(
    torqued, content_of, check_contract, rigid_library
):
    assert torqued.verdict == "ambiguous"
    others = alternative_parameters(torqued)
    members = list(torqued.ambiguous_with[0][1:])
    assert [o.effect for o in others] == members
    (step,) = torqued.steps
    odds = [math.exp(r.log_bayes_factor - step.log_bayes_factor) for r in step.alternatives]
    odds.append(math.exp(torqued.nameless_lead))
    assert [o.probability for o in others] == pytest.approx([x / (1.0 + sum(odds)) for x in odds])
    *with_names, nameless = others
    assert nameless.effect.startswith("nameless_")
    assert np.all(nameless.sd > torqued.base.sd[:9])
    assert np.all(np.abs(nameless.mean - torqued.base.theta[:9]) < 5.0 * nameless.sd)
    random = {e.name for e in STOCHASTIC_CANDIDATES}
    held = {r.effect: r.estimate for r in step.alternatives}
    for other in with_names:
        if other.effect in random:
            # Its size was learnt at the fit without it.
            direct = held[other.effect]
        else:
            direct = fitted_with(torqued.base.model, other.effect)
        assert np.all(np.abs(other.mean - direct.theta[:9]) < 0.01 * direct.sd[:9])
        np.testing.assert_allclose(other.sd, direct.robust_sd[:9], rtol=0.02)
    content = content_of(torqued, alternatives=others)
    check_contract(content, rigid_library)
    stored = next_fit_from(json.loads(json.dumps(content)), rigid_library)
    direct = next_fit(Investigation(torqued, scan_residuals(torqued.base), alternatives=others))
    assert (stored.verdict, stored.effects) == (direct.verdict, direct.effects)
    assert (stored.treatment, stored.drive) == (direct.treatment, direct.drive)
    for again, other in zip(stored.alternatives, others, strict=True):
        assert (again.effect, again.probability, again.names) == (
            other.effect,
            other.probability,
            other.names,
        )
        assert np.array_equal(again.mean, other.mean)
        assert np.array_equal(again.covariance, other.covariance)
    begun = (
        "The fit below includes constant torque. "
        "J and K are averaged over what may be true (constant torque "
    )
    assert any(said.startswith(begun) for said in diagnosis_verdict(content).sentences)
    sections = {section.title: section for section in diagnosis_sections(content)}
    assert "J and K, whichever it is" in sections
    rows = sections["How probable each answer is"].context["rows"]
    assert rows[0]["answer"] == "constant torque"


@pytest.mark.slow
def test_a_set_beside_another_effect_is_exchanged_with_that_effect_kept(lagging):
    """The lag was named, its alternative is the delay; a constant torque was named after it."""
    (first,), at = lagging.steps, lagging.final
    delay = refitted(lagging.base, "rate_sensor_delay")
    torque = refitted(at, "constant_torque")
    alternative = AlternativeEffect(
        "rate_sensor_delay", delay.estimate, first.log_bayes_factor - 1.0, 0.9
    )
    steps = (
        replace(first, alternatives=(alternative,)),
        Step("constant_torque", at, torque.estimate, 0.0),
    )
    (other,) = alternative_parameters(
        replace(lagging, verdict="ambiguous", steps=steps, final=torque.estimate)
    )
    direct = fitted_with(at.model, "rate_sensor_delay", "constant_torque")
    assert other.probability == pytest.approx(1.0 / (1.0 + math.e))
    assert np.all(np.abs(other.mean - direct.theta[:9]) < 0.01 * direct.sd[:9])
    # Without the effect named beside it J and K would be others.
    assert np.any(np.abs(other.mean - delay.estimate.theta[:9]) > 0.1 * direct.sd[:9])


@pytest.mark.slow
def test_one_in_place_of_several_leaves_these_out_and_several_in_place_of_one_stand_together(
    lagging,
):
    """The lag and a constant torque were named; the delay alone, or both, do as well."""
    (first,), model = lagging.steps, lagging.base.model
    torque = refitted(lagging.final, "constant_torque").estimate
    alone = fitted_with(model, "rate_sensor_delay")
    both = fitted_with(model, "rate_sensor_delay", "constant_torque")
    weight = first.log_bayes_factor
    rivals = (
        AlternativeEffect(
            "rate_sensor_delay", alone, weight, math.nan, replaces=("constant_torque",)
        ),
        AlternativeEffect("rate_sensor_delay", both, weight, math.nan, beside=("constant_torque",)),
    )
    steps = (
        replace(first, alternatives=rivals),
        Step("constant_torque", lagging.final, torque, 0.0),
    )
    named = replace(lagging, verdict="ambiguous", steps=steps, final=torque)
    one, several = alternative_parameters(named)
    assert (one.effect, several.effect) == (
        "rate_sensor_delay",
        "rate_sensor_delay and constant_torque",
    )
    for other, direct in ((one, alone), (several, both)):
        assert np.all(np.abs(other.mean - direct.theta[:9]) < 0.01 * direct.sd[:9])
    assert np.any(np.abs(one.mean - several.mean) > 0.1 * both.sd[:9])


@pytest.mark.long
@pytest.mark.slow
def test_what_has_no_shape_is_exchanged_beside_another_effect_too(lagging):
    """The lag was named; after it a random torque, or as well a constant one."""
    (first,), at = lagging.steps, lagging.final
    torque = refitted(at, "constant_torque").estimate
    noise = next(e for e in STOCHASTIC_CANDIDATES if e.name == "torque_noise")
    random = move_to(at, Model(at.model.campaign, (*at.effects_fitted, noise)))
    beside = (AlternativeEffect("constant_torque", torque, -1.0, math.nan),)
    steps = (first, Step("torque_noise", at, random, 0.0, beside, stochastic=True))
    ambiguous = replace(lagging, verdict="ambiguous", steps=steps, final=random)
    (other,) = alternative_parameters(ambiguous)
    assert np.all(np.abs(other.mean - torque.theta[:9]) < 0.05 * torque.sd[:9])


@pytest.fixture(scope="module")
def plain(torqued):
    """The posterior with the effect that was named."""
    settings = Settings(seed=2, ensembles=2, walkers=32, steps=60, max_steps=60)
    return fit(torqued.base.model.campaign, effects=(ConstantTorque(),), seed=2, settings=settings)


@pytest.mark.long
@pytest.mark.slow
def test_averaged_J_and_K_are_the_mixture_and_the_posterior_stays(plain, tmp_path):
    given = plain.summary()["parameters"]
    names = tuple(given)[:9]
    mean, sd = plain.samples[:, :9].mean(0), plain.samples[:, :9].std(0)
    far = AlternativeParameters(
        "star_tracker_shift",
        "constant_torque",
        0.3,
        names,
        mean + 4.0 * sd,
        np.diag((0.5 * sd) ** 2),
    )
    near = AlternativeParameters(
        "magnetic_dipole", "constant_torque", 0.1, names, mean - 2.0 * sd, np.diag(sd**2)
    )
    whole = averaged_posterior(plain, (far, near), seed=3)
    # Exactly: mean 0.3 * 4 - 0.1 * 2 = 1, variance 0.6 + 0.3 / 4 + 0.1 + (0.3 * 16 + 0.1 * 4 - 1) =
    # 4.975 in sds of the first.
    rows = whole.summary()["parameters"]
    n = whole.tree["averaged"][names[0]].size
    for name, m, s in zip(names, mean, sd, strict=True):
        error = math.sqrt(4.975 / n) + math.sqrt(
            0.6 / plain.attributes["diagnostics"]["ess_bulk_min"]
        )
        draws = whole.tree["averaged"][name].values.ravel()
        assert abs((draws.mean() - m) / s - 1.0) < 4.0 * error
        assert abs(draws.std() / s - math.sqrt(4.975)) < 4.0 * error
        assert rows[name]["mean"] == np.median(draws)
        low, high = np.quantile(draws, [0.05, 0.95])
        assert rows[name]["quoted_sd"] in (None, pytest.approx((high - low) / 3.2897, rel=1e-4))
    assert rows["constant_torque.torque_x"] == given["constant_torque.torque_x"]
    assert np.array_equal(whole.samples, plain.samples)
    assert averaged_posterior(plain, (), seed=3) is plain
    over = whole.summary()["averaged_over"]
    assert [row["effects"] for row in over] == [
        ["constant_torque"],
        ["star_tracker_shift"],
        ["magnetic_dipole"],
    ]
    assert [row["probability"] for row in over] == pytest.approx([0.6, 0.3, 0.1])
    again = Posterior.load(whole.save(tmp_path / "posterior.nc"))
    assert again.summary() == whole.summary()
    assert again.tree["averaged"]["Jxx"].attrs["units"] == "kg m^2"
    parameters = next(
        section for section in standard_sections(again) if section.title == "Parameters"
    )
    assert (
        parameters.context["averaged"]
        == "constant torque 60 %, star tracker shift 30 %, magnetic dipole 10 %"
    )


@pytest.mark.long
@pytest.mark.slow
def test_an_average_holds_no_tensor_that_no_body_has(plain):
    names = plain.names[:9]
    edge = np.array(
        [4.0, 2.0, 2.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    )  # 4 = 2 + 2: half of all draws about it break the triangle inequality
    other = AlternativeParameters(
        "star_tracker_shift", "constant_torque", 0.5, tuple(names), edge, 1e-4 * np.eye(9)
    )
    whole = averaged_posterior(plain, (other,), seed=1)
    moments = whole.tree["averaged"]["principal_moment"].values.reshape(-1, 3)
    assert np.all(moments[:, 0] + moments[:, 1] >= moments[:, 2])
    assert np.mean(moments[:, 2] > 3.9) == pytest.approx(
        0.5, abs=4.0 * math.sqrt(0.25 / len(moments))
    )


@pytest.mark.slow
def test_only_an_ambiguous_diagnosis_has_alternative_parameters(lagging, content_of):
    assert alternative_parameters(lagging) == ()
    assert content_of(lagging)["alternatives"] == []
