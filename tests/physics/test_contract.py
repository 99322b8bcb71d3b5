"""The contract of effects, rule by rule: each rule is checked, and what is checked is a rule."""

import ast
from pathlib import Path

import pytest

import bayes_inertia
from bayes_inertia.files import vocabulary

PACKAGE = Path(bayes_inertia.__file__).parent
PLACE_OF_RULE = {"require_rule": 2, "broken": 1}  # among the arguments


def rules_checked():
    """(rule, names of what its words are told) at each place of the package that checks one."""
    found = []
    for path in PACKAGE.rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            place = PLACE_OF_RULE.get(getattr(getattr(call, "func", None), "id", ""))
            if place is not None and isinstance(call.args[place], ast.Constant):
                told = {keyword.arg for keyword in call.keywords}
                found.append((call.args[place].value, told))
    return found


def test_each_rule_is_checked_and_each_check_has_its_words():
    rules, checked = vocabulary("physics")["contract"], rules_checked()
    assert {rule for rule, _ in checked} <= set(rules)
    text = "\n".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    assert [rule for rule in rules if f'"{rule}"' not in text] == []


@pytest.mark.slow
def test_words_of_a_rule_leave_nothing_open():
    for rule, told in rules_checked():
        if None not in told:  # `**told` names them elsewhere
            for words in vocabulary("physics")["contract"][rule]:
                words.format_map(dict.fromkeys(told, 1.0))
