"""Objects that hold arrays: `==` gives a bool, and no caller's array changes them afterwards."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import inspect
import pickle
import pkgutil
import re
from collections.abc import Iterator
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import bayes_inertia
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.flight.spacecraft import Controller, Spacecraft
from bayes_inertia.inference.likelihood import Point
from bayes_inertia.inference.posterior import FORMAT, Posterior
from bayes_inertia.maths.values import array_dataclass, equal
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_context import SlewContext, State, Trajectory
from bayes_inertia.physics.small_campaign import small_campaign


def classes() -> Iterator[type]:
    """Every class that a module of the package defines."""
    for info in pkgutil.walk_packages(bayes_inertia.__path__, "bayes_inertia."):
        module = importlib.import_module(info.name)
        yield from (
            c
            for c in vars(module).values()
            if isinstance(c, type) and c.__module__ == module.__name__
        )


def holds_arrays(cls: type, holders: set[str]) -> bool:
    """Whether a field's annotation names an array, or a named tuple that holds one."""
    words = re.compile(rf"\b({'|'.join({'ndarray', 'Array', *holders})})\b")
    return any(words.search(str(hint)) for hint in inspect.get_annotations(cls).values())


def array_holders() -> list[type]:
    """The dataclasses of the package that hold arrays themselves, not inside another dataclass."""
    tuples = [c for c in classes() if issubclass(c, tuple) and hasattr(c, "_fields")]
    holders: set[str] = set()
    while more := {c.__name__ for c in tuples if holds_arrays(c, holders)} - holders:
        holders |= more
    return [c for c in classes() if dataclasses.is_dataclass(c) and holds_arrays(c, holders)]


def filled(cls: type, value: float) -> object:
    """An object whose every field holds an array, made without the checks of the class."""
    made = object.__new__(cls)
    for field in dataclasses.fields(cls):
        object.__setattr__(made, field.name, np.array([value, np.nan]))
    return made


@pytest.mark.parametrize("cls", array_holders(), ids=lambda c: c.__qualname__)
def test_comparing_objects_that_hold_arrays_gives_a_bool(cls):
    first, same, different = filled(cls, 1.0), filled(cls, 1.0), filled(cls, 2.0)
    assert (first == different) is False
    assert (first == object()) is False
    if cls.__eq__ is not object.__eq__:  # Otherwise the identity alone counts.
        assert (first == same) is True
        assert hash(first) == hash(same)


def test_the_list_of_classes_is_not_empty():
    names = {c.__name__ for c in array_holders()}
    assert {"Slew", "InertiaPrior", "Spacecraft", "Flight", "Estimate", "Chains"} <= names


def caller_arrays() -> dict[str, np.ndarray]:
    return {
        "tensor": np.diag([3.0, 2.0, 2.0]),
        "axes": np.eye(3),
        "time": np.arange(4.0),
        "rate": np.zeros((4, 3)),
        "gain": np.ones(3),
    }


def spacecraft_with_values(gain: np.ndarray) -> Spacecraft:
    values = {"wheel_torque_gain": {"gain": gain}}
    sensor = RateSensor(sigma=1e-5)
    return Spacecraft(np.eye(3), (1.0, 1.0, 1.0), (), sensor, values=values)


def objects(arrays: dict[str, np.ndarray]) -> list[object]:
    """What users build from their own arrays."""
    sensor = RateSensor(sigma=1e-5, axes=arrays["axes"])
    return [
        InertiaPrior(arrays["tensor"], 0.04, 0.03),
        sensor,
        Slew("a", 0.0, arrays["time"], rate=arrays["rate"]),
        Spacecraft(arrays["tensor"], (1.0, 1.0, 1.0), (), sensor, None, (0.0, 0.0, 0.0)),
        Controller(arrays["tensor"]),
        spacecraft_with_values(arrays["gain"]),
        Point(arrays["gain"], arrays["gain"], arrays["rate"]),
    ]


def test_changing_the_callers_array_does_not_change_the_object():
    arrays = caller_arrays()
    made = objects(arrays)
    for array in arrays.values():
        array += 1e-3
    assert made == objects(caller_arrays())


