"""J and K where something is missing that no candidate explains."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.app.diagnosed_fit import Investigation, next_fit
from bayes_inertia.app.diagnosis_json import next_fit_from
from bayes_inertia.campaign.sensors import CHANNELS
from bayes_inertia.diagnosis.quoted_parameters import fitted_effects, quoted_parameters
from bayes_inertia.diagnosis.residuals import scan_residuals
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.diagnosis.unexplained import unexplained_signal
from bayes_inertia.inference.optimizer import with_noise
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.effects.tachometer_noise_walk import TachometerRemainder
from bayes_inertia.physics.effects.torque_noise import WheelTorqueRemainder
from bayes_inertia.physics.named_effects import remainders
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.report.fit_sections import diagnosis_sections

FREE = remainders("both")


@pytest.mark.long
@pytest.mark.slow
def test_where_nothing_explains_the_data_J_and_K_are_of_free_shapes(
    pumped, pumped_truth, content_of
):
    assert (pumped.verdict, pumped.why_unknown, pumped.other_rows) == ("unknown", "misfit", ())
    assert fitted_effects(pumped) == FREE
    quoted = quoted_parameters(pumped)
    # What the free shapes may have done is taken from what is known of J and K.
    plain = with_noise(pumped.base, dict.fromkeys(CHANNELS, 1.0))
    assert np.all(quoted.sd > plain.sd[:9])
    assert np.max(np.abs(quoted.mean - pumped_truth) / quoted.sd) < 4.0
    # The file gives the second half of a run what the first half had.
    content = content_of(pumped, unexplained=unexplained_signal(pumped.base))
    there = next_fit(Investigation(pumped, scan_residuals(pumped.base)))
    assert next_fit_from(content).effects == there.effects == FREE
    assert "J and K, whichever it is" not in {s.title for s in diagnosis_sections(content)}
    # An earlier version left the free shapes to the fit, another averaged over them.
    row = {"effect": "", "instead_of": "", "probability": 0.5, "names": quoted.names}
    averaged = row | {"mean": quoted.mean, "covariance": np.diag(quoted.sd**2)}
    for fitted in ([], [{"effect": "wheel_command_lag", "settings": {}}]):
        earlier = next_fit_from(content | {"fitted": fitted, "alternatives": [averaged]})
        assert (earlier.effects, earlier.alternatives) == (FREE, ())


@pytest.mark.long
@pytest.mark.slow
def test_what_is_named_is_fitted_and_imitations_give_way_to_free_shapes(lagging):
    named = quoted_parameters(lagging)
    # What was not detected moves and widens them by a part of their sd.
    assert np.all(np.abs(named.mean - lagging.final.theta[:9]) < lagging.final.sd[:9])
    assert np.all(named.sd > 0.95 * lagging.final.sd[:9])
    seen = replace(lagging, verdict="unknown", nameless_source="body torque")
    for why in ("misfit", "imitation"):
        assert fitted_effects(replace(seen, why_unknown=why)) == FREE
    # No free shape stands for what acts between wheels and body, unless it is seen there.
    between, shape = by_name(["wheel_torque_noise"]), FREE[0]
    model = replace(lagging.final.model, effects=(*lagging.effects_added, *between, shape))
    final = replace(lagging.final, model=model)
    (lag,) = lagging.steps
    steps = tuple(replace(lag, added=effect.name) for effect in model.effects)
    partly = replace(seen, verdict="partial", steps=steps, final=final)
    assert fitted_effects(partly) == (*lagging.effects_added, *between, *FREE)
    at_wheels = replace(partly, nameless_source="wheel torque")
    everywhere = (*FREE, WheelTorqueRemainder())
    assert fitted_effects(at_wheels) == (*lagging.effects_added, *everywhere)


def test_free_shapes_are_those_that_a_campaign_can_have():
    """Without a rate sensor a torque alone; of wheels, or tachometers, where it is seen."""
    campaign = small_campaign()
    gyroless = replace(
        campaign,
        rate_sensor=None,
        slews=tuple(replace(slew, rate=None) for slew in campaign.slews),
    )
    at_wheels = "wheel torque", (WheelTorqueRemainder(),)
    in_readings = "tachometers", (TachometerRemainder(),)
    for flown, shapes in ((campaign, FREE), (gyroless, FREE[:1])):
        base = SimpleNamespace(model=SimpleNamespace(campaign=flown))
        for source, more in (("", ()), ("body torque", ()), at_wheels, in_readings):
            imitated = {"verdict": "unknown", "effects_added": (), "nameless_source": source}
            assert fitted_effects(SimpleNamespace(base=base, **imitated)) == (*shapes, *more)
    # What acts where no shape is free keeps its name.
    walk = by_name(["tachometer_noise_walk"])
    base = SimpleNamespace(model=SimpleNamespace(campaign=campaign))
    for source, expected in (
        ("rate sensor", (*walk, *FREE)),
        ("tachometers", (*FREE, TachometerRemainder())),
    ):
        partly = {"verdict": "partial", "effects_added": walk, "nameless_source": source}
        assert fitted_effects(SimpleNamespace(base=base, **partly)) == expected


@pytest.mark.long
@pytest.mark.slow
def test_a_strong_error_of_tachometers_without_a_name_leaves_a_fit_that_holds(flown):
    """Smooth, of a hundred sds of a reading: no torque can explain it."""
    rng, slews = np.random.default_rng(3), []
    sigma = np.array([wheel.momentum_sigma for wheel in flown.campaign.wheels])
    for slew in flown.campaign.slews:
        knots = np.linspace(0.0, slew.time[-1], 6)
        error = np.stack([np.interp(slew.time, knots, rng.normal(size=6)) for _ in sigma], -1)
        slews.append(replace(slew, wheel_momentum=slew.wheel_momentum + 100.0 * sigma * error))
    found = diagnose(replace(flown.campaign, slews=tuple(slews)))
    assert found.nameless_source == "tachometers"
    assert found.verdict == "unknown"
    quoted = quoted_parameters(found)
    truth = flown.truth.theta[:9]
    assert np.max(np.abs(quoted.mean - truth) / quoted.sd) < 3.5
