"""How JAX must compute. Every module that can start a computation imports this one.

Attitude residuals of arc seconds on angles of radians need double precision. Ensembles run in
threads, and each waits for its own result: asynchronous dispatch only makes them fight over the
cores.
"""

from __future__ import annotations

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_cpu_enable_async_dispatch", False)
