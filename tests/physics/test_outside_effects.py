"""Effects in a file of one's own: found by reference, pinned by content, errors that teach."""

from __future__ import annotations

import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import assert_teaches

from bayes_inertia.errors import EffectError
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.simulated_campaigns import simulate
from bayes_inertia.physics.named_effects import effects_in_file, effects_named, pinned_names

HEAD = """from __future__ import annotations
from dataclasses import dataclass
from typing import ClassVar
import jax.numpy as jnp
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, vector

"""
PUSH = '''@dataclass(frozen=True)
class Push(Effect):
    """A body-fixed torque."""

    name: ClassVar[str] = "push"
    sigma: float = 1e-5

    def parameters(self, campaign):
        return (vector("torque", "xyz", unit="N m", prior=Normal(0.0, self.sigma)),)

    def body_torque(self, p, slew, t, state):
        return p["torque"]

STRONG = Push(sigma=1e-4)
'''
SETUP = len(HEAD.splitlines())


@pytest.fixture
def write(tmp_path):
    """Write a file of effects with this text behind the imports."""

    def file(text: str, name: str = "my_effects.py") -> Path:
        path = tmp_path / name
        path.write_text(HEAD + text)
        return path

    return file


def refused(name: str, words: list[str]) -> None:
    with pytest.raises(EffectError) as caught:
        pinned_names([name])
    assert_teaches(caught.value, words)


def test_a_class_or_an_instance_in_a_file_is_an_effect(write):
    path = write(PUSH)
    first, second = (effects_named([f"{path}:{name}"])[0] for name in ("Push", "STRONG"))
    assert (first.name, first.sigma, second.sigma) == ("push", 1e-5, 1e-4)
    assert [effect.name for effect in effects_in_file(path)] == ["push"]


def test_names_of_the_library_stay_as_they_are(write):
    path = write(PUSH)
    names = pinned_names(["rate_bias", f"{path}:Push"])
    assert names[0] == "rate_bias"
    assert [effect.name for effect in effects_named(names)] == ["rate_bias", "push"]


def test_one_content_gives_equal_effects_from_any_folder(write, monkeypatch, tmp_path):
    path = write(PUSH)
    (absolute,) = pinned_names([f"{path}:Push"])
    monkeypatch.chdir(tmp_path)
    assert pinned_names(["my_effects.py:Push"]) == (absolute,)
    assert effects_named(["my_effects.py:Push"]) == effects_named([absolute])


def test_a_pinned_file_that_was_changed_or_is_gone_is_told(write):
    path = write(PUSH)
    (name,) = pinned_names([f"{path}:Push"])
    path.write_text(HEAD + PUSH.replace("1e-5", "2e-5"))
    with pytest.raises(EffectError) as caught:
        effects_named([name])
    assert_teaches(caught.value, ["my_effects.py", "changed", "new run"])
    assert effects_named([f"{path}:Push"])[0].sigma == 2e-5
    path.unlink()
    with pytest.raises(EffectError) as caught:
        effects_named([name])
    assert_teaches(caught.value, ["my_effects.py", "no such file", "this run"])


def test_a_file_may_import_the_files_beside_it(write, tmp_path):
    (tmp_path / "sizes_beside.py").write_text("SIGMA = 3e-5\n")
    path = write("from sizes_beside import SIGMA\n\n" + PUSH.replace("1e-5", "SIGMA", 1))
    before = list(sys.path)
    assert effects_named([f"{path}:Push"])[0].sigma == 3e-5
    assert sys.path == before


