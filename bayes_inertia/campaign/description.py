"""From the text of `campaign.toml` to its checked content, with errors that name the key."""

from __future__ import annotations

from bayes_inertia.campaign.checked_toml import parse_toml
from bayes_inertia.campaign.consistency import check_consistency
from bayes_inertia.campaign.schema import CampaignPart


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
