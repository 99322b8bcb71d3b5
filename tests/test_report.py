"""The report and its pictures, on made-up posteriors of every kind, and on one small fit."""

import base64
import json
import re
import time
from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr
from matplotlib import rcParams
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from bayes_inertia.inference.posterior import FORMAT, Posterior
from bayes_inertia.maths import quaternion
from bayes_inertia.report import Section, pictures, render, standard_sections, wording, write_report
from bayes_inertia.report.pictures import data
from bayes_inertia.report.pictures.chains import worst_parameter

BASE = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3")
SIGMA = {"rate": 2e-5, "attitude": 2.5e-5, "momentum": 5e-6}


@dataclass(frozen=True)
class Case:
    """What a made-up posterior looks like; `lengths` rows of each slew, `fixes` 0: no star tracker."""

    lengths: tuple[int, ...] = (60, 60, 48)
    fixes: int = 8
    drive: str = "commanded"
    extra: tuple[str, ...] = ()
    misfit: float = 1.0
    converged: bool = True
    sharpness: float = 300.0
    robust: bool = True
    name: str = "a campaign <of slews> & more"


CASES = {
    "good": Case(),
    "one_slew": Case(lengths=(60,), robust=False, sharpness=1.02),
    "thrown": Case(lengths=(2100,) * 15, fixes=0, drive="measured", misfit=3.0, converged=False),
    "many_effects": Case(extra=tuple(f"wheel_friction.coulomb{i}" for i in range(1, 9))),
}


def made(case: Case, seed: int = 0) -> Posterior:
    """A posterior with the groups of a real one and telemetry that fits it, up to `misfit` times the stated noise."""
    rng = np.random.default_rng(seed)
    names = [*BASE, *case.extra]
    groups, telemetry = _draws(case, names, rng), _telemetry(case, rng)
    groups["/estimate"] = groups["/estimate"].merge(telemetry.pop("/residuals"))
    tree = xr.DataTree.from_dict(groups | telemetry)
    for group in ("posterior", "prior"):
        for name in names:
            tree[group][name].attrs["units"] = (
                "kg m^2" if name[0] == "J" else "" if name[0] == "K" else "N m"
            )
    tree.attrs = {"format": FORMAT, "bayes_inertia": json.dumps(_about(case))}
    return Posterior(tree)


def _draws(case: Case, names: list[str], rng) -> dict[str, xr.Dataset]:
    d = len(names)
    mean = np.array([3.33, 2.2, 1.8, -0.012, 0.0026, 0.016, 1.01, 1.02, 0.98, *[1e-5] * (d - 9)])
    prior_sd = np.array([0.13, 0.09, 0.07, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, *[5e-5] * (d - 9)])
    correlation = np.eye(d)
    correlation[0, 6] = correlation[6, 0] = -0.95
    sd = prior_sd / case.sharpness
    covariance = correlation * np.outer(sd, sd)
    values = mean + rng.multivariate_normal(np.zeros(d), covariance, (2 * 8, 50))
    prior = mean + prior_sd * rng.normal(size=(1, 500, d))
    robust = 1.4**2 * covariance if case.robust else np.full((d, d), np.nan)
    slews, labels = (
        [f"slew {i + 1}" for i in range(len(case.lengths))],
        ["rate", "attitude", "momentum"],
    )
    n = np.array(
        [
            [3 * rows, 3 * case.fixes, 3 * rows * (case.drive == "commanded")]
            for rows in case.lengths
        ]
    )
    per_slew = {"slew": slews, "channel": labels}
    estimate = {
        "theta": ("parameter", mean),
        "prior_mean": ("parameter", mean),
        "prior_sd": ("parameter", prior_sd),
        "covariance": (("parameter", "parameter_2"), covariance),
        "robust_covariance": (("parameter", "parameter_2"), robust),
        "robust_sd": ("parameter", np.sqrt(np.diag(robust))),
        "robust_principal_sd": ("axis", np.sqrt(np.diag(robust))[:3]),
        "discount": (("slew", "channel"), np.full(n.shape, min(1.0, case.misfit**-2.0))),
        "slew_chi2": (("slew", "channel"), case.misfit**2 * n),
        "slew_n_data": (("slew", "channel"), n),
    }
    return {
        "/posterior": xr.Dataset(
            {name: (("chain", "draw"), values[..., i]) for i, name in enumerate(names)}
        ),
        "/prior": xr.Dataset(
            {name: (("chain", "draw"), prior[..., i]) for i, name in enumerate(names)}
        ),
        "/derived": xr.Dataset(
            {"principal_moment": (("chain", "draw", "axis"), np.sort(values[..., :3], -1))}
        ),
        "/sample_stats": xr.Dataset({"lp": (("chain", "draw"), -0.5 * rng.chisquare(d, (16, 50)))}),
        "/estimate": xr.Dataset(
            estimate, coords={"parameter": names, "parameter_2": names, **per_slew}
        ),
    }


