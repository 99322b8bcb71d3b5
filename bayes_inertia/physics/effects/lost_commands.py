"""Torque commands that were not recorded: each lost one is unknown and integrated out."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from bayes_inertia.physics.random_basis import independent
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class LostCommands(StochasticEffect):
    """In every gap of the commands each wheel has an unknown torque beside what is guessed there.

    A model takes this effect by itself where its campaign has such gaps (`Slew.lost_command`). The
    unknown torque is constant over a piece of a gap; its sd is that of `Slew.lost_command_sd`.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> LostCommands().coefficient_count(small_campaign())
    0
    """

    name = "lost_commands"

    def coefficient_count(self, campaign):
        lost = (slew.lost_command for slew in campaign.slews)
        pieces = [0 if rows is None else int(np.max(rows)) for rows in lost]
        return max(pieces) * len(campaign.wheels)

    def coefficient_root(self, p, slew, count):
        return independent(1.0, count)

    def delivered_torque(self, p, slew, torque):
        if slew.lost_command is None or not p["coefficients"].shape[0]:
            return torque
        pieces = p["coefficients"].reshape(-1, torque.shape[1])
        # Where nothing was lost the sd is zero.
        return torque + slew.lost_command_sd * pieces[jnp.maximum(slew.lost_command - 1, 0)]
