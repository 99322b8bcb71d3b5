"""Physics: what a slew's telemetry would be for given J, K and effects.

Enters: a `Campaign`, effects, and parameter values. Leaves: predicted telemetry (`forward_model`),
and the effect library with its contract (`effect`, `effects`, `check_effect`). Nothing here knows
of statistics, plans or reports.
"""

from bayes_inertia.maths import jax_settings as jax_settings
