"""How the pages' figures are written: SVG, the same bytes in every run."""

from __future__ import annotations

from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

FIGURES = Path(__file__).parents[1] / "figures"


def save_svg(figure: Figure, name: str) -> None:
    """Write `figures/NAME.svg`."""
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
        figure.savefig(FIGURES / f"{name}.svg", metadata={"Date": None, "Creator": None})