def _telemetry(case: Case, rng) -> dict[str, xr.Dataset]:
    slews, rows, draws = (
        [f"slew {i + 1}" for i in range(len(case.lengths))],
        max(case.lengths),
        (2, 16),
    )
    coords = {"slew": slews, "wheel": ["w1", "w2", "w3"]}
    time_ = np.full((len(slews), rows), np.nan)
    for s, n in enumerate(case.lengths):
        time_[s, :n] = 0.5 * np.arange(n)
    clean = 0.02 * np.sin(np.nan_to_num(time_) / 8.0)[..., None] * np.array([1.0, -0.5, 0.2])
    observed, predicted, residual, constant = {}, {}, {}, {"time": (("slew", "row"), time_)}
    for name, last in (("rate", "sensor_axis"), ("momentum", "wheel")):
        noise = case.misfit * rng.normal(size=clean.shape)
        there = np.isfinite(time_)[..., None]
        observed[name] = (
            ("slew", "row", last),
            np.where(there, clean + SIGMA[name] * noise, np.nan),
        )
        if name == "rate" or case.drive == "commanded":
            predicted[name] = (
                ("chain", "draw", "slew", "row", last),
                clean + SIGMA[name] * rng.normal(size=(*draws, *clean.shape)),
            )
            residual[f"residual_{name}"] = (("slew", "row", last), np.where(there, noise, 0.0))
    if case.fixes:
        half = case.fixes // 2
        constant["fix_time"] = (
            ("slew", "fix"),
            np.array([[*t[:half], *t[np.isfinite(t)][-half:]] for t in time_]),
        )
        small = rng.normal(size=(len(slews), case.fixes, 3))
        truth = Rotation.random(len(slews) * case.fixes, rng)
        seen = truth * Rotation.from_rotvec(SIGMA["attitude"] * small.reshape(-1, 3))
        shape = (len(slews), case.fixes, 4)
        observed["attitude"] = (
            ("slew", "fix", "quaternion"),
            -seen.as_quat().reshape(shape),
        )  # q and -q are one attitude
        predicted["attitude"] = (
            ("chain", "draw", "slew", "fix", "quaternion"),
            np.broadcast_to(truth.as_quat().reshape(shape), (*draws, *shape)),
        )
        residual["residual_attitude"] = (("slew", "fix", "body_axis"), small)
    return {
        "/observed_data": xr.Dataset(observed, coords=coords),
        "/posterior_predictive": xr.Dataset(predicted, coords=coords),
        "/constant_data": xr.Dataset(constant, coords={"slew": slews}),
        "/residuals": xr.Dataset(residual),
    }


def _about(case: Case) -> dict:
    good, chi2 = case.misfit == 1.0, case.misfit**2
    channels = {
        "rate": True,
        "attitude": bool(case.fixes),
        "momentum": case.drive == "commanded",
        "total": True,
    }
    return {
        "campaign": case.name,
        "seed": 7,
        "campaign_sha256": None,
        "diagnostics": {
            "converged": case.converged,
            "nested_rhat_max": 1.001 if case.converged else 1.2,
            "ess_bulk_min": 9000.0,
            "ess_tail_min": 8000.0,
            "tau_max": 1.5,
            "evaluations": 20000,
            "ess_per_evaluation": 0.4,
            "seconds": 12.3,
            "acceptance": 0.8,
            "discarded": 12,
            "steps": 62,
        },
        "fit": {
            "reduced_chi2": {name: chi2 if there else None for name, there in channels.items()},
            "interval_99": {
                name: [0.95, 1.05] if there else None for name, there in channels.items()
            },
            "p_white": {
                "rate": 0.4,
                "attitude": None,
                "momentum": 0.2 if channels["momentum"] else None,
                "total": None,
            },
            "n_data": 1234,
            "discounted": not good,
            "starts_agreeing": [3, 3],
        },
        "gates": [
            {"name": "converged", "passed": case.converged, "says": "about the ensembles"},
            {
                "name": "explained",
                "passed": good,
                "says": "reduced chi^2; use robust_sd, see `diagnose`",
            },
        ],
        "effects": sorted({name.split(".")[0] for name in case.extra}),
        "drive": case.drive,
        "versions": {"bayes-inertia": "0.1.0"},
    }


