"""Every move samples the density it should, a kill costs nothing, the gates fail when they must, and the prior is respected."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import emcee
import numpy as np
import pytest
from scipy import stats

from bayes_inertia.app.cli import main
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import OutputError, SettingsError
from bayes_inertia.inference.chain_file import load_chain, save_chain
from bayes_inertia.inference.convergence import Diagnostics, autocorrelation_time, diagnose_chains
from bayes_inertia.inference.fit_context import FitContext
from bayes_inertia.inference.gates import check_gates
from bayes_inertia.inference.moves import IndependenceMove
from bayes_inertia.inference.noise_model import rate_noise_covariance
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.posterior_groups import build_posterior
from bayes_inertia.inference.sampler import Settings, sample, steps_wanted
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.forward_model import Model

D = 9


@dataclass(frozen=True)
class Target:
    """A density of x = root z whose components z are independent, with mean 0, variance 1 and known quantiles.

    `log_z` gives the log densities of standard components (n, D), `laws` the same as frozen scipy distributions.
    """

    log_z: Callable[[np.ndarray], np.ndarray]
    laws: tuple
    root: np.ndarray

    def log_density(self, x: np.ndarray) -> np.ndarray:
        return self.log_z(self.standard(x)).sum(1)

    def standard(self, x: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.root, x.T).T

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        return np.stack([law.rvs(n, random_state=rng) for law in self.laws], 1) @ self.root.T

    @property
    def covariance(self) -> np.ndarray:
        return self.root @ self.root.T


def _root(seed: int = 5) -> np.ndarray:
    """Correlations up to 0.9 and scales from 1e-6 to 1e2."""
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.normal(size=(D, D)))
    correlated = turned * np.sqrt(np.geomspace(0.1, 3.0, D))
    return rng.permutation(np.geomspace(1e-6, 1e2, D))[:, None] * correlated


def _gaussian() -> Target:
    return Target(lambda z: -0.5 * z**2, (stats.norm(),) * D, _root())


def _skewed() -> Target:
    """Five Gumbel components (skewness 1.14, one exponential tail) and four of Student's t with eight degrees of freedom."""
    width, middle = np.sqrt(6.0) / np.pi, -np.euler_gamma * np.sqrt(6.0) / np.pi
    narrow = np.sqrt(6.0 / 8.0)
    laws = (stats.gumbel_r(middle, width),) * 5 + (stats.t(8, 0.0, narrow),) * 4

    def log_z(z: np.ndarray) -> np.ndarray:
        y = (z[:, :5] - middle) / width
        with np.errstate(over="ignore"):
            return np.concatenate(
                [-y - np.exp(-y), -4.5 * np.log1p((z[:, 5:] / narrow) ** 2 / 8.0)], 1
            )

    return Target(log_z, laws, _root(6))


TARGETS = {"gaussian": _gaussian(), "skewed": _skewed()}
LEVELS = np.array([0.01, 0.05, 0.5, 0.95, 0.99])
BATCHES = 40


def departures(target: Target, moves, steps: int, walkers: int = 64, seed: int = 1) -> np.ndarray:
    """Means, second moments and quantiles of a long run minus their true values, each in its own Monte Carlo error.

    The run starts in the target, and its error comes from the scatter of the means of 40 stretches of the run.
    """
    random = np.random.RandomState(np.random.MT19937(seed))
    sampler = emcee.EnsembleSampler(walkers, D, target.log_density, vectorize=True, moves=moves)
    start = target.draw(np.random.default_rng(seed), walkers)
    sampler.run_mcmc(emcee.State(start, random_state=random.get_state()), steps)
    z = target.standard(sampler.get_chain(flat=True)).reshape(BATCHES, -1, D)
    cuts = np.array([[law.ppf(p) for p in LEVELS] for law in target.laws])
    upper = np.triu_indices(D)
    means = z.mean(1)
    products = np.einsum("bni,bnj->bij", z, z)[:, *upper] / z.shape[1] - np.eye(D)[upper]
    below = np.stack([(z[..., None, i] < cuts[i]).mean(1) - LEVELS for i in range(D)], 1).reshape(
        BATCHES, -1
    )
    found = np.concatenate([means, products, below], 1)
    error = found.std(0, ddof=1) / np.sqrt(BATCHES)
    # What never changes during the run (a sampler that is stuck) is infinitely wrong.
    return np.divide(found.mean(0), error, out=np.full_like(error, np.inf), where=error > 0.0)


