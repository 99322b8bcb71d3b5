"""Parameters that are learnt by evidence, in prior sds from the centres of their priors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayes_inertia.physics.forward_model import Model


@dataclass(frozen=True, eq=False)
class LearntParameters:
    """Which parameters are learnt, and how they are counted.

    Parameters
    ----------
    model : Model
    learnt : (h,) array of int
        Their indices.
    """

    model: Model
    learnt: np.ndarray

    @cached_property
    def priors(self) -> dict[str, np.ndarray]:
        """Of these parameters, as `ParameterSpace.constants`."""
        constants = self.model.space.constants().items()
        return {key: np.asarray(values)[self.learnt] for key, values in constants}

    def standardised(self, theta: np.ndarray) -> np.ndarray:
        """The learnt parameters of all.

        `theta` (..., d). Returns (..., h).
        """
        value, logarithmic = np.asarray(theta)[..., self.learnt], self.priors["logarithmic"]
        value = np.where(logarithmic, np.log(np.where(logarithmic, value, 1.0)), value)
        return (value - self.priors["mean"]) / self.priors["scale"]

    def put(self, theta: np.ndarray, standardised: np.ndarray) -> np.ndarray:
        """All parameters, with other values of the learnt ones.

        `theta` (d,); `standardised` (..., h). Returns (..., d).
        """
        priors, standardised = self.priors, np.asarray(standardised)
        value, logarithmic = priors["mean"] + priors["scale"] * standardised, priors["logarithmic"]
        value = np.where(logarithmic, np.exp(np.where(logarithmic, value, 0.0)), value)
        result = np.broadcast_to(theta, (*standardised.shape[:-1], len(theta))).copy()
        result[..., self.learnt] = np.clip(value, priors["lower"], priors["upper"])
        return result
