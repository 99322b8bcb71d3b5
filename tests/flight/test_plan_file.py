"""Plans in files: what is written is read back, and errors say where."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.flight.plan import PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_file import read_plan, write_plan


def test_plan_file_round_trip(tmp_path):
    plan = replace(
        paper_like_plan(),
        slews=(PlannedSlew((1.0, 2.0, 3.0), 0.3, 0.02, 5e-4, "smooth", 140.0),),
        orbit=None,
        pause=0.0,
    )
    path = write_plan(plan, tmp_path / "plan.toml")
    again = read_plan(path)
    assert again.slews[0].axis_B == plan.slews[0].axis_B
    assert again.slews[0].angle == pytest.approx(plan.slews[0].angle, rel=1e-15)
    assert replace(again, slews=plan.slews) == plan
    write_plan(plan, path)  # the same content is not in its own way
    with pytest.raises(OutputError, match="would overwrite"):
        write_plan(paper_like_plan(), path)
    write_plan(paper_like_plan(), path, overwrite=True)
    assert read_plan(path) == paper_like_plan()


def test_what_a_plan_file_leaves_out_is_as_in_the_base(tmp_path):
    base = replace(paper_like_plan(), telemetry_period=0.5, first_fix=0.0, fixes_in_motion=True)
    path = tmp_path / "plan.toml"
    slew = "[[slews]]\naxis = [1, 0, 0]\nangle_deg = 30\n"
    path.write_text(f'format = "bayes-inertia-plan/1"\nname = "by hand"\nsettle_s = 40\n{slew}')
    expected = replace(base, name="by hand", settle=40.0, slews=base.slews[:1])
    assert read_plan(path, base) == expected
    # Times that it leaves out follow its period.
    path.write_text(path.read_text().replace("settle_s = 40", "telemetry_period_s = 0.3"))
    assert read_plan(path, base).rest_before == pytest.approx(67 * 0.3)
    # A plan that was written has left nothing out.
    other = replace(base, fixes_in_motion=False)
    assert read_plan(write_plan(other, path, overwrite=True), base) == other


@pytest.mark.parametrize("base", [None, replace(paper_like_plan(), telemetry_period=0.5)])
def test_times_that_a_plan_file_leaves_out_fit_those_that_it_states(tmp_path, base):
    path = tmp_path / "plan.toml"
    head = 'format = "bayes-inertia-plan/1"\nname = "by hand"\n'
    slew = "[[slews]]\naxis = [1, 0, 0]\nangle_deg = 30\n"
    path.write_text(f"{head}telemetry_period_s = 0.3\n{slew}")
    plan = read_plan(path, base)
    assert (plan.rest_before, plan.fix_spacing) == pytest.approx((67 * 0.3, 0.9))
    path.write_text(f"{head}rest_before_s = 5\n{slew}")
    assert read_plan(path, base).first_fix == 2.5


def test_what_is_no_plan_or_no_path_is_told(tmp_path):
    with pytest.raises(CampaignError, match="plan: a str is no Plan"):
        write_plan("x", tmp_path / "plan.toml")
    with pytest.raises(CampaignError, match="path: None is no path"):
        write_plan(paper_like_plan(), None)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "angle_deg",
            "angle_degree",
            r'slews\[1 of 5\]\.angle_degree: unknown key; did you mean "angle_deg"\?',
        ),
        ("angle_deg = 30.0", "angle_deg = -30.0", "turn|positive"),
        ("angle_deg = 30.0", 'angle_deg = "30"', "'30' is not a number; write a number without"),
        ("angle_deg = 30.0\n", "", "missing key; add angle_deg = "),
        ('profile = "trapezoid"', 'profile = "square"', "choose trapezoid or smooth"),
        ("settle_s = 33.0", "settle_s = 33.0.0", r"line \d+: not valid TOML"),
        ("rest_before_s = 20.0", "rest_before_s = 20.1", "multiple of telemetry_period"),
        ("bayes-inertia-plan/1", "bayes-inertia-plan/2", 'is not one of "bayes-inertia-plan/1"'),
        ("[1.0, 0.0, 0.0]", "[" * 3000, "nested too deeply"),
        ("angle_deg = 30.0", f"angle_deg = {'9' * 400}", "is not a number"),
        ("angle_deg = 30.0", "angle_deg = inf", "inf is not finite"),
        ("angle_deg = 30.0", f"angle_deg = {'9' * 5000}", "too many digits"),
        ("rate_deg_per_s = 1.0", "rate_deg_per_s = 1e-9", "rows of telemetry"),
        ("acceleration_deg_per_s2 = 0.05", "acceleration_deg_per_s2 = 1e-320", "rows of tel"),
        (
            "angle_deg = 45.0",
            "angle_deg = -29.1",
            r"key slews\[2 of 5\]\.angle_deg: -29.1 is not positive; write a positive number$",
        ),
        (
            "angle_deg = 45.0",
            "angle_deg = 45.0\nduration_s = 9.0",
            r"\[2 of 5\]\.duration_s: 9 s is",
        ),
        ("[0.0, 1.0, 0.0]", "[0.0, 0.0, 0.0]", r"key slews\[2 of 5\]\.axis: .* is no direction"),
        ('profile = "trapezoid"', 'profile = "trapez"', r"key slews\[1 of 5\]\.profile: 'trapez'"),
        ("rate_deg_per_s = 1.0", "rate_deg_per_s = 1e-9", r"slews\[1 of 5\]: it has 1.2e\+11 rows"),
        (
            "telemetry_period_s = 0.25",
            "telemetry_period_s = 0.3",
            "key rest_before_s: 20.0 s is no multiple of telemetry_period_s; choose",
        ),
        (
            "telemetry_period_s = 0.25",
            "telemetry_period_s = 0.0001",
            r"slews\[1 of 5\]: it has .* rows of telemetry, more than 1,000,000; look at",
        ),
        ("pause_s = 300.0", "pause_s = -1.0", "key pause_s: -1.0 is negative; write 0 or more"),
    ],
)
def test_plan_file_errors_say_where(tmp_path, old, new, message):
    path = write_plan(paper_like_plan(), tmp_path / "plan.toml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(CampaignError, match=message) as caught:
        read_plan(path)
    assert str(path) in str(caught.value)
