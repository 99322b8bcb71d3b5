"""The public names are frozen: adding one is a decision, removing one breaks notebooks."""

from __future__ import annotations

import subprocess
import sys

import bayes_inertia as bi

PUBLIC = {
    "Campaign", "Contender", "Design", "Effect", "InertiaPrior", "KeepOut", "LIBRARY", "Limits", "Margin", "Model", "Posterior", "RateSensor", "Settings",
    "Slew", "StarTracker", "Wheel",
    "check_effect", "compare", "design", "diagnose", "estimate", "fit", "next_slew", "observability", "read_campaign",
    "separating_slew", "write_campaign", "write_report",
}  # fmt: skip


def test_the_public_names_are_these():
    assert set(bi.__all__) == PUBLIC
    for name in PUBLIC:
        value = getattr(bi, name)
        assert callable(value) or name == "LIBRARY"
        assert name == "LIBRARY" or value.__doc__


def test_functions_win_over_modules_of_the_same_name_in_any_order_of_imports():
    code = "import bayes_inertia.fit, bayes_inertia.diagnose, bayes_inertia.run, bayes_inertia as bi; assert callable(bi.fit) and callable(bi.diagnose)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_importing_does_not_load_plots_or_arviz():
    code = "import sys, bayes_inertia; assert not {'matplotlib', 'arviz', 'jinja2'} & set(sys.modules), sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)
