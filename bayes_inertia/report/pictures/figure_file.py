"""A figure as the bytes of a file, the same every time: no dates, ids from a fixed salt."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Literal

from matplotlib import rc_context
from matplotlib.figure import Figure

from bayes_inertia.files import write_atomically

_DPI = 130
_REPRODUCIBLE_SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "bayes-inertia",
    "svg.fonttype": "path",
    "path.simplify_threshold": 0.3,
}
_METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
}


def figure_bytes(figure: Figure, form: Literal["png", "svg"]) -> bytes:
    """A figure as a file in memory.

    Parameters
    ----------
    figure : Figure
        Any matplotlib figure.
    form : {"png", "svg"}
        PNG for thousands of points, otherwise SVG.

    Returns
    -------
    bytes
        Of the file.

    Examples
    --------
    >>> figure_bytes(Figure(figsize=(1.0, 1.0)), "png")[:4]
    b'\\x89PNG'
    """
    file = io.BytesIO()
    with rc_context(_REPRODUCIBLE_SETTINGS):
        figure.savefig(file, format=form, dpi=_DPI, metadata=_METADATA[form])
    return file.getvalue()


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