def limit(statistics: int) -> float:
    """No exact move exceeds this in one of 2000 runs: Student's t with as many degrees of freedom as stretches less one."""
    return float(stats.t.isf(0.5 / 2000 / statistics, BATCHES - 1))


def _right(t: Target) -> IndependenceMove:
    return IndependenceMove(np.zeros(D), t.covariance, 8.0)


def _wrong(t: Target) -> IndependenceMove:
    """Centre off by half a sigma in every component, widths off by factors of 0.8 to 1.6, correlations ignored in part."""
    z = np.diag(np.linspace(0.8, 1.6, D) ** 2) + 0.15
    return IndependenceMove(t.root @ np.full(D, 0.3), t.root @ z @ t.root.T, 5.0)


MOVES = {
    "independence": (lambda t: _right(t), 2000),
    "independence, wrong covariance": (lambda t: _wrong(t), 4000),
    "differential evolution": (lambda t: emcee.moves.DEMove(), 6000),
    "stretch": (lambda t: emcee.moves.StretchMove(), 10000),
    "as sample() mixes them": (lambda t: [(_right(t), 0.5), (emcee.moves.DEMove(), 0.5)], 3000),
}


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("move", MOVES)
def test_every_move_samples_its_target_exactly_in_nine_dimensions(move, target):
    make, steps = MOVES[move]
    t = departures(TARGETS[target], make(TARGETS[target]), steps)
    assert np.abs(t).max() < limit(len(t))


class _WrongSign(IndependenceMove):
    def _propose(self, coords, random):
        proposed, factors = super()._propose(coords, random)
        return proposed, -factors


class _NoCorrection(IndependenceMove):
    def _propose(self, coords, random):
        proposed, factors = super()._propose(coords, random)
        return proposed, np.zeros_like(factors)


class _OneDimensionTooMany(emcee.moves.StretchMove):
    def get_proposal(self, s, c, random):
        proposed, factors = super().get_proposal(s, c, random)
        return proposed, factors * D / (D - 1.0)


CONTROLS = {
    "wrong sign": ("gaussian", lambda t: _WrongSign(np.zeros(D), t.covariance, 8.0), 1000),
    "no correction": ("gaussian", lambda t: _NoCorrection(np.zeros(D), t.covariance, 8.0), 1000),
    "stretch with a wrong power": ("gaussian", lambda t: _OneDimensionTooMany(), 10000),
    # Its step is along a Euclidean direction: with scales as far apart as above it only ever moves one component.
    "emcee's snooker move": (
        "isotropic",
        lambda t: [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)],
        6000,
    ),
}


@pytest.mark.parametrize("move", CONTROLS)
def test_the_harness_notices_moves_that_sample_another_density(move):
    name, make, steps = CONTROLS[move]
    target = {**TARGETS, "isotropic": replace(TARGETS["gaussian"], root=np.eye(D))}[name]
    t = departures(target, make(target), steps)
    assert np.abs(t).max() > 1.5 * limit(len(t))


def _diagnosed(samples: np.ndarray):
    return diagnose_chains(
        samples, tau=1.0, evaluations=samples[..., 0].size, seconds=1.0, acceptance=1.0, discarded=0
    )


def test_a_positive_parameter_is_proposed_on_its_logarithm():
    """With many degrees of freedom the move is a normal and a log-normal distribution, density and draws."""
    move = IndependenceMove(
        np.array([1.0, 0.2]), np.diag([4.0, 0.01]), 1e9, np.array([False, True])
    )
    x = np.stack([np.linspace(-3.0, 3.0, 7), np.geomspace(0.02, 2.0, 7)], axis=1)
    expected = stats.norm(1.0, 2.0).logpdf(x[:, 0]) + stats.lognorm(0.5, scale=0.2).logpdf(x[:, 1])
    np.testing.assert_allclose(np.diff(move.log_density(x)), np.diff(expected), atol=1e-5)
    drawn = move.draw(np.random.RandomState(1), 2000)
    assert stats.kstest(drawn[:, 1], stats.lognorm(0.5, scale=0.2).cdf).pvalue > 1e-3
    assert stats.kstest(drawn[:, 1], stats.norm(0.2, 0.1).cdf).pvalue < 1e-6


