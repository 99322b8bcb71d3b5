"""A figure as the bytes of a small file, the same every time: no dates, ids from a fixed salt.

Pixels get a palette, a third of their size in full colour, those of rasterised artists inside an
SVG too. An SVG has text as text, and tenths of a point.
"""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from bayes_inertia.files import write_atomically
from bayes_inertia.report.layout import LAYOUT

_REPRODUCIBLE_SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "bayes-inertia",
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.3,
}
_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def figure_bytes(
    figure: Figure, form: Literal["png", "svg"], most_bytes: int | None = None
) -> bytes:
    """A figure as a file in memory; a PNG above `most_bytes` is made coarser, within what is read.

    >>> figure_bytes(Figure(figsize=(1.0, 1.0)), "png")[:4]
    b'\\x89PNG'
    """
    if form == "svg":
        return _with_small_images(_classed(_rounded(_vectors(figure))))
    content = b""
    for dpi, colours, choice in LAYOUT.png_qualities:
        content = _with_palette(_pixels(figure, dpi), colours, Image.Quantize[choice])
        if most_bytes is None or len(content) <= most_bytes:
            break
    return content


def _vectors(figure: Figure) -> bytes:
    """A figure as matplotlib writes it as SVG."""
    file = io.BytesIO()
    with rc_context(_REPRODUCIBLE_SETTINGS):
        figure.savefig(file, format="svg", dpi=LAYOUT.svg_dpi, metadata=_METADATA)
    return file.getvalue()


def _pixels(figure: Figure, dpi: int) -> Image.Image:
    """A figure drawn in full colour."""
    before = figure.dpi
    with rc_context(_REPRODUCIBLE_SETTINGS):
        try:
            figure.dpi = dpi
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
        finally:
            figure.dpi = before
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def _with_palette(full: Image.Image, colours: int, choice: Image.Quantize) -> bytes:
    """A picture as a PNG with a palette."""
    file = io.BytesIO()
    quantized = full.quantize(colours, method=choice, dither=Image.Dither.NONE)
    # The strongest compression takes six times as long for 6 % of the size.
    quantized.save(file, "PNG", compress_level=6)
    return file.getvalue()


def _rounded(svg: bytes) -> bytes:
    """An SVG without digits and blanks that nobody sees; scales and opacities stay."""
    text = re.sub(r"\n\s*", "\n", svg.decode("utf-8"))
    text = re.sub(r'(?<= d=")[^"]*|(?<= [xy]=")[^"]*', _short_path, text)
    # The reader's fonts draw the text: Verdana is as wide where DejaVu is not installed.
    return text.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif").encode("utf-8")


def _short_path(found: re.Match[str]) -> str:
    tenths = re.sub(r"(\d+\.\d)\d+", r"\1", found[0])
    path = re.sub(r"\s*([MLCQZz])\s*", r"\1", tenths).strip()
    return in_steps(path) if re.fullmatch(r"([ML]-?[\d.]+ -?[\d.]+|[Zz])+", path) else path


def in_steps(path: str) -> str:
    """A path of straight lines with steps from point to point, which have fewer digits."""
    steps, last, start = [], (0, 0), (0, 0)
    for letter, x, y in re.findall(r"([MLZz])(?:(-?[\d.]+) (-?[\d.]+))?", path):
        if letter in "Zz":
            steps.append("z")
            last = start
            continue
        point = (round(10.0 * float(x)), round(10.0 * float(y)))
        if letter == "M":
            start, last = point, (0, 0)
        step = " ".join(f"{0.1 * (new - old):.1f}" for new, old in zip(point, last, strict=True))
        steps.append(f"{letter if letter == 'M' else 'l'}{step}")
        last = point
    short = re.sub(r"(?<![\d.])0(?=\.[1-9])|\.0(?!\d)|-(?=0\.0)", "", "".join(steps))
    return re.sub(r"(?<=l)([^lMz]*) -", r"\1-", short)


def _classed(svg: bytes) -> bytes:
    """An SVG that says each style once, without ids and groups that nothing refers to."""
    text = svg.decode("utf-8")
    styles = dict.fromkeys(re.findall(r' style="([^"]*)"', text))
    names = {style: f"c{k}" for k, style in enumerate(styles)}
    text = re.sub(r' style="([^"]*)"', lambda found: f' class="{names[found[1]]}"', text)
    rules = "".join(
        f".{name}{{{re.sub('([:;]) ', r'\1', style)}}}" for style, name in names.items()
    )
    text = text.replace("</style>", f"{rules}</style>", 1)
    referred = set(re.findall(r'url\(#([^)]*)\)|href="#([^"]*)"', text))
    kept = {name for pair in referred for name in pair}
    text = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in kept else "", text)
    text = re.sub(r' transform="rotate\(-?0 [^"]*"', "", text)
    return re.sub(r"<g>\n(<(?:path|use|text|image)[^\n]*)\n</g>", r"\1", text).encode("utf-8")


def _with_small_images(svg: bytes) -> bytes:
    """An SVG whose rasterised artists have palettes."""

    def smaller(found: re.Match[bytes]) -> bytes:
        pixels = Image.open(io.BytesIO(base64.b64decode(found[1])))
        small = _with_palette(pixels, LAYOUT.colours_in_svg, Image.Quantize.FASTOCTREE)
        return b"data:image/png;base64," + base64.b64encode(small) + b'"'

    return re.sub(rb'data:image/png;base64,([^"]+)"', smaller, svg)


def write_png(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG, atomically."""
    return write_atomically(path, figure_bytes(figure, "png"))
