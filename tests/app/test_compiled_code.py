"""Compiled code kept between runs: where, how much, by whom, and what happens when it fails."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bayes_inertia.app.compiled_code import VARIABLE, cache_folder, compiled_code_kept
from bayes_inertia.errors import OutputError

# A command in small: what it computes, how often it compiled, and what it took from the cache.
PROGRAM = """
import json, sys
from bayes_inertia.app.compiled_code import compiled_code_kept, keep_compiled_code
with compiled_code_kept("no-cache" not in sys.argv):
    import jax, jax.numpy as jnp
    from jax import monitoring
    seen = []
    monitoring.register_event_listener(lambda name, **_: seen.append(name.split("/")[-1]))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    x = jnp.linspace(0.0, 3.0, 1001)
    f = jax.jit(lambda x: jnp.sum(jnp.sin(x) ** 3 / (1.0 + x)))
    bits = float(f(x)).hex()
print(json.dumps([bits, seen.count("cache_hits"), seen.count("cache_misses")]))
"""

# Estimate and density of a small campaign, to the last bit.
FIT = """
import hashlib, json, sys
from bayes_inertia.app.compiled_code import compiled_code_kept
with compiled_code_kept():
    from jax import monitoring
    hits = []
    monitoring.register_event_listener(lambda name, **_: hits.append("cache_hits" in name))
    traced = set()
    monitoring.register_event_duration_secs_listener(lambda *_, **k: traced.add(k.get("fun_name")))
    from bayes_inertia.inference.optimizer import estimate
    from bayes_inertia.inference.sampler import log_density_at
    from bayes_inertia.physics.forward_model import Model
    from bayes_inertia.physics.small_campaign import small_campaign
    fitted = estimate(Model(small_campaign()), starts=1)
    density = log_density_at(fitted)(fitted.theta[None] * 1.01)
    bits = hashlib.sha256(fitted.theta.tobytes() + density.tobytes()).hexdigest()
large = {"_plain_residuals", "_plain_sensitivities", "_pulls"} & traced
print(json.dumps([bits, sum(hits), sorted(large)]))
"""


def environment(cache: Path | str) -> dict[str, str]:
    """That of a user who keeps compiled code in a folder."""
    own = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    return own | {VARIABLE: str(cache)}


def run(cache: Path | str, *words: str, program: str = PROGRAM) -> tuple:
    """Bits, hits and misses of a run, and what it said on stderr."""
    done = subprocess.run(
        [sys.executable, "-c", program, *words],
        env=environment(cache),
        capture_output=True,
        text=True,
        check=True,
    )
    return (*json.loads(done.stdout), done.stderr)


def entries(cache: Path) -> list[Path]:
    return sorted(cache.glob("*/*-cache"))


@pytest.mark.slow
def test_the_second_run_compiles_nothing_and_gives_the_same_bits(tmp_path):
    bits, hits, misses, said = run(tmp_path)
    assert (hits, said) == (0, "")
    assert misses == len(entries(tmp_path)) > 0
    assert run(tmp_path) == (bits, misses, 0, "")
    assert run(tmp_path, "no-cache") == (bits, 0, 0, "")
    assert run("off") == (bits, 0, 0, "")


@pytest.mark.slow
def test_a_damaged_entry_is_said_once_and_mended(tmp_path):
    bits, _, misses, _ = run(tmp_path)
    for entry in entries(tmp_path):
        entry.write_bytes(entry.read_bytes()[:50])
    again, hits, _, said = run(tmp_path)
    assert (again, hits) == (bits, 0)
    assert said.count("\n") == 1
    assert "compiled again" in said
    # What was damaged is deleted; the next run writes it anew, the one after that reads it.
    assert entries(tmp_path) == []
    assert run(tmp_path) == (bits, 0, misses, "")
    assert run(tmp_path) == (bits, misses, 0, "")


@pytest.mark.slow
def test_two_runs_at_once_share_one_cache(tmp_path):
    command = [sys.executable, "-c", PROGRAM]
    runs = [
        subprocess.Popen(
            command,
            env=environment(tmp_path),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    outputs = [process.communicate() for process in runs]
    assert [said for _, said in outputs] == ["", "", ""]
    assert len({json.loads(printed)[0] for printed, _ in outputs}) == 1
    assert run(tmp_path)[2] == 0


@pytest.mark.slow
def test_a_folder_that_cannot_be_written_is_said_once(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    bits, hits, misses, said = run(file)
    assert (hits, misses) == (0, 0)
    assert bits == run("off")[0]
    assert said.count("error") + said.count("Traceback") == 0
    assert said.startswith("compiled code is not kept between runs:")
    assert VARIABLE in said


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs POSIX permissions")
def test_a_folder_that_others_may_write_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    folder = cache_folder()
    folder.mkdir()
    folder.chmod(0o777)
    from bayes_inertia import keep_compiled_code

    with pytest.raises(OutputError, match="others may write"):
        keep_compiled_code()
    assert entries(tmp_path) == []


def test_the_folder_is_of_a_version_a_python_and_a_processor(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    here = cache_folder()
    assert here.parent == tmp_path
    with monkeypatch.context() as other:
        other.setattr("bayes_inertia.app.compiled_code.sys.version_info", (3, 99))
        assert cache_folder() != here
    with monkeypatch.context() as other:
        other.setattr("bayes_inertia.app.compiled_code._processor", lambda: "another")
        assert cache_folder() != here
    monkeypatch.setattr("bayes_inertia.app.compiled_code.__version__", "0.0.1")
    assert cache_folder().name.startswith("0.0.1-")
    assert cache_folder() != here
    monkeypatch.setenv(VARIABLE, "off")
    assert cache_folder() is None


def test_old_versions_go_and_nothing_else_does(tmp_path):
    month = 40 * 86_400
    old, used, other = (tmp_path / n for n in ("0.0.1-0123abcd", "0.0.2-0123abcd", "my-0123abcd"))
    for folder in (old, used, other):
        folder.mkdir()
        entry = folder / "jit_f-1-cache"
        entry.write_bytes(b"x")
        if folder != used:
            then = entry.stat().st_mtime - month
            os.utime(entry, (then, then))
    run(tmp_path)
    assert [folder.exists() for folder in (old, used, other)] == [False, True, True]


def test_a_program_that_uses_jax_keeps_its_configuration(monkeypatch, tmp_path):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    with compiled_code_kept():
        assert "JAX_COMPILATION_CACHE_DIR" not in os.environ
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
@pytest.mark.slow
def test_a_fit_has_the_same_bits_with_kept_code(tmp_path):
    bits, hits, traced, said = run(tmp_path, program=FIT)
    assert said == ""
    assert hits < 10  # Of one run, too: equal programs of two functions.
    assert len(traced) == 3
    again, hits, traced, said = run(tmp_path, program=FIT)
    # The large programs are not even traced again, so that JAX's own copies are not read.
    assert traced == []
    # What takes less time to compile than to read is not kept.
    assert hits >= len(entries(tmp_path)) // 2 > 0
    assert (again, said) == (bits, "")
