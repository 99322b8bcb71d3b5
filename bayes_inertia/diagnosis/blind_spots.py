"""How far an effect that is too weak to be found could have moved J and K.

That a diagnosis names nothing does not mean that nothing is there. To first order an effect of
amplitude a (in units of its prior sd) that is left out moves what is fitted by -N^-1 F^T C a, with
N the normal matrix of everything fitted, F its columns and C the effect's, and shows itself with
the non-centrality a^T S a of its score (`score_test`). Of all amplitudes that would be found with
even odds at most, and that are no larger than two prior sds, the one that moves a parameter
furthest has a closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.score_test import ScoreTests, score_tests, unfitted
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.physics.parameters import N_BASE

_MAX_AMPLITUDE = 2.0  # [prior sd]


@dataclass(frozen=True)
class Undetected:
    """The effect, of those that were not found, that could have moved a parameter furthest.

    Parameters
    ----------
    parameter : str
        Element of J or K.
    unit : str
        Its unit.
    sd : float
        Of its fit.
    shift : float
        How far an effect found with even odds could move it.
    effect : str
        Which effect.
    values : dict
        {parameter of the effect: value} that does it; its opposite moves as far the other way.
    unseen : bool
        Whether it is the effect's own prior, not the data, that limits the shift.

    Examples
    --------
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


def undetected_effects(diagnosis: Diagnosis) -> tuple[Undetected, ...]:
    """Find the effect that could hide furthest behind each element of J and K.

    What was named is fitted and hides nothing. A flexible mode, whose signal is of second order, is
    left out.

    Returns: one for each element that was fitted; empty where the verdict is "unknown".
    """
    scored = scored_undetected(diagnosis)
    if scored is None:
        return ()
    fit, tests = scored
    worst: dict[int, Undetected] = {}
    for k in range(len(tests.names)):
        for i, row in _shifts(diagnosis.final, fit, tests, k, diagnosis.threshold).items():
            if i not in worst or row.shift > worst[i].shift:
                worst[i] = row
    return tuple(worst[i] for i in sorted(worst))


def scored_undetected(diagnosis: Diagnosis) -> tuple[LinearisedFit, ScoreTests] | None:
    """Score the candidates that were not named, at the final fit.

    Returns `tests`: of the candidates; None for both where the verdict is "unknown" or all are
    fitted.
    """
    names = unfitted(diagnosis.final)
    if not names or diagnosis.verdict == "unknown":
        return None
    fit = diagnosis.final.linearised()
    return fit, score_tests(diagnosis.final, names, fit=fit)


def _shifts(
    estimate: Estimate, fit: LinearisedFit, tests: ScoreTests, k: int, threshold: float
) -> dict[int, Undetected]:
    """How far candidate k could move each element of J and K that was fitted."""
    space, effect = estimate.model.space, tests.names[k]
    part, index = space.slice_of(effect), tests.indices[k]
    limit = noncentrality_at_even_odds(max(tests.dof(k), 1), threshold)
    shift, amplitude = largest_shifts(
        shift_per_amplitude(fit, estimate.free, fit.parameters[..., part] * space.sd[part]),
        tests.matrix[np.ix_(index, index)] / limit,
    )
    values = space.nulls[part] + amplitude * space.sd[part]
    unseen = np.sum(amplitude**2, 1) > 0.5 * _MAX_AMPLITUDE**2
    names = [name.split(".", 1)[1] for name in space.names[part]]
    return {
        int(i): Undetected(
            parameter=space.names[i],
            unit=space.units[i],
            sd=float(estimate.sd[i]),
            shift=float(shift[i]),
            effect=effect,
            values=dict(zip(names, values[i].tolist(), strict=True)),
            unseen=bool(unseen[i]),
        )
        for i in np.intersect1d(estimate.free, np.arange(N_BASE))
    }


def noncentrality_at_even_odds(dof: int, level: float) -> float:
    """Find the non-centrality that a chi^2 test finds every second time.

    `level`: its level: the p-value below which it finds something.

    Examples
    --------
    >>> round(noncentrality_at_even_odds(1, 0.05), 2)
    3.84
    """
    limit = stats.chi2.isf(level, dof)
    return float(optimize.brentq(lambda nc: stats.ncx2.sf(limit, dof, nc) - 0.5, 0.0, limit + 10.0))


def largest_shifts(
    shift_per_amplitude: np.ndarray, data: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Largest shifts over amplitudes a with a^T data a + |a|^2 / 4 at most 1.

    `shift_per_amplitude` (p, n). `data` (n, n): normal matrix of the amplitudes, 1 where an effect
    is found with even odds. Returns `shift` (p,): the largest value of each function; `amplitude`
    (p, n): the amplitudes that reach it.

    Examples
    --------
    >>> shift, amplitude = largest_shifts(np.eye(2), np.diag([1e6, 0.0]))
    >>> shift.round(6).tolist(), amplitude.round(6).tolist()
    ([0.001, 2.0], [[0.001, 0.0], [0.0, 2.0]])
    """
    towards = np.linalg.solve(data + np.eye(len(data)) / _MAX_AMPLITUDE**2, shift_per_amplitude.T).T
    shift = np.sqrt(np.maximum(np.sum(shift_per_amplitude * towards, 1), 0.0))
    return shift, towards / np.maximum(shift, 1e-300)[:, None]


def shift_per_amplitude(fit: LinearisedFit, free: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """How far what is left out moves the fit.

    `free` (f,). `columns` (slews, numbers, n): changes of the whitened residuals by units of what
    is left out. Returns (9, n): shift of J and K per unit; zero where they are held.
    """
    out, base = np.zeros((N_BASE, columns.shape[-1])), free < N_BASE
    out[free[base]] = (fit.inverse_root.T @ fit.imitated(columns))[: len(free)][base]
    return out
