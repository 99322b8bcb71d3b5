"""The verdict is read off the probabilities of a table."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.diagnosis import table_search
from bayes_inertia.diagnosis.hypothesis_table import log_prior_of_set, posterior
from bayes_inertia.diagnosis.limits import Rules
from bayes_inertia.diagnosis.table_search import (
    RefittedRow,
    Table,
    _read,
    hypotheses_of,
    read_table,
    unexplained_reading,
)

TORQUE, SHAPE = "constant_torque", "nameless_body_torque"


def table(values):
    """A table of rows, names joined by spaces, with these log evidences."""
    rows = {frozenset(names.split()): value for names, value in values.items()}
    prior = {row: log_prior_of_set(len(row), 25) for row in rows}
    return Table(posterior(rows, prior), rows, prior, {})


def test_one_set_that_holds_the_probability_is_named():
    found = read_table(
        table({"": 0.0, TORQUE: 20.0, "rate_bias": 12.0, SHAPE: 14.0}), Rules(), significant=True
    )
    assert (found.verdict, found.named, found.ambiguous_with) == ("named", (TORQUE,), ())
    assert found.nameless_lead == pytest.approx(-6.0)


@pytest.mark.filterwarnings("error")
def test_without_names_a_shape_that_is_all_the_probability_leads_by_infinity():
    found = read_table(table({"": 0.0, SHAPE: 2000.0}), Rules(), significant=True)
    assert (found.verdict, found.nameless_lead) == ("unknown", np.inf)


def test_what_is_not_significant_is_not_named():
    found = read_table(table({"": 0.0, TORQUE: 20.0}), Rules(), significant=False)
    assert (found.verdict, found.named) == ("consistent", ())


def test_sets_that_explain_the_data_nearly_as_well_are_ambiguous():
    values = {"": 0.0, TORQUE: 20.0, "rate_bias": 18.0, "rate_bias wheel_friction": 19.0}
    found = read_table(table(values | {SHAPE: 19.0}), Rules(), significant=True)
    assert found.verdict == "ambiguous"
    assert found.ambiguous_with == ((TORQUE, SHAPE, "rate_bias"),)


def test_nothing_and_fewer_effects_are_weighed_like_any_other_set():
    """A name that leaves a twentieth of its probability to nothing is no certainty."""
    weak = {"": 0.0, TORQUE: 5.5, "rate_bias": -1.0}
    found = read_table(table(weak), Rules(), significant=True)
    assert (found.verdict, found.ambiguous_with) == ("ambiguous", ((TORQUE, "nothing"),))
    strong = weak | {TORQUE: 9.0}
    assert read_table(table(strong), Rules(), significant=True).verdict == "named"
    both, friction = f"{TORQUE} wheel_friction", "wheel_friction"
    values = {"": 0.0, TORQUE: 20.0, friction: 3.0, f"{TORQUE} rate_bias": 26.0, both: 27.0}
    found = read_table(table(values), Rules(), significant=True)
    assert set(found.named) == {TORQUE, friction}
    assert found.ambiguous_with == ((friction, "rate_bias", "nothing"),)


def test_shapes_without_a_name_count_together():
    """Each alone has less than a twentieth of the name's probability."""
    shapes = ("nameless_body_torque", "nameless_wheel_torque", "nameless_rate_error")
    values = {"": 0.0, TORQUE: 20.0} | dict.fromkeys(shapes, 16.5)
    found = read_table(table(values), Rules(), significant=True)
    assert found.ambiguous_with == ((TORQUE, SHAPE),)


def test_a_set_that_only_adds_to_the_best_is_no_alternative():
    values = {"": 0.0, TORQUE: 20.0, f"{TORQUE} rate_bias": 23.0}
    assert read_table(table(values), Rules(), significant=True).verdict == "named"


@pytest.mark.parametrize(("evidence", "verdict"), [(24.6, "ambiguous"), (24.0, "named")])
def test_what_a_set_half_as_probable_adds_stands_or_nothing(evidence, verdict):
    """Prior odds of the second effect are 1 to 120: 24.0 leaves 0.45 of the single's, 24.6 0.83."""
    weighed = table({"": 0.0, TORQUE: 20.0, f"{TORQUE} rate_bias": evidence})
    found = read_table(weighed, Rules(), significant=True)
    assert found.verdict == verdict
    assert set(found.named) == {TORQUE, *(["rate_bias"] if verdict == "ambiguous" else [])}
    assert ("rate_bias", "nothing") in found.ambiguous_with or verdict == "named"
    alone = read_table(weighed, Rules(larger_set_share=1.0), significant=True)
    assert alone.named == (TORQUE,)