def test_arrays_of_an_object_are_read_only():
    slew = Slew("a", 0.0, np.arange(4.0), rate=np.zeros((4, 3)))
    with pytest.raises(ValueError, match="read-only"):
        slew.rate[0, 0] = 1.0


def test_replacing_one_field_shares_the_other_arrays():
    slew = Slew("a", 0.0, np.arange(4.0), rate=np.zeros((4, 3)))
    assert dataclasses.replace(slew, name="b").rate is slew.rate


@pytest.mark.slow
@array_dataclass
class Holder:
    """What a field may hold."""

    content: object


numbers = hnp.arrays(float, hnp.array_shapes(max_dims=2, max_side=3))


@given(content=st.recursive(numbers, lambda inner: st.lists(inner) | st.tuples(inner, inner)))
def test_copies_are_equal_and_hash_alike(content):
    first, second = Holder(content), Holder(content)
    assert (first == second) is True
    assert hash(first) == hash(second)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (np.zeros(2), jnp.zeros(2), True),
        (np.zeros(2), np.zeros(3), False),
        (np.zeros(1), 0.0, False),
        ({"a": np.array([np.nan])}, {"a": np.array([np.nan])}, True),
        ({"a": np.zeros(2)}, {"b": np.zeros(2)}, False),
        (float("nan"), float("nan"), True),
        ((1, np.zeros(2)), [1, np.zeros(2)], False),
        (np.array(["x"]), np.array(["x"]), True),
        (None, np.zeros(2), False),
    ],
)
def test_equality_of_fields(first, second, expected):
    assert equal(first, second) is expected


def test_copies_and_pickles_leave_out_what_was_worked_out():
    @array_dataclass
    class Fit:
        content: object

        @cached_property
        def compiled(self):
            return lambda: None

    assert copy.deepcopy(Holder(np.ones(2))) == Holder(np.ones(2))
    fit = Fit(np.ones(2))
    assert fit.compiled is fit.compiled
    assert copy.copy(fit).compiled is not fit.compiled


def test_a_model_is_equal_to_its_copy():
    model = Model(small_campaign())
    again = pickle.loads(pickle.dumps(model))
    assert again == model
    assert hash(again) == hash(model)
    assert Model(small_campaign(), drive="measured") != model


def test_a_view_of_the_callers_array_is_copied():
    owner = np.zeros(3)
    view = owner[:2]
    view.flags.writeable = False
    kept = Holder(view)
    owner[0] = 1.0
    assert kept == Holder(np.zeros(2))


def test_a_tree_of_data_stays_a_tree():
    # A DataTree is a mapping, but no dictionary: copied as one it would lose its attributes.
    tree = xr.DataTree.from_dict({"/posterior": xr.Dataset({"Jxx": ("draw", np.zeros(3))})})
    tree.attrs["format"] = FORMAT
    assert Posterior(tree).tree is tree


def test_trees_of_data_compare_as_a_whole():
    def tree(value):
        return Holder(xr.DataTree.from_dict({"a": xr.Dataset({"x": ("i", [value, np.nan])})}))

    assert (tree(1.0) == tree(1.0)) is True
    assert (tree(1.0) == tree(2.0)) is False
    assert hash(tree(1.0)) == hash(tree(1.0))


@pytest.mark.parametrize("cls", [SlewContext, State, Trajectory])
def test_named_tuples_of_arrays_compare_as_a_whole(cls):
    def one(value):
        return cls(*(jnp.array([value, np.nan]) for _ in cls._fields))

    assert (one(1.0) == one(1.0)) is True
    assert (one(1.0) != one(1.0)) is False
    assert (one(1.0) == one(2.0)) is False
    assert (one(1.0) != one(2.0)) is True
    assert (one(1.0) == tuple(one(1.0))) is False
    assert hash(one(1.0)) == hash(one(1.0))
    doubled = jax.jit(lambda x: jax.tree.map(lambda a: 2.0 * a, x))(one(1.0))
    assert doubled == one(2.0)
