"""What reading a campaign imports: the small commands must answer at once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import bayes_inertia

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
HEAVY = (
    "jax",
    "scipy",
    "pandas",
    "matplotlib",
    "arviz",
    "xarray",
    "emcee",
    "astropy",
    "pint",
    "pyarrow",
    "h5py",
    "tomlkit",
)
CHECK = f"""
import sys
from bayes_inertia.app.cli import main
try:
    main(["check", {str(EXAMPLE)!r}])
except SystemExit as ended:
    assert ended.code == 0
"""
PRECISE = """
import jax.numpy as jnp
assert jnp.asarray(1.0).dtype == jnp.float64
"""
NOT_ASYNCHRONOUS = """
import jax
assert jax.config.values["jax_cpu_enable_async_dispatch"] is False
"""


def heavy_after(code: str) -> list[str]:
    """The heavy libraries that are imported when a program ends."""
    said = f"\nimport sys\nprint('HEAVY', *[m for m in {HEAVY!r} if m in sys.modules])"
    run = subprocess.run(
        [sys.executable, "-c", code + said], check=True, capture_output=True, text=True
    )
    return run.stdout.splitlines()[-1].split()[1:]


def test_check_imports_nothing_heavy():
    assert heavy_after(CHECK) == []


def test_the_count_of_imports_can_fail():
    assert heavy_after("import h5py") == ["h5py"]


@pytest.mark.parametrize(
    "order",
    [
        "import bayes_inertia, jax",
        pytest.param("import jax, bayes_inertia", marks=pytest.mark.slow),
    ],
)
def test_an_import_changes_neither_jax_nor_the_environment(order):
    code = f"""
import os
before = dict(os.environ)
{order}
bayes_inertia.read_campaign({str(EXAMPLE)!r})
assert dict(os.environ) == before
assert not jax.config.jax_enable_x64
assert jax.config.values["jax_cpu_enable_async_dispatch"]
bayes_inertia.Model
assert dict(os.environ) == before
"""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_ENABLE")}
    subprocess.run([sys.executable, "-c", code + PRECISE], check=True, env=environment)


@pytest.mark.slow
@pytest.mark.parametrize(
    "off",
    [
        'jax.config.update("jax_enable_x64", False)',
        pytest.param("jax.enable_x64(False).__enter__()", marks=pytest.mark.long),
    ],
)
def test_single_precision_is_refused_at_once(off):
    code = f"""
import bayes_inertia as bi, jax
campaign = bi.read_campaign({str(EXAMPLE)!r})
model = bi.Model(campaign)
{off}
for what in (lambda: bi.Model(campaign), lambda: bi.estimate(model), lambda: bi.fit(campaign)):
    try:
        what()
    except bi.SettingsError as error:
        assert "jax_enable_x64" in str(error)
    else:
        raise AssertionError
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
def test_whatever_computes_sets_jax_up():
    for module in ("maths.quaternion", "maths.inertia_tensor", "physics.simulator"):
        code = f"import bayes_inertia.{module}" + PRECISE + NOT_ASYNCHRONOUS
        subprocess.run([sys.executable, "-c", code], check=True)