def test_a_shape_without_a_name_that_beats_the_names_leaves_them_unknown():
    found = read_table(table({"": 0.0, TORQUE: 20.0, SHAPE: 24.0}), Rules(), significant=True)
    assert (found.verdict, found.why_unknown) == ("unknown", "imitation")
    assert found.nameless_source == "body torque"


def test_names_that_a_shape_does_not_make_needless_explain_a_part():
    values = {"": 0.0, TORQUE: 900.0, SHAPE: 400.0, f"{TORQUE} {SHAPE}": 940.0}
    found = read_table(table(values), Rules(), significant=True)
    assert (found.verdict, found.named) == ("partial", (TORQUE,))


def test_residuals_that_are_not_noise_leave_a_part_or_nothing_named():
    beside = {"": 0.0, TORQUE: 900.0, SHAPE: 400.0, f"{TORQUE} {SHAPE}": 901.0}
    alone = {"": 0.0, TORQUE: 30.0, SHAPE: 29.0, f"{TORQUE} {SHAPE}": 26.0}
    for values, verdict in ((beside, "partial"), (alone, "unknown")):
        weighed = table(values)
        reading = read_table(weighed, Rules(), significant=True)
        assert unexplained_reading(weighed, reading).verdict == verdict


def test_listed_probabilities_add_up_to_one():
    """Shapes without a name are one hypothesis; improbable sets are one row."""
    names = [f"effect_{i}" for i in range(20)]
    values = {"": 0.0, SHAPE: 3.0, "nameless_rate_error": 2.0} | dict.fromkeys(names, 1.0)
    rows = hypotheses_of(table(values))
    assert sum(row.probability for row in rows) == pytest.approx(1.0)
    assert [row.kind for row in rows].count("nameless") == 1
    assert len(rows) < len(values)
    (others,) = (row for row in rows if row.kind == "others")
    assert others.log_evidence == pytest.approx(1.0)
    assert np.isfinite(others.log_prior)


def test_rows_stand_in_the_order_in_which_they_were_weighed():
    """Else last digits of probabilities would depend on how a process hashes names."""
    values = {frozenset([f"effect_{k}"]): -0.1 * k for k in range(20)} | {frozenset(): 0.0}
    first = RefittedRow(frozenset(), None, SimpleNamespace(members=()), None, values)
    assert list(_read({frozenset(): first}, Rules()).log_evidence) == list(values)


@pytest.mark.parametrize(
    ("foretold", "fits"), [(9.0, [7.0]), (99.0, [7.0, 5.0]), (99.0, [5.0, 7.0])]
)
def test_a_refit_from_far_away_is_repeated_from_its_end_and_the_lower_is_kept(
    monkeypatch, foretold, fits
):
    """Where the linear model foretells less than nothing does, 10, one fit is not enough."""
    space = SimpleNamespace(slice_of=lambda name: slice(9, 10))
    fit = SimpleNamespace(
        model=SimpleNamespace(space=space, n_known=9), point=None, white=None, objective=10.0,
        free=np.arange(9), theta=np.zeros(10),
    )  # fmt: skip
    near = RefittedRow(frozenset(), fit, None, None, {frozenset(): 0.0})
    asked = []

    def fitted(estimate, theta, free, **options):
        asked.append((estimate.objective, options["weak_data_first"]))
        return SimpleNamespace(**vars(fit) | {"objective": fits[len(asked) - 1]})

    stubs = {
        "_start": lambda *_: (fit, fit.theta, {}),
        "_followed": lambda *_: SimpleNamespace(bias=None, local=None, theta=None),
        "replace": lambda given, **_: given,
        "negative_log_posterior": lambda *_: foretold,
        "re_estimate": fitted,
        "within_prior": lambda given, *_, **__: given,
    }
    for name, stub in stubs.items():
        monkeypatch.setattr(table_search, name, stub)
    search = SimpleNamespace(rules=Rules())
    refitted = table_search._refit(frozenset([TORQUE]), {frozenset(): near}, search)
    assert refitted.objective == min(fits)
    # Again from where the first ended.
    again = [(fits[0], True)] if foretold > 10.0 else []
    assert asked == [(10.0, foretold > 10.0), *again]