@pytest.fixture(scope="module")
def posteriors() -> dict[str, Posterior]:
    return {name: made(case) for name, case in CASES.items()}


@pytest.fixture(scope="module")
def pages(posteriors) -> dict[str, str]:
    return {name: render(posterior) for name, posterior in posteriors.items()}


def text_of(page: str) -> str:
    """What a reader reads: without pictures, styles and tags."""
    page = re.sub(r"<style>.*?</style>", "", page, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))


@pytest.mark.parametrize("kind", CASES)
@pytest.mark.parametrize("name", pictures.__all__)
def test_pictures_are_figures_with_units_and_leave_settings_alone(posteriors, kind, name):
    before = dict(rcParams)
    figure = getattr(pictures, name)(posteriors[kind])
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
    channel = data.channel(posteriors["good"], "rate")
    assert [int(np.isfinite(r).all(-1).sum()) for r in channel.residual] == [60, 60, 48]
    figure = pictures.rates(posteriors["good"], [2])
    for axes in figure.axes:
        series = [line for line in axes.lines if len(line.get_xdata()) > 2]
        assert len(series) >= 3
        assert {len(line.get_xdata()) for line in series} == {48}


def test_misfit_angles_have_the_sign_and_size_of_the_residuals(posteriors):
    misfit = data.attitude_misfit(posteriors["good"])
    np.testing.assert_allclose(misfit.angle_B / SIGMA["attitude"], misfit.whitened, atol=1e-6)
    assert misfit.after.sum() == (~misfit.after).sum() == 12
    tree = posteriors["good"].tree
    predicted, measured = (
        tree[group]["attitude"].values.reshape(-1, 3, 8, 4)[0]
        for group in ("posterior_predictive", "observed_data")
    )
    np.testing.assert_allclose(misfit.angle_B, quaternion.error(predicted, measured), atol=1e-9)


