"""What this installation consists of, and whether it works."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.app.compiled_code import size_of
from bayes_inertia.app.terminal import headed, plain_console
from bayes_inertia.progress import Progress, silent

FORMAT = "bayes-inertia-installation/1"
_PACKAGES = ("bayes-inertia", "numpy", "scipy", "jax", "emcee", "arviz", "xarray", "matplotlib")
_STOCHASTIC = "effects_without_fixed_shape"
# Relative change of the energy of a free tumble over 100 s that the integrator may make.
_ENERGY_DRIFT_ALLOWED = 1e-9


def installation_json(progress: Progress = silent) -> dict[str, Any]:
    """Versions, the device that computes, a self-test, and the library of effects."""
    progress("loading JAX", 0, 0)
    import jax
    import jax.numpy as jnp

    from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC

    progress("self-test: a free tumble", 0, 0)
    drift = _energy_drift()
    return {
        "format": FORMAT,
        "versions": {name: metadata.version(name) for name in _PACKAGES},
        "devices": [str(device) for device in jax.devices()],
        "double_precision": bool(jnp.zeros(1).dtype == jnp.float64),
        "energy_drift": drift,
        "self_test_passed": drift < _ENERGY_DRIFT_ALLOWED,
        "compiled_code": _compiled_code(),
        "effects": [effect.name for effect in LIBRARY],
        _STOCHASTIC: [effect.name for effect in STOCHASTIC],
    }


def show_installation(content: Mapping[str, Any]) -> None:
    """Print what this installation consists of, and whether it works."""
    console, passed = plain_console(), content["self_test_passed"]
    drift = f"energy of a free tumble constant to {content['energy_drift']:.1g}"
    says = "self-test passed" if passed else "self-test FAILED: do not use this installation"
    console.print(headed(says, f" ({drift})", style="bold green" if passed else "bold red"))
    bits = "64-bit" if content["double_precision"] else "32-bit: do not use it"
    for what, value in (
        ("packages", ", ".join(f"{name} {of}" for name, of in content["versions"].items())),
        ("computing on", f"{', '.join(content['devices'])}, {bits}"),
        ("compiled code", content["compiled_code"]),
        ("effects", ", ".join(content["effects"])),
        ("effects without a fixed shape", ", ".join(content[_STOCHASTIC])),
    ):
        console.print(f"{what}: {value}")


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