def test_a_walker_that_never_moved_counts_as_one_draw():
    chain = np.random.default_rng(3).normal(size=(300, 8, 2))
    assert autocorrelation_time(chain) < 2.0
    chain[:, 3] = chain[:1, 3]
    assert autocorrelation_time(chain) == 300.0


def test_gates_fail_for_stuck_ensembles_and_pass_for_good_ones():
    good = np.random.default_rng(0).normal(size=(4, 32, 40, 3))
    assert _diagnosed(good).converged
    stuck = good.copy()
    stuck[0, ..., 1] += 6.0  # one ensemble has found another mode than the rest
    found = _diagnosed(stuck)
    assert not found.converged
    assert found.nested_rhat_max > 1.2
    # Walkers that never move agree between ensembles, and are still no sample.
    frozen = np.broadcast_to(good[:, :, :1], good.shape).copy()
    assert not _diagnosed(frozen + 1e-9 * good).converged
    short = good[:, :, :10]
    assert not _diagnosed(short).converged


def test_two_modes_between_the_ensembles_fail_the_gate():
    """Two modes, 12 sigma apart, that no walker leaves: each ensemble looks perfect, together they do not."""
    rng = np.random.default_rng(1)
    modes = np.array([-6.0, 6.0, 6.0, -6.0])[:, None, None, None]
    within = _diagnosed(rng.normal(size=(4, 32, 60, 2)))
    between = _diagnosed(rng.normal(size=(4, 32, 60, 2)) + modes)
    assert within.converged
    assert not between.converged


@pytest.fixture(scope="module")
def small_at(flown):
    return estimate(Model(flown.campaign), seed=1)


SHORT = Settings(seed=3, ensembles=2, walkers=32, steps=12, max_steps=12)


def test_one_seed_gives_the_same_bytes_whatever_the_threads_and_another_seed_does_not(
    small_at, tmp_path
):
    first = sample(small_at, replace(SHORT, threads=1), folder=tmp_path / "a")
    again = sample(small_at, replace(SHORT, threads=2), folder=tmp_path / "b")
    assert first.samples.tobytes() == again.samples.tobytes()
    assert first.log_posterior.tobytes() == again.log_posterior.tobytes()
    names = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert names == ["ensemble_0.h5", "ensemble_1.h5"]
    for name in names:
        assert _chain(tmp_path / "a" / name) == _chain(tmp_path / "b" / name)
    other = sample(small_at, replace(SHORT, seed=4, threads=1))
    assert not np.any(other.samples == first.samples)
    assert not np.any(first.samples[0] == first.samples[1])  # nor do ensembles share random numbers


def test_a_run_killed_when_some_ensembles_are_ahead_goes_on_to_the_same_bits(small_at, tmp_path):
    longer = replace(SHORT, max_steps=24)
    whole = sample(small_at, longer, folder=tmp_path / "whole")
    sample(small_at, SHORT, folder=tmp_path / "killed")
    shutil.copy(tmp_path / "whole" / "ensemble_0.h5", tmp_path / "killed" / "ensemble_0.h5")
    resumed = sample(small_at, longer, folder=tmp_path / "killed")
    assert whole.diagnostics.steps == resumed.diagnostics.steps == 24
    assert whole.samples.tobytes() == resumed.samples.tobytes()
    assert _chain(tmp_path / "whole" / "ensemble_1.h5") == _chain(
        tmp_path / "killed" / "ensemble_1.h5"
    )


def test_a_chain_file_holds_what_the_chain_held_and_a_damaged_one_is_refused(tmp_path):
    path, rng = tmp_path / "a.h5", np.random.default_rng(1)
    sampler = emcee.EnsembleSampler(
        8, 2, lambda x: -0.5 * np.sum(x**2, -1), vectorize=True, backend=load_chain(path, 8, 2)
    )
    sampler.run_mcmc(rng.normal(size=(8, 2)), 5)
    save_chain(sampler.backend, path)
    again = load_chain(path, 8, 2)
    first, second = sampler.get_last_sample(), again.get_last_sample()
    assert again.get_chain().tobytes() == sampler.get_chain().tobytes()
    assert first.coords.tobytes() == second.coords.tobytes()
    assert [
        np.array_equal(a, b) for a, b in zip(first.random_state, second.random_state, strict=True)
    ] == [True] * 5
    with pytest.raises(OutputError, match="shape"):
        load_chain(path, 10, 2)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(OutputError, match="delete it"):
        load_chain(path, 8, 2)


