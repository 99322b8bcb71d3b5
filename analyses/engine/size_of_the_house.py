"""Size of the package: lines, deciding numbers, import arrows and floors, against version 0.4.

    python -m analyses.engine.size_of_the_house

writes `results/engine/size_of_the_house.{md,json}`. Some seconds. `test_size_of_the_house.py` holds
the package to the committed counts: write them again after a change that makes them smaller.
"""

from __future__ import annotations

import ast
import io
import json
import re
import tarfile
import tokenize
from collections import Counter
from pathlib import Path
from subprocess import run
from tempfile import TemporaryDirectory

from analyses import results_of
from analyses.engine.wings import PACKAGE, ROOT, Tree, tree_of, wing_of
from analyses.pages.table import table_lines
from bayes_inertia.files import write_atomically

RESULT = results_of(__file__) / "size_of_the_house.json"
BEFORE = "d4b613c"  # version 0.4
CHANNELS = ("rate", "attitude", "momentum")
# Wings whose import arrows and floors are counted.
CORE = ("inference", "diagnosis")
_NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
_DOCUMENTED = ast.Module | ast.FunctionDef | ast.ClassDef


def counts(tree: Tree) -> dict[str, int]:
    """All counts of one state of the package, by what is counted."""
    sources = tree.sources.values()
    edges = {(importer, target) for importer, target in tree.imports()}
    importers = Counter(target for _, target in edges)
    lines = [lines_of(source) for source in sources]
    found = {
        "files": len(tree.sources),
        "lines": sum(source.count("\n") for source in sources),
        "lines of code": sum(code for code, _ in lines),
        "lines of docstrings": sum(docs for _, docs in lines),
        "deciding numbers at module level": sum(len(deciding_numbers(s)) for s in sources),
        "files that name all three channels": sum(names_all_channels(s) for s in sources),
        "of them, files that look channels up by these names": sum(
            looks_channels_up(s) for s in sources
        ),
        "modules with one importer": sum(number == 1 for number in importers.values()),
    }
    for wing in CORE:
        own = {(a, b) for a, b in edges if wing_of(a) == wing == wing_of(b)}
        found[f"import arrows inside {wing}"] = len(own)
        found[f"floors of {wing}"] = floors(own)
    return found


def lines_of(source: str) -> tuple[int, int]:
    """Lines of code and of docstrings.

    >>> lines_of('x = 1' + chr(10) + '# A comment.')
    (1, 0)
    """
    docs: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            docs |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    code = {k for t in tokens if t.type not in _NO_CODE for k in range(t.start[0], t.end[0] + 1)}
    return len(code - docs), len(docs)


def deciding_numbers(source: str) -> list[int | float]:
    """Numbers that assignments at module level state, tables (dictionaries) and types left out.

    >>> deciding_numbers("LIMIT, FEW = 0.9, 3")
    [0.9, 3]
    >>> deciding_numbers("UNITS = {'min': 60.0}")
    []
    """
    found: list[int | float] = []
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            found += _numbers(node.value)
    return found


def _numbers(node: ast.AST) -> list[int | float]:
    if isinstance(node, ast.Dict) or _is_annotated(node):
        return []
    own = (
        [node.value] if isinstance(node, ast.Constant) and type(node.value) in (int, float) else []
    )
    return own + [n for child in ast.iter_child_nodes(node) for n in _numbers(child)]


def _is_annotated(node: ast.AST) -> bool:
    if not isinstance(node, ast.Subscript) or not isinstance(node.value, ast.Name):
        return False
    return node.value.id == "Annotated"


def names_all_channels(source: str) -> bool:
    """Whether a file speaks of rate, attitude and momentum."""
    return all(re.search(rf"\b{channel}\b", source) for channel in CHANNELS)


def looks_channels_up(source: str) -> bool:
    """Whether all three names stand as texts of the program: as keys, not as words of physics.

    >>> looks_channels_up("rate, attitude = f(momentum)")
    False
    """
    nodes = ast.walk(ast.parse(source))
    return {n.value for n in nodes if isinstance(n, ast.Constant)}.issuperset(CHANNELS)


def floors(edges: set[tuple[str, str]]) -> int:
    """Modules of the longest chain of imports.

    >>> floors({("a", "b"), ("b", "c"), ("a", "c")})
    3
    """
    left, height = {name for edge in edges for name in edge}, 0
    while left:
        ground = left - {a for a, b in edges if a in left and b in left}
        left, height = left - ground, height + 1
    return height


def at_commit(commit: str) -> Tree:
    """The package as it stood at a commit."""
    archive = run(["git", "archive", commit, PACKAGE], cwd=ROOT, check=True, capture_output=True)
    with TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(folder, filter="data")
        return tree_of(Path(folder) / PACKAGE)


def page(before: dict[str, int], now: dict[str, int]) -> str:
    """Both counts side by side, in Markdown."""
    rows = [(what, f"{before[what]:,}", f"{number:,}") for what, number in now.items()]
    lines = [
        "# Size of the package",
        "",
        "Made by `python -m analyses.engine.size_of_the_house`. A deciding number is one that an "
        "assignment at module level states, outside tables and types. A floor is a step of the "
        "longest chain of imports inside a wing, an arrow one module that imports another.",
        "",
        *table_lines(("", "version 0.4", "now"), rows),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Count and write."""
    content = {"before": counts(at_commit(BEFORE)), "now": counts(tree_of(ROOT / PACKAGE))}
    write_atomically(RESULT, json.dumps(content, indent=1) + "\n")
    write_atomically(RESULT.with_suffix(".md"), text := page(**content))
    print(text)


if __name__ == "__main__":
    main()
