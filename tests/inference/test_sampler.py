"""The sampler: seeds, walkers, steps."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace

import jax
import numpy as np
import pytest
from jax import monitoring
from support.chains import SHORT, D, _chain

from bayes_inertia.errors import SettingsError
from bayes_inertia.inference import sampler
from bayes_inertia.inference.gates import Diagnostics
from bayes_inertia.inference.likelihood import _plain_residuals, _plain_sensitivities
from bayes_inertia.inference.marginal_posterior import _pulls
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.posterior_groups import build_posterior
from bayes_inertia.inference.predicted_telemetry import predicted_telemetry
from bayes_inertia.inference.sampler import sample, steps_wanted
from bayes_inertia.inference.settings import FitContext, Settings, usual_settings
from bayes_inertia.maths.kept_programs import IN_MEMORY
from bayes_inertia.physics.effects import ConstantTorque, RateRandomWalk
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


@pytest.mark.slow
def test_one_seed_gives_the_same_bytes_whatever_the_threads_and_another_seed_does_not(
    small_at, tmp_path
):
    first = sample(small_at, replace(SHORT, threads=1), folder=str(tmp_path / "a"))
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


def test_the_density_is_evaluated_as_often_as_the_diagnostics_say(small_at, monkeypatch):
    counted, density_at = [0], sampler.log_density_at

    def counting(estimate, most):
        density = density_at(estimate, most=most)

        def at(thetas):
            counted[0] += len(thetas)
            return density(thetas)

        return at

    monkeypatch.setattr(sampler, "log_density_at", counting)
    chains = sample(small_at, replace(SHORT, threads=1))
    assert counted[0] == chains.diagnostics.evaluations


@pytest.mark.slow
def test_walkers_are_at_least_twice_as_many_as_parameters(small_at):
    assert sample(small_at, replace(SHORT, walkers=4)).samples.shape[1] == 2 * D


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
    settings = Settings(steps=72, target_ess=4000.0)
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
        steps_wanted(_found(converged=False), settings) == 80
    )  # something else failed: go on a little


def compiled_by(work) -> list[str]:
    """What the compiler does meanwhile."""
    compiled = []

    def note(event: str, *_, **__) -> None:
        if "backend_compile" in event:
            compiled.append(event)

    monitoring.register_event_duration_secs_listener(note)
    try:
        work()
    finally:
        monitoring.unregister_event_duration_listener(note)
    return compiled


@pytest.mark.slow
def test_a_second_campaign_of_another_length_compiles_nothing(
    flying, setup_type, small_at, monkeypatch
):
    # What is kept on disk is another matter.
    monkeypatch.setattr("bayes_inertia.maths.kept_programs._kept_entries", lambda: None)
    estimate(Model(flying(12).campaign), starts=1)
    sample(small_at, SHORT)

    def fit(setup):
        sample(estimate(Model(flying(11, setup).campaign), starts=1), SHORT)

    known = setup_type()
    shorter = replace(known, rows=known.rows - 7, fix_rows=known.fix_rows[1:])
    # Flying compiles too.
    flying(11, shorter)
    assert compiled_by(lambda: fit(known)) == []
    assert compiled_by(lambda: fit(shorter)) == []
    # What is compiled anew is heard.
    assert compiled_by(lambda: jax.jit(lambda x: 3.0 * x + 1.0)(1.0)) != []


@pytest.mark.parametrize("slews", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_programs_of_one_slew_serve_campaigns_of_any_number(flying, setup_type, small_at, slews):
    setup = setup_type()
    turns = (*setup.turns, setup.turns[0])[:slews]
    sample(estimate(small_at.model, starts=1), SHORT)
    model = Model(flying(13, replace(setup, turns=turns)).campaign)
    known = set(IN_MEMORY.held())
    sample(estimate(model, starts=1), SHORT)
    new = {program for program, _ in set(IN_MEMORY.held()) - known}
    assert not new & {_plain_residuals, _plain_sensitivities, _pulls}


@pytest.mark.parametrize(
    ("name", "value", "advice"),
    [
        ("seed", -1, "0 or more"),
        ("seed", 1.5, "whole number"),
        ("ensembles", 1, "2 or more"),
        ("walkers", 0, "2 or more"),
        ("steps", 0, "4 or more"),
        ("steps", True, "4 or more"),
        ("max_steps", 27, "lower steps"),
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


def test_settings_of_numpy_become_those_of_python_which_a_file_holds():
    settings = Settings(seed=np.int64(3), target_ess=np.float32(500.0))
    assert json.loads(json.dumps(vars(settings))) == vars(Settings(seed=3, target_ess=500.0))


@pytest.mark.parametrize(("seed", "start"), [(-1, None), (None, None), (0, np.ones(3))])
def test_an_estimate_refuses_wrong_seeds_and_starts_in_words(seed, start):
    with pytest.raises(SettingsError, match=r"seed: is|start: its shape is \(3,\)"):
        estimate(small_campaign(), seed=seed, start=start)


@pytest.mark.slow
def test_predicted_rates_have_the_noise_that_the_likelihood_counts(small_flown):
    """In the measured drive tachometer noise shakes the predicted rates; here it is most of their
    noise.
    """
    campaign = small_flown.campaign
    wheels = tuple(replace(w, momentum_sigma=100.0 * w.momentum_sigma) for w in campaign.wheels)
    model = Model(replace(campaign, wheels=wheels), drive="measured")
    noisy = estimate(model, starts=1, discount=False)
    posterior = build_posterior(noisy, sample(noisy, SHORT), FitContext(), seed=0)
    draws = posterior.tree["posterior_predictive"]["rate"].values
    draws = draws.reshape(-1, *draws.shape[2:])
    spread = np.nanmean(np.var(draws, axis=0, ddof=1), axis=(0, 1))
    covariance = model.channels[0].noise(model.campaign, noisy.theta, model.structure.drive)
    stated = np.square(campaign.rate_sensor.sigma)
    assert np.all(np.diag(covariance) > 4.0 * stated)
    np.testing.assert_allclose(spread, np.diag(covariance), rtol=0.1)


@pytest.mark.slow
def test_predicted_telemetry_is_held_once_and_a_part_of_it_again(small_at):
    chains = sample(small_at, SHORT)
    predicted_telemetry(small_at, chains, np.random.default_rng(1))  # Compiled.
    tracemalloc.start()
    try:
        groups = predicted_telemetry(small_at, chains, np.random.default_rng(1))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    size = sum(values.nbytes for group in groups for values in group.values())
    assert peak < 3.0 * size


def test_an_effect_with_sizes_gets_the_settings_of_one_wherever_it_is_named():
    assert usual_settings((ConstantTorque(),), seed=2) == Settings(seed=2)
    wandering = usual_settings((ConstantTorque(), RateRandomWalk()), seed=2)
    assert wandering.seed == 2
    assert wandering.target_ess < Settings().target_ess
    assert wandering.walkers < Settings().walkers
