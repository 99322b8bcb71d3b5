"""How far an effect that is too weak to be found could have moved J and K.

That a diagnosis names nothing does not mean that nothing is there. To first order an effect of amplitude a (in units of its prior sd) that
is left out moves what is fitted by -N^-1 F^T C a, with N the normal matrix of everything fitted, F its columns and C the
effect's, and shows itself with the non-centrality a^T S a of its score (`fingerprint`). Of all amplitudes that would be found with
even odds at most, and that are no larger than two prior sds, the one that moves a parameter furthest has a closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.score_test import fingerprints, unfitted
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.physics.parameters import N_BASE

_MOST = 2.0  # [prior sd] largest amplitude


@dataclass(frozen=True)
class Undetected:
    """The effect, of those that were not found, that could have moved a parameter furthest.

    Attributes
    ----------
    parameter : of J or K. sd : of its fit. shift : how far an effect found with even odds could move it, in the parameter's `unit`.
    effect, values : which effect, and {its parameter: value} that does it (its opposite moves as far the other way).
    unseen : whether it is the effect's own prior, not the data, that limits the shift.

    >>> Undetected("Jxx", "kg m^2", 2e-4, 1e-3, "wheel_command_lag", {"tau": 1e-3}, False).sds
    5.0
    """

    parameter: str
    unit: str
    sd: float
    shift: float
    effect: str
    values: dict[str, float]
    unseen: bool

    @property
    def sds(self) -> float:
        """The shift in units of the parameter's sd."""
        return self.shift / self.sd


def undetected(found: Diagnosis) -> tuple[Undetected, ...]:
    """For each element of J and K the effect that could hide furthest behind it; empty where the verdict is "unknown".

    What was named is fitted and hides nothing. A flexible mode, whose signal is of second order, is left out.
    """
    at = found.final
    space = at.model.space
    tried = unfitted(at)
    if not tried or found.verdict == "unknown":
        return ()
    fit = at.linearised()
    marks = fingerprints(at, tried, fit=fit)
    worst: dict[int, Undetected] = {}
    for k, name in enumerate(tried):
        part, index = space.slice_of(name), marks.groups[k]
        data = marks.matrix[np.ix_(index, index)] / even_odds(max(marks.dof(k), 1), found.threshold)
        shift, amplitude = furthest(
            _pull(fit, at.free, fit.parameters[..., part] * space.sd[part]), data
        )
        values, unseen = (
            space.nulls[part] + amplitude * space.sd[part],
            np.sum(amplitude**2, 1) > 0.5 * _MOST**2,
        )
        names = [n.split(".", 1)[1] for n in space.names[part]]
        for i in np.intersect1d(at.free, np.arange(N_BASE)):
            if i not in worst or shift[i] > worst[i].shift:
                own = dict(zip(names, values[i].tolist(), strict=True))
                worst[i] = Undetected(
                    space.names[i],
                    space.units[i],
                    float(at.sd[i]),
                    float(shift[i]),
                    name,
                    own,
                    bool(unseen[i]),
                )
    return tuple(worst[i] for i in sorted(worst))


def even_odds(dof: int, level: float) -> float:
    """Non-centrality that a chi^2 test of this level finds every second time.

    >>> round(even_odds(1, 0.05), 2)
    3.84
    """
    limit = stats.chi2.isf(level, dof)
    return float(optimize.brentq(lambda nc: stats.ncx2.sf(limit, dof, nc) - 0.5, 0.0, limit + 10.0))


def furthest(pull: np.ndarray, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest pull a (p,) over amplitudes a with a^T data a + |a|^2 / 4 at most 1, and the amplitudes (p, n) that do it.

    >>> shift, amplitude = furthest(np.eye(2), np.diag([1e6, 0.0]))
    >>> shift.round(6).tolist(), amplitude.round(6).tolist()
    ([0.001, 2.0], [[0.001, 0.0], [0.0, 2.0]])
    """
    towards = np.linalg.solve(data + np.eye(len(data)) / _MOST**2, pull.T).T
    shift = np.sqrt(np.maximum(np.sum(pull * towards, 1), 0.0))
    return shift, towards / np.maximum(shift, 1e-300)[:, None]


def _pull(fit: LinearisedFit, free: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Shift (9, n) of J and K per unit of what is left out; zero where they are held."""
    out, rigid = np.zeros((N_BASE, columns.shape[-1])), free < N_BASE
    out[free[rigid]] = (fit.inverse_root.T @ fit.imitated(columns))[: len(free)][rigid]
    return out
