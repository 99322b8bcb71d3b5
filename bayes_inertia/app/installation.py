"""What this installation consists of, and whether it works."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import numpy as np
from rich.table import Table

from bayes_inertia.app.compiled_code import size_of
from bayes_inertia.app.terminal import plain_console

_PACKAGES = ("bayes-inertia", "numpy", "scipy", "jax", "emcee", "arviz", "xarray", "matplotlib")
# Relative change of the energy of a free tumble over 100 s that the integrator may make.
_ENERGY_DRIFT_ALLOWED = 1e-9


def show_installation() -> None:
    """Print versions, the device that computes, a self-test, and the library of effects."""
    import jax
    import jax.numpy as jnp

    from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC

    console = plain_console()
    table = Table("package", "version")
    for name in _PACKAGES:
        table.add_row(name, metadata.version(name))
    console.print(table)
    devices = ", ".join(str(device) for device in jax.devices())
    console.print(f"computing on: {devices}; 64-bit: {jnp.zeros(1).dtype == jnp.float64}")
    drift = _energy_drift()
    passed = "passed" if drift < _ENERGY_DRIFT_ALLOWED else "FAILED"
    console.print(f"self-test: energy of a free tumble is constant to {drift:.1e} ({passed})")
    console.print(f"compiled code: {_compiled_code()}")
    console.print(f"effects: {', '.join(effect.name for effect in LIBRARY)}")
    console.print(f"without a fixed shape: {', '.join(effect.name for effect in STOCHASTIC)}")


def _compiled_code() -> str:
    """Where compiled code is kept between runs."""
    import jax

    folder = jax.config.values["jax_compilation_cache_dir"]
    if folder is None or not jax.config.values["jax_enable_compilation_cache"]:
        return "not kept between runs"
    return f"kept in {folder} ({size_of(Path(folder)) / 1e6:.0f} MB)"


def _energy_drift() -> float:
    """Largest relative change of the energy of a body that tumbles freely for 100 s."""
    import jax.numpy as jnp

    from bayes_inertia.physics.simulator import simulate_slew
    from bayes_inertia.physics.slew_input import Start, idle_slew

    slew = idle_slew(np.arange(100.0))
    start = Start(jnp.array([0.01, 0.02, 0.01]), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(0))
    J = jnp.diag(jnp.array([3.0, 2.0, 2.0]))
    rate = simulate_slew(slew, start, J)[0].rate_B
    energy = jnp.einsum("ni,ij,nj->n", rate, J, rate)
    return float(jnp.abs(energy / (rate[0] @ J @ rate[0]) - 1.0).max())
