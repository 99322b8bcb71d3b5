"""An example for the help of each command."""

from __future__ import annotations

from collections.abc import Mapping

EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "new": ("new campaign --like cubesat",),
    "import": (
        "import gyro.csv wheels.csv --start mapping.toml",
        "import gyro.csv wheels.csv --using mapping.toml -o campaign",
    ),
    "check": ("check campaign",),
    "fit": (
        "fit campaign -o run --seed 1",
        "fit campaign -o run --effects my_effects.py:SolarPressure",
    ),
    "update": ("update run campaign_2027 -o run_2027 --inflate 1e-3",),
    "fit-many": ("fit-many fleet -o fits --jobs 8",),
    "diagnose": (
        "diagnose campaign -o run",
        "diagnose campaign -o run --effects my_effects.py:SolarPressure",
    ),
    "observe": ("observe campaign -o run",),
    "design": (
        "design campaign -o next --slews 4 --max-rate 0.8 --after",
        "design campaign -o next --goal correction_slew",
    ),
    "compare": ("compare campaign paper next/plan.toml -o out --simulated 20",),
    "history": ("history run_2026_03 run_2026_06 run_2026_09 -o history",),
    "fleet": ("fleet fits -o fleet_result",),
    "study": (
        "study campaign -o study --campaigns 200 --jobs 8",
        "study calibration -o calibration --fits 1000 --jobs 8",
    ),
    "resume": ("resume run",),
    "report": (
        "report run",
        "report run --plan next/plan.toml",
        "report run_before run_after -o comparison.html",
    ),
    "export": ("export run --to csv -o upload.csv", "export run --to basilisk"),
    "simulate": (
        "simulate -o simulated --hide wheel_command_lag.tau=0.1 --seed 3",
        "simulate -o flown --campaign campaign --plan next/plan.toml",
    ),
    "effects": ("effects --campaign campaign", "effects --check my_effects.py"),
    "demo": ("demo -o demo_run",),
    "doctor": ("doctor", "doctor campaign --json"),
}


def example_of(command: str) -> str:
    """The end of a command's help.

    >>> "bayes-inertia check campaign" in example_of("check")
    True
    """
    lines = "\n".join(f"  bayes-inertia {words}" for words in EXAMPLES[command])
    # The sign \\b keeps the help from filling the lines.
    return f"\b\nExample:\n{lines}\n\n`bayes-inertia --help` lists --quiet and --no-cache."
