"""Figures as small files: the same every time, coarser only where they must be."""

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


def test_an_svg_has_hundredths_of_a_point_and_keeps_its_scales():
    text = figure_bytes(scatter(5), "svg").decode()
    assert not re.search(r"<path[^>]* d=\"[^\"]*\d\.\d{3}", text)
    assert "scale(0.015625)" in text


@pytest.mark.parametrize(("n", "kind"), [(5, "image/svg+xml"), (4000, "image/png")])
def test_only_small_figures_are_vectors(n, kind):
    assert data_uri(Picture(scatter(n), "", "")).startswith(f"data:{kind};base64,")
