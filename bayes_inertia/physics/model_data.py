"""All arrays of a model; and each slew alone, padded to one of a few sizes, as programs take it.

Large programs are compiled for one slew and run for each: how many slews a campaign has decides
nothing, and rows, fixes and grid points are rounded up to `padded_size`. A campaign of another
length then runs the programs of the last one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import jax
import numpy as np
from jax import Array

from bayes_inertia.maths.device_arrays import on_device, padded_size, repeated
from bayes_inertia.physics.nuisances import NuisanceScale
from bayes_inertia.physics.packing import Arrays
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.slew_input import SlewInput

# What a slew's context holds at each grid point.
_ON_GRID = ("time", "step", "torque", "lost_command", "lost_command_sd", "fix_group")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Data:
    """All arrays of a model.

    Parameters
    ----------
    arrays : Arrays
        Inputs and measurements, with the slews as leading axis.
    sensors : tuple
        Constants of each channel.
    scale : NuisanceScale
        Prior sd of the nuisances.
    """

    arrays: Arrays
    sensors: tuple[Any, ...]
    scale: NuisanceScale

    @cached_property
    def pieces(self) -> tuple[Data, ...]:
        """Each slew alone (the leading axis stays), its last row and fix repeated up to a size."""
        arrays = jax.tree.map(np.asarray, self.arrays)
        padded = Arrays(
            _padded_inputs(arrays.slews), jax.tree.map(_padded, arrays.telemetry), arrays.reference
        )
        alone = (jax.tree.map(partial(_slew, k), padded) for k in range(len(arrays.slews.momentum)))
        return tuple(Data(of_slew, self.sensors, self.scale) for of_slew in alone)

    @cached_property
    def contexts(self) -> SlewContext:
        """The contexts of all slews, their grids padded."""
        alone = (piece.arrays.slews.context for piece in self.pieces)
        return jax.tree.map(lambda *rows: np.concatenate(rows), *alone)


def _slew(k: int, rows: np.ndarray) -> Array:
    return on_device(rows[k : k + 1])


def _padded(rows: Any) -> Any:
    return repeated(rows, padded_size(rows.shape[1])) if rows.shape[1] else rows


def _padded_inputs(slews: SlewInput) -> SlewInput:
    context = slews.context
    given = {key: getattr(context, key) for key in _ON_GRID}
    on_grid = {key: _padded(rows) for key, rows in given.items() if rows is not None}
    return slews._replace(
        context=context._replace(**on_grid),
        momentum=_padded(slews.momentum),
        environment=jax.tree.map(_padded, slews.environment),
        inputs=jax.tree.map(_padded, slews.inputs),
    )
