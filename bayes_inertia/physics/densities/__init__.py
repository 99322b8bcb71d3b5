"""The densities that a channel's noise may have: one small file for each family."""

from __future__ import annotations

from collections.abc import Mapping

from bayes_inertia.physics.densities.density import Density
from bayes_inertia.physics.densities.gaussian import Gaussian
from bayes_inertia.physics.densities.student_t import StudentT

__all__ = ["FAMILIES", "Density"]

# By name; a new family is one file and its entry here.
FAMILIES: Mapping[str, Density] = {d.name: d for d in (Gaussian(), StudentT())}
