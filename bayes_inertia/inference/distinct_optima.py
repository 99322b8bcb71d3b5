"""Which ends of the optimizer's gentle descents are worth following."""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.point import Point
from bayes_inertia.physics.forward_model import Model

# Ends of gentle descents nearer than this [prior sd] are one.
_SAME_PLACE_SD = 0.1
# Ends whose (gentle) objective is this much above the best are not followed.
_MAX_OBJECTIVE_EXCESS = 1.0


def distinct_optima(model: Model, descents: list[tuple[float, Point]]) -> list[tuple[Point, int]]:
    """The ends of gentle descents that are worth following, without repetition.

    While the data count weakly an objective hardly tells two optima apart; places do.

    Parameters
    ----------
    model : Model
    descents : list of (float, Point)
        Objective and end of each descent.

    Returns
    -------
    list of (Point, int)
        Ends not far worse than the best, best first, and how often each was reached.
    """
    descents = sorted(descents, key=lambda descent: descent[0])
    groups: list[list[Point]] = []
    for objective, point in descents:
        place = _unknowns_in_prior_sd(model, point)
        same = [
            g
            for g in groups
            if np.max(np.abs(_unknowns_in_prior_sd(model, g[0]) - place)) < _SAME_PLACE_SD
        ]
        if same:
            same[0].append(point)
        elif objective <= descents[0][0] + _MAX_OBJECTIVE_EXCESS:
            groups.append([point])
    return [(group[0], len(group)) for group in groups]


def _unknowns_in_prior_sd(model: Model, point: Point) -> np.ndarray:
    """All unknowns in prior sd."""
    return np.concatenate([point.theta / model.space.sd, point.bias, point.local.ravel()])
