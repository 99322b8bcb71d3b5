"""bayes_inertia: inertia tensor and rate-sensor scale factors of a spacecraft from slew telemetry, with honest uncertainty.

In a notebook::

    import bayes_inertia as bi
    campaign = bi.read_campaign("my_campaign")
    posterior = bi.fit(campaign, seed=1)
    posterior.summary()["parameters"]["Jxy"]
    bi.write_report(posterior, "report.html")
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import jax

# Attitude residuals of arc seconds on angles of radians need double precision.
jax.config.update("jax_enable_x64", True)
# Ensembles run in threads, and each waits for its own result: asynchronous dispatch only makes them fight over the cores.
jax.config.update("jax_cpu_enable_async_dispatch", False)

__version__ = "0.1.0"

# Public names and where they live; loaded on first use, so that a quick check does not pay for samplers and plots.
_PUBLIC = {
    "Campaign": "campaign",
    "InertiaPrior": "campaign",
    "RateSensor": "campaign",
    "Slew": "campaign",
    "StarTracker": "campaign",
    "Wheel": "campaign",
    "Effect": "effect",
    "LIBRARY": "effects",
    "Model": "model",
    "Posterior": "posterior",
    "Settings": "sample",
    "check_effect": "testing",
    "diagnose": "diagnose",
    "estimate": "estimate",
    "fit": "fit",
    "read_campaign": "io",
    "write_campaign": "io",
    "write_report": "report",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
