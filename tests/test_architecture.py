"""The house rules that a machine can check: arrows, state, docstrings, sizes."""

from __future__ import annotations

import ast
import re
import tokenize
from collections.abc import Callable
from functools import cache
from io import StringIO
from pathlib import Path

import pytest

import bayes_inertia

ROOT = Path(bayes_inertia.__file__).parent
MODULES = sorted(ROOT.rglob("*.py"))
# Of code: docstrings, comments and empty lines do not count.
MAX_LINES = 400
MAX_FUNCTION_LINES = 40

# Which wings each wing may import. Inside a wing its files may use each other.
OPEN_TO_ALL = ("errors", "files", "folder_lock", "progress", "sealing", "version")
BELOW_PHYSICS = ("campaign", "faults", "tables", "maths")
BELOW_DESIGN = ("inference", "flight", "physics", *BELOW_PHYSICS)
MIDDLE = ("observability", "diagnosis", "design", "series")
ARROWS = {
    "errors": (),
    "progress": ("errors",),
    "version": (),
    "files": ("errors",),
    "folder_lock": ("errors", "files"),
    "sealing": ("errors", "files"),
    "maths": OPEN_TO_ALL,
    "tables": ("maths", *OPEN_TO_ALL),
    "faults": ("tables", "maths", *OPEN_TO_ALL),
    "campaign": ("faults", "tables", "maths", *OPEN_TO_ALL),
    "importing": (*BELOW_PHYSICS, *OPEN_TO_ALL),
    "conventions": (*BELOW_PHYSICS, *OPEN_TO_ALL),
    "physics": (*BELOW_PHYSICS, *OPEN_TO_ALL),
    "flight": ("physics", *BELOW_PHYSICS, *OPEN_TO_ALL),
    "inference": ("physics", *BELOW_PHYSICS, *OPEN_TO_ALL),
    "observability": ("inference", "physics", *BELOW_PHYSICS, *OPEN_TO_ALL),
    "diagnosis": ("inference", "physics", *BELOW_PHYSICS, *OPEN_TO_ALL),
    "series": ("inference", "physics", *BELOW_PHYSICS, *OPEN_TO_ALL),
    "design": (*BELOW_DESIGN, *OPEN_TO_ALL),
    "studies": (*MIDDLE, *BELOW_DESIGN, *OPEN_TO_ALL),
    "report": (*MIDDLE, "inference", "physics", *BELOW_PHYSICS, *OPEN_TO_ALL),
    "app": ("report", "studies", *MIDDLE, "importing", "conventions", *BELOW_DESIGN, *OPEN_TO_ALL),
}


def name_of(path: Path) -> str:
    """The module's place in the layers: its first part below the package; "" for the package
    itself.
    """
    parts = path.relative_to(ROOT).with_suffix("").parts
    return "" if parts == ("__init__",) else parts[0]


def imported(tree: ast.Module) -> set[str]:
    """First parts below the package of everything imported from it, wherever in the file, type
    checking included.
    """
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
    """Imports of one wing that its row of arrows does not allow."""
    for target in targets:
        assert target in ARROWS, f"{target}: place this wing in ARROWS"
    forbidden = targets - {importer} - set(ARROWS[importer])
    return [f"{importer} imports {target}" for target in sorted(forbidden)]


@cache
def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def in_modules(check: Callable[[Path], object]) -> dict[str, object]:
    """What a check finds, by module; modules without a finding are left out."""
    found = {str(path.relative_to(ROOT)): check(path) for path in MODULES}
    return {module: what for module, what in found.items() if what}


def module_name(path: Path) -> str:
    """The full name of a module of the package."""
    parts = ("bayes_inertia", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts).removesuffix(".__init__")


def circle(imports: dict[str, set[str]]) -> list[str]:
    """Modules that import each other in a circle; what is left when leaves are taken off."""
    left = {name: targets & set(imports) for name, targets in imports.items()}
    while leaves := {name for name, targets in left.items() if not targets & set(left)}:
        left = {name: targets for name, targets in left.items() if name not in leaves}
    return sorted(left)


