"""Effects that a later one makes needless."""

import numpy as np
import pytest
from support.refits import refitted

from bayes_inertia.diagnosis.result import Step
from bayes_inertia.diagnosis.rules import Rules
from bayes_inertia.diagnosis.search import drop_needless


@pytest.mark.slow
def test_an_effect_that_a_later_one_makes_needless_leaves_no_trace(lagging):
    """A step that took the wrong effect first is undone: what remains is weighed against the base
    fit, not against the wrong one.
    """
    at = lagging.base
    wrong = refitted(at, "rate_sensor_delay")
    first = Step("rate_sensor_delay", at, wrong.estimate, wrong.log_bayes_factor)
    right = refitted(wrong.estimate, "wheel_command_lag")
    second = Step("wheel_command_lag", wrong.estimate, right.estimate, right.log_bayes_factor)
    (step,) = drop_needless([first, second], None, Rules())
    (direct,) = lagging.steps
    assert (step.added, step.before) == ("wheel_command_lag", at)
    assert step.log_bayes_factor == pytest.approx(direct.log_bayes_factor, abs=0.5)
    assert not np.isin(
        np.arange(99)[at.model.space.slice_of("rate_sensor_delay")], step.after.free
    ).any()
    # The other way round the effect is needed and stays.
    both = [
        Step("wheel_command_lag", at, lagging.final, direct.log_bayes_factor),
        Step("rate_sensor_delay", lagging.final, right.estimate, 0.0),
    ]
    assert [s.added for s in drop_needless(both, None, Rules())] == [
        "wheel_command_lag",
        "rate_sensor_delay",
    ]
