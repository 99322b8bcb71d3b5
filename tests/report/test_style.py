"""Helpers of the pictures, on arrays. (Pictures of whole posteriors are tested with the report.)"""

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure

from bayes_inertia.report.pictures import style


@pytest.mark.parametrize(
    ("name", "unit", "center", "half"),
    [
        ("Jxx", "kg m^2", 3.33117, 1e-3),
        ("Jyy", "kg m^2", 3.3e-4, 4e-6),
        ("K1", "", 1.0, 0.2),
        ("Jxy", "kg m^2", -0.0118, 4e-4),
        ("b", "rad/s", 0.0, 2e-6),
    ],
)
def test_scales_give_short_ticks_and_are_exact(name, unit, center, half):
    scale = style.scale(name, unit, center, half)
    ends = np.array([center - half, center + half])
    shown = scale(ends)
    assert 1e-2 <= np.abs(shown).max() < 1e4
    np.testing.assert_allclose(shown * scale.factor + scale.offset, ends, rtol=1e-12)
    assert scale.label.startswith(name)
    assert scale.label.endswith("]")


def test_scale_label_states_offset_sign_and_power():
    assert style.scale("Jxy", "kg m^2", -0.6118, 4e-4).label == "Jxy + 0.61180 [× 10⁻⁶ kg m²]"
    assert style.scale("Jyy", "kg m^2", 3.282e-4, 4e-6).label == "Jyy [× 10⁻⁶ kg m²]"


def test_density_is_a_density_wherever_the_window_lies():
    draws = np.random.default_rng(3).normal(2.0, 0.5, 40_000)
    x, p = style.density(draws, 0.0, 4.0)
    step = x[1] - x[0]
    assert p.sum() * step == pytest.approx(1.0, abs=0.01)
    sd = 4.0 * np.sqrt(
        np.exp(-0.5) * 0.798 / (len(draws) * 0.05)
    )  # binomial error of a histogram bin as wide as the kernel, four sigma
    assert abs(np.interp(2.5, x, p) - 0.4839) < sd
    x, p = style.density(draws, 2.0, 3.0)  # cut off: what is outside is not squeezed in
    assert p.sum() * (x[1] - x[0]) == pytest.approx(0.477, abs=0.02)


def test_style_leaves_matplotlib_as_it_was():
    before = dict(rcParams)

    @style.styled
    def picture():
        assert rcParams["axes.spines.top"] is False
        return Figure()

    assert isinstance(picture(), Figure)
    assert dict(rcParams) == before


def test_grid_cells_lie_inside_and_apart():
    _, cells = style.grid(6.0, 3, 2)
    boxes = [(left, bottom, left + width, bottom + height) for left, bottom, width, height in cells]
    assert all(0 < a < c < 1 and 0 < b < d < 1 for a, b, c, d in boxes)
    for i, (a, b, c, d) in enumerate(boxes):
        assert all(c <= e or g <= a or d <= f or h <= b for e, f, g, h in boxes[i + 1 :])


@pytest.mark.parametrize(
    ("values", "expected"), [([0.1, -0.2], 4.2), ([np.nan], 4.2), ([100.0, np.nan], 108.0)]
)
def test_residual_panels_show_three_sigma_and_every_outlier(values, expected):
    assert style.symmetric_limit(np.array(values)) == pytest.approx(expected)
