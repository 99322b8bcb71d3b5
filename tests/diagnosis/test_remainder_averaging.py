"""J and K where something is missing that no candidate explains."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.app.diagnosed_fit import Investigation, next_fit
from bayes_inertia.app.diagnosis_json import next_fit_from
from bayes_inertia.campaign.sensors import CHANNELS
from bayes_inertia.diagnosis.quoted_parameters import (
    FREE_SHAPES,
    alternatives_of,
    fitted_effects,
    quoted_parameters,
)
from bayes_inertia.diagnosis.residuals import scan_residuals
from bayes_inertia.diagnosis.result import Step
from bayes_inertia.diagnosis.unexplained import unexplained_signal
from bayes_inertia.inference.optimizer import with_noise
from bayes_inertia.physics.effects import REMAINDERS, by_name
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.report.diagnosis_sections import diagnosis_sections


@pytest.mark.long
@pytest.mark.slow
def test_what_no_candidate_explains_is_averaged_over_free_shapes(pumped, pumped_truth, content_of):
    assert pumped.why_unknown == "misfit"
    alternatives = alternatives_of(pumped)
    (free,) = alternatives
    assert (free.effect, free.instead_of, free.probability) == (FREE_SHAPES, "", 0.5)
    # What the free shapes may have done is taken from what is known of J and K.
    plain = with_noise(pumped.base, dict.fromkeys(CHANNELS, 1.0))
    assert np.all(free.sd > plain.sd[:9])
    assert np.max(np.abs(free.mean - pumped_truth) / free.sd) < 4.0
    # The file gives the second half of a run what the first half had.
    more = {"unexplained": unexplained_signal(pumped.base), "alternatives": alternatives}
    content = content_of(pumped, **more)
    stored = next_fit_from(content)
    there = next_fit(Investigation(pumped, scan_residuals(pumped.base), alternatives=alternatives))
    assert stored.effects == there.effects == fitted_effects(pumped)
    assert np.array_equal(stored.alternatives[0].covariance, there.alternatives[0].covariance)
    assert "J and K, whichever it is" not in {s.title for s in diagnosis_sections(content)}
    # An earlier version left the free shapes to the fit.
    assert next_fit_from(content | {"fitted": [], "alternatives": []}).effects == REMAINDERS


@pytest.mark.long
@pytest.mark.slow
def test_what_is_named_is_not_averaged_and_imitations_give_way_to_free_shapes(lagging):
    assert FREE_SHAPES not in {row.effect for row in alternatives_of(lagging)}
    imitated = replace(lagging, verdict="unknown", why_unknown="imitation")
    assert alternatives_of(imitated) == ()
    assert fitted_effects(imitated) == REMAINDERS
    # A shape that is free is tried, and not kept beside the remainder.
    (lag,) = lagging.steps
    model = replace(lagging.final.model, effects=(*lagging.final.model.effects, *REMAINDERS))
    final = replace(lagging.final, model=model)
    both = (lag, Step(REMAINDERS[0].name, lag.before, final, 0.0))
    missing = replace(lagging, verdict="unknown", why_unknown="misfit", steps=both, final=final)
    assert [effect.name for effect in fitted_effects(missing)] == ["wheel_command_lag"]
    # No free shape stands for what acts between wheels and body.
    between = by_name(["wheel_torque_noise"])
    model = replace(lagging.final.model, effects=(*lagging.final.model.effects, *between))
    final = replace(lagging.final, model=model)
    both = (lag, Step("wheel_torque_noise", lag.before, final, 0.0))
    missing = replace(missing, steps=both, final=final)
    assert fitted_effects(missing) == (*lagging.effects_added, *between)
    # Beside what is named in part the free shapes stand as well.
    partial = fitted_effects(replace(lagging, verdict="partial"))
    assert partial == (*lagging.effects_added, *REMAINDERS)


@pytest.mark.long
@pytest.mark.slow
def test_what_is_quoted_holds_the_truth_whatever_the_verdict(pumped, pumped_truth, lagging):
    named = quoted_parameters(lagging)
    # What was not detected moves and widens them by a part of their sd.
    assert np.all(np.abs(named.mean - lagging.final.theta[:9]) < lagging.final.sd[:9])
    assert np.all(named.sd > 0.95 * lagging.final.sd[:9])
    quoted = quoted_parameters(pumped)
    (free,) = alternatives_of(pumped)
    assert quoted.names == free.names
    # Half of the average is the fit with free shapes: a tenth of that lies outside the interval.
    assert np.all(quoted.sd > 0.5 * free.sd)
    assert np.max(np.abs(quoted.mean - pumped_truth) / quoted.sd) < 4.0


def test_without_a_rate_sensor_the_free_shape_is_a_torque():
    campaign = small_campaign()
    gyroless = replace(
        campaign,
        rate_sensor=None,
        slews=tuple(replace(slew, rate=None) for slew in campaign.slews),
    )
    for flown, shapes in ((campaign, REMAINDERS), (gyroless, REMAINDERS[:1])):
        base = SimpleNamespace(model=SimpleNamespace(campaign=flown))
        imitated = {"verdict": "unknown", "why_unknown": "imitation", "effects_added": ()}
        assert fitted_effects(SimpleNamespace(base=base, **imitated)) == shapes