def test_gates_say_which_noise_was_taken_and_fail_where_something_unknown_remains(small_at):
    chains = sample(small_at, SHORT)
    stated, louder, unknown = (
        check_gates(small_at, chains.diagnostics, context)
        for context in (
            None,
            FitContext(measured_noise={"rate": 2.25, "attitude": 1.0}),
            FitContext(verdict="unknown"),
        )
    )
    assert "the stated noise predict" in stated[1]["says"]
    assert "rate 2.25" in louder[1]["says"]
    assert "attitude" not in louder[1]["says"]
    assert [g["name"] for g in stated] == ["converged", "explained"]
    assert unknown[-1]["name"] == "diagnosed"
    assert not unknown[-1]["passed"]


def test_walkers_are_at_least_twice_as_many_as_parameters(small_at):
    assert sample(small_at, replace(SHORT, walkers=4)).samples.shape[1] == 2 * D


@pytest.mark.parametrize("met_by", [0, 1])
def test_an_interrupt_stops_all_ensembles_soon_whichever_meets_it(
    small_at, tmp_path, monkeypatch, met_by
):
    interrupted = threading.Event()

    def save(backend, path):
        if path.name == f"ensemble_{met_by}.h5":
            interrupted.set()
            raise KeyboardInterrupt
        assert interrupted.wait(
            60.0
        )  # however busy the machine is, the other ensemble is not ahead by chance
        save_chain(backend, path)

    monkeypatch.setattr("bayes_inertia.inference.sampler.save_chain", save)
    with pytest.raises(KeyboardInterrupt):
        sample(small_at, replace(SHORT, steps=2000, max_steps=2000, threads=2), folder=tmp_path)
    lengths = {
        p.name: emcee.backends.HDFBackend(str(p), read_only=True).iteration
        for p in tmp_path.iterdir()
    }
    assert f"ensemble_{met_by}.h5" not in lengths
    assert all(length < 1000 for length in lengths.values())


def _found(**other) -> Diagnostics:
    fields = {
        "converged": True,
        "nested_rhat_max": 1.0,
        "ess_bulk_min": 8000.0,
        "ess_tail_min": 4000.0,
        "tau_max": 2.0,
        "evaluations": 18_944,
    }
    fields |= {
        "ess_per_evaluation": 0.2,
        "seconds": 1.0,
        "acceptance": 0.6,
        "discarded": 12,
        "steps": 72,
    }
    return Diagnostics(**(fields | other))


def test_more_steps_are_taken_as_need_be_and_never_more_than_twice_as_many():
    settings = Settings(target_ess=4000.0)
    assert steps_wanted(_found(), settings) == 72
    assert (
        steps_wanted(_found(), replace(settings, target_ess=5000.0)) == 95
    )  # 12 + 1.1 * 60 * 5 / 4
    assert steps_wanted(_found(tau_max=4.0, converged=False), settings) == 100  # 12 + 1.1 * 20 * 4
    assert steps_wanted(_found(ess_tail_min=400.0), settings) == 144
    assert steps_wanted(_found(ess_tail_min=float("nan"), converged=False), settings) == 144
    assert steps_wanted(_found(ess_tail_min=0.0, converged=False), settings) == 144
    assert steps_wanted(_found(converged=False), replace(settings, max_steps=72)) == 72
    assert (
        steps_wanted(_found(converged=False), settings) == 84
    )  # something else failed: go on a little


def test_shared_code_samples_the_same_posterior(small_at):
    own, shared = sample(small_at, SHORT), sample(small_at, SHORT, shared_code=True)
    # Rounding differs in the last digits of the density: hardly a decision of the sampler does.
    assert np.mean(np.isclose(own.samples, shared.samples, rtol=1e-9).all(-1)) > 0.9


