"""The command `effects`, and runs with an effect of one's own."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.commands import run

import bayes_inertia
from bayes_inertia.app import run_folder
from bayes_inertia.app.commands.check import show_checked_effect
from bayes_inertia.errors import EffectError, OutputError
from bayes_inertia.physics.check_effect import CheckedEffect
from bayes_inertia.physics.effects import LIBRARY, STOCHASTIC

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
PUSH = '''"""A body-fixed torque, as an effect outside the package."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class Push(Effect):
    """A body-fixed torque."""

    name: ClassVar[str] = "push"
    sigma: float = 1e-5

    def parameters(self, campaign):
        return (vector("torque", "xyz", unit="N m", prior=Normal(0.0, self.sigma)),)

    def body_torque(self, p, slew, t, state):
        return p["torque"]
'''


@pytest.fixture
def my_effects(tmp_path):
    path = tmp_path / "my_effects.py"
    path.write_text(PUSH)
    return path


def test_the_list_shows_every_effect_within_80_columns(capsys):
    assert run("effects") == 0
    lines = capsys.readouterr().out.splitlines()
    names = [effect.name for effect in (*LIBRARY, *STOCHASTIC)]
    assert [line for line in lines if line in names] == names
    assert max(map(len, lines)) <= 80
    for part in ("torque (3) [N m]: 0 ±", "acts in body torque", "needs magnetic_field_N"):
        assert any(part in line for line in lines), part


def test_the_list_as_json(capsys):
    assert run("effects", "--json", "--campaign", EXAMPLE) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["format"] == "bayes-inertia-effects/1"
    rows = {row["name"]: row for row in content["effects"]}
    (tau,) = rows["wheel_command_lag"]["parameters"]
    assert (tau["unit"], tau["null"], tau["prior"]["kind"]) == ("s", 0.0, "normal")
    assert rows["constant_torque"]["hooks"] == ["body_torque"]
    assert rows["torque_noise"]["kind"] == "named"


def test_the_check_says_what_was_proven(capsys):
    show_checked_effect(CheckedEffect("push", {"commanded": {"push.torque_z": 812.3}}))
    printed = capsys.readouterr().out
    assert "push: keeps the contract" in printed
    assert "push.torque_z, commanded drive: 812" in printed
    assert max(map(len, printed.splitlines())) <= 80


@pytest.mark.slow
def test_the_check_says_what_is_broken(my_effects, capsys):
    my_effects.write_text(PUSH.replace('p["torque"]', '1e-6 + p["torque"]'))
    assert run("effects", "--check", f"{my_effects}:Push") == 2
    assert "at its null values it changes the telemetry" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_keeps_the_reference_and_says_when_the_file_changed(my_effects, tmp_path):
    out = tmp_path / "run"
    run_folder.start(EXAMPLE, out, effects=[f"{my_effects}:Push"])
    (name,) = run_folder.read_run(out).effects
    assert name.startswith(f"{my_effects}:Push@")
    # The same command finds the same run.
    run_folder.start(EXAMPLE, out, effects=[f"{my_effects}:Push"])
    my_effects.write_text(PUSH.replace("1e-5", "2e-5"))
    with pytest.raises(OutputError, match="other effects"):
        run_folder.start(EXAMPLE, out, effects=[f"{my_effects}:Push"])
    with pytest.raises(EffectError, match="was changed since this run"):
        run_folder.finish(out)


@pytest.mark.parametrize("command", ["fit", "diagnose", "observe"])
def test_commands_say_what_is_wrong_with_a_file(my_effects, tmp_path, capsys, command):
    my_effects.write_text(PUSH + "\ndef (:\n")
    out = tmp_path / "run"
    assert run(command, EXAMPLE, "-o", out, "--effects", f"{my_effects}:Push") == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert f"my_effects.py, line {len(PUSH.splitlines()) + 2}: is not Python" in message
    assert not out.exists()


def test_a_diagnosis_tries_the_effect_beside_the_library(my_effects, tmp_path, monkeypatch):
    tried = []

    def investigate(campaign, *, library, **options):
        tried.extend(effect.name for effect in library)
        raise EffectError("enough", where="here", advice="stop")

    monkeypatch.setattr(run_folder, "investigate", investigate)
    out = tmp_path / "run"
    run_folder.start(EXAMPLE, out, kind="diagnose", effects=[f"{my_effects}:Push", "rate_bias"])
    with pytest.raises(EffectError, match="enough"):
        run_folder.finish(out)
    assert tried == [*(effect.name for effect in LIBRARY), "push"]
