"""The pictures of whole posteriors."""

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.figure import Figure

from bayes_inertia.maths import quaternion
from bayes_inertia.report.pictures import posterior_data
from bayes_inertia.report.pictures.attitude import draw_attitude
from bayes_inertia.report.pictures.chains import draw_chains, worst_parameter
from bayes_inertia.report.pictures.pairs import draw_pairs
from bayes_inertia.report.pictures.priors import draw_priors
from bayes_inertia.report.pictures.telemetry import draw_momentum, draw_rates

KINDS = ("good", "one_slew", "thrown", "many_effects")
PICTURES = {
    "attitude": draw_attitude,
    "chains": draw_chains,
    "momentum": draw_momentum,
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