def test_no_modules_import_each_other_in_a_circle():
    imports = {}
    for path in MODULES[1:]:
        nodes = [n for n in ast.walk(parse(path)) if isinstance(n, ast.ImportFrom) and n.module]
        deeper = {f"{n.module}.{alias.name}" for n in nodes for alias in n.names}
        imports[module_name(path)] = deeper | {n.module for n in nodes}
    assert circle(imports) == []


def test_the_check_of_circles_can_fail():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["a", "b", "c"]
    assert circle({"a": {"b"}, "b": set()}) == []


def against_the_arrows(path: Path) -> list[str]:
    """Imports of a module that the arrows do not allow."""
    name, targets = name_of(path), imported(parse(path))
    if name in ("", "__main__"):
        # The package itself collects the public names; nothing below may import it back.
        return sorted(targets - set(ARROWS))
    assert name in ARROWS, f"{name}: place this wing in ARROWS"
    return violations(name, targets)


def test_imports_follow_the_arrows():
    assert in_modules(against_the_arrows) == {}


# Modules that a wing must not import although it may import their wing: they search and decide.
# The report reads results, and the limits that were used stand in them.
DECIDING_MODULES = {
    "report": {
        "diagnosis.search",
        "diagnosis.limits",
        "design.designer",
        "inference.limits",
        "inference.gates",
        "inference.optimizer",
        "inference.residual_tests",
        "inference.sampler",
        "observability.analysis",
    },
}


