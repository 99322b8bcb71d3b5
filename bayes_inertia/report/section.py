"""What a report is made of: sections with a template each, and pictures that travel inside the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

_DPI = 130


@dataclass(frozen=True)
class Picture:
    """A figure with the caption that explains it.

    Attributes
    ----------
    figure : any matplotlib figure. caption : plain text. alt : for readers who cannot see it.
    dense : thousands of points: embedded as PNG, otherwise as SVG.
    """

    figure: Figure
    caption: str
    alt: str
    dense: bool = False


@dataclass(frozen=True)
class Section:
    """One section of the report.

    Attributes
    ----------
    title : its heading. template : Jinja source of its body (`packaged` reads one that ships with the package); sees `context`,
    and everything is escaped. context : the values it prints. pictures : drawn under the body, in order.

    >>> Section("Notes", "<p>{{ text }}</p>", {"text": "a < b"}).title
    'Notes'
    """

    title: str
    template: str
    context: Mapping[str, Any] = field(default_factory=dict)
    pictures: tuple[Picture, ...] = ()


def packaged(name: str) -> str:
    """Source of a template or style sheet of this package.

    >>> "<table" in packaged("settings.html")
    True
    """
    return files("bayes_inertia.report").joinpath(name).read_text(encoding="utf-8")


def data_uri(picture: Picture) -> str:
    """The picture as a `data:` address, byte for byte the same every time (no dates, ids from a fixed salt)."""
    file = io.BytesIO()
    with rc_context(
        {"svg.hashsalt": "bayes-inertia", "svg.fonttype": "path", "path.simplify_threshold": 0.3}
    ):
        if picture.dense:
            picture.figure.savefig(file, format="png", dpi=_DPI, metadata={"Software": None})
        else:
            picture.figure.savefig(
                file,
                format="svg",
                dpi=_DPI,
                metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
            )
    kind = "png" if picture.dense else "svg+xml"
    return f"data:image/{kind};base64,{base64.b64encode(file.getvalue()).decode('ascii')}"
