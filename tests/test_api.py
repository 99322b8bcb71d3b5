"""The public names are frozen: adding one is a decision, removing one breaks notebooks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bayes_inertia as bi

PUBLIC = {
    "Campaign", "Contender", "Design", "Effect", "InertiaPrior", "KeepOut", "LIBRARY", "Limits", "Margin", "Model", "Posterior", "RateSensor", "Settings",
    "Slew", "StarTracker", "Wheel",
    "check_effect", "compare_plans", "design_plan", "diagnose", "diagnose_and_fit", "estimate", "fit", "next_slew", "observe", "read_campaign",
    "separating_slew", "write_campaign", "write_report",
}  # fmt: skip


def test_the_public_names_are_these():
    assert set(bi.__all__) == PUBLIC
    for name in PUBLIC:
        value = getattr(bi, name)
        assert callable(value) or name == "LIBRARY"
        assert name == "LIBRARY" or value.__doc__


def test_no_public_function_hides_a_module():
    modules = {path.stem for path in Path(bi.__file__).parent.iterdir()}
    assert not modules & set(bi.__all__)


def test_importing_does_not_load_plots_or_arviz():
    code = "import sys, bayes_inertia; assert not {'matplotlib', 'arviz', 'jinja2'} & set(sys.modules), sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)
