"""A figure as the bytes of a small file, the same every time: no dates, ids from a fixed salt.

PNG gets a palette, a third of its size in full colour. SVG gets hundredths of a point.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, Literal

from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from bayes_inertia.files import write_atomically

# Dots per inch, colours and their choice of a PNG: the next where the file would be too large.
# The octree is truer to many colours, coverage keeps white and pale grey among few.
_QUALITIES = (
    (130, 128, Image.Quantize.FASTOCTREE),
    (110, 48, Image.Quantize.MAXCOVERAGE),
    (100, 32, Image.Quantize.MAXCOVERAGE),
)
_REPRODUCIBLE_SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "bayes-inertia",
    "svg.fonttype": "path",
    "path.simplify_threshold": 0.3,
}
_METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
}


def figure_bytes(
    figure: Figure, form: Literal["png", "svg"], most_bytes: int | None = None
) -> bytes:
    """A figure as a file in memory.

    Parameters
    ----------
    figure : Figure
        Any matplotlib figure.
    form : {"png", "svg"}
        PNG for thousands of points, otherwise SVG.
    most_bytes : int or None
        From there on a PNG is made coarser, within what can be read; None: never.

    Returns
    -------
    bytes
        Of the file.

    Examples
    --------
    >>> figure_bytes(Figure(figsize=(1.0, 1.0)), "png")[:4]
    b'\\x89PNG'
    """
    if form == "svg":
        return _rounded(_drawn(figure, form, _QUALITIES[0][0]).getvalue())
    content = b""
    for dpi, colours, choice in _QUALITIES:
        content = _with_palette(_drawn(figure, form, dpi), colours, choice)
        if most_bytes is None or len(content) <= most_bytes:
            break
    return content


def _drawn(figure: Figure, form: Literal["png", "svg"], dpi: int) -> io.BytesIO:
    """A figure as matplotlib writes it."""
    file = io.BytesIO()
    # It is compressed once more, and better.
    fast: dict[str, Any] = {"pil_kwargs": {"compress_level": 1}} if form == "png" else {}
    with rc_context(_REPRODUCIBLE_SETTINGS):
        figure.savefig(file, format=form, dpi=dpi, metadata=_METADATA[form], **fast)
    return file


def _with_palette(file: io.BytesIO, colours: int, choice: Image.Quantize) -> bytes:
    """A PNG in full colour as one with a palette."""
    smaller = io.BytesIO()
    with Image.open(file) as image:
        full = image.convert("RGB")
        quantized = full.quantize(colours, method=choice, dither=Image.Dither.NONE)
    quantized.save(smaller, "PNG", optimize=True)
    return smaller.getvalue()


def _rounded(svg: bytes) -> bytes:
    """An SVG without digits that nobody sees and without indentation; scales stay as they are."""
    text = re.sub(r"(?<![\d.])(-?\d+\.\d\d)\d+(?=[ \"])", r"\1", svg.decode("utf-8"))
    return re.sub(r"\n\s*", "\n", text).encode("utf-8")


def write_png(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG, atomically.

    Parameters
    ----------
    figure : Figure
        Any matplotlib figure.
    path : str or Path
        Of the file; it is replaced where it exists.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    return write_atomically(path, figure_bytes(figure, "png"))
