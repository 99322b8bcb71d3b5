"""bayes_inertia: inertia tensor and rate-sensor scale factors of a spacecraft from slew telemetry, with honest uncertainty."""

from __future__ import annotations

import jax

# Attitude residuals of arc seconds on angles of radians need double precision.
jax.config.update("jax_enable_x64", True)
# Ensembles run in threads, and each waits for its own result: asynchronous dispatch only makes them fight over the cores.
jax.config.update("jax_cpu_enable_async_dispatch", False)

__version__ = "0.1.0"