BROKEN = {
    "syntax": ("def f(:\n", "Push", [f"line {SETUP + 1}", "is not Python"]),
    "fails": ("x = 1 / 0\n", "Push", [f"line {SETUP + 1}", "ZeroDivisionError"]),
    "no module": ("import no_such_thing\n", "Push", ["no_such_thing", "line"]),
    "no class": (PUSH, "Pusk", ["Pusk", "perhaps Push"]),
    "no effect at all": ("x = 1\n", "Push", ["Push", "defines no effect"]),
    "not an effect": (PUSH + "class Other: pass\n", "Other", ["is no effect", "derive"]),
    "needs arguments": (
        PUSH.replace("sigma: float = 1e-5", "sigma: float").replace("STRONG", "x = 0 #"),
        "Push",
        ["without arguments", "default"],
    ),
    "not frozen": (PUSH.replace("(frozen=True)", ""), "Push", ["frozen"]),
    "a name of the library": (PUSH.replace('"push"', '"rate_bias"'), "Push", ["rate_bias"]),
    "no unit": (PUSH.replace('"N m"', '"deg"'), "Push", ["deg", "SI"]),
    "parameters fail": (PUSH.replace("vector(", "vectr("), "Push", ["parameters(campaign)"]),
    "no width": (PUSH.replace("1e-5", "0.0"), "Push", ["parameters(campaign)", "scale is 0.0"]),
    "hook fails": (PUSH.replace('p["torque"]', 'p["force"]'), "Push", ["body_torque fails"]),
    "hook of a wrong shape": (
        PUSH.replace('return p["torque"]', "return jnp.ones(4)"),
        "Push",
        ["body_torque returned (4,)"],
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_with_a_file_is_said_with_its_place(write, case):
    text, name, words = BROKEN[case]
    path = write(text)
    refused(f"{path}:{name}", ["push" if case in QUOTES_NAME else str(path), *words])


# These are of an effect that was made, and name it instead of the file.
QUOTES_NAME = {"no unit", "no width", "parameters fail", "hook fails", "hook of a wrong shape"}


def test_a_file_or_a_package_that_is_not_there_is_told(tmp_path):
    refused(f"{tmp_path}/none.py:Push", ["none.py", "no such file"])
    refused("no_such_package.effects:Push", ["no_such_package", "install"])
    refused("rate_bais", ["rate_bias"])


def test_an_installed_package_offers_effects_by_name(write, monkeypatch, tmp_path):
    write(PUSH, "pushing_package.py")
    monkeypatch.syspath_prepend(tmp_path)
    entry = metadata.EntryPoint("push", "pushing_package:Push", "bayes_inertia.effects")

    def entry_points(*, group, name=None):
        return [entry] if group == entry.group and name in (None, entry.name) else []

    monkeypatch.setattr(metadata, "entry_points", entry_points)
    assert effects_named(["push"])[0].name == "push"
    (name,) = pinned_names(["push"])
    assert name.startswith("pushing_package:Push@")
    assert effects_named([name]) == effects_named(["push"])


@pytest.mark.slow
def test_a_simulation_hides_an_effect_from_outside(write, tmp_path):
    path, plan = write(PUSH), Plan("one", (PlannedSlew((1.0, 0.0, 0.0), 0.5),))
    flight = simulate(
        plan,
        most_like_mission(),
        tmp_path / "out",
        1,
        hidden=[f"{path}:Push.torque=1e-5,0,-2e-5"],
    )
    assert np.array_equal(flight.spacecraft.values["push"]["torque"], [1e-5, 0.0, -2e-5])
    with pytest.raises(EffectError) as caught:
        simulate(plan, most_like_mission(), tmp_path / "other", 1, hidden=[f"{path}:Push.force=1"])
    assert_teaches(caught.value, ["force", "torque"])


def test_settings_follow_the_name_of_an_effect(write):
    file = write(PUSH)
    change, mode = effects_named(
        ["inertia_change:from_slew=5", "flexible_mode:frequency=0.12:damping=0.01"]
    )
    assert change.from_slew == 5
    assert change.sigma is None
    assert (mode.frequency, mode.damping) == (0.12, 0.01)
    (pushed,) = effects_named(pinned_names([f"{file}:Push:sigma=2e-4"]))
    assert pushed.sigma == 2e-4


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("flexible_mode:frequencey=0.12", ["frequencey", "perhaps frequency"]),
        ("inertia_change:from_slew=half", ["'half'", "from_slew", "inertia_change"]),
        ("flexible_mode:frequency=", ["''", "frequency"]),
    ],
)
def test_a_wrong_setting_is_refused_by_name(name, words):
    refused(name, words)


def test_an_instance_of_a_class_of_the_library_stands_for_it(write):
    file = write(
        "from bayes_inertia.physics.effects import InertiaChange\nLATE = InertiaChange(from_slew=3)"
    )
    assert effects_named([f"{file}:LATE"])[0].from_slew == 3
