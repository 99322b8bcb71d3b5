"""Compile what a fit with effects without a fixed shape needs, while something else is done.

The compiler needs no interpreter lock: it works beside an optimizer that is busy with a smaller
model, or with other programs of the same one. A program that two threads want is compiled once.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np

from bayes_inertia.inference.hyperparameters import evidence_at
from bayes_inertia.inference.likelihood import residuals
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.point import Point
from bayes_inertia.physics.forward_model import Model


@contextmanager
def compiled_meanwhile(model: Model, point: Point) -> Iterator[None]:
    """Compile a fit with effects without a fixed shape while the body of `with` runs.

    `model`: of others nothing is compiled: their few programs are needed at once. `point`: where it
    is evaluated once for that; the results are thrown away.
    """
    if not model.structure.hyperparameters:
        yield
        return
    with ThreadPoolExecutor(1) as pool:
        # Whatever fails here fails again where its result is asked for.
        pool.submit(_evaluate, model, point)
        yield


def _evaluate(model: Model, point: Point) -> None:
    """Derivatives and evidence first: they take longest to compile."""
    white = whitening(model, point.theta)
    evidence = evidence_at(model, point, white, np.arange(model.space.size))
    evidence.negative_log(evidence.standardised(point.theta))
    residuals(model.structure, point, model.data, white)
