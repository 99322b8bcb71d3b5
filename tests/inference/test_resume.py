"""Chains that are killed go on to the same bits."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import emcee
import numpy as np
import pytest
from support.chains import SHORT, _chain

from bayes_inertia.app.cli import main
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import OutputError
from bayes_inertia.inference.sampler import load_chain, sample, save_chain
from bayes_inertia.inference.settings import Settings


@pytest.mark.slow
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


@pytest.mark.slow
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


def _command(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    return stopped.value.code


def _kill_in_the_middle(campaign: Path, run: Path) -> None:
    """Start `fit` in a process of its own, and SIGKILL it while its chains grow; on a busy machine
    that may take another try.
    """
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


@pytest.mark.long
@pytest.mark.slow
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