def imported_modules(tree: ast.Module) -> set[str]:
    """Wing and module ("wing.module") of everything imported from the package."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    parts = [name.split(".")[1:3] for name in names if name.startswith("bayes_inertia.")]
    return {".".join(part) for part in parts if len(part) == 2}


def results_of_the_fit(tree: ast.Module) -> set[str]:
    """What is imported from the module of the posterior, which holds a result and its limits."""
    return {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module == "bayes_inertia.inference.posterior"
        for alias in node.names
    }


def decides(path: Path) -> set[str]:
    """What a module imports that its wing must leave to others."""
    tree, wing = parse(path), name_of(path)
    deciding = imported_modules(tree) & DECIDING_MODULES.get(wing, set())
    return deciding | (results_of_the_fit(tree) - {"Posterior"} if wing == "report" else set())


def test_the_report_reads_results_and_never_decides():
    assert in_modules(decides) == {}


def test_the_check_of_deciding_modules_can_fail():
    tree = ast.parse(
        "from bayes_inertia.diagnosis.search import Rules\n"
        "from bayes_inertia.inference import sampler\n"
        "from bayes_inertia.inference.posterior import OBSERVABLE_ABOVE"
    )
    assert imported_modules(tree) & DECIDING_MODULES["report"] == {
        "diagnosis.search",
        "inference.sampler",
    }
    assert results_of_the_fit(tree) == {"OBSERVABLE_ABOVE"}


def test_the_command_line_alone_imports_the_commands():
    importers = in_modules(lambda path: "app.commands" in imported_modules(parse(path)))
    within = {name for name in importers if name.startswith("app/commands/")}
    assert set(importers) - within == {"app/cli.py"}


def test_the_arrows_make_no_circle():
    below: dict[str, set[str]] = {}
    for wing, targets in ARROWS.items():
        assert set(targets) <= set(below), f"{wing} stands above what it imports"
        below[wing] = set(targets)


def test_the_check_of_arrows_can_fail():
    tree = ast.parse(
        "def f():\n    from bayes_inertia import app\n    import bayes_inertia.design as d"
    )
    assert imported(tree) == {"app", "design"}
    assert violations("inference", imported(tree)) == [
        "inference imports app",
        "inference imports design",
    ]
    assert violations("inference", {"physics", "campaign", "errors"}) == []
    assert violations("diagnosis", {"design"}) == ["diagnosis imports design"]
    assert violations("maths", {"campaign"}) == ["maths imports campaign"]
    with pytest.raises(AssertionError, match="place this wing"):
        violations("app", {"somewhere_new"})


def mutable_state(tree: ast.Module) -> list[str]:
    """Names of module level that hold something changeable which functions could change: lists,
    sets, dicts used as state, `global`.
    """
    found = [f"global {', '.join(n.names)}" for n in ast.walk(tree) if isinstance(n, ast.Global)]
    module_names = {t.id: n for n in tree.body for t in targets_of(n)}
    mutable = {name for name, node in module_names.items() if is_mutable(node.value)}
    # A table that is only read (a constant in capitals) is no state; what changes it, or what is
    # not named as a constant, is.
    found += sorted(
        name for name in mutable if not name.lstrip("_").isupper() and name != "__all__"
    )
    changed = {name for node in ast.walk(tree) for name in changes(node)}
    return found + sorted(mutable & changed)


def targets_of(node: ast.stmt) -> list[ast.Name]:
    if isinstance(node, ast.Assign):
        return [t for t in node.targets if isinstance(t, ast.Name)]
    return (
        [node.target]
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value
        else []
    )


def is_mutable(value: ast.expr) -> bool:
    if isinstance(value, ast.Call):
        called = (
            value.func.id if isinstance(value.func, ast.Name) else getattr(value.func, "attr", "")
        )
        return called in {
            "list",
            "dict",
            "set",
            "defaultdict",
            "OrderedDict",
            "Counter",
            "deque",
            "zeros",
            "array",
            "default_rng",
        }
    return isinstance(
        value, ast.List | ast.Dict | ast.Set | ast.ListComp | ast.DictComp | ast.SetComp
    )


def changes(node: ast.AST) -> list[str]:
    """Names whose content a statement changes: x[...] = , x.append(...), del x[...]."""
    methods = {
        "append",
        "extend",
        "insert",
        "add",
        "update",
        "setdefault",
        "pop",
        "popitem",
        "clear",
        "remove",
        "discard",
        "sort",
        "reverse",
    }
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in methods
        and isinstance(node.func.value, ast.Name)
    ):
        return [node.func.value.id]
    places = (
        node.targets
        if isinstance(node, ast.Assign | ast.Delete)
        else [node.target]
        if isinstance(node, ast.AugAssign)
        else []
    )
    return [
        p.value.id for p in places if isinstance(p, ast.Subscript) and isinstance(p.value, ast.Name)
    ]


def test_no_module_has_mutable_state():
    assert in_modules(lambda path: mutable_state(parse(path))) == {}


def test_the_state_check_can_fail():
    assert mutable_state(ast.parse("registry = []")) == ["registry"]
    assert mutable_state(ast.parse("TABLE = {}\ndef f(k):\n    TABLE[k] = 1")) == ["TABLE"]
    assert mutable_state(ast.parse("TABLE = {}\ndef f(k):\n    TABLE.setdefault(k, [])")) == [
        "TABLE"
    ]
    assert mutable_state(ast.parse("def f():\n    global x\n    x = 1")) == ["global x"]
    assert mutable_state(ast.parse("TABLE = {'a': 1}\nNAMES = ('a',)\n__all__ = ['f']")) == []


def undocumented(tree: ast.Module) -> list[str]:
    """Public functions, classes, methods and properties without a docstring; an override inherits
    that of its base.
    """
    definitions = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    found = []
    for node in tree.body:
        if not isinstance(node, definitions) or node.name.startswith("_"):
            continue
        if not ast.get_docstring(node):
            found.append(node.name)
        if isinstance(node, ast.ClassDef) and not node.bases:
            found += [
                f"{node.name}.{m.name}"
                for m in node.body
                if isinstance(m, definitions)
                and not m.name.startswith("_")
                and not ast.get_docstring(m)
            ]
    return found


def test_every_module_and_public_name_says_what_it_is_for():
    assert in_modules(lambda path: not ast.get_docstring(parse(path))) == {}
    assert in_modules(lambda path: undocumented(parse(path))) == {}


NO_CODE = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)


def code_lines(path: Path) -> frozenset[int]:
    """Numbers of the lines of a file that hold code."""
    return code_lines_of(path.read_text(encoding="utf-8"))


@cache
def code_lines_of(source: str) -> frozenset[int]:
    tokens = tokenize.generate_tokens(StringIO(source).readline)
    held = {t.start[0] + k for t in tokens if t.type not in NO_CODE for k in range(lines_of(t))}
    return frozenset(held - docstring_lines(ast.parse(source)))


def lines_of(token: tokenize.TokenInfo) -> int:
    """Number of lines over which a token stands."""
    return token.end[0] - token.start[0] + 1


def docstring_lines(tree: ast.AST) -> set[int]:
    """Numbers of the lines of all docstrings below a node."""
    found: set[int] = set()
    for node in ast.walk(tree):
        documented = isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
        if documented and ast.get_docstring(node) is not None:
            text = node.body[0]
            found |= set(range(text.lineno, (text.end_lineno or 0) + 1))
    return found


def lines_too_many(path: Path) -> int:
    """Lines of code of a file from the limit on."""
    return max(0, len(code_lines(path)) - MAX_LINES + 1)


def test_no_head_claims_to_hold_all_thresholds():
    """Steps keep thresholds of their own: who looks for one must not be told otherwise."""
    claims = re.compile(r"\b(all|every) thresholds?\b|one place decides", re.IGNORECASE)
    assert claims.search("All thresholds stand in `Rules`.")
    texts = [*ROOT.rglob("*.py"), *(ROOT.parent / "docs").rglob("*.md")]
    assert [str(path) for path in texts if claims.search(path.read_text("utf-8"))] == []


def test_no_file_is_long():
    assert in_modules(lines_too_many) == {}


def long_functions(path: Path) -> list[str]:
    """Functions with more lines of code than allowed."""
    code = code_lines(path)
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    lengths = [
        (node.name, len(code.intersection(range(node.lineno, (node.end_lineno or 0) + 1))))
        for node in functions
    ]
    return [f"{name}: {lines} lines" for name, lines in lengths if lines > MAX_FUNCTION_LINES]


def test_no_function_is_long():
    assert in_modules(long_functions) == {}


def test_a_finding_is_told_by_module():
    assert in_modules(lambda path: path.name == "version.py") == {"version.py": True}
    assert in_modules(lambda path: 0) == {}


def test_the_checks_of_lengths_can_fail(tmp_path):
    path = tmp_path / "long.py"
    body = "\n".join("    x = 1  # A reason." for _ in range(MAX_FUNCTION_LINES))
    path.write_text(f"def f():\n{body}\n", encoding="utf-8")
    assert long_functions(path) == ["f: 41 lines"]
    path.write_text(
        f'def f():\n    """Docstring."""\n\n{body[len("    x = 1  # A reason.") + 1 :]}\n',
        encoding="utf-8",
    )
    assert long_functions(path) == []
    path.write_text("x = 1\n" * MAX_LINES + "\n# A reason.\n", encoding="utf-8")
    assert lines_too_many(path) == 1


WINGS = [wing for wing in ARROWS if (ROOT / wing).is_dir()]


def test_the_wings_are_those_of_the_arrows_and_nothing_else():
    files = {path.stem for path in ROOT.iterdir() if path.suffix == ".py"}
    assert set(ARROWS) == {*WINGS, *OPEN_TO_ALL}
    assert files == {"__init__", "__main__", *OPEN_TO_ALL}


@pytest.mark.parametrize("wing", WINGS)
def test_a_wing_says_what_enters_and_what_leaves(wing):
    text = ast.get_docstring(parse(ROOT / wing / "__init__.py")) or ""
    assert len(text.splitlines()) >= 3
    assert "nter" in text
    assert "eave" in text


def test_importing_the_package_computes_in_double_precision():
    import jax.numpy as jnp

    assert jnp.asarray(1.0).dtype == jnp.float64
