"""What effects that are named in a command tell the conventions check."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayes_inertia.conventions.motion import ToldTorque


def torques_of(campaign: Path, effects: Sequence[str]) -> dict[str, ToldTorque]:
    """What a user's own effects do to the body, by the name of a slew.

    Those of the library are no larger than what the laws allow for undisclosed physics.
    `effects`: names, see `effects_named`.
    """
    if not any(":" in name for name in effects):
        return {}
    # Physics takes seconds to load.
    from bayes_inertia.campaign.reader import read_campaign
    from bayes_inertia.physics.named_effects import effects_named
    from bayes_inertia.physics.told_torques import told_torques

    told = told_torques(read_campaign(campaign), effects_named(effects))
    return {slew: ToldTorque(*parts) for slew, parts in told.items()}
