"""What rate, slews, gyro noise and fixes must be: the sd of each element of J against each of them.

    python analyses/before_you_fly.py [--picture]

Rates and numbers of slews are those of `observability_study.py` (`results/cross_terms.json`); gyro
noise and star-tracker fixes are forecast here, in the same way, into
`results/before_you_fly.json`. One minute. The picture is `figures/before_you_fly.svg`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from observability_cases import CRAFT, NUMBERS, RATES
from observability_study import expected, plan_at
from page_figures import save_svg

from bayes_inertia.files import write_atomically
from bayes_inertia.report.pictures import style

ROOT = Path(__file__).parents[1]
RESULT, SHARED = (
    ROOT / "analyses" / "results" / f"{n}.json" for n in ("before_you_fly", "cross_terms")
)
_CASE = "tachometers, misalignment known"
GYRO_SIGMA = (2e-6, 6e-6, 2e-5, 6e-5, 2e-4, 6e-4)  # of one reading at 4 Hz [rad/s]
FIX_SPACING = (12.0, 6.0, 4.0, 2.0, 1.0, 0.5)  # [s] in rests of 12 s
_REST = 12.0
ELEMENTS = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz")


def measure() -> dict:
    """Expected sds (9,) of J and K for each gyro noise and each number of fixes in a rest."""
    plan = plan_at()
    noise = [
        expected(
            plan, replace(CRAFT, rate_sensor=replace(CRAFT.rate_sensor, sigma=(s, s, s))), False
        )
        for s in GYRO_SIGMA
    ]
    fixes = [expected(replace(plan, fix_spacing=s), CRAFT, False) for s in FIX_SPACING]
    return {
        "gyro_sigma": GYRO_SIGMA,
        "fixes": [round(_REST / s) for s in FIX_SPACING],
        "by_noise": noise,
        "by_fixes": fixes,
    }


@style.styled
def picture(result: dict, shared: dict) -> Figure:
    """Four panels, one line an element of J."""
    panels = (
        ("slew rate [deg/s]", RATES, shared["rate"]),
        ("number of slews", NUMBERS, shared["number"]),
        ("gyro noise of a reading [rad/s]", result["gyro_sigma"], result["by_noise"]),
        ("star-tracker fixes in each rest", result["fixes"], result["by_fixes"]),
    )
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    axes = figure.subplots(2, 2, sharey=True)
    for ax, (label, x, sds) in zip(axes.flat, panels, strict=True):
        for k, name in enumerate(ELEMENTS):
            ax.loglog(
                x,
                np.array(sds)[:, k],
                color=style.color(k),
                ls="-" if k < 3 else "--",
                marker=style.MARKERS[k],
                ms=3.5,
                label=name,
            )
        ax.set_xlabel(label)
        ax.grid(color=style.PALE, lw=0.5)
        ax.set_ylim(1e-5, 0.2)
    for ax, ticks in ((axes[0, 0], (0.1, 0.2, 0.5, 1, 2)), (axes[0, 1], (1, 2, 3, 5, 10))):
        ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
        ax.minorticks_off()
    axes[1, 1].set_xticks(result["fixes"], [f"{n}" for n in result["fixes"]])
    axes[1, 1].minorticks_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("sd [kg m²]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=6)
    return figure


def main() -> None:
    """Measure, unless there is a result, and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--picture", action="store_true", help="draw the result that is there")
    if not parser.parse_args().picture:
        write_atomically(RESULT, json.dumps(measure(), indent=1) + "\n")
    shared = json.loads(SHARED.read_text())["curves"][_CASE]
    save_svg(picture(json.loads(RESULT.read_text()), shared), "before_you_fly")


if __name__ == "__main__":
    main()
