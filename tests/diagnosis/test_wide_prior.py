"""Effects far outside their priors are named, measured, and said to be outside."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.app.diagnosis_json import next_fit_from
from bayes_inertia.diagnosis.hypothesis_table import log_evidence_of_columns
from bayes_inertia.diagnosis.quoted_parameters import fitted_effects
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.physics.effects import RateSensorMisalignment, WheelCommandLag
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.report.verdict import diagnosis_verdict

# A sensor turned by five degrees: 29 sds of its prior.
TURNED = np.array([0.087, 0.0, 0.0])


def test_a_prior_scale_widens_amplitudes_and_leaves_the_model():
    """Compiled code is shared: the structure does not know how wide priors are."""
    campaign = small_campaign()
    stated = Model(campaign, (WheelCommandLag(),))
    wide = Model(campaign, (WheelCommandLag(prior_scale=8.0),))
    part = stated.space.slice_of("wheel_command_lag")
    np.testing.assert_allclose(wide.space.sd[part], 8.0 * stated.space.sd[part], rtol=1e-12)
    np.testing.assert_array_equal(wide.space.sd[:9], stated.space.sd[:9])
    assert wide.structure == stated.structure
    assert wide.effects != stated.effects


@pytest.mark.parametrize("size", [3.0, 30.0])
def test_a_size_beyond_its_prior_costs_its_logarithm_not_its_square(size):
    power = 1e4
    gain = 0.5 * size**2 * power  # of an amplitude without any prior
    evidence = log_evidence_of_columns(np.array([size * power]), np.array([[power]]))
    assert gain - 25.0 < evidence < gain
    # At the stated prior alone its square is paid beside what is paid for every amplitude.
    alone = 0.5 * ((size * power) ** 2 / (1.0 + power) - np.log1p(power))
    assert (evidence > alone) == (size > 10.0)


@pytest.mark.long
@pytest.mark.slow
def test_a_sensor_turned_by_five_degrees_is_named_and_said_to_be(
    flight, lagging, rigid_library, content_of
):
    hidden = (RateSensorMisalignment(),)
    campaign = flight(hidden, {"rate_sensor_misalignment": {"angle": TURNED}})
    found = diagnose(campaign, library=rigid_library)
    assert (found.verdict, found.named) == ("named", ("rate_sensor_misalignment",))
    (row,) = found.beyond_prior
    assert (row.effect, row.parameter) == ("rate_sensor_misalignment", "angle_x")
    sd = found.final.sd[found.final.model.space.slice_of(row.effect)][0]
    assert abs(row.value - TURNED[0]) < 4.0 * sd
    assert row.prior_sds == pytest.approx(29.0, abs=1.0)
    assert row.prior_scale == 32.0
    content = content_of(found)
    assert next_fit_from(content).effects == fitted_effects(found)
    assert any("29 prior sd" in text for text in diagnosis_verdict(content).sentences)
    # What its prior allows is fitted with that prior, and nothing is said.
    assert lagging.beyond_prior == ()
    assert {e.prior_scale for e in lagging.final.model.effects} == {1.0}
    assert found.final.model.space.sd[:9] == pytest.approx(lagging.final.model.space.sd[:9])


def test_a_truncated_prior_stays_truncated():
    wide = Model(small_campaign(), (replace(WheelCommandLag(), prior_scale=4.0),))
    part = wide.space.slice_of("wheel_command_lag")
    assert wide.space.lower[part].tolist() == [0.0]
