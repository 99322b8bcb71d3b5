"""Readings of a high rate replaced by few combinations of them that tell as much.

Within one integration step every rate and wheel momentum that the model can predict is a
combination of a few known functions of time: a quintic, what the wheels did beyond the cubic that
the integrator was given times a quintic, and the wheels' momentum itself. Readings with white noise
tell of the model only through their projections on the span of these functions (the sufficient
statistics of linear regression; Golub and Van Loan 2013, section 5.3). With U an orthonormal basis
of the span, the model is evaluated at as many rows p as it has functions, chosen by QR with column
pivoting, and U U_p^-1 = Q R leads from there to all rows:
|z - m|^2 = |Q^T z - R m_p|^2 + |z - Q Q^T z|^2. The last term does not depend on the model.

A chosen row's value is exact for any model in the span; functions are left out of it only where the
model holds less of them than `_NEGLIGIBLE` of the noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import qr
from scipy.special import factorial2

from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.marginal_posterior import Marginal
from bayes_inertia.inference.noise_model import Whitening
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import padded_size
from bayes_inertia.physics.prediction import Structure
from bayes_inertia.physics.slew_input import SlewInput
from bayes_inertia.physics.step_drive import KnownMomentum, known_momentum

_DEGREE = 5  # of the dense output


class _Channel(NamedTuple):
    """One channel on the integration grid; noise and weights are the same in all rows of a slew."""

    valid: np.ndarray  # (slews, grid)
    readings: np.ndarray  # (slews, grid, components)
    factor: np.ndarray  # (slews, ...), what whitens a reading
    columns: np.ndarray  # (slews, grid, components, nuisances), whitened


class _Rows(NamedTuple):
    """Rows at which the model is evaluated, and what leads from there to all rows of a step."""

    chosen: np.ndarray  # (slews, m, q), within each step
    to_all: np.ndarray  # (slews, m, r, q)


class _Combined(NamedTuple):
    """One channel in few combinations of its readings."""

    factor: np.ndarray  # (slews, m, q, q)
    readings: np.ndarray  # (slews, m q, components)
    columns: np.ndarray  # (slews, m q components, nuisances)
    unexplained: float


def compressed(structure: Structure, marginal: Marginal) -> Marginal:
    """The same marginal posterior from fewer numbers, where the rate of telemetry is high.

    Returns: the one given, where `why_not_compressed` has a reason or little would be gained.
    """
    if why_not_compressed(structure, marginal) is not None:
        return marginal
    series = {
        k: _on_grid(marginal, k)
        for k, channel in enumerate(structure.channels)
        if channel.stream.is_series
    }
    valid = np.logical_or.reduce([channel.valid for channel in series.values()])
    rows = _chosen_rows(structure, marginal, valid)
    if rows is None:
        return marginal
    telemetry = marginal.data.arrays.telemetry
    first = structure.rows_per_step * np.arange(rows.chosen.shape[1])
    grid_rows = (rows.chosen + first[:, None]).reshape(len(rows.chosen), -1)
    columns, readings, white = (
        [*each] for each in (marginal.columns, telemetry.readings, marginal.white)
    )
    unexplained = 0.0
    for k, on_grid in series.items():
        few = _combined(on_grid, rows)
        readings[k] = readings[k]._replace(
            values=jnp.asarray(few.readings), combined=jnp.asarray(few.factor)
        )
        each_row = np.repeat(on_grid.factor[:, None], grid_rows.shape[1], axis=1)
        white[k] = Whitening(jnp.asarray(each_row))
        if structure.channels[k].compared:
            columns[k] = jnp.asarray(few.columns)
        unexplained += few.unexplained
    telemetry = telemetry._replace(readings=tuple(readings), combined_at=jnp.asarray(grid_rows))
    arrays = marginal.data.arrays._replace(telemetry=telemetry)
    return marginal._replace(
        columns=tuple(columns),
        data=replace(marginal.data, arrays=arrays),
        white=tuple(white),
        unexplained=jnp.asarray(unexplained),
    )


def why_not_compressed(structure: Structure, marginal: Marginal) -> str | None:
    """Why the readings of a campaign are compared one by one.

    Returns: the reason; None where nothing speaks against combining them.
    """
    if structure.rows_per_step < LIMITS.fewest_rows:
        return "integration steps span few rows"
    acting = any(effect.acts("delivered_torque") for effect in structure.effects)
    if acting or not structure.has_sparse_output:
        return "an effect acts on the motion within a step, or on a sensor"
    if marginal.coefficients is not None:
        return "effects without a fixed shape are integrated out"
    if any(not channel.stream.field for channel in structure.channels):
        return "further sensors are compared"
    for channel, white in zip(structure.channels, marginal.white, strict=True):
        sensor = channel.stream.sensor
        if white.memory is not None:
            return f"the noise of the {sensor} is correlated"
        factors = np.asarray(white.factors)
        if channel.stream.is_series and not _even(factors.reshape(*factors.shape[:2], -1)):
            return f"the noise of the {sensor} differs between rows, or some lack a reading"
    return None


def _even(factors: np.ndarray) -> bool:
    """Whether all rows (slews, n, k) of each slew that are not zero are equal."""
    valid = (factors != 0.0).any(axis=-1)
    same = (factors == _of_slews(factors, valid)[:, None]).all(axis=-1)
    return bool((same | ~valid).all())


def _of_slews(whiten: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """The first factor of each slew that is not zero."""
    return whiten[np.arange(len(whiten)), valid.argmax(axis=1)]


def _on_grid(marginal: Marginal, k: int) -> _Channel:
    """A channel moved from the rows of the telemetry to those of the grid."""
    arrays, factors = marginal.data.arrays, np.asarray(marginal.white[k].factors)
    sample, grid = np.asarray(arrays.telemetry.sample), arrays.slews.context.time.shape[1]
    valid = (factors != 0.0).any(axis=tuple(range(2, factors.ndim)))
    readings = np.asarray(arrays.telemetry.readings[k].values)

    def moved(rows: np.ndarray) -> np.ndarray:
        places = np.zeros((len(rows), grid, *rows.shape[2:]), rows.dtype)
        for s, counts in enumerate(valid):
            places[s, sample[s, counts]] = rows[s, counts]
        return places

    columns = np.asarray(marginal.columns[k])
    # In the measured drive tachometers are not compared.
    shape = *readings.shape, columns.shape[-1]
    columns = columns.reshape(shape) if columns.size else np.zeros(shape)
    factor = _of_slews(factors, valid)
    return _Channel(moved(valid), moved(readings), factor, moved(columns))


def _known(structure: Structure, slews: SlewInput) -> KnownMomentum:
    """What is known beforehand of all slews, arrays of numpy: compiling would take longer."""
    drive, rows = structure.drive, structure.rows_per_step
    arrays = jax.tree.map(np.asarray, slews)

    def of(k: int) -> KnownMomentum:
        slew = jax.tree.map(lambda x: x[k], arrays)
        return known_momentum(slew, slew.context.torque, drive, rows, np)

    parts = [of(k) for k in range(len(arrays.context.time))]
    return jax.tree.map(lambda *x: np.stack(x), *parts)


def _chosen_rows(structure: Structure, marginal: Marginal, valid: np.ndarray) -> _Rows | None:
    """As many rows of each step as the model has functions there; None where most are needed."""
    slews, r = marginal.data.arrays.slews, structure.rows_per_step
    known = _known(structure, slews)
    counts = valid.reshape(known.steps.fraction.shape)[..., None]
    basis, size, _ = np.linalg.svd(_functions(structure, marginal, known) * counts, False)
    rank = (size > LIMITS.negligible * np.sqrt(r)).sum(axis=-1)
    # Few numbers of rows, for each is another program.
    q = padded_size(int(rank.max()), 4, often=True)
    if q > LIMITS.worthwhile * r:
        return None
    chosen = np.zeros((*rank.shape, q), int)
    to_all = np.zeros((*rank.shape, r, q))
    for at in np.ndindex(rank.shape):
        of_step = basis[at][:, : rank[at]]
        order = qr(of_step.T, mode="r", pivoting=True)[1] if rank[at] else np.arange(r)
        chosen[at] = np.sort(order[:q])
        to_all[at] = of_step @ np.linalg.pinv(of_step[chosen[at]])
    return _Rows(chosen, to_all)


def _functions(structure: Structure, marginal: Marginal, known: KnownMomentum) -> np.ndarray:
    """What predictions may consist of (slews, m, r, functions), as large as it may be in sigmas."""
    motion = _Motion.of(structure, marginal)
    fraction = known.steps.fraction
    legendre = legvander(2.0 * fraction - 1.0, _DEGREE)
    order = np.arange(_DEGREE + 1)
    half_turn = 0.5 * motion.frequency * known.steps.length.max()
    # Expansion coefficients of a plane wave (Abramowitz and Stegun 1972, 10.1.2 and 10.1.47).
    fading = np.minimum(1.0, half_turn**order / factorial2(np.maximum(2 * order - 1, 1)))
    assert known.left_out is not None
    kicked = (known.left_out * motion.per_kick)[..., None] * fading * legendre[..., None, :]
    wheels = known.at_rows.reshape(known.left_out.shape) * motion.per_momentum
    parts = [
        legendre * motion.rate,
        LIMITS.compression_margin * kicked.reshape(*fraction.shape, kicked[0, 0, 0].size),
        wheels,
    ]
    if structure.drive == "measured":
        modes = np.asarray(marginal.data.arrays.telemetry.tachometer_modes)
        sd = np.asarray(marginal.data.scale.local)[6:].max(initial=0.0)
        size = LIMITS.compression_margin * sd * motion.per_momentum.max(initial=0.0)
        parts.append(size * modes.reshape(*fraction.shape, modes.shape[-1]))
    return np.concatenate(parts, axis=-1)


class _Motion(NamedTuple):
    """How large the parts of predictions are, in sigmas of whichever sensor sees them best."""

    frequency: float  # fastest change of the rates [rad/s]
    rate: float
    per_kick: np.ndarray  # (wheels,) of momentum integrated over time [1/(N m s^2)]
    per_momentum: np.ndarray  # (wheels,) [1/(N m s)]

    @classmethod
    def of(cls, structure: Structure, marginal: Marginal) -> _Motion:
        """From readings, and J of the optimum."""
        slews, telemetry, _ = marginal.data.arrays
        gyro, wheels = structure.place("rate"), structure.place("momentum")
        hardware = slews.context.wheel_axes_B, slews.context.spin_inertia
        axes, spin = (np.asarray(part)[0] for part in hardware)
        tensor = inertia_tensor.tensor(np.asarray(marginal.optimum.theta)[:6])
        moments = np.linalg.eigvalsh(tensor)
        rate = np.sqrt(3.0) * float(np.abs(telemetry.readings[gyro].values).max(initial=0.0))
        held = np.abs(np.asarray(slews.momentum)).max(axis=(0, 1), initial=0.0)
        momentum = float(moments[-1] * rate + held.sum())
        frequency = rate + momentum / float(np.sqrt(moments[0] * moments[1]))
        by_wheel = np.asarray(marginal.white[wheels].factors).max(axis=(0, 1), initial=0.0)
        by_gyro = float(np.abs(marginal.white[gyro].factors).max(initial=0.0))
        sigmas = max(by_gyro, float((by_wheel * spin).max(initial=0.0)))
        turned = sigmas * np.linalg.norm(np.linalg.solve(tensor, axes), axis=0)
        kick = turned * momentum / moments[0]
        return cls(frequency, rate * sigmas, kick, turned + by_wheel)


def _combined(channel: _Channel, rows: _Rows) -> _Combined:
    """A channel's readings and columns projected on what the model can predict."""
    slews, m, r, q = rows.to_all.shape
    shape = slews, m, r
    factors = np.linalg.qr(rows.to_all * channel.valid.reshape(*shape, 1))
    readings = channel.readings.reshape(*shape, channel.readings.shape[-1])
    combined = np.einsum("smrq,smrc->smqc", factors.Q, readings)
    rest = readings - factors.Q @ combined
    whiten = channel.factor
    matrix = whiten if whiten.ndim == 3 else whiten[..., None] * np.eye(whiten.shape[-1])
    unexplained = np.einsum("scd,smrd->smrc", matrix, rest)
    columns = channel.columns.reshape(*shape, *channel.columns.shape[2:])
    columns = np.einsum("smrq,smrck->smqck", factors.Q, columns)
    return _Combined(
        factors.R,
        combined.reshape(slews, m * q, readings.shape[-1]),
        columns.reshape(slews, m * q * readings.shape[-1], columns.shape[-1]),
        float(np.sum(unexplained**2)),
    )
