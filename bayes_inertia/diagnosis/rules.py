"""The thresholds by which a diagnosis decides: when an effect is named, and when nothing is."""

from __future__ import annotations

from dataclasses import dataclass, fields

from bayes_inertia.errors import SettingsError

_PROBABILITY_FIELDS = ("false_alarm_probability", "misfit_p_value")
_SHARE_FIELDS = ("refit_share", "imitation_correlation")
_COUNT_FIELDS = ("max_refits", "max_effects", "max_alternatives")


@dataclass(frozen=True)
class Rules:
    """The thresholds of the search.

    Parameters
    ----------
    false_alarm_probability : float
        Probability of naming anything in a campaign without hidden effect. At 2 % the
        interval of a study of 200 campaigns stays below 5 %.
    max_refits : int
        Candidates that are refitted in one round of the search, at most.
    refit_share : float
        A candidate is refitted only if its first-order log evidence is at least this share
        of the best one's.
    max_effects : int
        Effects that can be named, at most.
    max_alternatives : int
        Effects that one step of the search keeps beside the one it adds, at most.
    log_evidence_margin : float
        Log evidence by which the best effect must beat another that could imitate it, and by
        which a disturbance without a name must beat the effects named.
    imitation_correlation : float
        Canonical correlation with the best effect above which another counts as an imitation.
        At 0.6: where an ideal test finds an effect in 99 % of campaigns, an effect that is
        less alike wins by chance in less than 1 %.
    misfit_p_value : float
        p-value of the final residuals below which the data are not explained.
    prior_sd_at_most : float
        A parameter of an effect that lies further than this from where it does nothing [prior sd]
        is beyond its prior, which is then widened and the effect fitted again. A prior that is
        right is exceeded in one parameter of 16,000.
    evidence_temperature : float
        What log evidences are divided by where probabilities are stated.

    Raises
    ------
    SettingsError
        If a threshold is outside its range.

    Examples
    --------
    >>> Rules(max_effects=2).log_evidence_margin
    3.0
    >>> Rules(false_alarm_probability=2.0)
    Traceback (most recent call last):
    ...
    bayes_inertia.errors.SettingsError: false_alarm_probability: 2.0 is not between 0 and 1; ...
    """

    false_alarm_probability: float = 0.02
    max_refits: int = 6
    refit_share: float = 0.3
    max_effects: int = 4
    max_alternatives: int = 2
    log_evidence_margin: float = 3.0
    imitation_correlation: float = 0.6
    misfit_p_value: float = 1e-4
    prior_sd_at_most: float = 4.0
    evidence_temperature: float = 1.0

    def __post_init__(self) -> None:
        for field in fields(self):
            _check(field.name, getattr(self, field.name))


def _check(name: str, value: float) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SettingsError(f"{value!r} is not a number", where=name, advice="give a number")
    if name in _PROBABILITY_FIELDS and not 0.0 < value < 1.0:
        raise SettingsError(
            f"{value} is not between 0 and 1",
            where=name,
            advice=f"give a probability, such as {getattr(Rules, name)}",
        )
    if name in _SHARE_FIELDS and not 0.0 <= value <= 1.0:
        raise SettingsError(
            f"{value} is not from 0 to 1",
            where=name,
            advice=f"give a share, such as {getattr(Rules, name)}",
        )
    if name in _COUNT_FIELDS and not (isinstance(value, int) and value >= (name == "max_refits")):
        raise SettingsError(
            f"{value} is no such count",
            where=name,
            advice="give a whole number: 1 or more refits, 0 or more effects and alternatives",
        )
    if name == "prior_sd_at_most" and not value > 0.0:
        raise SettingsError(
            f"{value} is no distance", where=name, advice="give a positive number of prior sds"
        )
    if name == "evidence_temperature" and not 1.0 <= value < float("inf"):
        raise SettingsError(
            f"{value} is no temperature",
            where=name,
            advice="give 1 (evidences as they are) or more",
        )
    if name == "log_evidence_margin" and not 0.0 <= value < float("inf"):
        raise SettingsError(
            f"{value} is no margin",
            where=name,
            advice="give 0 or more; 3 is evidence of 20 to 1",
        )
