"""Effects by what a user calls them: a name of the library, or a reference to code of their own.

A reference is `FILE.py:Class` or `package.module:Class`, or the name of an entry point of the group
`bayes_inertia.effects`. Nothing is loaded that is not named. A pinned reference,
`/path/FILE.py:Class@0123456789abcdef`, states the beginning of the SHA-256 of the file that defines
the class: a run that goes on with another file is refused.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp

from bayes_inertia.files import read_bytes, text_of
from bayes_inertia.physics.declaration import check_declaration, require_own_name
from bayes_inertia.physics.effect import Effect, broken, guarded, require_effects, require_rule
from bayes_inertia.physics.effects import LIBRARY, REMAINDERS, STOCHASTIC, by_name
from bayes_inertia.physics.effects.of_device import with_settings
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.physics.stochastic_effect import StochasticEffect
from bayes_inertia.sealing import sha256_of

ENTRY_POINTS = "bayes_inertia.effects"
_REFERENCE = re.compile(r"(?P<source>.+):(?P<attribute>[A-Za-z_]\w*)(?:@(?P<digest>[0-9a-f]{16}))?")


@dataclass(frozen=True)
class EffectReference:
    """Where an effect from outside is defined.

    Parameters
    ----------
    source : str
        A file's path, ending in ".py", or the dotted name of a module.
    attribute : str
        Name of the class, or of an instance.
    digest : str, optional
        Of the file's content; empty where any content will do.

    Examples
    --------
    >>> str(EffectReference("my_effects.py", "SolarPressure"))
    'my_effects.py:SolarPressure'
    """

    source: str
    attribute: str
    digest: str = ""

    @property
    def is_file(self) -> bool:
        """Whether the source is a file, not a module."""
        return self.source.endswith(".py")

    def __str__(self) -> str:
        return f"{self.source}:{self.attribute}" + (f"@{self.digest}" if self.digest else "")


def reference_of(name: str) -> EffectReference | None:
    """The reference that a name is, or that an entry point of this name has.

    Returns: none for a plain name that no installed package declares.

    Examples
    --------
    >>> reference_of("my_effects.py:SolarPressure").attribute
    'SolarPressure'
    >>> reference_of("constant_torque") is None
    True
    """
    match = _REFERENCE.fullmatch(name)
    if match is None:
        for entry in metadata.entry_points(group=ENTRY_POINTS, name=name):
            return reference_of(entry.value.replace(" ", ""))
        return None
    return EffectReference(match["source"], match["attribute"], match["digest"] or "")


def installed_effects() -> dict[str, str]:
    """Entry points of installed packages, by name; nothing is loaded."""
    return {entry.name: entry.value for entry in metadata.entry_points(group=ENTRY_POINTS)}


def load_effect(reference: EffectReference) -> Effect:
    """The effect that a reference names; its code is run.

    Returns: an instance; of a class, the one without arguments.
    """
    module = _module(reference)
    value = getattr(module, reference.attribute, None)
    if value is None:
        _raise_no_such_class(reference, module)
    return _instance(value, reference)


def effects_in_file(path: Path) -> tuple[Effect, ...]:
    """All effects that a file defines, in its order."""
    require_rule(path.suffix == ".py", path, "python_file")
    module = _module_of_file(EffectReference(str(path), ""))
    names = _classes_of(module)
    require_rule(bool(names), path, "defines_effects")
    return tuple(_instance(getattr(module, n), EffectReference(str(path), n)) for n in names)


def pinned(reference: EffectReference) -> EffectReference:
    """The reference with an absolute path and the digest of the file as it is now."""
    if reference.is_file:
        path = Path(reference.source).resolve()
        return replace(reference, source=str(path), digest=_digest(read_bytes(path)))
    file = importlib.import_module(reference.source).__file__
    return replace(reference, digest=_digest(read_bytes(Path(file)))) if file else reference


def _module(reference: EffectReference) -> ModuleType:
    """The module of a reference, its code run."""
    if reference.is_file:
        return _module_of_file(reference)
    try:
        module = importlib.import_module(reference.source)
    except Exception as error:
        raise broken(reference.source, "importable", why=_reason(error)) from error
    if reference.digest and module.__file__ is not None:
        _require_same(reference, _digest(read_bytes(Path(module.__file__))))
    return module


def _module_of_file(reference: EffectReference) -> ModuleType:
    path = Path(reference.source)
    wanted = "; this run was begun with it" if reference.digest else ""
    require_rule(path.is_file(), path, "file_there", wanted=wanted)
    data = read_bytes(path)
    digest = _digest(data)
    _require_same(reference, digest)
    # Named by its content, so that classes of one content are equal however often it is read.
    name = f"bayes_inertia_outside_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    require_rule(spec is not None, path, "python_file")
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    # As Python's own import does it: dataclasses look their module up.
    sys.modules[name] = module
    try:
        with _neighbours_importable(path.resolve().parent):
            _run(text_of(data, str(path)), path, module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _run(text: str, path: Path, module: ModuleType) -> None:
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)
    except SyntaxError as error:
        where = f"{path}, line {error.lineno}"
        raise broken(where, "is_python", why=error.msg) from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == str(path)]
        where = f"{path}, line {lines[-1]}" if lines else str(path)
        raise broken(where, "runs", why=_reason(error), file=path.name) from error


@contextmanager
def _neighbours_importable(folder: Path) -> Iterator[None]:
    """Let a file import the files beside it, behind everything installed."""
    sys.path.append(str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def _classes_of(module: ModuleType) -> list[str]:
    """Names of the effects that a module itself defines."""
    return [
        name
        for name, value in vars(module).items()
        if isinstance(value, type)
        and issubclass(value, Effect)
        and value.__module__ == module.__name__
        and not name.startswith("_")
    ]


def _raise_no_such_class(reference: EffectReference, module: ModuleType) -> None:
    names = _classes_of(module)
    near = difflib.get_close_matches(reference.attribute, names, 1) or names
    advice = f"perhaps {', '.join(near)}" if near else "it defines no effect at all"
    raise broken(reference.source, "class_there", name=reference.attribute, near=advice)


def _instance(value: Any, reference: EffectReference) -> Effect:
    if isinstance(value, Effect):
        return value
    where = f"{reference.source}:{reference.attribute}"
    is_class = isinstance(value, type) and issubclass(value, Effect)
    require_rule(is_class, where, "is_effect")
    try:
        return value()
    except Exception as error:
        raise broken(where, "made_without_arguments", why=_first_line(error)) from error


def _require_same(reference: EffectReference, digest: str) -> None:
    require_rule(reference.digest in ("", digest), reference.source, "unchanged")


def _digest(data: bytes) -> str:
    return sha256_of(data)[:16]  # as many as `_REFERENCE` takes


def _reason(error: BaseException) -> str:
    return f"{type(error).__name__}: {_first_line(error)}"


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def effects_named(names: Sequence[Effect | str]) -> tuple[Effect, ...]:
    """The effects with these names, of the library or from outside; an effect is taken as it is.

    `names`: each a name of the library ("rate_bias"), `FILE.py:Class`, `package.module:Class`, the
    name of an entry point of an installed package, or what `pinned_names` returned; behind each,
    settings as in "flexible_mode:frequency=0.12:damping=0.01". "delay[mems]" is of one device.

    Examples
    --------
    >>> effects_named(["inertia_change:from_slew=5"])[0].from_slew
    5
    """
    listed = isinstance(names, Iterable) and not isinstance(names, str)
    require_rule(listed, "effects", "list_of_names", given=names)
    effects = require_effects(_effect_named(n) if isinstance(n, str) else n for n in names)
    every = [effect.name for effect in effects]
    for name in every:
        require_rule(every.count(name) == 1, name, "once")
    return effects


def remainders(kind: str | None) -> tuple[StochasticEffect, ...]:
    """What stands for disturbances without a name in a fit.

    Examples
    --------
    >>> [effect.name for effect in remainders("both")]
    ['torque_remainder', 'rate_remainder']
    """
    wanted = [f"{each}_remainder" for each in (("torque", "rate") if kind == "both" else (kind,))]
    return tuple(effect for effect in REMAINDERS if effect.name in wanted)


def pinned_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names as a run keeps them; effects from outside are checked.

    Returns: references with absolute paths and digests; names of the library as they are.
    """
    effects_named(names)
    return tuple(_pinned_name(name) for name in names)


