"""Frozen dataclasses that hold arrays: safe to compare, and independent of the caller's arrays.

A plain frozen dataclass compares its fields with `==`, and numpy then raises "the truth value of an
array is ambiguous". It also keeps the very array it is given: what the caller changes later changes
inside the object. `attrs` mends both field by field (`cmp_using`, `converter`); here one decorator
does it for all fields, so that no field can be forgotten. `json_ready` turns values into what a
JSON file holds.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from datetime import UTC, datetime
from typing import Any, dataclass_transform

import numpy as np

from bayes_inertia.errors import (
    BayesInertiaError,
    CampaignError,
    SettingsError,
    require,
    require_kind,
)

# Three numbers along body axes, as plain floats: such a field can be hashed and compared.
Vector = tuple[float, float, float]
# A numpy array on the host, a JAX array inside compiled code.
AnyArray = Any


@dataclass_transform(frozen_default=True)
def array_dataclass[T](cls: type[T]) -> type[T]:
    """Make a frozen dataclass that may hold arrays.

    The object copies numpy arrays once, after its own `__post_init__`, and makes its copies
    read-only. An array that nobody can write to is taken as it is. Arrays in dictionaries,
    lists and tuples are treated alike.

    Two objects are equal if they have one class and equal fields. Arrays are equal if their shapes
    and values are; NaN equals NaN. Equal objects have equal hashes. Copies and pickles work out
    anew what was cached.

    `cls`: the class, with annotated fields as `dataclasses.dataclass` wants them.

    Examples
    --------
    >>> @array_dataclass
    ... class Reading:
    ...     rate: np.ndarray
    >>> rate = np.array([0.1, np.nan])
    >>> reading = Reading(rate)
    >>> rate[0] = 9.0
    >>> reading == Reading(np.array([0.1, np.nan]))
    True
    """
    check: Callable[..., None] | None = getattr(cls, "__post_init__", None)

    def __post_init__(self: Any, *init_only: Any) -> None:
        if check is not None:
            check(self, *init_only)
        for field in fields(self):
            given = getattr(self, field.name)
            kept = frozen(given)
            if kept is not given:
                object.__setattr__(self, field.name, kept)

    for name, method in (
        ("__post_init__", __post_init__),
        ("__eq__", _same_class_and_fields),
        ("__hash__", _hash_of_fields),
        ("__getstate__", _fields_alone),
    ):
        setattr(cls, name, method)
    return dataclass(frozen=True, eq=False)(cls)


def array_tuple[T: tuple[Any, ...]](cls: type[T]) -> type[T]:
    """Let a named tuple of arrays be compared as a whole.

    Two of them are equal as two of an `array_dataclass` are. Arrays are not copied: such tuples
    travel through compiled code.

    Examples
    --------
    >>> from typing import NamedTuple
    >>> @array_tuple
    ... class Reading(NamedTuple):
    ...     rate: np.ndarray
    >>> Reading(np.zeros(3)) == Reading(np.zeros(3)), Reading(np.zeros(3)) != Reading(np.ones(3))
    (True, True)
    """
    for name, method in (
        ("__eq__", equal),
        ("__ne__", lambda self, other: not equal(self, other)),
        ("__hash__", lambda self: hash((cls, _hashable(tuple(self))))),
    ):
        setattr(cls, name, method)
    return cls


def _same_class_and_fields(self: Any, other: object) -> bool:
    """Whether two objects have one class and equal fields."""
    if self is other:
        return True
    if type(self) is not type(other):
        return NotImplemented
    own_class: Any = type(self)
    names = [field.name for field in fields(own_class) if field.compare]
    return all(equal(getattr(self, name), getattr(other, name)) for name in names)


def _hash_of_fields(self: Any) -> int:
    """A hash that equal objects share."""
    compared = (f.name for f in fields(self) if f.compare)
    return hash((type(self), *(_hashable(getattr(self, name)) for name in compared)))


def _fields_alone(self: Any) -> dict[str, Any]:
    """What a copy or a file keeps: not what was worked out of it, such as compiled code."""
    return {field.name: getattr(self, field.name) for field in fields(self)}


def frozen(given: Any) -> Any:
    """A copy that nobody else can change.

    `given`: an array of numpy, or a dictionary, list or tuple (named or not) of such. Returns:
    read-only copies of writeable arrays, in new containers; anything else as it is.

    Examples
    --------
    >>> frozen(np.zeros(2)).flags.writeable
    False
    """
    if isinstance(given, np.ndarray):
        return _frozen_array(given)
    if isinstance(given, tuple):
        kept = tuple(frozen(x) for x in given)
        if all(new is old for new, old in zip(kept, given, strict=True)):
            return given
        return type(given)._make(kept) if hasattr(given, "_make") else kept
    if isinstance(given, list):
        return [frozen(x) for x in given]
    if isinstance(given, dict):
        return {key: frozen(x) for key, x in given.items()}
    return given


def _frozen_array(given: np.ndarray) -> np.ndarray:
    """The array itself if nobody can write to it, else a read-only copy of the same layout."""
    owner: Any = given
    while isinstance(owner, np.ndarray) and not owner.flags.writeable:
        owner = owner.base
    if owner is None or _is_jax_array(owner):
        return given
    copy = given.copy(order="K")
    copy.flags.writeable = False
    return copy


def equal(first: Any, second: Any) -> bool:
    """Whether two fields are equal, as one bool.

    Returns: true if types of containers, shapes and values are the same; NaN equals NaN.

    Examples
    --------
    >>> equal((np.array([1.0, np.nan]), "a"), (np.array([1.0, np.nan]), "a"))
    True
    """
    if first is second:
        return True
    if _is_array(first) or _is_array(second):
        return _is_array(first) and _is_array(second) and _equal_arrays(first, second)
    if hasattr(first, "identical"):  # xarray's word: its `==` compares element by element.
        return type(first) is type(second) and bool(first.identical(second))
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return first.keys() == second.keys() and all(equal(first[k], second[k]) for k in first)
    if isinstance(first, tuple | list):
        same_form = type(first) is type(second) and len(first) == len(second)
        return same_form and all(equal(x, y) for x, y in zip(first, second, strict=True))
    if isinstance(first, float) and isinstance(second, float) and math.isnan(first):
        return math.isnan(second)
    return bool(first == second)


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) or _is_jax_array(value)


def _is_jax_array(value: Any) -> bool:
    # Whoever holds an array of JAX has imported it; this module must not, because it takes long.
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(value, jax.Array)


def _equal_arrays(first: Any, second: Any) -> bool:
    first, second = np.asarray(first), np.asarray(second)
    numbers = all(x.dtype.kind in "fc" for x in (first, second))
    return bool(np.array_equal(first, second, equal_nan=numbers))


def _hashable(value: Any) -> Any:
    """What equal fields have in common and is quick to hash: of an array its shape."""
    if _is_array(value):
        return np.shape(value)
    if hasattr(value, "identical"):
        return type(value)
    if isinstance(value, Mapping):
        return frozenset(value)
    if isinstance(value, tuple | list):
        return tuple(_hashable(x) for x in value)
    if isinstance(value, float) and math.isnan(value):
        return "nan"
    return hash(value)


def plain_array(
    value: Any, where: str, advice: str = "", error: type[BayesInertiaError] = CampaignError
) -> np.ndarray:
    """An array of whatever holds numbers or dates: NaN where it is masked, never with a unit.

    Dates of astropy are UTC; `NA` of pandas is NaN.

    >>> plain_array(np.ma.masked_equal([1, 9], 9), "rate").tolist()
    [1.0, nan]
    """
    value = _of_astropy(value, where, error)
    first = value
    while isinstance(first, list | tuple) and first:
        first = first[0]
    # Of astropy or pint; numpy would take what is in degrees for a plain number.
    units = (getattr(first, key, None) for key in ("unit", "units"))
    has_unit = hasattr(first, "to") and any(unit is not None for unit in units)
    how = "x.to_value('rad/s') of astropy, x.m_as('rad/s') of pint"
    plain = f"give plain numbers in SI units and radians, such as {how}"
    require(not has_unit, where, "it carries a unit", plain, error=error)
    try:
        if not isinstance(first, np.ma.MaskedArray):
            return _without_missing(np.asarray(value))
        masked: Any = np.ma.asarray(value)
        if masked.dtype.kind in "mM":
            return masked.filled(np.array("NaT", masked.dtype))
        return masked.astype(np.result_type(masked, float)).filled(np.nan)
    except (TypeError, ValueError) as reason:
        raise error(f"no array of numbers ({reason})", where=where, advice=advice) from None


def _of_astropy(value: Any, where: str, error: type[BayesInertiaError]) -> Any:
    """Dates of astropy, also one by one, as numpy's in UTC, and their differences as seconds."""
    # Whoever holds one has imported astropy, which the package does not need.
    library: Any = sys.modules.get("astropy.time")
    if not hasattr(library, "TimeDelta"):  # Absent, or just being imported in another thread.
        return value
    if isinstance(value, list | tuple):
        return [_of_astropy(member, where, error) for member in value]
    if isinstance(value, library.TimeDelta):
        return np.where(value.mask, np.nan, np.asarray(value.to_value("sec")))
    if not isinstance(value, library.Time):
        return value
    what, advice = "its scale is local, which has no zone", "give its UTC: Time(..., scale='utc')"
    require(value.scale != "local", where, what, advice, error=error)
    return np.where(value.mask, np.datetime64("NaT", "ns"), np.asarray(value.utc.datetime64))


