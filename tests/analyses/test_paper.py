"""The analyses of the paper: quick variants run, figures are the same bytes again, the page is
complete, the statistics are right.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

ANALYSES = Path(__file__).resolve().parents[2] / "analyses"


@pytest.fixture(scope="module")
def quick(analysis, tmp_path_factory):
    """{name: (result, pictures)} of quick variants, and the folder that they were written to."""
    found = {
        name: analysis(f"paper.{name}").analysis(True)
        for name in (
            "claim_disturbances",
            "claim_torque_error",
            "claim_misalignment",
        )
    }
    out = tmp_path_factory.mktemp("paper")
    for result, pictures in found.values():
        analysis("paper.ferguson").write_result(result, pictures, out)
    return found, out


@pytest.mark.long
@pytest.mark.slow
def test_quick_variants_say_what_the_full_ones_say(quick):
    found, _ = quick
    numbers = {name: result.numbers for name, (result, _) in found.items()}
    # 2 sin(180 deg / 2) of the misalignment is left; the simulated median has the noise of four
    # flights (about 60").
    assert (
        abs(
            numbers["claim_misalignment"]["at_180_arcsec"]
            - numbers["claim_misalignment"]["expected_180_arcsec"]
        )
        < 150.0
    )
    # A torque that is 1 % too large looks like an inertia that is 1 % too small, where the wheels
    # stored no momentum.
    assert numbers["claim_torque_error"][
        "slope no tachometers, wheels start at rest"
    ] == pytest.approx(-1.0, abs=0.1)
    assert (
        numbers["claim_disturbances"]["Jxx fitted"] < numbers["claim_disturbances"]["Jxx trusted"]
    )


@pytest.mark.long
@pytest.mark.slow
def test_a_figure_drawn_again_has_the_same_bytes(analysis, quick, tmp_path):
    _, out = quick
    ferguson = analysis("paper.ferguson")
    again = analysis("paper.claim_misalignment").analysis(True)[1]["claim_misalignment_angle.png"]
    path = ferguson.save_picture(again, tmp_path / "again.png")
    assert path.read_bytes() == (out / "figures" / "claim_misalignment_angle.png").read_bytes()
    assert b"tIME" not in path.read_bytes()


@pytest.mark.long
@pytest.mark.slow
def test_the_page_names_every_analysis_and_figure_and_is_idempotent(analysis, quick):
    _, out = quick
    ferguson = analysis("paper.ferguson")
    page = out / "analyses" / "PAPER.md"
    text = page.read_text()
    ferguson.write_page(out)
    assert page.read_text() == text
    for path in sorted((out / "analyses" / "results").glob("paper/*.json")):
        result = json.loads(path.read_text())
        assert f"python -m analyses.paper.{result['name']}" in text
        assert all(
            (out / "figures" / file).is_file() and f"../figures/{file}" in text
            for file, _ in result["figures"]
        )


def test_committed_page_is_what_the_committed_results_say(analysis, tmp_path):
    ferguson = analysis("paper.ferguson")
    folder = Path("analyses", "results", "paper")
    (tmp_path / folder).mkdir(parents=True)
    for name in ferguson.ANALYSES:
        text = (ANALYSES.parent / folder / f"{name}.json").read_text()
        (tmp_path / folder / f"{name}.json").write_text(text)
        for file, _ in json.loads(text)["figures"]:
            assert (ANALYSES.parent / "figures" / file).is_file()
    assert ferguson.write_page(tmp_path).read_text() == (ANALYSES / "PAPER.md").read_text()


@pytest.mark.long
@pytest.mark.slow
def test_scatter_is_what_repeated_campaigns_show(analysis):
    """Errors of ten campaigns at 50 times our noise, whitened by the predicted scatter, are
    standard normal.
    """
    ferguson = analysis("paper.ferguson")
    from bayes_inertia.flight.plan import paper_like_plan
    from bayes_inertia.inference.optimizer import estimate
    from bayes_inertia.physics.forward_model import Model

    truth, initial = ferguson.SIMULATION.truth, ferguson.SIMULATION.initial
    quiet = ferguson.flown(paper_like_plan(), ferguson.spacecraft_of(truth), seed=1)
    s = ferguson.scatter(estimate(Model(quiet.campaign), starts=1), initial - truth, (50.0,) * 3)
    white = np.linalg.inv(np.linalg.cholesky(s.covariance))
    n, chi2 = 10, 0.0
    for seed in range(n):
        flight = ferguson.flown(paper_like_plan(), ferguson.spacecraft_of(truth, 50.0), seed=seed)
        error = white @ (
            estimate(Model(flight.campaign), starts=1, discount=False).theta - truth - s.mean
        )
        chi2 += float(error @ error)
    # chi^2 of 9 n degrees of freedom, four of its standard deviations
    assert abs(chi2 - 9 * n) < 4.0 * np.sqrt(2 * 9 * n)
