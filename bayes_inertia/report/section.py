"""Sections of a report, with a template each, and pictures inside the page."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Any
from urllib.parse import quote

from markupsafe import Markup
from matplotlib.figure import Figure

from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures.figure_file import figure_bytes
from bayes_inertia.report.words import sentences

# What a `data:` address in double quotes may hold; without a colon the page names no other address.
_AS_THEY_ARE = " !$'()*+,-./;=?@_{}~"


@dataclass(frozen=True)
class Picture:
    """A figure with the caption that explains it.

    Parameters
    ----------
    figure : Figure
        Any matplotlib figure.
    caption : str
        Plain text below the picture.
    alt : str
        For readers who cannot see it.
    dense : bool
        Whether it has thousands of points that are not rasterised: then it is embedded as PNG,
        otherwise as SVG unless that is large.
    instead_of_script : bool
        Whether a script of the section shows the same: then the picture is for readers who run no
        scripts.
    folded : bool
        Whether it is evidence for experts: then the page folds it, and paper leaves it out.
    """

    figure: Figure
    caption: str
    alt: str
    dense: bool = False
    instead_of_script: bool = False
    folded: bool = False


@dataclass(frozen=True)
class Section:
    """One section of the report.

    Parameters
    ----------
    title : str
        Its heading.
    template : str
        Jinja source of its body (`packaged` reads one that ships with the package).
        It sees `context`, and everything is escaped.
    context : mapping
        The values it prints.
    pictures : tuple of Picture
        Drawn under the body, in order.
    script : str
        JavaScript that the page runs, once for all sections that want it. Everything must be
        readable without it.

    Examples
    --------
    >>> Section("Notes", "<p>{{ text }}</p>", {"text": "a < b"}).title
    'Notes'
    """

    title: str
    template: str
    context: Mapping[str, Any] = field(default_factory=dict)
    pictures: tuple[Picture, ...] = ()
    script: str = ""


@dataclass(frozen=True)
class Table:
    """Cells of a table, for page and terminal alike."""

    # Headings, and the classes of their cells: n (numbers), extra (not on a phone), unit, long.
    columns: Mapping[str, str]
    rows: Sequence[Sequence[str]]
    kind: str = "narrow"  # classes of the whole
    marked: Sequence[int] = ()  # rows whose last cell stands out

    def without(self, *heads: str) -> Table:
        """The table without some columns."""
        kept = [k for k, head in enumerate(self.columns) if head not in heads]
        columns = {head: kind for head, kind in self.columns.items() if head not in heads}
        return replace(self, columns=columns, rows=[[row[k] for k in kept] for row in self.rows])

    def section(
        self,
        title: str,
        pictures: tuple[Picture, ...] = (),
        *,
        sentence: str = "",
        level: str = "",
        more: str = "",
        notes: Sequence[str] = (),
    ) -> Section:
        """A section with a sentence above the table (`level`: its colour), and notes below."""
        said = {"sentence": sentence, "level": level, "more": more, "notes": notes}
        return Section(title, packaged("table.html"), {"table": self} | said, pictures)


def packaged(name: str) -> str:
    """Source of a template, style sheet or script of this package.

    >>> "<table" in packaged("settings.html")
    True
    """
    return files("bayes_inertia.report").joinpath(name).read_text(encoding="utf-8")


def captioned(name: str, figure: Figure | None, *values: Any, **shown: bool) -> tuple[Picture, ...]:
    """A figure with the words that `words/pictures.txt` has for it; none without a figure."""
    if figure is None:
        return ()
    alt, caption = sentences("pictures", name, *values)
    return (Picture(figure, caption, alt, **shown),)


def data_uri(picture: Picture) -> Markup:
    """The picture as a `data:` address, byte for byte the same every time."""
    content, kind = b"", "image/svg+xml"
    if not picture.dense:
        content = figure_bytes(picture.figure, "svg")
    if picture.dense or len(content) > LAYOUT.largest_svg:
        content, kind = figure_bytes(picture.figure, "png", LAYOUT.largest_png), "image/png"
        return Markup(f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}")
    # A third shorter than base64. Without quotes and ampersands an attribute holds it as it is.
    text = content.decode("utf-8").replace(">\n<", "><").replace("\n", " ")
    text = re.sub("<[^>']*>", lambda tag: tag[0].replace('"', "'"), text)
    return Markup(f"data:{kind},{quote(text, safe=_AS_THEY_ARE)}")
