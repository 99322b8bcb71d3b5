"""Pictures of a posterior: pure functions that return a matplotlib `Figure`, one file each.

A picture of something that the fit does not have (no star tracker, no predicted momentum) is None.
"""

from bayes_inertia.report.pictures.attitude import attitude
from bayes_inertia.report.pictures.chains import chains
from bayes_inertia.report.pictures.pairs import pairs
from bayes_inertia.report.pictures.priors import prior_posterior
from bayes_inertia.report.pictures.telemetry import momentum, rates

__all__ = ["attitude", "chains", "momentum", "pairs", "prior_posterior", "rates"]
