"""Programs that are compiled for one slew and run for each: padded before, cut afterwards.

How many slews a campaign has decides nothing of what is compiled, and its rows only through the few
sizes that slews are padded to (`physics.packing`). Outside of here nobody sees the padding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from bayes_inertia.inference.noise_model import Whitenings
from bayes_inertia.inference.point import Point
from bayes_inertia.maths.device_arrays import filled
from bayes_inertia.physics.packing import Data


class SlewPiece(NamedTuple):
    """What a program of one slew is given; the slew's axis stays, of length one."""

    point: Point
    data: Data
    white: Whitenings


def is_traced(*arrays: Any) -> bool:
    """Whether JAX transforms the caller: then all slews are one program, in their own size."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arrays))


def slew_pieces(point: Point, data: Data, white: Whitenings) -> list[SlewPiece]:
    """Nuisances (slews, n_local), arrays and noise of each slew alone; padding has no weight."""
    local = np.asarray(point.local)
    sizes = [readings.values.shape[1] for readings in data.pieces[0].arrays.telemetry.readings]
    padded = tuple(
        jax.tree.map(lambda x, size=size: filled(np.asarray(x), size), each)
        for each, size in zip(white, sizes, strict=True)
    )
    return [
        SlewPiece(replace(point, local=local[k : k + 1]), alone, of_slew(k, padded))
        for k, alone in enumerate(data.pieces)
    ]


def of_slew(k: int, arrays: Any) -> Any:
    """One slew of arrays of numpy whose leading axis are slews."""
    return jax.tree.map(lambda rows: rows[k : k + 1], arrays)


def of_all_slews(parts: Sequence[Any], sizes: Any) -> Any:
    """Results of each slew (1, padded, ...) as those of all (slews, size, ...), of numpy.

    `sizes` has an array's true second axis in its place.
    """

    def stacked(size: int, *of_slews: Any) -> np.ndarray:
        return np.concatenate([np.asarray(x)[:, :size] for x in of_slews])

    return jax.tree.map(stacked, sizes, *parts)
