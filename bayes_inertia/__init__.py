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
    "Campaign": "campaign",
    "Contender": "compare",
    "Design": "design",
    "InertiaPrior": "campaign",
    "KeepOut": "constraints",
    "Limits": "constraints",
    "Margin": "constraints",
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
    "next_slew": "design",
    "separating_slew": "separation",
    "read_campaign": "io",
    "write_campaign": "io",
    "write_report": "report",
}

__all__ = sorted([*_PUBLIC, "compare", "design", "diagnose", "estimate", "fit", "observability"])


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]


# After everything above, because these modules need it. They are bound here and not on first use because a module and its
# function share a name: the function must win.
from bayes_inertia.compare import compare  # noqa: E402, F401
from bayes_inertia.design import design  # noqa: E402, F401
from bayes_inertia.diagnose import diagnose  # noqa: E402, F401
from bayes_inertia.estimate import estimate  # noqa: E402, F401
from bayes_inertia.fit import fit  # noqa: E402, F401
from bayes_inertia.observability import observability  # noqa: E402, F401
