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

# Further public names and where they live, loaded on first use: plots and reports take a second to import.
_PUBLIC = {
    "Campaign": "campaign.campaign",
    "Contender": "design.comparison",
    "Design": "design.designer",
    "Effect": "physics.effect",
    "InertiaPrior": "campaign.inertia_prior",
    "KeepOut": "design.limits",
    "LIBRARY": "physics.effects",
    "Limits": "design.limits",
    "Margin": "design.margins",
    "Model": "physics.forward_model",
    "Posterior": "inference.posterior",
    "RateSensor": "campaign.hardware",
    "Settings": "inference.sampler",
    "Slew": "campaign.slew",
    "StarTracker": "campaign.hardware",
    "Wheel": "campaign.hardware",
    "check_effect": "physics.check_effect",
    "compare_plans": "design.comparison",
    "design_plan": "design.designer",
    "diagnose": "diagnosis.search",
    "diagnose_and_fit": "app.diagnosed_fit",
    "estimate": "inference.optimizer",
    "fit": "app.fit_campaign",
    "next_slew": "design.designer",
    "observe": "observability.analysis",
    "read_campaign": "campaign.reader",
    "separating_slew": "design.separating_slew",
    "write_campaign": "campaign.writer",
    "write_report": "report.page",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