def _chain(path: Path) -> tuple:
    """Everything that emcee keeps, as bytes."""
    backend = emcee.backends.HDFBackend(str(path), read_only=True)
    state = backend.random_state
    return (
        backend.get_chain().tobytes(),
        backend.get_log_prob().tobytes(),
        np.asarray(backend.accepted).tobytes(),
        state[1].tobytes(),
        state[2:],
    )


def _command(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    return stopped.value.code


def _kill_in_the_middle(campaign: Path, run: Path) -> None:
    """Start `fit` in a process of its own, and SIGKILL it while its chains grow; on a busy machine that may take another try."""
    for _ in range(4):
        _kill(campaign, run)
        lengths = [
            emcee.backends.HDFBackend(str(p), read_only=True).iteration
            for p in sorted((run / "chains").glob("ensemble_*.h5"))
        ]
        if 0 < sum(lengths) < Settings().ensembles * Settings().steps:
            return
        shutil.rmtree(run)
    pytest.fail("none of four kills hit the middle of the sampling")


def _kill(campaign: Path, run: Path) -> None:
    program = "import sys; from bayes_inertia.app.cli import main; main(sys.argv[1:])"
    command = [
        sys.executable,
        "-c",
        program,
        "fit",
        str(campaign),
        "-o",
        str(run),
        "--seed",
        "5",
        "--no-report",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    files, seen, deadline = run / "chains", set(), time.monotonic() + 300.0
    try:
        while len(seen) < 8:  # files are replaced every eighth step
            if process.poll() is not None:  # a busy machine let it end unwatched: another try
                assert (run / "summary.json").exists(), (
                    f"the fit failed: {process.stdout.read().decode()}"
                )
                return
            assert time.monotonic() < deadline, "the fit never began to sample"
            seen |= {(p.name, p.stat().st_mtime_ns) for p in files.glob("ensemble_*.h5")}
            time.sleep(0.002)
        os.kill(process.pid, signal.SIGKILL)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_killed_fit_resumes_to_the_bits_of_one_that_was_not_killed(flown, tmp_path):
    campaign, whole, killed = tmp_path / "campaign", tmp_path / "whole", tmp_path / "killed"
    write_campaign(flown.campaign, campaign)
    _kill_in_the_middle(campaign, killed)
    assert not (killed / "summary.json").exists()
    # What a kill in the middle of a save leaves behind.
    (killed / "chains" / ".ensemble_0.h5.0a1b2c.tmp.h5").write_bytes(b"half a file")
    code = _command("fit", str(campaign), "-o", str(whole), "--seed", "5", "--no-report")
    assert _command("resume", str(killed), "--no-report") == code
    assert sorted(p.name for p in (killed / "chains").iterdir()) == [
        f"ensemble_{k}.h5" for k in range(4)
    ]
    for k in range(4):
        assert _chain(whole / "chains" / f"ensemble_{k}.h5") == _chain(
            killed / "chains" / f"ensemble_{k}.h5"
        )
    summaries = [json.loads((run / "summary.json").read_text()) for run in (whole, killed)]
    for summary in summaries:
        assert summary["diagnostics"].pop("seconds") > 0.0
    assert summaries[0] == summaries[1]
    # Done is done: to resume a finished run changes nothing.
    before = (killed / "chains" / "ensemble_0.h5").read_bytes()
    assert _command("resume", str(killed), "--no-report") == code
    assert (killed / "chains" / "ensemble_0.h5").read_bytes() == before


def _independent(chains, n: int, seed: int) -> np.ndarray:
    """n draws (n, d), each of another walker or long after it."""
    draws = chains.samples[:, :, :: max(1, int(np.ceil(8 * chains.diagnostics.tau_max)))].reshape(
        -1, chains.samples.shape[-1]
    )
    assert len(draws) >= n
    return np.random.default_rng(seed).permutation(draws)[:n]


def _p_values(draws: np.ndarray, reference: np.ndarray) -> np.ndarray:
    return np.array(
        [stats.ks_2samp(a, b).pvalue for a, b in zip(draws.T, reference.T, strict=True)]
    )


def test_without_motion_the_posterior_is_the_prior_physical_edge_included(flying, setup_type):
    """A quarter of this prior's tensors break the triangle inequality: its edge is sampled, not only its middle."""
    setup = setup_type(
        turns=((0.0, 0.0, 0.0),),
        rows=64,
        relative_sigma=0.25,
        product_sigma=0.3,
        start_rate=(0.0, 0.0, 0.0),
        start_momentum=0.0,
    )
    model = Model(flying(3, setup).campaign)
    rng = np.random.default_rng(0)
    assert np.mean(np.asarray(inertia_tensor.is_physical(model.space.draw(rng, 2000)[:, :6]))) < 0.9
    at = estimate(model)
    chains = sample(at, Settings(steps=144, max_steps=144))
    assert chains.diagnostics.converged
    assert np.all(np.asarray(inertia_tensor.is_physical(chains.flat[:, :6])))
    draws, prior = _independent(chains, 1000, 1), model.draw_prior(rng, 20_000)
    assert _p_values(draws, prior).min() > 1e-3 / D
    # The smallest distance from the triangle inequality's edge, as the prior has it.
    edge = [
        0.5 * m.sum(-1) - m[..., -1]
        for m in (inertia_tensor.principal_moments(x[:, :6]) for x in (draws, prior))
    ]
    assert stats.ks_2samp(*edge).pvalue > 1e-3
    # The same test notices a prior without the constraint.
    assert _p_values(draws, model.space.draw(rng, 20_000)).min() < 1e-4


def test_what_one_slew_cannot_see_stays_as_the_prior_has_it(flying, setup_type):
    setup = setup_type(
        turns=((0.8, 0.0, 0.0),), rows=64, start_rate=(0.0, 0.0, 0.0), start_momentum=0.0
    )
    at = estimate(Model(flying(3, setup).campaign))
    contraction = 1.0 - (at.sd / at.model.space.sd) ** 2
    unseen = np.flatnonzero(contraction < 0.01)
    assert {"Jyy", "Jzz", "Jyz"} <= {at.model.space.names[i] for i in unseen}
    assert contraction[0] > 0.99
    chains = sample(at, Settings())
    assert chains.diagnostics.converged
    assert np.all(np.asarray(inertia_tensor.is_physical(chains.flat[:, :6])))
    draws, prior = (
        _independent(chains, 700, 2),
        at.model.draw_prior(np.random.default_rng(1), 20_000),
    )
    assert _p_values(draws[:, unseen], prior[:, unseen]).min() > 1e-3 / len(unseen)
    assert _p_values(draws[:, :1], prior[:, :1]).max() < 1e-6


@pytest.mark.parametrize(
    ("name", "value", "advice"),
    [
        ("seed", -1, "0 or more"),
        ("seed", 1.5, "whole number"),
        ("ensembles", 1, "2 or more"),
        ("walkers", 0, "2 or more"),
        ("steps", 0, "4 or more"),
        ("steps", True, "4 or more"),
        ("max_steps", 71, "lower steps"),
        ("target_ess", 0.0, "above 0"),
        ("target_ess", float("nan"), "above 0"),
        ("threads", 0, "1 or more"),
        ("threads", "two", "1 or more"),
    ],
)
def test_settings_that_cannot_be_used_are_refused_by_name(name, value, advice):
    with pytest.raises(SettingsError, match=advice) as caught:
        Settings(**{name: value})
    assert caught.value.where == name


def test_predicted_rates_have_the_noise_that_the_likelihood_counts(small_flown):
    """In the measured drive tachometer noise shakes the predicted rates; here it is most of their noise."""
    campaign = small_flown.campaign
    wheels = tuple(replace(w, momentum_sigma=100.0 * w.momentum_sigma) for w in campaign.wheels)
    model = Model(replace(campaign, wheels=wheels), drive="measured")
    noisy = estimate(model, starts=1, discount=False)
    posterior = build_posterior(noisy, sample(noisy, SHORT), FitContext(), seed=0)
    draws = posterior.tree["posterior_predictive"]["rate"].values
    draws = draws.reshape(-1, *draws.shape[2:])
    spread = np.nanmean(np.var(draws, axis=0, ddof=1), axis=(0, 1))
    covariance = rate_noise_covariance(model, noisy.theta)
    stated = np.square(campaign.rate_sensor.sigma)
    assert np.all(np.diag(covariance) > 4.0 * stated)
    np.testing.assert_allclose(spread, np.diag(covariance), rtol=0.1)
