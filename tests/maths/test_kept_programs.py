"""Programs that the next process takes as they are: found by what is traced, never by less."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from bayes_inertia.maths import kept_programs
from bayes_inertia.maths.kept_programs import KeptProgram, ProgramsInMemory
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import by_name

# LAPACK has to be there before the loaded program calls it.
FACTOR = """
import sys
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
from bayes_inertia.maths.kept_programs import KeptProgram
traced = []
def factor(structure, matrix):
    traced.append(1)
    return jnp.linalg.cholesky(matrix)
print(len(traced), float(KeptProgram(factor)(1, 4.0 * np.eye(3))[2, 2]), len(traced))
"""


@dataclass(frozen=True)
class Structure:
    """What decides the code, as in a model."""

    effects: tuple[Effect, ...] = ()
    power: int = 2


class OfAUser(Effect):
    """Its code may change without the package's."""


@pytest.fixture
def folder(tmp_path):
    """Where JAX keeps compiled code; what it holds open of the folder before is let go."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    compilation_cache.reset_cache()
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)
    compilation_cache.reset_cache()


class Counted:
    """The same function in each process, and how often it is traced there."""

    def __init__(self):
        self.traced = 0

        def power(structure, x):
            self.traced += 1
            return jnp.sin(x) ** structure.power

        self.program = KeptProgram(power)

    def __call__(self, *args):
        return self.program(*args)


def entries(folder):
    return sorted(folder.glob("bayes_inertia_power-*-cache"))


def test_what_one_traced_the_next_takes_with_the_same_bits(folder):
    x = np.linspace(0.1, 0.9, 7)
    first, second = Counted(), Counted()
    there = np.asarray(first(Structure(), x))
    assert (first.traced, len(entries(folder))) == (1, 1)
    assert np.asarray(second(Structure(), x)).tobytes() == there.tobytes()
    np.testing.assert_allclose(second(Structure(), x), np.sin(x) ** 2, rtol=1e-14)
    assert second.traced == 0


@pytest.mark.parametrize(
    ("structure", "x"),
    [
        (Structure(power=3), np.ones(7)),
        (Structure(by_name(["rate_bias_drift"])), np.ones(7)),
        (Structure(), np.ones(8)),
        (Structure(), np.ones(7, np.float32)),
        (Structure(), 1.0),
    ],
)
def test_another_structure_shape_or_type_is_another_program(folder, structure, x):
    Counted()(Structure(), np.ones(7))
    other = Counted()
    value = np.asarray(other(structure, x))
    assert other.traced == 1
    np.testing.assert_allclose(value, np.sin(x) ** structure.power, rtol=1e-6)
    assert len(entries(folder)) == 2


def test_other_code_of_the_package_is_another_program(folder, monkeypatch):
    Counted()(Structure(), np.ones(2))
    monkeypatch.setattr(kept_programs, "_digest_of_package", lambda: "changed")
    later = Counted()
    later(Structure(), np.ones(2))
    assert (later.traced, len(entries(folder))) == (1, 2)


def test_a_program_with_an_effect_of_a_user_is_not_kept(folder):
    structure = Structure((OfAUser(),))
    for program in (Counted(), Counted()):
        assert float(program(structure, 0.5)) == pytest.approx(np.sin(0.5) ** 2)
        assert program.traced == 1
    assert entries(folder) == []


def test_a_damaged_entry_is_said_and_compiled_again(folder):
    there = Counted()(Structure(), np.ones(2))
    entry = entries(folder)[0]
    entry.write_bytes(entry.read_bytes()[:50])
    program = Counted()
    with pytest.warns(UserWarning, match="cache entry for 'bayes_inertia_power'"):
        again = program(Structure(), np.ones(2))
    assert np.asarray(again).tobytes() == np.asarray(there).tobytes()
    assert program.traced == 1


def test_what_cannot_be_read_back_is_tried_once(folder, monkeypatch):
    monkeypatch.setattr(kept_programs, "_packed", lambda compiled: b"no program")
    for _ in range(2):
        program = Counted()
        assert float(program(Structure(), 0.5)) == pytest.approx(np.sin(0.5) ** 2)
        assert program.traced == 1
    assert [entry.read_bytes() for entry in entries(folder)] == [b""]


def test_under_a_transformation_it_is_the_function(folder):
    program = Counted()
    slope = jax.vmap(jax.grad(lambda x: program(Structure(), x)))(jnp.array([0.2, 0.4]))
    np.testing.assert_allclose(slope, np.sin([0.4, 0.8]), rtol=1e-12)
    assert entries(folder) == []


def test_without_a_folder_nothing_is_kept(folder):
    jax.config.update("jax_compilation_cache_dir", None)
    assert float(Counted()(Structure(), 0.5)) == pytest.approx(np.sin(0.5) ** 2)
    assert entries(folder) == []


def powers_held(memory):
    return [form[0][0] for _, form in memory.held()]


def test_beyond_a_size_the_programs_called_longest_ago_are_forgotten(folder):
    memory = ProgramsInMemory()
    raised = KeptProgram(lambda power, x: x**power, memory=memory)
    scaled = KeptProgram(lambda factor, x: factor * x, memory=memory)
    for power in (2, 3):
        raised(power, np.ones(4))
    scaled(7, np.ones(4))
    raised(2, np.ones(4))
    assert powers_held(memory) == [3, 7, 2]
    memory.most_bytes = memory.size()
    raised(3, np.ones(4))
    assert powers_held(memory) == [7, 2, 3]
    raised(4, np.ones(4))
    assert powers_held(memory) == [2, 3, 4]
    assert memory.size() <= memory.most_bytes
    assert scaled(7, np.full(4, 2.0)).tolist() == [14.0] * 4


def test_a_program_larger_than_the_memory_is_held_alone(folder):
    memory = ProgramsInMemory(most_bytes=1)
    raised = KeptProgram(lambda power, x: x**power, memory=memory)
    for power in (2, 3):
        assert raised(power, 2.0) == 2.0**power
        assert powers_held(memory) == [power]


def test_with_the_programs_of_former_campaigns_what_jax_keeps_of_them_is_forgotten(folder):
    single, memory = jax.jit(lambda x: 2.0 * x), ProgramsInMemory()
    raised = KeptProgram(lambda power, x: x**power, memory=memory)
    raised(2, 2.0)
    single(1.0)
    assert single._cache_size() == 1
    memory.clear_after = memory.size()
    raised(3, 2.0)
    assert single._cache_size() == 0
    assert (single(1.5), raised(3, 2.0)) == (3.0, 8.0)


def test_what_needs_no_structure_is_compiled_by_shapes_alone(folder):
    memory = ProgramsInMemory()
    doubled = KeptProgram(lambda x: 2.0 * x, static=0, memory=memory)
    assert [doubled(np.ones(n)).sum() for n in (1, 2, 2)] == [2.0, 4.0, 4.0]
    assert len(memory.held()) == 2


@pytest.mark.slow
def test_a_loaded_program_finds_lapack(tmp_path):
    command = [sys.executable, "-c", FACTOR, str(tmp_path)]
    said = [subprocess.run(command, capture_output=True, text=True).stdout for _ in range(2)]
    assert said == ["0 2.0 1\n", "0 2.0 0\n"]
