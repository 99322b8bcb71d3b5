"""What is missing: strong hidden effects are named, nothing is named where nothing is missing, and outsiders stay unknown."""

import json
import math
from dataclasses import dataclass, replace
from importlib import import_module
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.app.diagnosed_fit import fitted_effects, next_fit
from bayes_inertia.app.diagnosis_json import next_fit_from, to_json
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.app.investigation import Investigation
from bayes_inertia.app.measured_noise import with_measured_noise
from bayes_inertia.design.correction_slew import correction_forecast
from bayes_inertia.diagnosis.blind_spots import even_odds, furthest, undetected
from bayes_inertia.diagnosis.model_averaging import Alternative, alternatives, averaged
from bayes_inertia.diagnosis.residual_scan import Window, disagreement
from bayes_inertia.diagnosis.result import Rival, Step
from bayes_inertia.diagnosis.search import Rules, diagnose, nameless_lead
from bayes_inertia.diagnosis.unexplained import unknown_torque
from bayes_inertia.errors import EffectError
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.sampler import Settings
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import (
    LIBRARY,
    ConstantTorque,
    EachSlew,
    FlexibleMode,
    InertiaChange,
    WheelCommandLag,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import Normal, ParameterSpace, scalar
from bayes_inertia.physics.slew_input import idle_slew
from bayes_inertia.report.diagnosis_sections import diagnosis_sections
from bayes_inertia.report.diagnosis_verdict import diagnosis_verdict, headline
from bayes_inertia.report.fit_sections import standard_sections

# The module; the package exports its function under the same name.
search = import_module("bayes_inertia.diagnosis.search")
# Without the flexible mode, whose every refit compiles code of its own.
RIGID = tuple(e for e in LIBRARY if e.name != "flexible_mode")


@dataclass(frozen=True)
class Pump(Effect):
    """Outside the library: a torque at 0.3 Hz about -y that never stops."""

    name: ClassVar[str] = "pump"

    def parameters(self, campaign):
        return (scalar("torque", unit="N m", prior=Normal(0.0, 1e-4)),)

    def body_torque(self, p, slew, t, state):
        return -p["torque"] * jnp.sin(2.0 * jnp.pi * 0.3 * t) * jnp.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Leak(Effect):
    """Outside the library: a thruster that leaks for ten seconds in each slew, which several effects together can imitate."""

    name: ClassVar[str] = "leak"

    def body_torque(self, p, slew, t, state):
        return p["size"] * jnp.array([0.3, -1.0, 0.0]) * jnp.exp(-(((t - 50.0) / 6.0) ** 2))


@pytest.fixture(scope="module")
def flight():
    """`flight(effects, values, seed)`: a campaign of three slews at 2 Hz; all have one shape, so that they share compiled code."""
    plan = replace(paper_like_plan(), telemetry_period=0.5)
    plan = replace(plan, slews=(plan.slews[0], plan.slews[3], plan.slews[4]))
    template = planned_campaign(plan, most_like_mission())

    def fly(effects=(), values=None, seed=11):
        return draw_flight(
            template, plan, seed, effects=effects, values=values, vary=False
        ).campaign

    return fly


@pytest.fixture(scope="module")
def clean(flight):
    return flight()


@pytest.fixture(scope="module")
def lagging(flight):
    return diagnose(flight((WheelCommandLag(),), {"wheel_command_lag": {"tau": np.array(0.1)}}))


@pytest.fixture(scope="module")
def pumped(flight):
    return diagnose(flight((Pump(),), {"pump": {"torque": np.array(3e-4)}}), library=RIGID)


def content_of(found, **more):
    changed = bool(found.steps) or any(f > 1.0 for f in found.noise.values())
    after = disagreement(found.final, stated=False) if changed else None
    return to_json(Investigation(found, Rules(), disagreement(found.base), after, **more))


def test_nothing_is_named_in_a_clean_campaign(clean):
    found = diagnose(clean)
    assert (found.verdict, found.named, found.ambiguous_with, found.steps) == (
        "consistent",
        (),
        (),
        (),
    )
    content = content_of(found)
    check_contract(content)
    assert content["disagreement"] == []
    assert headline(content) == "Nothing is missing: the model explains the data."


def test_a_lag_is_named_and_measured(lagging):
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
    # Three slews: two alone leave J so open that the third is predicted badly even by a perfect model.
    assert step["held_out_before"] > step["held_out_after"]
    assert {w["channel"] for w in content["disagreement"]} >= {"momentum"}
    assert content["disagreement_after"] == []
    assert [e.name for e in next_fit_from(content).effects] == ["wheel_command_lag"]


def test_a_constant_torque_is_named(flight):
    found = diagnose(
        flight((ConstantTorque(),), {"constant_torque": {"torque": np.array([1e-5, 0.0, -5e-6])}})
    )
    assert found.verdict == "named"
    assert found.named == ("constant_torque",)


def test_loud_noise_is_measured_and_nothing_physical_is_named(clean):
    # The noise of campaigns where nothing but the noise is wrong is a verdict of its own.
    quieter = with_measured_noise(clean, dict.fromkeys(("rate", "attitude", "momentum"), 1.0 / 1.5))
    found = diagnose(quieter)
    assert (found.steps, found.verdict, found.named) == ((), "named", ("noise_level",))
    for channel in ("rate", "momentum"):
        n = sum(len(x) * 3 for x in found.base.residual_series[channel])
        # Median of squared second differences: see `noise`. The sd of the factor is half that of the power.
        assert found.noise[channel] == pytest.approx(
            1.5, abs=4.0 * 0.5 * 1.5 * np.sqrt(1.4 * 3.9 / n)
        )
    content = content_of(
        found, unexplained=unknown_torque(found.base) if found.verdict == "unknown" else None
    )
    check_contract(content)
    assert next_fit_from(content).effects == ()
    assert {w["kind"] for w in content["disagreement"]} == {"energy"}
    assert {w["channel"] for w in content["disagreement"]} == {"rate", "attitude", "momentum"}


def test_noise_is_worded_as_noise():
    content = {"verdict": "named", "named": ["noise_level"], "ambiguous_with": []}
    assert headline(content) == "No effect is missing, but the noise is larger than stated."


def test_what_no_candidate_explains_is_unknown_and_described(pumped):
    assert (pumped.verdict, pumped.named) == ("unknown", ())
    content = content_of(pumped, unexplained=unknown_torque(pumped.base))
    check_contract(content, RIGID)
    assert content["unknown"]["frequency_hz"] == pytest.approx(0.3, abs=0.01)
    assert abs(content["unknown"]["axis"][1]) > 0.97
    assert fitted_effects(pumped) == ()
    assert diagnosis_verdict(content).level == "bad"
    assert any("0.3 Hz ringing about y" in s for s in diagnosis_verdict(content).sentences)


def test_the_next_correction_slew_before_and_after(lagging, flight):
    # A lag is removed by feedback and leaves nothing at rest, but the K that was fitted without it does.
    found = correction_forecast(lagging.base, lagging.final)
    assert found.expected[0] > 1.5 * found.promised[0]
    assert found.updated[0] < found.expected[0]
    same = correction_forecast(lagging.final, lagging.final)
    assert same.expected == same.updated
    content = content_of(lagging, correction=found)
    check_contract(content)
    assert any("should need a correction of" in s for s in diagnosis_verdict(content).sentences)


def test_the_next_slew_is_flown_with_the_tensor_after_its_change(flight):
    size = np.array([0.15, 0.1, -0.1, 0.0, 0.0, 0.0])
    first = idle_slew([0.0, 1.0]).context
    assert np.allclose(
        InertiaChange().afterwards().inertia({"change": size}, first, np.eye(3)),
        np.diag([1.15, 1.1, 0.9]),
    )
    assert np.allclose(InertiaChange().inertia({"change": size}, first, np.eye(3)), np.eye(3))
    final = estimate(
        Model(flight((InertiaChange(),), {"inertia_change": {"change": size}}), (InertiaChange(),))
    )
    # One estimate on both sides: what differs is the tensor flown with, before and after the change, and the spacecraft's own.
    found = correction_forecast(final, final)
    assert len({found.promised, found.expected, found.updated}) == 3


def test_what_differs_from_slew_to_slew_is_drawn_from_its_prior_in_the_next_slew(clean):
    """It was as in the first slew; what the next slew will have, only the prior tells."""
    apart = EachSlew.of(ConstantTorque(sigma=1e-4), clean)
    base, final = estimate(Model(clean)), estimate(Model(clean, (apart,)))
    forecast = correction_forecast(base, final)
    assert forecast.expected[1] > 2.0 * forecast.promised[1]


def test_wheels_about_two_axes_turn_no_body_anywhere(lagging):
    campaign = lagging.final.model.campaign
    flat = replace(
        campaign,
        wheels=tuple(
            replace(w, axis_B=axis)
            for w, axis in zip(campaign.wheels, np.eye(3)[[0, 1, 1]], strict=True)
        ),
    )
    assert (
        correction_forecast(
            lagging.base, replace(lagging.final, model=replace(lagging.final.model, campaign=flat))
        )
        is None
    )


def test_times_from_an_epoch_are_shown_from_each_slews_start(pumped):
    """Telemetry may count its seconds from 1980."""
    where, unknown, late = disagreement(pumped.base), unknown_torque(pumped.base), 1.4e9
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
        to_json(Investigation(pumped, Rules(), seen, unexplained=signal))
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


def test_a_conspicuous_stretch_of_a_consistent_campaign_is_not_called_a_disagreement(clean, flight):
    found = diagnose(clean)
    where = disagreement(found.base)
    window = Window("rate", where.slews[0], "axis 1", 3.0, 9.0, "shift", 20.0, 0.04)
    said = diagnosis_verdict(
        to_json(Investigation(found, Rules(), replace(where, windows=(window,))))
    ).sentences[0]
    assert "one campaign of 25" in said
    assert "disagrees" not in said


def test_the_report_says_and_draws_it(lagging, pumped):
    content = content_of(lagging)
    sections = diagnosis_sections(content)
    assert [s.title for s in sections] == [
        "What is missing?",
        "Where does the base model disagree?",
        "Candidates",
        "What adding effects changes",
    ]
    assert sections[0].context["verdict"].title == "Found what is missing: wheel command lag."
    assert [len(s.pictures) for s in sections] == [0, 2, 1, 2]
    last = diagnosis_sections(content_of(pumped, unexplained=unknown_torque(pumped.base)))[-1]
    assert last.title == "What nothing explains"
    assert len(last.pictures) >= 1


def test_effects_that_only_imitate_another_are_not_named(flight, lagging):
    found = diagnose(flight((Leak(),), {"leak": {"size": np.array(1.2e-5)}}), library=RIGID)
    assert (found.verdict, found.named) == ("unknown", ())
    assert len(found.steps) >= 2
    assert found.nameless_lead == nameless_lead(found.steps, len(found.candidates)) > Rules().margin
    assert lagging.nameless_lead < -Rules().margin
    assert nameless_lead((), len(RIGID)) == -math.inf
    content = content_of(found, unexplained=unknown_torque(found.base)) | {
        "why_unknown": "imitation"
    }
    check_contract(content, RIGID)
    assert any(
        "an imitation of something that is not among the candidates" in s
        for s in diagnosis_verdict(content).sentences
    )


def test_an_effect_that_a_later_one_makes_needless_leaves_no_trace(lagging):
    """A step that took the wrong effect first is undone: what remains is weighed against the base fit, not against the wrong one."""
    rules, at = Rules(), lagging.base
    marks = search._marks(at, None)
    found = {c.effect: c for c in search._candidates(marks)}
    wrong = search._fitted(at, marks, found["rate_sensor_delay"], None)
    first = Step("rate_sensor_delay", at, wrong.after, wrong.log_bayes_factor)
    marks = search._marks(wrong.after, None)
    right = search._fitted(
        wrong.after,
        marks,
        {c.effect: c for c in search._candidates(marks)}["wheel_command_lag"],
        None,
    )
    second = Step("wheel_command_lag", wrong.after, right.after, right.log_bayes_factor)
    (step,) = search._without_needless([first, second], None, rules)
    (direct,) = lagging.steps
    assert (step.added, step.before) == ("wheel_command_lag", at)
    assert step.log_bayes_factor == pytest.approx(direct.log_bayes_factor, abs=0.5)
    assert not np.isin(
        np.arange(99)[at.model.space.slice_of("rate_sensor_delay")], step.after.free
    ).any()
    # The other way round the effect is needed and stays.
    both = [
        Step("wheel_command_lag", at, lagging.final, direct.log_bayes_factor),
        Step("rate_sensor_delay", lagging.final, right.after, 0.0),
    ]
    assert [s.added for s in search._without_needless(both, None, rules)] == [
        "wheel_command_lag",
        "rate_sensor_delay",
    ]


def test_candidates_need_names_of_their_own(clean):
    with pytest.raises(EffectError, match="2 candidates have this name"):
        diagnose(clean, library=(ConstantTorque(), ConstantTorque(sigma=1e-6)))
    with pytest.raises(EffectError, match="give a FlexibleMode itself"):
        diagnose(clean, library=(EachSlew.of(FlexibleMode(), clean),))


def test_a_column_without_numbers_is_no_column(clean):
    empty = replace(
        clean,
        slews=tuple(replace(s, position_N=np.full((len(s.time), 3), np.nan)) for s in clean.slews),
    )
    usable, skipped = search._usable(empty, RIGID)
    assert "gravity_gradient" not in {e.name for e in usable}
    assert "gravity_gradient" in dict(skipped)


def test_ambiguity_is_worded_as_such():
    content = {
        "verdict": "ambiguous",
        "named": ["rate_bias", "wheel_friction"],
        "ambiguous_with": [["wheel_friction", "viscous_torque"]],
    }
    assert (
        headline(content)
        == "Something is missing: either wheel friction or viscous torque. This campaign cannot tell which. Besides: rate bias."
    )


@pytest.fixture(scope="module")
def torqued(flight):
    """A weak constant torque, which three slews cannot tell from a dipole or a star-tracker shift."""
    return diagnose(
        flight(
            (ConstantTorque(),), {"constant_torque": {"torque": 1e-7 * np.array([1.0, -1.0, 1.0])}}
        ),
        library=RIGID,
    )


def test_each_member_of_an_ambiguous_set_has_its_own_J_and_K(torqued):
    assert torqued.verdict == "ambiguous"
    others = alternatives(torqued)
    assert [o.effect for o in others] == list(torqued.ambiguous_with[0][1:])
    (step,) = torqued.steps
    odds = [math.exp(r.log_bayes_factor - step.log_bayes_factor) for r in step.alternatives]
    assert [o.probability for o in others] == pytest.approx([x / (1.0 + sum(odds)) for x in odds])
    library = {e.name: e for e in RIGID}
    for other in others:
        direct = estimate(
            Model(torqued.base.model.campaign, (library[other.effect],)), discount=False
        )
        assert np.all(np.abs(other.mean - direct.theta[:9]) < 0.01 * direct.sd[:9])
        np.testing.assert_allclose(other.sd, direct.sd[:9], rtol=0.01)
    content = content_of(torqued, alternatives=others)
    check_contract(content, RIGID)
    stored = next_fit_from(json.loads(json.dumps(content)), RIGID)
    direct = next_fit(
        Investigation(torqued, Rules(), disagreement(torqued.base), alternatives=others)
    )
    assert (stored.verdict, stored.effects) == (direct.verdict, direct.effects)
    assert (stored.noise, stored.drive) == (direct.noise, direct.drive)
    for again, other in zip(stored.alternatives, others, strict=True):
        assert (again.effect, again.probability, again.names) == (
            other.effect,
            other.probability,
            other.names,
        )
        assert np.array_equal(again.mean, other.mean)
        assert np.array_equal(again.covariance, other.covariance)
    begun = "The fit below includes constant torque. J and K are averaged over what may be true (constant torque "
    assert any(said.startswith(begun) for said in diagnosis_verdict(content).sentences)
    assert "J and K, whichever it is" in [section.title for section in diagnosis_sections(content)]


def test_a_name_that_something_without_one_matches_is_called_likely(lagging):
    content = content_of(lagging)
    sure, tied = (
        diagnosis_verdict(content | {"nameless_lead": lead}).sentences
        for lead in (content["nameless_lead"], 0.0)
    )
    assert len(tied) == len(sure) + 1
    assert any("likely, not proven" in s for s in tied)
    assert not any("likely, not proven" in s for s in sure)


def test_a_set_beside_another_effect_is_exchanged_with_that_effect_kept(lagging):
    """The lag was named, its rival is the delay; a constant torque was named after it."""
    (first,), at = lagging.steps, lagging.final
    marks = search._marks(lagging.base, None)
    delay = search._fitted(
        lagging.base,
        marks,
        {c.effect: c for c in search._candidates(marks)}["rate_sensor_delay"],
        None,
    )
    marks = search._marks(at, None)
    torque = search._fitted(
        at, marks, {c.effect: c for c in search._candidates(marks)}["constant_torque"], None
    )
    rival = Rival("rate_sensor_delay", delay.after, first.log_bayes_factor - 1.0, 0.9)
    steps = (replace(first, alternatives=(rival,)), Step("constant_torque", at, torque.after, 0.0))
    (other,) = alternatives(replace(lagging, verdict="ambiguous", steps=steps, final=torque.after))
    library = {e.name: e for e in RIGID}
    direct = estimate(
        Model(at.model.campaign, (library["rate_sensor_delay"], library["constant_torque"])),
        discount=False,
    )
    assert other.probability == pytest.approx(1.0 / (1.0 + math.e))
    assert np.all(np.abs(other.mean - direct.theta[:9]) < 0.01 * direct.sd[:9])
    # Without the effect named beside it J and K would be others.
    assert np.any(np.abs(other.mean - delay.after.theta[:9]) > 0.1 * direct.sd[:9])
    # A rival that was named in the end, because both are needed, is none.
    both = Rival("constant_torque", torque.after, first.log_bayes_factor - 1.0, 0.9)
    judged = search._verdict(
        lagging.base,
        torque.after,
        [replace(steps[0], alternatives=(rival, both)), steps[1]],
        (lagging.candidates, lagging.threshold, marks),
        lagging.noise,
        (),
        Rules(),
    )
    assert [r.effect for r in judged.steps[0].alternatives] == ["rate_sensor_delay"]
    assert all("constant_torque" not in group for group in judged.ambiguous_with)


def test_averaged_J_and_K_are_the_mixture_and_the_posterior_stays(torqued, tmp_path):
    settings = Settings(seed=2, ensembles=2, walkers=32, steps=60, max_steps=60)
    plain = fit(torqued.base.model.campaign, effects=(ConstantTorque(),), seed=2, settings=settings)
    given = plain.summary()["parameters"]
    names = tuple(given)[:9]
    mean, sd = (np.array([given[name][key] for name in names]) for key in ("mean", "sd"))
    far = Alternative(
        "star_tracker_shift",
        "constant_torque",
        0.3,
        names,
        mean + 4.0 * sd,
        np.diag((0.5 * sd) ** 2),
    )
    near = Alternative(
        "magnetic_dipole", "constant_torque", 0.1, names, mean - 2.0 * sd, np.diag(sd**2)
    )
    whole = averaged(plain, (far, near), seed=3)
    # Exactly: mean 0.3 * 4 - 0.1 * 2 = 1, variance 0.6 + 0.3 / 4 + 0.1 + (0.3 * 16 + 0.1 * 4 - 1) = 4.975 in sds of the first.
    rows = whole.summary()["parameters"]
    n = whole.tree["averaged"][names[0]].size
    for name, m, s in zip(names, mean, sd, strict=True):
        error = math.sqrt(4.975 / n) + math.sqrt(
            0.6 / plain.attributes["diagnostics"]["ess_bulk_min"]
        )
        assert abs((rows[name]["mean"] - m) / s - 1.0) < 4.0 * error
        assert abs(rows[name]["sd"] / s - math.sqrt(4.975)) < 4.0 * error
        assert rows[name]["robust_sd"] >= rows[name]["sd"]
    assert rows["constant_torque.torque_x"] == given["constant_torque.torque_x"]
    assert np.array_equal(whole.samples, plain.samples)
    assert averaged(plain, (), seed=3) is plain
    for key, row in whole.summary()["derived"].items():
        assert row["robust_sd"] >= row["sd"] > plain.summary()["derived"][key]["sd"]
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


def test_an_average_holds_no_tensor_that_no_body_has(torqued):
    settings = Settings(seed=2, ensembles=2, walkers=32, steps=12, max_steps=12)
    plain = fit(torqued.base.model.campaign, effects=(ConstantTorque(),), seed=2, settings=settings)
    names = plain.names[:9]
    edge = np.array(
        [4.0, 2.0, 2.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    )  # 4 = 2 + 2: half of all draws about it break the triangle inequality
    other = Alternative(
        "star_tracker_shift", "constant_torque", 0.5, tuple(names), edge, 1e-4 * np.eye(9)
    )
    whole = averaged(plain, (other,), seed=1)
    moments = whole.tree["averaged"]["principal_moment"].values.reshape(-1, 3)
    assert np.all(moments[:, 0] + moments[:, 1] >= moments[:, 2])
    assert np.mean(moments[:, 2] > 3.9) == pytest.approx(
        0.5, abs=4.0 * math.sqrt(0.25 / len(moments))
    )


def test_what_could_hide_moves_the_fit_as_far_as_it_says(flight, clean):
    """The effect is flown, with the noise of the clean campaign, and left out of the fit."""
    found = diagnose(clean, library=RIGID)
    rows = {row.parameter: row for row in undetected(found)}
    assert tuple(rows) == found.base.model.space.names[:9]
    for name in ("Jxy", "Jxz", "K2"):
        row, i = rows[name], found.base.model.space.names.index(name)
        assert row.shift > 2.0 * row.sd
        (effect,) = (e for e in RIGID if e.name == row.effect)
        space = ParameterSpace(tuple((effect.name, p) for p in effect.parameters(clean)))
        theta = np.array([row.values[n.split(".", 1)[1]] for n in space.names])
        values = {k: np.asarray(v) for k, v in space.split(theta)[effect.name].items()}
        moved = estimate(Model(flight((effect,), {effect.name: values})), discount=False)
        # Half a per cent of it is of second order in the effect.
        assert (moved.theta[i] - found.base.theta[i]) / row.shift == pytest.approx(1.0, abs=0.02)
        # What moves one furthest moves the others no further than what moves those furthest.
        assert all(
            abs(moved.theta[j] - found.base.theta[j]) < 1.02 * other.shift
            for j, other in enumerate(rows.values())
        )
    content = content_of(found, blind_spots=tuple(rows.values()))
    check_contract(content, RIGID)
    assert (
        diagnosis_verdict(content)
        .sentences[-1]
        .startswith("An effect too weak to be found could still have moved J and K: most of all ")
    )
    assert "What could still hide" in [section.title for section in diagnosis_sections(content)]


def test_what_is_fitted_hides_nothing_and_of_the_unknown_nothing_is_said(lagging, pumped):
    assert "wheel_command_lag" not in {row.effect for row in undetected(lagging)}
    assert undetected(pumped) == ()


def test_even_odds_are_even_and_the_furthest_amplitude_is_the_furthest():
    rng, n = np.random.default_rng(4), 40_000
    size, limit = (
        even_odds(3, 1e-3),
        16.266,
    )  # chi^2 with three degrees of freedom exceeds it once in a thousand times
    error = math.sqrt(0.25 / n)

    def found(size):
        return np.mean(np.sum(rng.normal([math.sqrt(size), 0.0, 0.0], 1.0, (n, 3)) ** 2, 1) > limit)

    assert abs(found(size) - 0.5) < 4.0 * error
    assert abs(found(1.1 * size) - 0.5) > 4.0 * error
    pull, root = rng.normal(size=(2, 4)), rng.normal(size=(4, 4))
    data = 9.0 * root @ root.T
    shift, amplitude = furthest(pull, data)
    shape = data + 0.25 * np.eye(4)
    np.testing.assert_allclose(np.einsum("pi,ij,pj->p", amplitude, shape, amplitude), 1.0)
    np.testing.assert_allclose(np.sum(pull * amplitude, 1), shift)
    others = rng.normal(size=(5000, 4))
    others /= np.sqrt(np.einsum("ni,ij,nj->n", others, shape, others))[:, None]
    assert np.all(np.abs(others @ pull.T) <= shift * (1.0 + 1e-12))


def test_only_an_ambiguous_diagnosis_has_alternatives(lagging):
    assert alternatives(lagging) == ()
    assert content_of(lagging)["alternatives"] == []


def check_contract(content: dict, library=LIBRARY) -> None:
    """diagnosis.json as DESIGN section 8 promises it."""
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert content["verdict"] in ("consistent", "named", "ambiguous", "unknown")
    assert {e.name for e in library} | {"noise_level"} == {
        c["effect"] for c in content["candidates"]
    }
    for c in content["candidates"]:
        assert {
            "effect",
            "dof",
            "score",
            "p_value",
            "log_bayes_factor",
            "parameters",
            "reason",
        } == set(c)
        assert (c["p_value"] is None) == (c["score"] is None)
        assert c["p_value"] is not None or c["reason"]
        assert (c["parameters"] is not None) == (
            c["effect"] in [s["added"] for s in content["steps"]]
        )
    for w in content["disagreement"]:
        assert {"channel", "slew", "t_start", "t_end", "p_value"} <= set(w)
        assert w["channel"] in ("rate", "attitude", "momentum")
        assert w["t_start"] <= w["t_end"]
        assert 0.0 <= w["p_value"] < 0.05
    for s in content["steps"]:
        assert (
            set(s["reduced_chi2_before"])
            == set(s["reduced_chi2_after"])
            == {"rate", "attitude", "momentum", "total"}
        )
        assert set(s["shift"]) == {"Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3"}
    assert (content["unknown"] is not None) == (content["verdict"] == "unknown")
    if content["unknown"]:
        assert {"description", "axis", "frequency_hz", "torque_rms"} <= set(content["unknown"])
        assert math.isclose(np.linalg.norm(content["unknown"]["axis"]), 1.0, rel_tol=1e-9)
