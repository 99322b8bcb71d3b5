"""From the text of `campaign.toml` to its checked content, with errors that name the key.

What keys of `campaign.toml` demand of each other; each key alone is checked by its type.
"""

from __future__ import annotations

from typing import NoReturn

from bayes_inertia.campaign.checked_toml import parse_toml
from bayes_inertia.campaign.schema import CampaignPart, SlewPart
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
    check_consistency(parsed, label)
    return parsed


_WHEEL_KEYS = ("wheel_torque", "wheel_momentum", "wheel_speed")


def check_consistency(campaign: CampaignPart, label: str) -> None:
    """Refuse entries that contradict each other or the hardware."""
    _check_wheels(campaign, label)
    given = campaign.columns.given()
    if "attitude" in given and campaign.star_tracker is None:
        _refuse(
            label,
            "columns.attitude",
            "attitude columns without a star tracker",
            "add [star_tracker] with its sigmas, or leave the columns out",
        )
    for slew in campaign.slews:
        _check_files(slew, campaign, label)
        _check_names(slew, campaign, label)


def _refuse(label: str, key: str, what: str, advice: str) -> NoReturn:
    raise CampaignError(what, where=f"{label}, key {key}", advice=advice)


def _check_wheels(campaign: CampaignPart, label: str) -> None:
    """One measurement of the wheels, one column a wheel."""
    given = campaign.columns.given()
    if "wheel_momentum" in given and "wheel_speed" in given:
        _refuse(
            label,
            "columns.wheel_speed",
            "wheel_momentum is given too",
            "keep one of the two, they are the same measurement",
        )
    for key in _WHEEL_KEYS:
        if key in given and len(given[key].names) != len(campaign.wheels):
            _refuse(
                label,
                f"columns.{key}.names",
                f"{len(given[key].names)} column(s) for {len(campaign.wheels)} [[wheels]]",
                "name one column a wheel, in the same order",
            )


def _check_files(slew: SlewPart, campaign: CampaignPart, label: str) -> None:
    """Either `file` or `files`, and only tables of entries that `[columns]` has."""
    place = f"slews.{slew.name}"
    if slew.file is None and slew.files is None:
        advice = 'add file = the table of the slew, such as "slew_01.csv"'
        _refuse(label, f"{place}.file", "missing key", f"{advice}, or files = {{ rate = ... }}")
    if slew.file is not None and slew.files is not None:
        _refuse(
            label,
            f"{place}.files",
            "file is given too",
            "keep file (one table) or files (one table for each entry of [columns])",
        )
    for key in () if slew.files is None else type(slew.files).model_fields:
        if slew.file_of(key) is not None and key not in campaign.columns.given():
            _refuse(
                label,
                f"{place}.files.{key}",
                f"[columns] has no {key}",
                f"say under columns.{key} which columns hold it",
            )


def _check_names(slew: SlewPart, campaign: CampaignPart, label: str) -> None:
    """In one table each column has one meaning; only columns of time may be shared."""
    used: dict[tuple[str | None, str], str] = {}
    times: dict[tuple[str | None, str], str] = {}
    columns = campaign.columns
    for key, entry in columns.given().items():
        if key == "time":
            continue
        file = slew.file_of(key)
        own = entry.time is not None
        clock = entry.time if own else columns.time
        times[file, clock.names[0]] = f"{key}.time" if own else "time"
        for name in entry.names:
            if (file, name) in used:
                _refuse(
                    label,
                    f"columns.{key}.names",
                    f"the column {name!r} is already used by {used[file, name]}",
                    "name each column once",
                )
            used[file, name] = key
    for place, key in times.items():
        if place in used:
            _refuse(
                label,
                f"columns.{used[place]}.names",
                f"the column {place[1]!r} is already used by {key}",
                "name each column once",
            )
