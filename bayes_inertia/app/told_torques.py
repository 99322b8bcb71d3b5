"""The conventions check with what devices and named effects do to the body."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.conventions.check import ConventionsCheck
from bayes_inertia.conventions.check import check_conventions as checked
from bayes_inertia.conventions.check import refuse_impossible as refused
from bayes_inertia.conventions.reading import ToldTorque


def check_conventions(campaign: Campaign | str | Path, *, quick: bool = False) -> ConventionsCheck:
    """Hold a campaign's conventions against physics, before any fit.

    Closure of rotation, conservation of momentum and the drive of the wheels are laws that data
    obey whatever J and K are. Where they are grossly broken, every mistake in units, signs, orders
    and frames is undone in turn; the one that mends all laws is proposed. Nothing is changed.

    Parameters
    ----------
    campaign : Campaign, str or Path
        A campaign, or its folder.
    quick : bool, optional
        Whether to leave out what does not bear on the verdict: what the data cannot show, and dirt.

    Returns
    -------
    ConventionsCheck
        The verdict and what it rests on.

    Raises
    ------
    CampaignError
        If the folder cannot be read.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> check_conventions(small_campaign()).verdict
    'consistent'
    """
    return checked(campaign, torques_of, quick=quick)


def refuse_impossible(campaign: Path, effects: Sequence[str] = ()) -> ConventionsCheck:
    """Raise an error if data are impossible as stated, whatever devices and named effects do."""
    return refused(campaign, partial(torques_of, effects=effects))


def torques_of(campaign: Campaign, effects: Sequence[str] = ()) -> dict[str, ToldTorque]:
    """What the campaign's devices and a user's own effects do to the body, by the name of a slew.

    Effects of the library are no larger than what the laws allow for undisclosed physics.
    `effects`: names, see `effects_named`.
    """
    own = any(":" in name for name in effects)
    if not own and not campaign.actuators:
        return {}
    # Physics takes seconds to load.
    from bayes_inertia.physics.actuators import effects_of
    from bayes_inertia.physics.named_effects import effects_named
    from bayes_inertia.physics.told_torques import told_torques

    named = effects_named(effects) if own else ()
    told = told_torques(campaign, (*effects_of(campaign), *named))
    return {slew: ToldTorque(*parts) for slew, parts in told.items()}
