"""The benchmark and the calibration study run, their statistics are right, and a killed study goes
on where it was.
"""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from scipy import stats


@pytest.fixture(scope="module")
def calibration(analysis):
    pytest.importorskip("pyarrow")
    return analysis("calibration.ranks")


@pytest.fixture(scope="module")
def statistics(analysis):
    """Ranks and coverage, which the study's page shows."""
    return analysis("calibration.rank_statistics")


@pytest.fixture(scope="module")
def benchmark(analysis):
    return analysis("engine.benchmark")


def _table(statistics, spread: float, campaigns: int = 300) -> pd.DataFrame:
    """Fits as the study would write them whose sd is `spread` times the error's true sd."""
    rng, rows = np.random.default_rng(3), []
    for i in range(campaigns):
        for name in ("Jxx", "K1"):
            truth = rng.normal()
            mean = truth + rng.normal()
            draws = mean + spread * rng.normal(size=(2, statistics.RANKED))
            row = {
                "study": "five slews",
                "campaign": i,
                "parameter": name,
                "truth": truth,
                "mean": mean,
                "sd": spread,
                "prior_sd": 10.0,
            }
            row |= {"explained": True, "nested_rhat": 1.0, "reduced_chi2": 1.0}
            row |= {
                f"q{100 * p:g}": mean + spread * stats.norm.ppf(p)
                for level in statistics.LEVELS
                for p in (0.5 - level / 2, 0.5 + level / 2)
            }
            ranks = [draws[0], mean + 0.8 * (draws[0] - mean), draws[1]]
            rows.append(
                row
                | {
                    key: int((x < truth).sum())
                    for key, x in zip(statistics.RANKS, ranks, strict=True)
                }
            )
    return pd.DataFrame(rows)


def test_the_band_holds_uniform_ranks_as_often_as_it_says(statistics):
    n, trials = 60, 600
    half = statistics.band(n, 0.9)
    ranks = np.random.default_rng(9).integers(0, statistics.RANKED + 1, (trials, n))
    inside = sum(np.abs(statistics.departure(r)).max() <= half for r in ranks)
    low, high = stats.binom.ppf([1e-4, 1 - 1e-4], trials, 0.9)
    assert low <= inside <= high


@pytest.mark.slow
def test_right_uncertainties_pass_and_wrong_ones_are_noticed(statistics):
    right, wrong = (statistics.uniformity(_table(statistics, spread)) for spread in (1.0, 0.75))
    assert not right[right.ranks == "rank"].leaves.any()
    assert wrong[wrong.ranks == "rank"].leaves.any()
    assert right[right.ranks == "rank_shrunk"].leaves.any()
    covered = statistics.coverage(_table(statistics, 0.75))
    ninety = covered[(covered.level == 0.9) & (covered.kind == "sd")]
    assert (ninety.high < 0.9).all()
    z = statistics.scores(_table(statistics, 0.75))
    assert np.all(np.abs(z.sd_z - 1.0 / 0.75) < 5.0 / 0.75 / np.sqrt(600))