def _without_missing(array: np.ndarray) -> np.ndarray:
    """The array with NaN for the `NA` of pandas."""
    pandas: Any = sys.modules.get("pandas")
    if array.dtype.kind != "O" or not hasattr(pandas, "NA"):
        return array
    missing = np.array([x is pandas.NA for x in array.ravel()], bool).reshape(array.shape)
    return np.where(missing, np.nan, array)


def moments(value: Any, where: str, advice: str = "") -> np.ndarray:
    """As `plain_array`; dates of any kind are numpy's, in UTC.

    >>> moments([datetime(2026, 1, 1, 12, tzinfo=UTC), None], "time").astype("M8[h]").tolist()
    [datetime.datetime(2026, 1, 1, 12, 0), None]
    """
    array = plain_array(value, where, advice)
    if array.dtype.kind == "O":
        # Of pandas, with a time zone, or Python's own.
        dates = [_utc(moment) for moment in array.ravel()]
        if any(date is not None for date in dates):
            array = np.array(dates, "datetime64[us]").reshape(array.shape)
    if array.dtype.kind != "M":
        return array
    years = array.astype("datetime64[Y]")
    kept = (years >= np.datetime64("1678")) & (years <= np.datetime64("2261"))
    advice = advice or "give dates that nanoseconds can count"
    in_reach = bool((kept | np.isnat(years)).all())
    require(in_reach, where, "a date is before 1678 or after 2261", advice)
    return array.astype("datetime64[ns]")


