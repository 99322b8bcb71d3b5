"""The house rules that a machine can check: layers, no module state, documented public names, small files."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import bayes_inertia

ROOT = Path(bayes_inertia.__file__).parent
MODULES = sorted(ROOT.rglob("*.py"))
MAX_LINES = 450

# Imports point strictly downward; inside one package (io, effects, report) its files may use each other.
LAYERS = {
    "errors": 0,
    "rotation": 0,
    "parameters": 1,
    "inertia": 1,
    "levenberg": 1,
    "campaign": 2,
    "effect": 2,
    "io": 2,
    "dynamics": 3,
    "telemetry": 3,
    "chain_file": 3,
    "effects": 3,
    "model": 4,
    "likelihood": 5,
    "adequacy": 5,
    "objective": 6,
    "begin": 6,
    "estimate": 6,
    "sample": 6,
    "moves": 6,
    "posterior": 6,
    "maneuver": 7,
    "plan": 7,
    "planfile": 7,
    "spacecraft": 7,
    "flight": 7,
    "simulation": 7,
    "evidence": 7,
    "held_out": 7,
    "projection": 7,
    "fingerprint": 7,
    "noise": 7,
    "torque_response": 7,
    "ahead": 7,
    "proportional": 7,
    "oscillator": 7,
    "fit": 7,
    "linearised": 7,
    "disagreement": 7,
    "history": 7,
    "unknown": 7,
    "degeneracy": 7,
    "observability_view": 7,
    "observability": 7,
    "agreement": 7,
    "motion": 7,
    "response": 7,
    "forecast": 7,
    "constraints": 7,
    "criterion": 7,
    "region": 7,
    "separation": 7,
    "expectation": 7,
    "search": 7,
    "design": 7,
    "compare": 7,
    "diagnosis": 7,
    "diagnose": 7,
    "averaging": 7,
    "undetected": 7,
    "correction": 7,
    "testing": 7,
    "diagnosis_file": 8,
    "study": 8,
    "investigation": 8,
    "run": 8,
    "observe": 8,
    "planning": 8,
    "terminal": 8,
    "plots": 8,
    "report": 8,
    "cli": 8,
}
# Within a layer, each of these may use those before it. Everything else in one layer is independent.
ORDERED = (
    ("errors", "rotation"),
    ("inertia", "parameters", "levenberg"),
    ("campaign", "effect", "io"),
    ("dynamics", "telemetry", "effects"),
    ("adequacy", "likelihood"),
    ("moves", "objective", "begin", "estimate", "sample", "posterior"),
    (
        "plan",
        "planfile",
        "spacecraft",
        "flight",
        "maneuver",
        "simulation",
        "evidence",
        "held_out",
        "projection",
        "fingerprint",
        "noise",
        "torque_response",
        "ahead",
        "proportional",
        "oscillator",
        "fit",
        "linearised",
        "disagreement",
        "history",
        "unknown",
        "degeneracy",
        "observability_view",
        "observability",
        "agreement",
        "motion",
        "response",
        "forecast",
        "constraints",
        "criterion",
        "region",
        "separation",
        "expectation",
        "search",
        "design",
        "compare",
        "diagnosis",
        "diagnose",
        "averaging",
        "undetected",
        "correction",
        "testing",
    ),
    ("plots", "report", "diagnosis_file", "investigation", "run", "observe", "planning", "study", "terminal", "cli"),
)


def name_of(path: Path) -> str:
    """The module's place in the layers: its first part below the package; "" for the package itself."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return "" if parts == ("__init__",) else parts[0]


def imported(tree: ast.Module) -> set[str]:
    """First parts below the package of everything imported from it, wherever in the file, type checking included."""
    found = set()
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names = [node.module or ""]
            if node.module == "bayes_inertia":
                names = [f"bayes_inertia.{alias.name}" for alias in node.names]
        found |= {n.split(".")[1] for n in names if n.startswith("bayes_inertia.")}
    return found


def violations(importer: str, targets: set[str]) -> list[str]:
    """Imports of one module that do not point downward."""
    bad = []
    for target in targets - {importer, "__version__"}:
        assert target in LAYERS, f"{target}: place this module in LAYERS"
        level, own = LAYERS[target], LAYERS[importer]
        beside = any(importer in group and target in group and group.index(target) < group.index(importer) for group in ORDERED)
        if level > own or (level == own and not beside):
            bad.append(f"{importer} (L{own}) imports {target} (L{level})")
    return bad


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


ids = [str(p.relative_to(ROOT)) for p in MODULES]
every_module = pytest.mark.parametrize("path", MODULES, ids=ids)


