"""The page and the figure of SUCHAI-3, from the content of `tumble.json`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment
from matplotlib.figure import Figure

from analyses.pages.figures import save_svg
from analyses.suchai3.spin import SPIN_SIGMA
from bayes_inertia.report.pictures import style
from bayes_inertia.version import __version__

_TEMPLATE = Path(__file__).parent / "tumble.md.jinja"
_DIFFERENCE = "largest minus middle, in 1000 of the largest"


def page(content: Mapping[str, Any]) -> str:
    """Markdown."""
    template = Environment(autoescape=False, keep_trailing_newline=True).from_string(
        _TEMPLATE.read_text(encoding="utf-8")
    )
    return template.render(
        content,
        version=__version__,
        whole=content["fits"]["all sessions"],
        difference=_DIFFERENCE,
        spin_sigma=SPIN_SIGMA,
    )


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
    name = _DIFFERENCE
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
