"""Wheels of one type: `same_as` takes what one wheel of a mapping says for another."""

from __future__ import annotations

from typing import Any

from bayes_inertia.errors import CampaignError

_OF_TYPE = ("spin_inertia", "max_torque", "max_momentum", "momentum_sigma")


def with_alike_wheels(document: dict[str, Any], label: str) -> dict[str, Any]:
    """A mapping whose wheels all say themselves what `same_as` took from another.

    Parameters
    ----------
    document : dict
        The content of the mapping.
    label : str
        The file, as messages name it.

    Returns
    -------
    dict
        The content without the key.

    Raises
    ------
    CampaignError
        If `same_as` names no wheel above.

    Examples
    --------
    >>> wheels = [{"name": "x", "spin_inertia": 1e-3}, {"name": "y", "same_as": "x"}]
    >>> with_alike_wheels({"wheels": wheels}, "m.toml")["wheels"][1]["spin_inertia"]
    0.001
    """
    wheels = document.get("wheels")
    if not isinstance(wheels, list) or not all(isinstance(wheel, dict) for wheel in wheels):
        return document
    complete: list[dict[str, Any]] = []
    for wheel in wheels:
        own = dict(wheel)
        if "same_as" in own:
            other = own.pop("same_as")
            above = {before.get("name"): before for before in complete}
            if not isinstance(other, str) or other not in above:
                raise CampaignError(
                    f"{other!r} is no wheel above it",
                    where=f"{label}, key wheels.{own.get('name')}.same_as",
                    advice=f"name one of {', '.join(map(str, above)) or 'none: it is the first'}, "
                    "or give spin_inertia",
                )
            own = {k: v for k, v in above[other].items() if k in _OF_TYPE} | own
        complete.append(own)
    return document | {"wheels": complete}
