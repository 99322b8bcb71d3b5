"""From the text of `campaign.toml` to its checked content, with errors that name the key."""

from __future__ import annotations

from bayes_inertia.campaign.checked_toml import parse_toml
from bayes_inertia.campaign.schema import CampaignPart
from bayes_inertia.errors import CampaignError


def parse_description(text: str, label: str) -> CampaignPart:
    """The content of a `campaign.toml`, every key checked.

    Parameters
    ----------
    text : str
        The content of the file.
    label : str
        The file, as messages name it.

    Returns
    -------
    CampaignPart
        What the file says.

    Raises
    ------
    CampaignError
        If it is no TOML (naming the line), or a key is unknown, missing, or of a wrong type or
        value (naming the key).

    Examples
    --------
    >>> parse_description('format = "bayes-inertia-campaign/1"\\nnmae = "x"', "campaign.toml")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: campaign.toml, key nmae: unknown key; did you mean "name"?
    """
    parsed = parse_toml(text, label, CampaignPart)
    _check_columns(parsed, label)
    return parsed


def _check_columns(campaign: CampaignPart, label: str) -> None:
    """Refuse entries of `[columns]` that contradict each other or the hardware."""

    def refuse(key: str, what: str, advice: str):
        raise CampaignError(what, where=f"{label}, key columns.{key}", advice=advice)

    given = campaign.columns.given()
    if "wheel_momentum" in given and "wheel_speed" in given:
        refuse(
            "wheel_speed",
            "wheel_momentum is given too",
            "keep one of the two, they are the same measurement",
        )
    for key in ("wheel_torque", "wheel_momentum", "wheel_speed"):
        if key in given and len(given[key].names) != len(campaign.wheels):
            refuse(
                f"{key}.names",
                f"{len(given[key].names)} column(s) for {len(campaign.wheels)} [[wheels]]",
                "name one column a wheel, in the same order",
            )
    if "attitude" in given and campaign.star_tracker is None:
        refuse(
            "attitude",
            "attitude columns without a star tracker",
            "add [star_tracker] with its sigmas, or leave the columns out",
        )
    used: dict[str, str] = {}
    for key, entry in given.items():
        for name in entry.names:
            if name in used:
                refuse(
                    f"{key}.names",
                    f"the column {name!r} is already used by {used[name]}",
                    "name each column once",
                )
            used[name] = key