@pytest.mark.long
@pytest.mark.slow
def test_a_quick_calibration_writes_its_results_and_goes_on_after_a_kill(
    analysis, calibration, tmp_path, monkeypatch
):
    small = calibration.studies()[1:]
    monkeypatch.setattr(calibration, "studies", lambda: small)
    table = calibration.main(["--campaigns", "4", "--out", str(tmp_path)])
    assert table.campaign.nunique() == 2  # the second study gets half
    assert np.all(table["rank"].between(0, analysis("calibration.rank_statistics").RANKED))
    # Nine standardised errors of two honest fits: chi^2 with 18 degrees of freedom, were they
    # independent.
    z = (table.truth - table["mean"]) / table.sd
    assert float(z @ z) < stats.chi2.isf(1e-6, 18) * 2.0
    for file in (
        "figures/calibration.png",
        "analyses/results/calibration/calibration.md",
        "analyses/results/calibration/calibration.parquet",
    ):
        assert (tmp_path / file).stat().st_size > 1000
    rows = next((tmp_path / "run_calibration").rglob("rows.jsonl"))
    kept = rows.read_bytes()
    rows.write_bytes(kept[: len(kept) // 2])  # as if the run had been killed on the way
    again = calibration.main(["--campaigns", "4", "--out", str(tmp_path)])
    pd.testing.assert_frame_equal(again, table)
    assert rows.read_bytes() == kept


@pytest.mark.long
@pytest.mark.slow
def test_the_baseline_flies_what_the_package_flies(analysis, benchmark):
    import jax
    import jax.numpy as jnp

    from bayes_inertia.physics.forward_model import Model
    from bayes_inertia.physics.simulator import simulate_slew
    from bayes_inertia.physics.slew_input import Start

    campaign, truth = benchmark.the_campaign(benchmark.QUICK, 2026)
    campaign = campaign.subset([1])
    by_hand = analysis("engine.emcee_by_hand").ByHand(campaign, "LSODA", 1e-8, 1e-10)
    J = campaign.inertia.tensor
    start, wheel = by_hand.start(campaign.slews[0], np.ones((1, 3)))
    path = by_hand.fly(
        campaign.slews[0].time, campaign.slews[0].wheel_torque[None], start, wheel, J[None]
    )[0]
    slew = jax.tree.map(lambda a: a[0], Model(campaign).data.arrays.slews)
    flown, _ = jax.jit(simulate_slew)(
        slew,
        Start(jnp.asarray(start[0, 4:]), jnp.asarray(start[0, :4]), jnp.asarray(wheel[0])),
        jnp.asarray(J),
    )
    rows = len(path)
    # A twentieth of the noise of one reading.
    assert np.abs(flown.rate_B[:rows] - path[:, 4:7]).max() < 1e-6
    assert np.abs(flown.attitude[:rows] - path[:, :4]).max() < 1e-6
    assert np.abs(flown.wheel_momentum[:rows] - path[:, 7:]).max() < 2.5e-7
    # Slew by slew and all walkers at once are one density; both fall away from the truth.
    thetas = np.stack([truth, truth + np.array([0, 0.02, 0, 0, 0, 0, 0, 0, 0])])
    one, many = np.array([by_hand(theta) for theta in thetas]), by_hand.batch(thetas)
    np.testing.assert_allclose(many - one, 0.0, atol=1e-3 * np.abs(one).max())
    assert one[0] > one[1] + 100.0
    assert by_hand(np.array([9.0, 1.0, 1.0, 0, 0, 0, 1, 1, 1])) == -np.inf


@pytest.mark.long
@pytest.mark.slow
def test_a_quick_benchmark_writes_its_results(benchmark, tmp_path):
    found = benchmark.main(["--quick", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "analyses/results/engine/benchmark.json").read_text())
    assert [r["name"] for r in content["results"]] == [r.name for r in found]
    assert (tmp_path / "figures/benchmark.png").stat().st_size > 1000
    text = (tmp_path / "analyses/results/engine/benchmark.md").read_text()
    assert all(r.name in text for r in found)
    ours = found[0]
    # 24 steps of 4 ensembles with 64 walkers, the first 6 of them warm-up like the starts.
    assert ours.evaluations == 4 * 64 * 18
    assert ours.warmup_evaluations > 4 * 64 * 6
    assert all(np.isfinite([r.ess, r.milliseconds]).all() and r.ess > 0.0 for r in found)
    # Noise or not: solve_ivp and StretchMove together are slower by orders of magnitude.
    assert {c["claim"]: c["reached"] for c in content["claims"]}[
        "times those of the do-it-yourself baseline, slew by slew"
    ]


def test_effective_samples_are_the_smaller_count_of_the_worst_parameter(analysis):
    rng = np.random.default_rng(4)
    slow, white = np.empty((8, 4000)), rng.normal(size=(8, 4000))
    slow[:, 0] = rng.normal(size=8)
    for t in range(1, 4000):
        slow[:, t] = 0.9 * slow[:, t - 1] + np.sqrt(0.19) * rng.normal(size=8)
    found = analysis("engine.benchmark_samplers").effective_samples(np.stack([white, slow], -1))
    # An AR(1) process with 0.9 has an autocorrelation time of 19; emcee's and ArviZ's estimates
    # scatter by a tenth.
    assert 0.7 * 32_000 / 19 < found < 1.2 * 32_000 / 19