def split_settings(name: str) -> tuple[str, dict[str, str]]:
    """What a user calls an effect, and the settings behind it.

    Examples
    --------
    >>> split_settings("my_effects.py:Slosh:sigma=0.1")
    ('my_effects.py:Slosh', {'sigma': '0.1'})
    """
    given: dict[str, str] = {}
    while "=" in (setting := name.rpartition(":")[2]) and ":" in name:
        name = name.removesuffix(f":{setting}")
        key, _, value = setting.partition("=")
        given = {key.strip(): value.strip(), **given}
    return name, given


def _effect_named(name: str) -> Effect:
    plain, settings = split_settings(name)
    reference = _from_outside(plain)
    if reference is None:
        return with_settings(by_name([plain])[0], settings)
    effect = load_effect(reference)
    require_own_name(effect, str(reference))
    return with_settings(effect, settings)


def _pinned_name(name: str) -> str:
    plain, _ = split_settings(name)
    reference = _from_outside(plain)
    if reference is None:
        return name
    _check_traceable(_effect_named(name))
    return f"{pinned(reference)}{name.removeprefix(plain)}"


def _from_outside(name: str) -> EffectReference | None:
    """The reference that a name is; none for a name of the library, whoever else declares it."""
    known = any(effect.name == name for effect in (*LIBRARY, *STOCHASTIC))
    return None if known else reference_of(name)


def _check_traceable(effect: Effect) -> None:
    """Call every hook once, on shapes alone: quick, and no traceback in the middle of a fit."""
    campaign = small_campaign()
    check_declaration(effect, campaign)
    drives: tuple[Drive, Drive] = ("commanded", "measured")
    for drive in drives:
        model = guarded(effect, "building the model", partial(Model, campaign, (effect,), drive))
        local = jnp.zeros((model.n_slews, model.structure.n_local))
        predict = partial(predict_all, model.structure)
        arguments = (jnp.asarray(model.space.mean), local, jnp.zeros(model.n_bias), model.data)
        guarded(effect, "predicting telemetry", partial(jax.eval_shape, predict, *arguments))