@every_module
def test_imports_point_strictly_downward(path):
    name = name_of(path)
    if name:
        assert name in LAYERS, f"{name}: place this module in LAYERS"
        assert violations(name, imported(parse(path))) == []
    else:
        # The package itself collects the public names; nothing below may import it back through a name of its own.
        assert imported(parse(path)) <= set(LAYERS)


def test_the_layer_check_can_fail():
    tree = ast.parse("def f():\n    from bayes_inertia import cli\n    import bayes_inertia.estimate as e")
    assert imported(tree) == {"cli", "estimate"}
    assert violations("likelihood", imported(tree)) != []
    assert violations("estimate", {"likelihood", "model", "errors"}) == []
    assert violations("rotation", {"errors"}) == []
    assert violations("errors", {"rotation"}) != []
    assert violations("parameters", {"campaign"}) != []
    with pytest.raises(AssertionError, match="place this module"):
        violations("cli", {"somewhere_new"})


def mutable_state(tree: ast.Module) -> list[str]:
    """Names of module level that hold something changeable which functions could change: lists, sets, dicts used as state, `global`."""
    found = [f"global {', '.join(n.names)}" for n in ast.walk(tree) if isinstance(n, ast.Global)]
    module_names = {t.id: n for n in tree.body for t in targets_of(n)}
    mutable = {name for name, node in module_names.items() if is_mutable(node.value)}
    # A table that is only read (a constant in capitals) is no state; what changes it, or what is not named as a constant, is.
    found += sorted(name for name in mutable if not name.lstrip("_").isupper() and name != "__all__")
    changed = {name for node in ast.walk(tree) for name in changes(node)}
    return found + sorted(mutable & changed)


def targets_of(node: ast.stmt) -> list[ast.Name]:
    if isinstance(node, ast.Assign):
        return [t for t in node.targets if isinstance(t, ast.Name)]
    return [node.target] if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value else []


def is_mutable(value: ast.expr) -> bool:
    if isinstance(value, ast.Call):
        called = value.func.id if isinstance(value.func, ast.Name) else getattr(value.func, "attr", "")
        return called in {"list", "dict", "set", "defaultdict", "OrderedDict", "Counter", "deque", "zeros", "array", "default_rng"}
    return isinstance(value, ast.List | ast.Dict | ast.Set | ast.ListComp | ast.DictComp | ast.SetComp)


def changes(node: ast.AST) -> list[str]:
    """Names whose content a statement changes: x[...] = , x.append(...), del x[...]."""
    methods = {"append", "extend", "insert", "add", "update", "setdefault", "pop", "popitem", "clear", "remove", "discard", "sort", "reverse"}
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in methods and isinstance(node.func.value, ast.Name):
        return [node.func.value.id]
    places = node.targets if isinstance(node, ast.Assign | ast.Delete) else [node.target] if isinstance(node, ast.AugAssign) else []
    return [p.value.id for p in places if isinstance(p, ast.Subscript) and isinstance(p.value, ast.Name)]


@every_module
def test_no_module_has_mutable_state(path):
    assert mutable_state(parse(path)) == []


def test_the_state_check_can_fail():
    assert mutable_state(ast.parse("registry = []")) == ["registry"]
    assert mutable_state(ast.parse("TABLE = {}\ndef f(k):\n    TABLE[k] = 1")) == ["TABLE"]
    assert mutable_state(ast.parse("TABLE = {}\ndef f(k):\n    TABLE.setdefault(k, [])")) == ["TABLE"]
    assert mutable_state(ast.parse("def f():\n    global x\n    x = 1")) == ["global x"]
    assert mutable_state(ast.parse("TABLE = {'a': 1}\nNAMES = ('a',)\n__all__ = ['f']")) == []


def undocumented(tree: ast.Module) -> list[str]:
    """Public functions, classes, methods and properties without a docstring; an override inherits that of its base."""
    definitions = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    found = []
    for node in tree.body:
        if not isinstance(node, definitions) or node.name.startswith("_"):
            continue
        if not ast.get_docstring(node):
            found.append(node.name)
        if isinstance(node, ast.ClassDef) and not node.bases:
            found += [f"{node.name}.{m.name}" for m in node.body if isinstance(m, definitions) and not m.name.startswith("_") and not ast.get_docstring(m)]
    return found


@every_module
def test_every_module_and_public_name_says_what_it_is_for(path):
    tree = parse(path)
    assert ast.get_docstring(tree)
    assert undocumented(tree) == []


@every_module
def test_no_file_is_long(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MAX_LINES


def test_importing_the_package_computes_in_double_precision():
    import jax.numpy as jnp

    assert jnp.asarray(1.0).dtype == jnp.float64
