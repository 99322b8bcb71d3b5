"""Plots on axes of one's own."""

import json
from io import BytesIO

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot, rcParams
from matplotlib.dates import num2date
from matplotlib.figure import Figure

import bayes_inertia as bi
from bayes_inertia.diagnosis.result import Candidate, Diagnosis
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.observability.analysis import observe
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.report.pictures.series import draw_fleet, draw_history
from bayes_inertia.report.plots import plot_candidates

BASE = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3")
OF_POSTERIOR = {
    "plot_attitude": {},
    "plot_pairs": {},
    "plot_prior": {"name": "Jxy"},
    "plot_ranks": {},
    "plot_rates": {"slew": 1},
    "plot_residuals": {"slew": "slew 3", "channel": "momentum"},
    "plot_trace": {"name": "K1"},
}


@pytest.mark.parametrize("name", OF_POSTERIOR)
def test_plots_draw_on_the_axes_they_are_given(posteriors, name):
    before, figure = dict(rcParams), Figure()
    axes = figure.subplots()
    assert getattr(bi, name)(posteriors["good"], **OF_POSTERIOR[name], ax=axes) is axes
    assert axes.has_data() or axes.texts
    assert figure.axes == [axes]
    assert dict(rcParams) == before


@pytest.mark.parametrize("kind", ["good", "many_effects"])
def test_labels_of_pairs_tell_ends_of_cells_and_are_not_cut(posteriors, kind):
    figure = Figure()
    axes = bi.plot_pairs(posteriors[kind], ax=figure.subplots())
    for text in axes.texts:
        box = text.get_window_extent()
        assert min(box.x0, box.y0) >= 0
        assert box.x1 <= figure.bbox.width
        assert box.y1 <= figure.bbox.height
    labels = [text.get_text() for text in axes.texts]
    assert not any("±" in label for label in labels)
    assert "name [unit]\nends of the cells" in labels


def test_pairs_may_be_named(posteriors):
    posterior, every = posteriors["good"], range(len(BASE))
    for names, shown in ((["K1", 0], ["K1", "Jxx"]), ("Jxy", ["Jxy"]), (every, BASE)):
        axes = bi.plot_pairs(posterior, names, ax=Figure().subplots())
        assert [t.get_text() for t in axes.texts if t.get_text() in BASE] == list(shown)


@pytest.mark.parametrize("name", ["plot_attitude", "plot_rates", "plot_residuals"])
def test_a_plot_of_several_axes_names_them(posteriors, name):
    legend = getattr(bi, name)(posteriors["good"], ax=Figure().subplots()).get_legend()
    assert len(legend.get_texts()) == 3


def test_without_axes_a_new_figure_is_made(posteriors):
    matplotlib.use("agg")
    axes = bi.plot_rates(posteriors["good"])
    assert axes.figure is pyplot.gcf()
    pyplot.close(axes.figure)


def test_the_report_draws_with_the_same_code(posteriors):
    from bayes_inertia.report.pictures.pairs import draw_priors

    drawn = draw_priors(posteriors["good"]).axes[3].lines
    own = bi.plot_prior(posteriors["good"], "Jxy", ax=Figure().subplots()).lines
    for ours, theirs in zip(own, drawn, strict=True):
        np.testing.assert_array_equal(ours.get_xydata(), theirs.get_xydata())


def test_telemetry_and_observability_are_drawn_before_any_fit():
    campaign = small_campaign()
    axes = bi.plot_telemetry(campaign.slews[0], ax=Figure().subplots())
    assert len(axes.lines) == 3
    assert axes.get_ylabel() == "rate sensor [rad/s]"
    seen = observe(campaign)
    axes = bi.plot_observability(seen, ax=Figure().subplots())
    assert [text.get_text() for text in axes.get_yticklabels()] == list(seen.names)


@pytest.fixture(scope="module")
def series(posteriors):
    """Four fits, Jzz 2 % larger in the last two: as campaigns of one craft, and of two crafts."""
    fits = [Posterior(posteriors["good"].tree.copy(deep=True)) for _ in range(4)]
    for fit in fits[2:]:
        fit.tree["estimate"]["theta"][2] *= 1.02
    days = np.array(["2026-01-01", "2026-03-01", "2026-05-01", "2026-07-01"], "M8[D]")
    return bi.history(fits, time=days), bi.fleet({"sat A": fits[0], "sat B": fits[2:]})


def test_a_history_and_a_fleet_of_fits_are_drawn_as_their_pages_do(series):
    history, fleet = series
    # K does not jump, Jzz does.
    for name, lines in (("Jzz", 3), ("K1", 2), (2, 3)):
        axes = Figure().subplots()
        assert bi.plot_history(history, name, ax=axes) is axes
        assert len(axes.lines) == lines
        known = num2date(axes.get_lines()[0].get_xdata(orig=False))
        assert [day.month for day in known] == [1, 3, 5, 7]
    axes = bi.plot_fleet(fleet, "Jzz", ax=Figure().subplots())
    assert [text.get_text() for text in axes.get_xticklabels()] == ["sat A", "sat B"]
    of_pages = draw_history(history).axes[2].lines, draw_fleet(fleet).axes[2].lines
    of_plots = bi.plot_history(history, "Jzz", ax=Figure().subplots()).lines, axes.lines
    for ours, theirs in zip(of_plots, of_pages, strict=True):
        for own, line in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(own.get_xydata(), line.get_xydata())


