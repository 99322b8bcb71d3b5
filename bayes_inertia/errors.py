"""Exceptions: every one says what is wrong, where, and what to do about it."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from importlib import import_module
from types import NoneType
from typing import Any, get_args


class BayesInertiaError(Exception):
    """Base of all errors a user can cause or must know of.

    Parameters
    ----------
    what : str
        What is wrong, one sentence.
    where : str
        The file, line or key that it concerns; may be empty.
    advice : str
        What to do about it; may be empty.

    Examples
    --------
    >>> str(BayesInertiaError("no such column", where="slew_01.csv", advice="name another"))
    'slew_01.csv: no such column; name another'
    """

    def __init__(self, what: str, *, where: str = "", advice: str = ""):
        self.what, self.where, self.advice = what, where, advice
        super().__init__(f"{where + ': ' if where else ''}{what}{'; ' + advice if advice else ''}")

    def inside(self, place: str) -> BayesInertiaError:
        """The same error with another place written before where it happened.

        Parameters
        ----------
        place : str
            A file, say.

        Returns
        -------
        BayesInertiaError
            Of the same kind.

        Examples
        --------
        >>> str(BayesInertiaError("not positive", where="sigma").inside("campaign.toml"))
        'campaign.toml, sigma: not positive'
        """
        where = f"{place}, {self.where}" if self.where else place
        return type(self)(self.what, where=where, advice=self.advice)


class CampaignError(BayesInertiaError):
    """The campaign (its description or its telemetry) cannot be used as it is."""


class EffectError(BayesInertiaError):
    """An effect breaks its contract, is unknown, or needs data that the campaign lacks."""


class OutputError(BayesInertiaError):
    """A result cannot be written, or would overwrite a result of other data."""


class EstimateError(BayesInertiaError):
    """The optimizer found no usable estimate; `advice` says what usually helps."""


class DesignError(BayesInertiaError):
    """No plan keeps what was asked; the error says which limit binds and by how much."""


class SettingsError(BayesInertiaError):
    """A setting has a value that it cannot have; `where` names the setting."""


class StudyError(BayesInertiaError):
    """A study cannot go on as it is: its workers or its scheduler are lost, or all tasks failed."""


def require(
    condition: bool,
    where: str,
    what: str,
    advice: str,
    *,
    error: type[BayesInertiaError] = CampaignError,
) -> None:
    """Raise `CampaignError`, or another `error`, unless a condition holds."""
    if not condition:
        raise error(what, where=where, advice=advice)


def kind_of(value: Any) -> str:
    """What a value is, as messages call it.

    >>> kind_of(3), kind_of("x")
    ('an int', 'a str')
    """
    return with_article(type(value).__name__)


def with_article(name: str) -> str:
    """The name of a kind with "a" or "an"; capitals are spoken letter by letter.

    >>> with_article("Estimate"), with_article("Plan"), with_article("RDM")
    ('an Estimate', 'a Plan', 'an RDM')
    """
    vowels = "AEFHILMNORSX" if name.isupper() else "AEIOaeio"
    return f"an {name}" if name.startswith((*vowels, "nd")) else f"a {name}"


def is_one_of(value: Any, words: Container[str]) -> bool:
    """Whether a value is one of some words: an array, for one, is none."""
    return isinstance(value, str) and value in words


def require_kind(
    value: Any,
    kind: Any,
    where: str,
    advice: str = "",
    *,
    error: type[BayesInertiaError] = CampaignError,
) -> None:
    """Raise `CampaignError`, or another `error`, unless a value is of a kind, or one of several.

    >>> require_kind("no", bool, "as_stated")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: as_stated: a str is no bool; give a bool
    """
    kinds = [each.__name__ for each in get_args(kind) or (kind,) if each is not NoneType]
    names = " or ".join(dict.fromkeys(kinds))
    what, advice = f"{kind_of(value)} is no {names}", advice or f"give {with_article(names)}"
    require(isinstance(value, kind), where, what, advice, error=error)


def members(
    given: Any, kind: Any, where: str, *, error: type[BayesInertiaError] = CampaignError
) -> tuple[Any, ...]:
    """What is listed, all of one kind, or `CampaignError` or another; of a dictionary its pairs.

    >>> members("Jxx", str, "names")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: names: a str is no list; give a tuple, of a single one ...
    """
    listed = isinstance(given, Iterable) and not isinstance(given, str)
    advice = "give a tuple, of a single one too: (one,)"
    require(listed, where, f"{kind_of(given)} is no list", advice, error=error)
    found = tuple(given.items() if isinstance(given, Mapping) else given)
    for member in found:
        require_kind(member, kind, where, error=error)
    return found


def library_of_extra(
    name: str,
    extra: str,
    *,
    where: str = "",
    otherwise: str = "",
    error: type[BayesInertiaError] = CampaignError,
) -> Any:
    """A module of an extra of this package; where it is absent the error names the extra."""
    try:
        return import_module(name)
    except ImportError:
        advice = f"pip install 'bayes-inertia[{extra}]'{', or ' if otherwise else ''}{otherwise}"
        what = f"needs the package {name.partition('.')[0]}, which is not installed"
        raise error(what, where=where, advice=advice) from None
