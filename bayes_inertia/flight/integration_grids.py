"""Integration grids of a campaign that has yet to be flown, padded to whole telemetry rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import EffectError
from bayes_inertia.physics.channels import channels_of
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.integration_plan import integration_plan
from bayes_inertia.physics.packing import pack
from bayes_inertia.physics.slew_context import Environment
from bayes_inertia.physics.slew_input import SlewInput


class IntegrationGrid(NamedTuple):
    """Integration grids of all slews.

    Parameters
    ----------
    slews : SlewInput
        Grids and environment, with a leading axis of slews.
    n_rows : int
        Telemetry rows, padded.
    substeps : int
        Integration steps a row.
    """

    slews: SlewInput
    n_rows: int
    substeps: int


def integration_grid(campaign: Campaign, effects: Sequence[Effect]) -> IntegrationGrid:
    """The grids that a `Model` of the flown campaign will integrate on.

    `campaign`: the plan as a campaign that has not been flown.
    """
    for effect in effects:
        for column in effect.needs:
            if any(getattr(slew, column) is None for slew in campaign.slews):
                raise EffectError(
                    f"needs {column}",
                    where=effect.name,
                    advice="give the plan an [orbit], or leave the effect out",
                )
    step = integration_plan(campaign, effects, "commanded").spacing
    arrays = pack(campaign, channels_of(campaign, "commanded"), max_step=step)
    n_rows = arrays.telemetry.sample.shape[1]
    substeps = int(arrays.telemetry.sample[0, 1])
    missing = n_rows * substeps - arrays.slews.context.time.shape[1]
    return IntegrationGrid(_padded(arrays.slews, missing), n_rows, substeps)


def _padded(slews: SlewInput, missing: int) -> SlewInput:
    """Grids with `missing` more points at their end, where time stands still."""
    if missing == 0:
        return slews

    def pad(x: Array, mode: Literal["constant", "edge"]) -> Array:
        width = [(0, 0), (0, missing)] + [(0, 0)] * (x.ndim - 2)
        return jnp.asarray(np.pad(np.asarray(x), width, mode=mode))

    context = slews.context._replace(
        step=pad(slews.context.step, "constant"),
        time=pad(slews.context.time, "edge"),
        torque=pad(slews.context.torque, "edge"),
    )
    return slews._replace(
        context=context,
        momentum=pad(slews.momentum, "edge"),
        environment=Environment(*(pad(x, "edge") for x in slews.environment)),
    )