def test_what_a_history_and_a_fleet_draw_is_said_beside_it(series):
    history, fleet = series
    said = [
        {text.get_text() for text in axes.get_legend().get_texts()}
        for axes in (bi.plot_history(history, "Jzz"), bi.plot_fleet(fleet, "Jzz"))
    ]
    assert said == [
        {"90 % interval", "all campaigns together", "each alone ± sd"},
        {"spread between spacecraft", "mean of the fleet", "alone ± sd", "with its sisters ± sd"},
    ]


def test_names_of_users_are_no_formulas(posteriors):
    fits = [posteriors["good"], Posterior(posteriors["good"].tree.copy(deep=True))]
    crafts = dict(zip((r"a $\foo$", "$x_1$"), fits, strict=True))
    figure = Figure()
    axes = bi.plot_fleet(bi.fleet(crafts), ax=figure.subplots())
    figure.savefig(BytesIO())
    assert {text.get_text() for text in axes.get_xticklabels()} == set(crafts)


def test_fits_of_J_with_and_without_the_spin_of_wheels_are_no_series(posteriors):
    fits = []
    for spin in (True, False):
        tree = posteriors["good"].tree.copy(deep=True)
        attributes = posteriors["good"].attributes | {"includes_wheel_spin": spin}
        tree.attrs["bayes_inertia"] = json.dumps(attributes)
        fits.append(Posterior(tree))
    for ask in (bi.history, lambda fits: bi.fleet(dict(zip("ab", fits, strict=True)))):
        with pytest.raises(bi.CampaignError, match="wheels' spin inertia in J, others do not"):
            ask(fits)


def test_fits_that_share_a_slew_are_no_series(posteriors):
    tree = posteriors["good"].tree.copy(deep=True)
    attributes = posteriors["good"].attributes | {"slew_digests": {"own": ["1"]}}
    tree.attrs["bayes_inertia"] = json.dumps(attributes)
    for ask in (bi.history, lambda fits: bi.fleet(dict(zip("ab", fits, strict=True)))):
        with pytest.raises(bi.CampaignError, match="hold the same telemetry, which would count"):
            ask([Posterior(tree), Posterior(tree)])


def test_candidates_are_drawn_without_a_report():
    class Found(Diagnosis):
        def __init__(self):
            """Of a diagnosis nothing but what is drawn."""

        candidates = (Candidate("rate_bias", 3, 40.0, 1e-8, 15.0),)
        threshold, named = 0.05, ("rate_bias",)

    axes = plot_candidates(Found(), ax=Figure().subplots())
    assert [text.get_text() for text in axes.get_yticklabels()] == ["rate bias"]


def test_numbers_from_0_may_stand_for_names_also_those_of_numpy(posteriors):
    posterior = posteriors["good"]
    axes = [bi.plot_rates(posterior, slew, ax=Figure().subplots()) for slew in (1, np.int64(1))]
    first, second = (a.lines[0].get_xydata() for a in axes)
    np.testing.assert_array_equal(first, second)
    for plot in (bi.plot_prior, bi.plot_trace, bi.plot_ranks):
        axes = [plot(posterior, name, ax=Figure().subplots()) for name in ("Jyy", 1)]
        assert axes[0].get_xlabel() == axes[1].get_xlabel()
        assert axes[0].get_ylabel() == axes[1].get_ylabel()


@pytest.mark.parametrize(
    ("name", "settings", "says"),
    [
        ("plot_prior", {"name": "Jzx"}, "there is no 'Jzx'"),
        ("plot_pairs", {"names": ["Jxx", "Jzx"]}, "there is no 'Jzx'"),
        ("plot_rates", {"slew": "slew 9"}, "there is no 'slew 9'"),
        ("plot_residuals", {"channel": "gyro_2"}, "the fit predicts no gyro_2"),
        ("plot_residuals", {"channel": ["rate"]}, "channel: a list is no str; give the name of"),
        ("plot_pairs", {"names": 3}, "names: an int is no list"),
        ("plot_pairs", {"max_parameters": 0}, "max_parameters: is 0; give a whole number, 1 or"),
        ("plot_attitude", {"after": "x"}, "after: a str is no bool"),
        ("plot_rates", {"ax": Figure().subplots(1, 2)}, "ax: an ndarray is no Axes; give one Axes"),
        ("plot_rates", {"ax": Figure()}, r"of plt.subplots\(1, 2\) one by its number, ax=axes.0."),
    ],
)
def test_what_is_not_there_is_said(posteriors, name, settings, says):
    with pytest.raises(bi.SettingsError, match=says):
        getattr(bi, name)(posteriors["good"], **{"ax": Figure().subplots()} | settings)
    with pytest.raises(bi.SettingsError, match="channel: a list is no str; give a field of Slew"):
        bi.plot_telemetry(small_campaign().slews[0], ["rate"])


def test_what_is_no_section_of_a_report_is_said(posteriors, tmp_path):
    for sections, says in (("abc", "sections: a str is no list"), ([1], "an int is no Section")):
        with pytest.raises(bi.SettingsError, match=says):
            bi.write_report(posteriors["good"], tmp_path / "report.html", sections)


@pytest.mark.parametrize("name", [name for name in dir(bi) if name.startswith("plot_")])
def test_what_a_plot_cannot_show_is_said(name):
    with pytest.raises(
        bi.errors.SettingsError, match=r"a Campaign was given; give (an [AEIO]|a [^AEIO])"
    ):
        getattr(bi, name)(small_campaign(), *([0] if name == "plot_prior" else []))
