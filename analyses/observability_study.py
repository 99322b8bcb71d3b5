"""Why the cross terms are poorly observable: their sd against slew rate, number of slews, noise,
tachometers and misalignment.

    python analyses/observability_study.py

writes `figures/cross_terms.png`, `analyses/results/cross_terms.json` and the page
`analyses/CROSS_TERMS.md` (about ten minutes).
Every sd is that of the full model, linearised at the truth of closed-loop flights with noise
(`bayes_inertia.design.expected_accuracy`),
root mean square over a few truths drawn from the prior.
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bayes_inertia.design.expected_accuracy import estimate_at_truth, likely_missions
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight, fly
from bayes_inertia.flight.spacecraft import (
    Controller,
    Spacecraft,
    most_like_prior,
    most_like_spacecraft,
)
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.observability.analysis import observe
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.pictures import style

ROOT = Path(__file__).resolve().parent.parent
DEGREE = math.pi / 180.0
CRAFT, PRIOR = replace(most_like_spacecraft(), bias=(0.0, 0.0, 0.0)), most_like_prior()
MISSION = Mission(CRAFT, PRIOR)
MISALIGNMENT = "rate_sensor_misalignment"
RATES = np.array([0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0])  # [deg/s]
NUMBERS = np.array([1, 2, 3, 4, 5, 7, 10])
NOISES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
# What is fitted and measured: (tachometers, misalignment fitted).
CASES = {
    "tachometers, misalignment known": (True, False),
    "no tachometers": (False, False),
    "misalignment fitted": (True, True),
    "no tachometers, misalignment fitted": (False, True),
}
TRUTHS = 3


def craft_with(tachometers: bool = True, noise: float = 1.0) -> Spacecraft:
    """The MOST-like spacecraft with all its sensors `noise` times as noisy."""
    sensor, tracker = CRAFT.rate_sensor, CRAFT.star_tracker
    return replace(
        CRAFT,
        wheels=tuple(
            replace(w, momentum_sigma=noise * w.momentum_sigma if tachometers else None)
            for w in CRAFT.wheels
        ),
        rate_sensor=replace(sensor, sigma=tuple(noise * s for s in sensor.sigma)),
        star_tracker=replace(
            tracker, sigma_cross=noise * tracker.sigma_cross, sigma_roll=noise * tracker.sigma_roll
        ),
    )


def plan_at(rate: float = 1.0, slews: int = 5) -> Plan:
    """The paper-like slews at another rate [deg/s], the whole motion stretched in time, or another
    number of them (in turn).
    """
    base = paper_like_plan()
    chosen = tuple(
        replace(base.slews[i % 5], rate=rate * DEGREE, acceleration=0.05 * rate**2 * DEGREE)
        for i in range(slews)
    )
    return replace(base, slews=chosen, orbit=None)


def expected(plan: Plan, craft: Spacecraft, fitted: bool) -> list[float]:
    """Expected sds (9,) of J and K; the misalignment's angles are fitted with their prior of the
    library, or known.
    """
    effects = by_name((MISALIGNMENT,)) if fitted else ()
    controller = Controller.from_prior(PRIOR, craft.rate_sensor, craft.wheels)
    truths = likely_missions(plan, Mission(craft, PRIOR), TRUTHS + 1, 1)[1:]
    sds = [
        estimate_at_truth(plan, truth, effects, controller=controller, seed=i).sd[:9]
        for i, truth in enumerate(truths)
    ]
    return np.sqrt(np.mean(np.square(sds), axis=0)).tolist()


def curves() -> dict:
    """sds (points, 9) of every case against rate, number of slews and noise."""
    out = {name: {"rate": [], "number": [], "noise": []} for name in CASES}
    points = [("rate", plan_at(rate), 1.0) for rate in RATES]
    points += [("number", plan_at(slews=int(n)), 1.0) for n in NUMBERS]
    points += [("noise", plan_at(), noise) for noise in NOISES]
    # Cases inside points: they share compiled code.
    for key, plan, noise in points:
        for name, (tachometers, fitted) in CASES.items():
            out[name][key].append(expected(plan, craft_with(tachometers, noise), fitted))
    return out


def causes(at: Estimate) -> dict:
    """What limits each parameter at the paper-like slews: signal of its own size, inflation by
    group.
    """
    found = observe(at)
    return {
        p.name: {
            "value": p.value,
            "sd": p.sd,
            "signal_of_size": p.signal_of_size,
            "conditional_sd": p.conditional_sd,
            "lost": math.sqrt(p.variance_inflation),
            "inflation": {group: math.sqrt(factor) for group, factor in p.inflation.items()},
            "channels": dict(
                zip(("rate", "attitude", "momentum"), p.share.sum(0).tolist(), strict=True)
            ),
        }
        for p in found.parameters
    }


def _telemetry(flight: Flight) -> dict[str, np.ndarray]:
    """All telemetry in units of its noise, and the commands [N m]."""
    sigma = {
        "rate": CRAFT.rate_sensor.sigma[0],
        "wheel_momentum": CRAFT.wheels[0].momentum_sigma,
        "wheel_torque": 1.0,
    }
    return {
        key: np.concatenate([getattr(slew, key).ravel() for slew in flight.campaign.slews]) / s
        for key, s in sigma.items()
    }


def hidden_by_control(at: Estimate) -> dict:
    """Response of the telemetry to a change of each parameter by its prior sd: of the motion with
    the recorded torque commands (as the fit
    sees it), and of the closed loop, where the controller answers with other commands."""
    theta, sd, out = MISSION.theta, at.model.space.sd, {}
    controller = Controller(CRAFT.inertia_B, CRAFT.scale_factor)
    found = observe(at)
    for i, name in enumerate(BASE_NAMES):
        ends = []
        for sign in (1.0, -1.0):
            moved = theta.copy()
            moved[i] += sign * 0.05 * sd[i]
            J = np.array(
                [
                    [moved[0], moved[3], moved[4]],
                    [moved[3], moved[1], moved[5]],
                    [moved[4], moved[5], moved[2]],
                ]
            )
            truth = replace(CRAFT, inertia_B=J, scale_factor=tuple(moved[6:9]))
            ends.append(
                _telemetry(
                    fly(
                        plan_at(),
                        replace(MISSION, spacecraft=truth),
                        None,
                        controller=controller,
                    )
                )
            )
        response = {
            key: float(np.linalg.norm((ends[0][key] - ends[1][key]) / 0.1)) for key in ends[0]
        }
        share = found[name].signal_by
        out[name] = {
            "rate_with_given_commands": float(np.sqrt(np.sum(share[:, 0] ** 2))),
            "rate_in_closed_loop": response["rate"],
            "commands_rms": response["wheel_torque"]
            / math.sqrt(sum(s.wheel_torque.size for s in at.model.campaign.slews)),
        }
    return out


def worst(sds: Sequence) -> np.ndarray:
    """Largest sd of a product of inertia (last axis: nine parameters)."""
    return np.asarray(sds)[..., 3:6].max(-1)


@style.styled
def picture(found: dict) -> Figure:
    """The worst cross term against rate, number of slews and noise, four cases; and what the loss
    is made of.
    """
    figure = Figure(figsize=(style.WIDTH, 6.6), layout="constrained")
    panels = figure.subplots(2, 2)
    x = {"rate": RATES, "number": NUMBERS, "noise": NOISES}
    labels = {
        "rate": "slew rate [deg/s], same slews stretched in time",
        "number": "number of slews",
        "noise": "noise of all sensors, times nominal",
    }
    for axes, key in zip(panels.ravel(), x, strict=False):
        for k, (name, curve) in enumerate(found["curves"].items()):
            axes.plot(
                x[key],
                worst(curve[key]),
                color=style.color(k),
                ls=style.DASHES[k],
                marker=style.MARKERS[k],
                ms=3.5,
                lw=1.3,
                label=name,
            )
        size = max(abs(v) for v in MISSION.theta[3:6])
        axes.axhline(size, color=style.MUTED, lw=0.8, ls=(0, (4, 3)))
        axes.axhline(PRIOR.product_sigma, color=style.MUTED, lw=0.8)
        axes.text(
            x[key][-1],
            size * 0.93,
            "the largest cross term itself",
            fontsize=7.5,
            color=style.MUTED,
            va="top",
            ha="right",
        )
        axes.text(
            x[key][-1],
            PRIOR.product_sigma * 1.05,
            "prior",
            fontsize=7.5,
            color=style.MUTED,
            va="bottom",
            ha="right",
        )
        axes.set(
            yscale="log",
            xscale="linear" if key == "number" else "log",
            xlabel=labels[key],
            ylabel="sd of the worst cross term [kg m²]",
        )
    panels[0, 1].legend(loc="upper right", bbox_to_anchor=(1.0, 0.82))
    _losses(panels[1, 1], found["causes"])
    return figure


def _losses(axes, causes: dict) -> None:
    groups = list(next(iter(causes.values()))["inflation"])
    for y, (_name, row) in enumerate(causes.items()):
        start = 0.0
        for k, group in enumerate(groups):
            length = max(0.0, math.log10(row["inflation"][group]))
            label = group if y == 0 else None
            axes.barh(
                y,
                length,
                left=start,
                height=0.6,
                color=style.color(k),
                hatch="///" if k % 2 else None,
                ec="white",
                lw=0,
                label=label,
            )
            start += length
        axes.text(start, y, f"  ×{row['lost']:.2g}", va="center", fontsize=7.5, color=style.MUTED)
    axes.set(
        yticks=range(len(causes)),
        yticklabels=causes,
        ylim=(len(causes) - 0.4, -1.6),
        xlabel="decades of sd lost to not knowing …",
    )
    axes.set_xlim(0.0, 1.25 * max(math.log10(row["lost"]) for row in causes.values()))
    axes.legend(ncols=4, loc="upper left", fontsize=7.5, columnspacing=1.0)


def page(found: dict) -> str:
    """The answer, with numbers."""
    c, curve, hidden = found["causes"], found["curves"], found["hidden"]
    base = curve["tachometers, misalignment known"]
    at = {
        key: {name: worst(rows[key]) for name, rows in curve.items()}
        for key in ("rate", "number", "noise")
    }
    one, tenth = int(np.flatnonzero(RATES == 1.0)[0]), int(np.flatnonzero(RATES == 0.1)[0])
    half = worst(base["rate"])[int(np.flatnonzero(RATES == 0.5)[0])]
    value, sd = abs(c["Jxy"]["value"]), c["Jxy"]["sd"]
    relative = {name: c[name]["sd"] / abs(c[name]["value"]) for name in BASE_NAMES[:6]}
    rate = DEGREE
    lost = found["lost"]
    lines = [
        "# Why are the cross terms poorly observable?",
        "",
        "`python analyses/observability_study.py` · MOST-like spacecraft, five slews of 30 to 60 "
        "deg, three wheels with tachometers, rate sensor 2e-5 rad/s",
        "a sample at 4 Hz. All sds are what a fit of the whole telemetry would state.",
        "",
        "## In one paragraph",
        "",
        "Because they are small, not because they are hidden. "
        "In kg m² the products of inertia are known *better* than the moments: "
        f"{sd:.1e} for Jxy and",
        f"{c['Jxx']['sd']:.1e} for Jxx. But Jxx is {c['Jxx']['value']:.2f} and Jxy {value:.3f} kg "
        "m²: relative to their size the cross terms are",
        f"{relative['Jxy'] / relative['Jxx']:.0f} (Jxy) to {relative['Jxz'] / relative['Jxx']:.0f} "
        "(Jxz) times worse. "
        f"The signal of Jxy's own size in all telemetry is {c['Jxy']['signal_of_size']:,.0f} "
        "sigma,",
        f"that of Jxx {c['Jxx']['signal_of_size']:,.0f}: "
        f"at 1 deg/s a cross term of {value:.3f} kg m² asks the wheels for {value * rate:.1e} N m "
        "s, and its gyroscopic torque",
        f"is {value * rate**2:.1e} N m; slews at 0.1 deg/s have a tenth and a hundredth of that.",
        "",
        "## What is lost to what",
        "",
        "| | value | sd | signal of its size [sigma] | sd lost to other unknowns | most to |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in c.items():
        most = max(row["inflation"], key=lambda g, r=row: r["inflation"][g])
        own = row["value"] - (1.0 if name.startswith("K") else 0.0)
        lines.append(
            f"| {name} | {own:.4g} | {row['sd']:.2g} | {row['signal_of_size']:,.0f} | "
            f"×{row['lost']:.1f} | {most} (×{row['inflation'][most]:.1f}) |"
        )
    lines += [
        "",
        "(K as its distance from 1.) Each slew's own start state is what costs most: "
        "its rate, attitude and wheel momentum are fitted, too.",
        "",
    ]
    lines += [
        "## Against rate, number of slews, noise, sensors",
        "",
        "![Cross terms](../figures/cross_terms.png)",
        "",
    ]
    lines += [
        "| | 0.1 deg/s | 1 deg/s | 1 slew | 5 slews | 10 slews | noise ×10 |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in CASES:
        cells = [
            at["rate"][name][tenth],
            at["rate"][name][one],
            at["number"][name][0],
            at["number"][name][4],
            at["number"][name][6],
            at["noise"][name][4],
        ]
        lines.append(f"| {name} | " + " | ".join(f"{v:.2g}" for v in cells) + " |")
    known, fitted = (
        at["rate"]["tachometers, misalignment known"][one],
        at["rate"]["misalignment fitted"][one],
    )
    deaf = at["rate"]["no tachometers"][one]
    both = at["rate"]["no tachometers, misalignment fitted"][one]
    ten = [at["noise"]["tachometers, misalignment known"][k] for k in (2, 4)]
    few = at["number"]["tachometers, misalignment known"]
    lines += [
        "",
        "(sd of the worst cross term, kg m²; prior 0.03.)",
        "",
        "- **Rate**: the same slews stretched in time to a tenth of the rate give "
        f"{at['rate']['tachometers, misalignment known'][tenth] / known:.0f} times larger sds, "
        "although they have",
        f"  ten times the readings. From 0.5 deg/s on ({half:.1e}) hardly anything is gained: "
        "what rate adds in signal, stretching loses in readings and in telling",
        f"  J from the start states (which cost Jxy a factor {lost['0.2']:.1f} at 0.2 deg/s, "
        f"{lost['0.5']:.1f} at 0.5, {lost['1.0']:.1f} at 1 and {lost['2.0']:.1f} at 2: a deviation",
        f"  turns with momentum over inertia, once in {found['period']:.0f} s here). "
        "With equal telemetry the sd goes on falling (`analyses/PAPER.md`).",
        f"- **Number of slews**: one slew leaves {few[0]:.1e} and two {few[1]:.1e}: "
        "about one axis not all three products show. Three slews about three",
        f"  axes give {few[2]:.1e}, five {few[4]:.1e}; "
        f"from five to ten it becomes {few[4] / few[6]:.2f} times better (√2 would be 1.41).",
        f"- **Noise**: ten times the noise, {ten[1] / ten[0]:.1f} times the sd.",
        f"- **Tachometers**: without them {deaf / known:.1f} times worse: "
        "the momentum of the wheels must then be inferred from the motion.",
        "- **Misalignment of the rate sensor**: fitting it costs the cross terms a factor "
        f"{fitted / known:.2f} with tachometers and {both / deaf:.2f} without: the slews",
        f"  themselves determine its angles to {found['misalignment_sd']:.1e} rad (prior 3e-3), "
        "because momentum and the star tracker do not pass through the rate sensor.",
        "  (Left out of the fit, a misalignment does pull J: `analyses/PAPER.md`.)",
        "",
        "## What the feedback controller hides",
        "",
        "Response of the rate sensors, over five slews, to a change of each parameter by its prior "
        "sd: with the torque commands as they were recorded, which is what",
        "the fit compares, and in the closed loop, where the controller answers the change with "
        "other commands. The ratio is what feedback hides from the motion.",
        "",
        "| | with recorded commands [sigma] | in closed loop [sigma] | hidden by | commands change "
        "by (rms) [N m] |",
        "|---|---|---|---|---|",
    ]
    for name, row in hidden.items():
        given, closed = row["rate_with_given_commands"], row["rate_in_closed_loop"]
        lines.append(
            f"| {name} | {given:,.0f} | {closed:,.0f} | ×{given / max(closed, 1e-9):,.1f} | "
            f"{row['commands_rms']:.1e} |"
        )
    products = [
        hidden[n]["rate_with_given_commands"] / hidden[n]["rate_in_closed_loop"]
        for n in BASE_NAMES[3:6]
    ]
    lines += [
        "",
        "From the motion alone a controller hides the cross terms by factors of "
        f"{min(products):.0f} to {max(products):.0f}: "
        "whoever fits rates without the recorded commands",
        "fits what is left. The commands carry it: that is why `fit` takes them as recorded, and "
        "nothing is hidden from it.",
        "",
        "For slews that show the cross terms better see `analyses/results/design.md`; "
        "for the paper's own claim about rate, `analyses/PAPER.md`.",
        "",
    ]
    return "\n".join(lines)


def computed() -> dict:
    """All numbers."""
    at = estimate_at_truth(plan_at(), MISSION)
    misaligned = estimate_at_truth(plan_at(), MISSION, by_name((MISALIGNMENT,))).sd[9:]
    losses = {
        str(r): observe(estimate_at_truth(plan_at(r), MISSION))["Jxy"].inflation[
            "initial conditions"
        ]
        ** 0.5
        for r in (0.2, 0.5, 1.0, 2.0)
    }
    h = np.linalg.norm(plan_at().wheel_momentum)
    period = 2.0 * math.pi * np.trace(CRAFT.inertia_B) / 3.0 / h
    numbers = {"misalignment_sd": float(misaligned.max()), "lost": losses, "period": float(period)}
    return numbers | {"curves": curves(), "causes": causes(at), "hidden": hidden_by_control(at)}


def main() -> None:
    """Compute (unless the numbers are there: delete their file to begin again), draw, write."""
    numbers = ROOT / "analyses" / "results" / "cross_terms.json"
    if not numbers.exists():
        write_atomically(numbers, json.dumps(computed(), indent=1) + "\n")
    found = json.loads(numbers.read_text())
    write_atomically(
        ROOT / "figures" / "cross_terms.png",
        lambda path: picture(found).savefig(
            path, format="png", dpi=150, metadata={"Software": None}
        ),
    )
    text = page(found)
    write_atomically(ROOT / "analyses" / "CROSS_TERMS.md", text)
    print(text)


if __name__ == "__main__":
    main()
