"""The pictures of whole posteriors."""

from functools import partial

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.parameters import base_names, base_units
from bayes_inertia.report.pictures import posterior_data
from bayes_inertia.report.pictures.chains import draw_chains, worst_parameter
from bayes_inertia.report.pictures.diagnosis import draw_misfit_by_step, draw_shifts
from bayes_inertia.report.pictures.pairs import draw_pairs, draw_priors
from bayes_inertia.report.pictures.telemetry import draw_attitude, draw_rates, draw_residuals

KINDS = ("good", "one_slew", "thrown", "many_effects")
PICTURES = {
    "attitude": draw_attitude,
    "chains": draw_chains,
    "momentum": partial(draw_residuals, name="momentum"),
    "pairs": draw_pairs,
    "priors": draw_priors,
    "rates": draw_rates,
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", PICTURES)
def test_pictures_are_figures_with_units_and_leave_settings_alone(posteriors, kind, name):
    before = dict(rcParams)
    figure = PICTURES[name](posteriors[kind])
    assert dict(rcParams) == before
    absent = kind == "thrown" and name in ("attitude", "momentum")
    assert (figure is None) == absent
    if absent:
        return
    assert isinstance(figure, Figure)
    if name == "pairs":  # one axes; names and units are texts
        texts = [t.get_text() for t in figure.axes[0].texts]
        assert any("[kg m²]" in t for t in texts)
        assert any("[–]" in t for t in texts)
        return
    labels = [
        text
        for axes in figure.axes
        for text in (axes.get_xlabel(), axes.get_ylabel())
        if text and text not in ("slew", "step of the ensemble")
    ]
    assert labels
    assert all("[" in text and text.endswith("]") for text in labels)


def test_padding_is_not_drawn(posteriors):
    channel = posterior_data.channel_series(posteriors["good"], "rate")
    assert [int(np.isfinite(r).all(-1).sum()) for r in channel.residual] == [60, 60, 48]
    figure = draw_rates(posteriors["good"], [2])
    for axes in figure.axes:
        series = [line for line in axes.lines if len(line.get_xdata()) > 2]
        assert len(series) >= 3
        assert {len(line.get_xdata()) for line in series} == {48}


def test_misfit_angles_have_the_sign_and_size_of_the_residuals(posteriors, stated_sigma):
    misfit = posterior_data.attitude_misfit(posteriors["good"])
    np.testing.assert_allclose(
        misfit.angle_B / stated_sigma["attitude"], misfit.whitened, atol=1e-6
    )
    assert misfit.after.sum() == (~misfit.after).sum() == 12
    tree = posteriors["good"].tree
    predicted, measured = (
        tree[group]["attitude"].values.reshape(-1, 3, 8, 4)[0]
        for group in ("posterior_predictive", "observed_data")
    )
    np.testing.assert_allclose(misfit.angle_B, quaternion.error(predicted, measured), atol=1e-9)


def test_the_worst_parameter_is_the_one_whose_ensembles_disagree(made):
    posterior = made("good")
    values = posterior.tree["posterior"]["K2"].values
    values[: len(values) // 2] += 3.0 * values.std()
    assert worst_parameter(posterior) == "K2"


def test_the_worst_slews_are_drawn_in_flown_order(made):
    posterior = made("thrown")
    posterior.tree["estimate"]["slew_chi2"].values[[11, 3], 0] *= 5.0
    assert posterior_data.worst_slews(posterior, 2) == [3, 11]
    assert len(posterior_data.worst_slews(posterior, 99)) == 15


@pytest.mark.parametrize("n", [6, 8, 9, 10], ids=["no gyro", "2 axes", "3 axes", "4 axes"])
def test_shifts_of_any_number_of_scale_factors_are_drawn(n):
    row = {"before": 1.0, "after": 1.1, "sd_before": 0.1, "sd_after": 0.1}
    shift = {
        name: row | {"unit": unit} for name, unit in zip(base_names(n), base_units(n), strict=True)
    }
    labels = [axes.get_xlabel() for axes in draw_shifts([{"shift": shift}]).axes]
    assert [label.split(" ")[0] for label in labels] == list(base_names(n))


def test_misfits_of_more_channels_than_markers_are_drawn():
    chi2 = dict.fromkeys([*(f"sensor {i}" for i in range(8)), "total"], 1.0)
    step = {"added": "a", "reduced_chi2_before": chi2, "reduced_chi2_after": chi2}
    step |= {"held_out_before": None, "held_out_after": None}
    (axes,) = draw_misfit_by_step([step]).axes
    assert [text.get_text() for text in axes.get_legend().get_texts()][-1] == "all channels"


def test_times_count_from_the_first_row_of_each_slew(made):
    """A clock that counts from an epoch: words and pictures name the same second."""
    posterior = made("good")
    before = [axes.get_xlim() for axes in draw_rates(posterior).axes]
    constant = posterior.tree["constant_data"]
    for name in ("time", "fix_time"):
        constant[name].values[...] += 1.7e9
    np.testing.assert_allclose([axes.get_xlim() for axes in draw_rates(posterior).axes], before)
    assert posterior_data.attitude_misfit(posterior).after.sum() == 12
