"""Figures as small files: the same every time, coarser only where they must be."""

import base64
import io
import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from bayes_inertia.report.pictures.figure_file import figure_bytes
from bayes_inertia.report.section import Picture, data_uri


def scatter(n: int) -> Figure:
    """Dots that compress badly."""
    figure = Figure(figsize=(8.0, 6.0))
    axes = figure.add_subplot()
    axes.scatter(*np.random.default_rng(3).normal(size=(2, n)), s=3, c=np.arange(n))
    return figure


def test_a_png_has_a_palette_and_is_coarser_only_where_it_is_too_large():
    figure = scatter(6000)
    full = figure_bytes(figure, "png")
    assert figure_bytes(figure, "png") == full
    with Image.open(io.BytesIO(full)) as image:
        assert image.mode == "P"
        width = image.width
    assert figure_bytes(figure, "png", len(full)) == full
    smaller = figure_bytes(figure, "png", len(full) - 1)
    assert len(smaller) < len(full)
    with Image.open(io.BytesIO(smaller)) as image:
        assert image.width < width


def test_an_svg_has_text_tenths_of_a_point_and_its_opacities():
    figure = scatter(5)
    figure.axes[0].fill([0, 1, 1], [0, 0, 1], alpha=0.35)
    text = figure_bytes(figure, "svg").decode()
    assert not re.search(r"<path[^>]* d=\"[^\"]*\d\.\d{2}", text)
    assert "0.35" in text
    assert "<text" in text
    assert "Verdana" in text


def test_the_dots_of_a_large_scatter_are_pixels_with_a_palette_inside_the_svg():
    figure = scatter(4000)
    figure.axes[0].collections[0].set_rasterized(True)
    uri = data_uri(Picture(figure, "", ""))
    assert uri.startswith("data:image/svg+xml;base64,")
    svg = base64.b64decode(uri.split(",", 1)[1])
    pixels = re.search(rb'data:image/png;base64,([^"]+)"', svg).group(1)
    with Image.open(io.BytesIO(base64.b64decode(pixels))) as image:
        assert image.mode == "P"
    assert figure_bytes(figure, "svg") == figure_bytes(figure, "svg")


@pytest.mark.parametrize(("n", "kind"), [(5, "image/svg+xml"), (4000, "image/png")])
def test_only_figures_of_very_many_points_are_pixels_throughout(n, kind):
    assert data_uri(Picture(scatter(n), "", "")).startswith(f"data:{kind};base64,")