def test_the_worst_parameter_is_the_one_whose_ensembles_disagree():
    posterior = made(CASES["good"])
    values = posterior.tree["posterior"]["K2"].values
    values[: len(values) // 2] += 3.0 * values.std()
    assert worst_parameter(posterior) == "K2"


def test_the_worst_slews_are_drawn_in_flown_order(posteriors):
    posterior = made(CASES["thrown"])
    posterior.tree["estimate"]["slew_chi2"].values[[11, 3], 0] *= 5.0
    assert data.worst_slews(posterior, 2) == [3, 11]
    assert len(data.worst_slews(posterior, 99)) == 15


@pytest.mark.parametrize("kind", CASES)
def test_pages_are_complete_safe_and_ask_for_nothing(pages, posteriors, kind):
    page = pages[kind]
    assert (
        page.count("<section")
        == len(standard_sections(posteriors[kind]))
        == page.count("</section>")
    )
    assert len(page) < 6e6
    assert "Content-Security-Policy" in page
    assert "default-src 'none'" in page
    assert not re.search(r"https?://", page)
    assert set(re.findall(r'(?:src|href)="(.)', page)) <= {"d", "#"}
    assert "a campaign &lt;of slews&gt; &amp; more" in page
    for kind_, payload in re.findall(r'src="data:image/([a-z+]+);base64,([^"]+)"', page):
        content = base64.b64decode(payload)
        assert content.startswith(b"\x89PNG" if kind_ == "png" else b"<?xml")
        addresses = set(re.findall(rb"https?://[^\"'< ]+", content)) if kind_ != "png" else set()
        assert all(
            a.startswith(
                (b"http://www.w3.org/", b"http://creativecommons.org/", b"http://purl.org/")
            )
            for a in addresses
        )


def test_the_style_sheet_is_the_one_that_the_policy_allows(pages):
    import hashlib

    css = re.search(r"<style>(.*?)</style>", pages["good"], re.S).group(1)
    allowed = re.search(r"style-src 'sha256-([^']+)'", pages["good"]).group(1)
    assert base64.b64encode(hashlib.sha256(css.encode()).digest()).decode() == allowed
    assert "style=" not in re.sub(r'src="[^"]*"', "", pages["good"])


def test_rendering_again_gives_the_same_bytes(pages, tmp_path):
    path = write_report(made(CASES["good"]), tmp_path / "report.html")
    assert path.read_text(encoding="utf-8") == pages["good"]


def test_a_report_is_quick():
    posterior = made(CASES["thrown"])
    began = time.process_time()
    render(posterior)
    assert time.process_time() - began < 6.0


@pytest.mark.parametrize(
    ("kind", "says", "says_not"),
    [
        (
            "good",
            [
                "Yes, these numbers can be trusted",
                "Jxx and K1 are hard to tell apart (correlation −0.9",
                "robust sd from 3 slews",
            ],
            ["weight", "diagnose”"],
        ),
        (
            "one_slew",
            ["does not determine every parameter", "One slew is too few for a robust sd"],
            ["Use the robust sd", "robust sd from"],
        ),
        (
            "thrown",
            [
                "Do not use these numbers yet",
                "an effect is missing",
                "Use the robust sd",
                "1/9",
                "no star-tracker fixes",
                "9 of 15 slews",
            ],
            ["chi^2", "`"],
        ),
        (
            "many_effects",
            ["wheel friction: coulomb8", "Only the 16 most correlated of 17 parameters"],
            [],
        ),
    ],
)
def test_pages_say_what_is_so(pages, kind, says, says_not):
    text = text_of(pages[kind])
    assert "common gain of all wheels cannot be told apart" in text
    assert [s for s in says if s not in text] == []
    assert [s for s in says_not if s in text] == []


def test_the_quoted_uncertainty_is_framed(pages):
    cells = re.findall(r'<td class="n quoted">([^<]*)</td>', pages["good"])
    posterior = made(CASES["good"])
    expected = [
        wording.number(
            row["robust_sd"], row["robust_sd"], wording.exponent(row["mean"], row["robust_sd"])
        )
        for row in posterior.summary()["parameters"].values()
    ]
    assert cells[:9] == expected


def test_own_sections_can_be_added(posteriors):
    own = Section("My own <remarks>", "<p>{{ what }}</p>", {"what": "1 < 2"})
    page = render(posteriors["good"], [*standard_sections(posteriors["good"]), own])
    assert "My own &lt;remarks&gt;" in page
    assert "<p>1 &lt; 2</p>" in page


def summary_of(**changes) -> dict:
    """A summary of two parameters, changed."""
    row = {"mean": 1.0, "sd": 1e-3, "robust_sd": 1.1e-3, "prior_sd": 0.1}
    about = _about(CASES["good"]) | {"parameters": {"Jxx": row, "K1": row}}
    passed = {gate["name"]: gate["passed"] for gate in about["gates"]} | changes.pop("passed", {})
    about["gates"] = [
        {"name": name, "passed": value, "says": "it says"} for name, value in passed.items()
    ]
    for key in ("sd", "robust_sd"):
        if key in changes:
            about["parameters"] = about["parameters"] | {"K1": row | {key: changes[key]}}
    about["fit"] = about["fit"] | {
        key: changes[key]
        for key in ("reduced_chi2", "p_white", "starts_agreeing")
        if key in changes
    }
    about["diagnostics"] = about["diagnostics"] | changes.get("diagnostics", {})
    return about


LARGE = {"rate": 2.0, "attitude": 1.0, "momentum": 1.0, "total": 1.5}
SMALL = {"rate": 0.5, "attitude": 1.0, "momentum": 1.0, "total": 0.8}
ONLY_TOTAL = {"rate": 1.04, "attitude": 1.04, "momentum": 1.04, "total": 1.08}


@pytest.mark.parametrize(
    ("changes", "level", "says"),
    [
        ({}, "good", "agree"),
        ({"robust_sd": 5e-3}, "good", "scatter more than the model's sd for K1"),
        ({"sd": 0.09}, "caution", "Not determined by this campaign: K1"),
        ({"starts_agreeing": [1, 3]}, "caution", "Only 1 of 3 starts"),
        (
            {"passed": {"converged": False}, "diagnostics": {"nested_rhat_max": 1.3}},
            "bad",
            "disagree (nested R-hat 1.300",
        ),
        (
            {"passed": {"converged": False}, "diagnostics": {"ess_tail_min": 120.0}},
            "bad",
            "only 120 effective samples",
        ),
        (
            {"passed": {"converged": False}, "diagnostics": {"tau_max": 40.0}},
            "bad",
            "50 kept steps are too few",
        ),
        (
            {"passed": {"explained": False}, "reduced_chi2": LARGE},
            "bad",
            "residuals (rate) are larger",
        ),
        (
            {
                "passed": {"explained": False},
                "p_white": {"rate": 0.3, "attitude": None, "momentum": 1e-9, "total": None},
            },
            "bad",
            "residuals (momentum)",
        ),
        (
            {"passed": {"explained": False}, "reduced_chi2": ONLY_TOTAL},
            "bad",
            "all channels together",
        ),
        (
            {"passed": {"explained": False}, "reduced_chi2": SMALL},
            "caution",
            "smaller than the stated noise",
        ),
        ({"passed": {"another": False}}, "bad", "It says."),
    ],
)
def test_verdicts(changes, level, says):
    verdict = wording.verdict(summary_of(**changes), n_slews=5)
    assert verdict.level == level
    assert says in " ".join(verdict.sentences)


def test_without_a_robust_sd_a_misfit_leaves_no_uncertainty_to_use():
    summary = summary_of(passed={"explained": False}, reduced_chi2=LARGE)
    for row in summary["parameters"].values():
        row["robust_sd"] = None
    said = " ".join(wording.verdict(summary, n_slews=1).sentences)
    assert "no uncertainty below can be defended" in said
    assert "Use the robust sd" not in said


@pytest.mark.parametrize(
    ("reduced", "interval", "p_white", "expected"),
    [
        (None, None, None, "no data"),
        (1.0, (0.9, 1.1), None, "as predicted"),
        (1.11, (0.9, 1.1), 0.2, "borderline"),
        (1.3, (0.9, 1.1), 0.2, "too large"),
        (1.3, (0.9, 1.1), 1e-8, "too large and structured in time"),
        (1.0, (0.9, 1.1), 1e-8, "structured in time"),
        (0.5, (0.9, 1.1), 0.2, "smaller than the stated noise"),
    ],
)
def test_channel_verdicts(reduced, interval, p_white, expected):
    assert wording.channel_verdict(reduced, interval, p_white) == expected


@pytest.mark.parametrize(
    ("value", "sd", "power", "expected"),
    [
        (-0.01180, 8.6e-5, 0, "−0.011800"),
        (99.96, 1.2, 0, "100.0"),
        (1.6886e-3, 1.4e-5, -3, "1.689"),
        (0.0, 1.8e-4, -6, "0"),
        (5.0, 0.0, 0, "5"),
        (1.0, float("nan"), 0, "1"),
    ],
)
def test_numbers_are_rounded_by_their_uncertainty(value, sd, power, expected):
    assert wording.number(value, sd, power) == expected


@pytest.mark.parametrize(
    ("drive", "effects", "channels", "wheels", "slews", "says", "does_not_say"),
    [
        (
            "measured",
            [],
            [],
            3,
            1,
            ["momentum is the input", "no star-tracker fixes", "has 1 slew:", "common gain"],
            ["its momentum residuals"],
        ),
        (
            "commanded",
            ["wheel_torque_gain"],
            ["attitude", "momentum"],
            3,
            8,
            ["commanded torques are the input", "comes from their prior", "its momentum residuals"],
            ["star-tracker"],
        ),
        (
            "commanded",
            [],
            ["attitude"],
            3,
            8,
            ["there are no tachometers"],
            ["its momentum residuals"],
        ),
        (
            "commanded",
            [],
            ["attitude"],
            0,
            8,
            ["there are no wheels", "ratios"],
            ["common gain", "commanded torques"],
        ),
        (
            "commanded",
            ["inertia_change"],
            ["attitude", "momentum"],
            3,
            8,
            ["J is the tensor before its change"],
            [],
        ),
    ],
)
def test_limits(drive, effects, channels, wheels, slews, says, does_not_say):
    said = " ".join(
        wording.limits(
            drive=drive, effects=effects, channels=channels, wheels=wheels, n_slews=slews
        )
    )
    assert [s for s in says if s not in said] == []
    assert [s for s in does_not_say if s in said] == []


@pytest.mark.parametrize(
    ("r", "expected"),
    [
        (0.5, None),
        (-0.95, "−0.95): raising one while"),
        (0.9871, "+0.987): raising or lowering both"),
        (-0.99999, "beyond −0.999"),
    ],
)
def test_correlation_sentences(r, expected):
    said = wording.correlations(["Jxx", "K1"], [[1.0, r], [r, 1.0]])
    assert [expected in s for s in said] == ([True] if expected else [])


@pytest.mark.slow
def test_a_real_fit_can_be_reported(flying, setup_type):
    """The made-up posteriors above have the groups that a fit has."""
    from bayes_inertia.app.fit_campaign import fit
    from bayes_inertia.inference.sampler import Settings

    campaign = flying(
        1, setup_type(turns=((0.6, 0.1, 0.0), (0.1, 0.5, 0.5)), rows=48, dt=2.0)
    ).campaign
    posterior = fit(campaign, settings=Settings(ensembles=2, walkers=24, steps=40, max_steps=40))
    assert render(posterior).count("<figure>") == 6
    assert set(posterior.tree.children) >= set(made(CASES["good"]).tree.children)