def _utc(moment: Any) -> np.datetime64 | None:
    """A datetime as numpy's, in UTC; None for what is no datetime."""
    if not isinstance(moment, datetime):
        return None
    if moment != moment:  # The NaT of pandas.
        return np.datetime64("NaT", "ns")
    aware = moment if moment.tzinfo is None else moment.astimezone(UTC).replace(tzinfo=None)
    return np.datetime64(aware)


# What numpy, or Python's `float`, would make numbers of.
_NO_NUMBERS = (("dates", "mM", datetime), ("texts", "US", str), ("complex numbers", "c", complex))


def numbers(
    value: Any, where: str, advice: str, error: type[BayesInertiaError] = CampaignError
) -> np.ndarray:
    """Floats of whatever holds real numbers, or an `error`.

    >>> numbers([1, None], "rate", "").tolist()
    [1.0, nan]
    """
    given = plain_array(value, where, advice, error)
    members = given.ravel().tolist() if given.dtype.kind == "O" else ()
    for name, kinds, kind in _NO_NUMBERS:
        found = given.dtype.kind in kinds or any(isinstance(x, kind) for x in members)
        require(not found, where, f"no array of numbers, but of {name}", advice, error=error)
    try:
        return given.astype(float, copy=False)
    except (TypeError, ValueError) as reason:
        raise error(f"no array of numbers ({reason})", where=where, advice=advice) from None


def require_flags(**given: Any) -> None:
    """Raise `SettingsError` for what is neither true nor false, by its name.

    >>> require_flags(as_stated="no")
    Traceback (most recent call last):
    bayes_inertia.errors.SettingsError: as_stated: a str is no bool; give True or False
    """
    for name, value in given.items():
        require_kind(value, bool | np.bool_, name, "give True or False", error=SettingsError)


def whole_number(value: Any, where: str, least: int = 0) -> int:
    """A whole number as Python's own, also of numpy's; `SettingsError` for anything else.

    >>> whole_number(np.int64(3), "seed")
    3
    """
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least:
        advice = f"give a whole number, {least} or more"
        raise SettingsError(f"is {value!r}", where=where, advice=advice)
    return int(value)


def picked(value: Any, *names: str) -> dict[str, Any]:
    """Attributes of an object by their names, as a JSON file holds them.

    Examples
    --------
    >>> picked(3 + 4j, "real", "imag")
    {'real': 3.0, 'imag': 4.0}
    """
    return {name: json_ready(getattr(value, name)) for name in names}


def by_name(names: Iterable[str], **columns: Any) -> dict[str, dict[str, Any]]:
    """The rows of a table by their names, as a JSON file holds them.

    `columns`: by key, each with a value a row.

    Examples
    --------
    >>> by_name(["Jxx", "K1"], mean=np.array([3.3, 1.0]), unit=["kg m^2", ""])
    {'Jxx': {'mean': 3.3, 'unit': 'kg m^2'}, 'K1': {'mean': 1.0, 'unit': ''}}
    """
    rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
    return {name: json_ready(row) for name, row in zip(names, rows, strict=True)}


def json_ready(value: Any) -> Any:
    """A value with Python's own types, and None for what is not finite.

    `value`: numbers, texts, or dicts, dataclasses, lists, tuples and arrays of such.

    Examples
    --------
    >>> json_ready({"sd": np.array([1.5, np.inf]), "rank": np.int64(2)})
    {'sd': [1.5, None], 'rank': 2}
    """
    if isinstance(value, dict):
        return {str(key): json_ready(item) for key, item in value.items()}
    if is_dataclass(value):
        return {field.name: json_ready(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, list | tuple | np.ndarray):
        return [json_ready(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
