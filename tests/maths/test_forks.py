"""Processes that are forked: before JAX has computed they work, afterwards they say so at once."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system"
)
PROGRAM = """
import multiprocessing, warnings
from pathlib import Path
import numpy as np
import bayes_inertia as bi

warnings.simplefilter("ignore")  # JAX warns at each fork.
bi.Model, bi.estimate, bi.fly, bi.diagnose  # Everything is imported.
fork = multiprocessing.get_context("fork")
campaign = bi.read_campaign(Path(bi.__file__).parent / "example")

def modelled(_):
    return bi.Model(campaign).space.size

def in_child(what):
    queue = fork.SimpleQueue()
    def attempt():
        try:
            queue.put(str(what()))
        except bi.BayesInertiaError as error:
            queue.put(str(error))
    process = fork.Process(target=attempt, daemon=True)
    process.start()
    process.join(30)
    print(queue.get() if process.exitcode == 0 else "it hangs")

{body}
"""
AFTER = """
model = bi.Model(campaign)
fitted = bi.estimate(model)
plan = bi.Plan("one", (bi.PlannedSlew((1.0, 0.0, 0.0), 0.5),))
mission = bi.Mission(bi.most_like_spacecraft(), bi.most_like_prior())
for what in (
    lambda: bi.fit(campaign, seed=2),
    lambda: bi.estimate(model),
    lambda: bi.observe(fitted),
    lambda: bi.fly(plan, mission, 1),
    lambda: bi.design_plan(mission),
    lambda: bi.check_effect(bi.LIBRARY[0]),
):
    in_child(what)
with fork.Pool(1) as pool:
    try:
        pool.map_async(modelled, [0]).get(30)
    except bi.SettingsError as error:
        print(error)
"""
OTHERS_JAX = """
import jax
jax.jit(lambda x: x + 1)(np.ones(3)).block_until_ready()
in_child(lambda: modelled(0))
in_child(lambda: bi.check_effect(bi.LIBRARY[0]))
"""
BEFORE = """
import jax
in_child(lambda: np.asarray(jax.numpy.arange(modelled(0)))[-1])
with fork.Pool(1) as pool:
    print(*pool.map(modelled, [0, 1]))
print(modelled(0))
"""


def said_by(body: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(body=body)],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_a_process_forked_after_a_computation_says_how_to_start_it():
    said = said_by(AFTER)
    assert len(said) == 7
    assert all(
        'start processes with spawn: multiprocessing.get_context("spawn")' in s for s in said
    )


@pytest.mark.slow
def test_so_does_one_forked_after_another_librarys_computation():
    said = said_by(OTHERS_JAX)
    assert len(said) == 2
    assert all("start processes with spawn" in s for s in said)


def test_a_process_forked_before_any_computation_works():
    assert said_by(BEFORE) == ["8", "9 9", "9"]
