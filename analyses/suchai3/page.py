"""The page and the figure of SUCHAI-3, from `tumble.json`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from analyses.pages.figures import save_svg
from bayes_inertia.report.pictures import style
from bayes_inertia.version import __version__

_HEAD = """# SUCHAI-3: a real satellite, from packets to a result

Version {version}; `python -m analyses.suchai3.tumble`.

A 3U CubeSat of the University of Chile, in free rotation for months: no wheels, no control. Gyro and magnetometer at
1 Hz in {sessions} sessions, two-line elements for orbit and field. The telemetry is public
([source and licence](../../suchai3/data/README.md)); `import` cuts it at the gaps, leaves repeated packets out and says
how many. Each session is cut into slews of at most 300 s: {slews} slews, {rows} rows.

![Spin history, and ratios of the principal moments]({figure})

## What free rotation tells

Without a known torque the scale of J is the CAD's. Ratios are not. Medians and 90 % intervals:

| | CAD | {names} |
|---|---|{bars}|
"""

_FIT_ROWS = ("slews", "reduced χ², gyro", "reduced χ², magnetometer")


def page(content: Mapping[str, Any]) -> str:
    """Markdown."""
    fits = content["fits"]
    whole = fits["all sessions"]
    text = _HEAD.format(
        version=__version__,
        sessions=len(content["spin"]["day"]),
        slews=whole["slews"],
        rows=f"{whole['rows']:,}",
        figure="../../../figures/suchai3.svg",
        names=" | ".join(fits),
        bars="---|" * (len(fits) - 1) + "---",
    )
    for name in whole["ratios"]:
        cells = [_interval(fit["ratios"][name]) for fit in fits.values()]
        text += f"| {name} | {content['cad'][name]:.4g} | {' | '.join(cells)} |\n"
    for name, key in (("gyro", "rate"), ("magnetometer", "magnetometer")):
        cells = [f"{fit['reduced_chi2'][key]:.2f}" for fit in fits.values()]
        text += f"| reduced χ², {name} | | {' | '.join(cells)} |\n"
    return text + _verdict(content) + _sensors(whole) + _torques(content)


def _interval(row: Mapping[str, float]) -> str:
    return f"{row['median']:.4g} ({row['low']:.4g} to {row['high']:.4g})"


def _verdict(content: Mapping[str, Any]) -> str:
    ratios, cad = content["fits"]["all sessions"]["ratios"], content["cad"]
    difference = "largest minus middle, in 1000 of the largest"
    nutation = "nutation over spin"
    axis = ratios["spin axis towards x [deg]"]
    return f"""
**Which number of the CAD is wrong.** Jyy - Jxx: the CAD says {cad[difference]:.2g} thousandths of Jyy, the rotation
{_interval(ratios[difference])}. Nutation over spin, which is what telemetry shows, is {_interval(ratios[nutation])} instead of
{cad[nutation]:.3f}. The interval holds none of the CAD's values. How small Jzz is adds little: free rotation tells it no
better than the prior's 3 %.

**The spin axis** is an axis of the largest moment, {_interval(axis)} degrees from the gyro's y axis towards x. Gyro and
magnetometer are on one structure, and the magnetometer's circle is tilted the same way: the tensor is turned, not one
sensor. A CAD tensor without products says 0. The intervals are those of the model: what the sessions of 2023 and of 2024
say of each other stands in the columns beside.
"""


def _sensors(whole: Mapping[str, Any]) -> str:
    rows = "".join(
        f"| {name} | {row['mean']:.4g} | {row['sd']:.2g} |\n"
        for name, row in whole["parameters"].items()
        if name.startswith(("K", "magnetometer"))
    )
    return f"""
## The sensors

| | estimate | sd |
|---|---|---|
{rows}
K2 rests on the magnetometer's spin against the gyro's. K1 and K3 see the nutation alone: their sds are the prior's.
Offsets are beside the middle of all readings [T]; scale and soft iron are shares.
"""


def _torques(content: Mapping[str, Any]) -> str:
    spin, best = content["spin"], content["torques"][0]
    rows = "".join(
        f"| {', '.join(history['torques'])} "
        f"| {', '.join(f'{1e9 * torque:.1f}' for torque in history['torque_N_m'])} "
        f"| {history['rms']:.2f} | {history['bic'] - best['bic']:.0f} |\n"
        for history in content["torques"]
    )
    return f"""
## What turns the spin

From {spin["spin"][0]:.1f} to {spin["spin"][-1]:+.1f} deg/s in {spin["day"][-1]:.0f} days, through zero. Mean torques about the spin axis, on the CAD's
scale; drag goes with the growth of the mean motion, which two-line elements tell:

| torques | mean [nN m] | rms left [deg/s] | BIC above the best |
|---|---|---|---|
{rows}
A torque that keeps its sign while the spin changes its own is no damping, and no field drives it: drag on a body that is
no mirror image of itself, and sunlight on it, do. The best row leaves {best["rms"]:.2f} deg/s, more than the sessions' noise: the
direction of the spin axis to the wind, which no session here fixes for months, is not in it. What share is drag's, we do
not know better than these rows differ.
"""


@style.styled
def _picture(content: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(7.6, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    spin, best = content["spin"], content["torques"][0]
    left.axhline(0.0, color=style.PALE, lw=0.8)
    left.plot(spin["day"], best["modelled"], color=style.VERMILLION, label="best torques")
    left.plot(spin["day"], spin["spin"], "o", ms=4, color=style.BLUE, label="sessions")
    left.set(xlabel="days since 2023-09-04", ylabel="spin [deg/s]", title="Spin about y")
    left.legend()
    names = list(content["fits"])
    name = "largest minus middle, in 1000 of the largest"
    for k, fit in enumerate(names):
        row = content["fits"][fit]["ratios"][name]
        right.plot([row["low"], row["high"]], [k, k], color=style.color(k), lw=3)
        right.plot(row["median"], k, style.MARKERS[k], color=style.color(k))
    right.axvline(content["cad"][name], color=style.INK, ls="--", lw=1)
    right.annotate("CAD", (content["cad"][name], len(names) - 0.6), ha="left", va="top")
    right.set(
        yticks=range(len(names)),
        yticklabels=names,
        ylim=(-0.6, len(names) - 0.4),
        xlim=(0.0, None),
        xlabel="(Jyy - Jxx) / Jyy, in thousandths; bars: 90 %",
        title="How far the body is from round",
    )
    return figure


def draw(content: Mapping[str, Any]) -> None:
    """Write the figure."""
    save_svg(_picture(content), "suchai3")
