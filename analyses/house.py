"""The house in numbers and pictures: what imports what, before the redraw into wings and now.

`python analyses/house.py` counts two trees of the package: of a past commit, and the present one.
It writes `analyses/results/house.md`, `figures/house.svg` (imports before and after) and
`figures/wings.svg` (the wings alone, for CONTRIBUTING.md). The past one needs the git history.
"""

from __future__ import annotations

import argparse
import ast
import re
import subprocess
import tarfile
import tempfile
from collections import Counter
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "bayes_inertia"
# The last commit in which all modules lay in one folder.
BEFORE = "2beddaa"
# Rows of the picture from top to bottom; within a row wings do not know each other.
FLOORS = (
    ("app",),
    ("report", "studies"),
    ("observability", "diagnosis", "design"),
    ("inference", "flight"),
    ("physics", "importing", "conventions"),
    ("campaign",),
    ("tables",),
    ("maths",),
)
SAYS = {
    "app": "commands, pipelines, run folders",
    "report": "the page and its pictures",
    "studies": "many tasks, one engine",
    "observability": "what is determined, and why not",
    "diagnosis": "which effect is missing",
    "design": "which slews to fly next",
    "inference": "likelihood, optimizer, sampler",
    "flight": "plans flown in closed loop",
    "physics": "effects, simulator, forward model",
    "importing": "raw logs to a campaign",
    "conventions": "units, signs, axes, clocks",
    "campaign": "what was flown: files to records",
    "tables": "any file to columns",
    "maths": "quaternions, inertia tensors",
}
INK, FAINT, BOX = "#1f2933", "#7b8794", "#e4edf5"
BOX_HEIGHT = 0.52


@dataclass(frozen=True)
class Tree:
    """The modules of one state of the package.

    Parameters
    ----------
    sources : dict
        {module name without the package's: source text}.
    """

    sources: dict[str, str]

    def imports(self) -> Counter[tuple[str, str]]:
        """How often each module imports from each other module: {(importer, imported): names}."""
        edges: Counter[tuple[str, str]] = Counter()
        for module, source in self.sources.items():
            for target in _targets(ast.parse(source), self.sources):
                if target != module:
                    edges[module, target] += 1
        return edges


def _targets(tree: ast.Module, modules: dict[str, str]) -> list[str]:
    """Modules of the package that a file imports, one entry a name."""
    targets = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith(PACKAGE):
            continue
        base = (node.module or "").removeprefix(PACKAGE).removeprefix(".")
        for alias in node.names:
            deeper = f"{base}.{alias.name}".removeprefix(".")
            targets.append(deeper if deeper in modules else base)
    return [target for target in targets if target in modules]


def tree_of(folder: Path) -> Tree:
    """The tree of a package folder."""
    paths = sorted(folder.rglob("*.py"))
    names = (".".join(p.relative_to(folder).with_suffix("").parts) for p in paths)
    named = {
        name.removesuffix("__init__").rstrip("."): path
        for name, path in zip(names, paths, strict=True)
    }
    return Tree({name: path.read_text(encoding="utf-8") for name, path in named.items() if name})


def tree_at(commit: str) -> Tree:
    """The tree of a past commit."""
    archive = subprocess.run(
        ["git", "archive", commit, PACKAGE], cwd=ROOT, check=True, capture_output=True
    ).stdout
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=BytesIO(archive)) as tar:
            tar.extractall(folder, filter="data")
        return tree_of(Path(folder) / PACKAGE)


def wing_of(module: str) -> str:
    """The wing of a module: its first part.

    >>> wing_of("physics.effects.rate_bias")
    'physics'
    """
    return module.split(".")[0]


def floors(edges: Counter[tuple[str, str]], modules: list[str]) -> dict[str, int]:
    """The import floor of each module: one above the highest that it imports, else 0."""
    below = {m: {b for a, b in edges if a == m} for m in modules}
    level: dict[str, int] = {}

    def height(module: str, path: tuple[str, ...] = ()) -> int:
        if module not in level:
            targets = below[module] - {module, *path}
            level[module] = 1 + max((height(t, (*path, module)) for t in targets), default=-1)
        return level[module]

    return {m: height(m) for m in modules}


def functions_of(source: str) -> list[tuple[str, int, ast.FunctionDef]]:
    """Name, lines without the docstring, and node of every function and method of a file."""
    rows = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            length = (node.end_lineno or 0) - node.lineno + 1
            first = node.body[0]
            if ast.get_docstring(node) is not None:
                length -= (first.end_lineno or 0) - first.lineno + 1
            rows.append((node.name, length, node))
    return rows


def documented_parameters(source: str) -> tuple[int, int]:
    """How many parameters of public functions a file documents, and how many it has."""
    done = total = 0
    for name, _, node in functions_of(source):
        if name.startswith("_"):
            continue
        text = ast.get_docstring(node) or ""
        arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        for argument in arguments:
            if argument.arg in ("self", "cls"):
                continue
            total += 1
            done += bool(re.search(rf"\b{argument.arg}\b[^:\n]{{0,60}} :", text))
    return done, total


def counts(tree: Tree) -> dict[str, str]:
    """The rows of the table for one tree."""
    lines = [line for source in tree.sources.values() for line in source.splitlines()]
    edges = tree.imports()
    modules = list(tree.sources)
    folders = {wing_of(m) for m in modules if "." in m}
    wings = folders if len(folders) > 4 else set()
    between = {(wing_of(a), wing_of(b)) for a, b in edges}
    between = {(a, b) for a, b in between if a != b and b in wings and a in wings}
    functions = [
        (length, f"{m}.{name}")
        for m, source in tree.sources.items()
        for name, length, _ in functions_of(source)
    ]
    parameters = [documented_parameters(source) for source in tree.sources.values()]
    done, total = (sum(x) for x in zip(*parameters, strict=True))
    longest_file = max((len(s.splitlines()), m) for m, s in tree.sources.items())
    return {
        "files": str(len(modules)),
        "files in the top folder": str(sum("." not in m and m not in folders for m in modules)),
        "wings": str(len(wings)) if wings else "none",
        "imports between modules": str(len(edges)),
        "import floors": str(1 + max(floors(edges, modules).values())),
        "arrows between wings": str(len(between)) if between else "-",
        "arrows that point up": str(len(upward(between))) if between else "-",
        "lines": str(len(lines)),
        "lines above 88 columns": f"{100 * sum(len(x) > 88 for x in lines) / len(lines):.1f} %",
        "lines above 100 columns": f"{100 * sum(len(x) > 100 for x in lines) / len(lines):.1f} %",
        "longest file": f"{longest_file[0]} lines ({longest_file[1]})",
        "longest function": "{} lines ({})".format(*max(functions)),
        "functions above 40 lines": str(sum(length > 40 for length, _ in functions)),
        "parameters of public functions documented": f"{done} of {total} ({done / total:.0%})",
    }


def upward(arrows: set[tuple[str, str]]) -> list[tuple[str, str]]:
    """Arrows that point up, or between wings of one floor."""
    floor = {wing: i for i, row in enumerate(FLOORS) for wing in row}
    return [(a, b) for a, b in sorted(arrows) if a in floor and b in floor and floor[a] >= floor[b]]


def draw_modules(axes: Axes, tree: Tree) -> None:
    """Every module as a dot on its import floor, every import as a line."""
    edges, modules = tree.imports(), list(tree.sources)
    level = floors(edges, modules)
    place = {}
    for floor in sorted(set(level.values())):
        row = sorted(m for m in modules if level[m] == floor)
        for i, module in enumerate(row):
            place[module] = ((i + 0.5) / len(row), floor)
    for a, b in edges:
        axes.plot(*zip(place[a], place[b], strict=True), color=FAINT, lw=0.25, zorder=1)
    for module, (x, y) in place.items():
        axes.plot(x, y, "o", color=INK, ms=2.5, zorder=2)
        axes.annotate(module.split(".")[-1], (x, y), (0, 3), textcoords="offset points",
                      ha="center", fontsize=4, color=INK)  # fmt: skip
    axes.set_axis_off()


def draw_wings(axes: Axes, tree: Tree, *, every: bool) -> None:
    """Every wing as a box; `every` used arrow, or only those that are not implied by others."""
    pairs = ((wing_of(a), wing_of(b)) for a, b in tree.imports())
    arrows = {(a, b) for a, b in pairs if a != b and {a, b} <= set(SAYS)}
    place = {
        wing: ((k + 0.5) / len(row), -float(i))
        for i, row in enumerate(FLOORS)
        for k, wing in enumerate(row)
    }
    for a, b in arrows if every else _not_implied(arrows):
        _arrow(axes, place[a], place[b])
    files = Counter(wing_of(m) for m in tree.sources if "." in m)
    for wing, (x, y) in place.items():
        _box(axes, x, y, wing, SAYS[wing], f"{files[wing]} files")
    axes.set(xlim=(0, 1), ylim=(-len(FLOORS) + 0.45, 0.55))
    axes.set_axis_off()


def _not_implied(arrows: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Arrows that no path of other arrows makes superfluous."""

    def reaches(start: str, end: str) -> bool:
        return any(b == end or reaches(b, end) for a, b in arrows if a == start)

    def by_a_detour(a: str, b: str) -> bool:
        return any(reaches(via, b) for start, via in arrows if start == a and via != b)

    return {(a, b) for a, b in arrows if not by_a_detour(a, b)}


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    above_each_other = abs(start[0] - end[0]) < 1e-6 and start[1] - end[1] > 1.5
    bend = f"arc3,rad={0.3 if above_each_other else 0.0}"
    style = {"arrowstyle": "-|>", "lw": 0.8, "color": FAINT, "connectionstyle": bend}
    half = 0.5 * BOX_HEIGHT
    tail, head = (start[0], start[1] - half), (end[0], end[1] + half)
    axes.annotate("", head, tail, arrowprops=style, zorder=1)


def _box(axes: Axes, x: float, y: float, name: str, says: str, size: str) -> None:
    width, height = 0.27, BOX_HEIGHT
    corner = (x - width / 2, y - height / 2)
    look = {"fc": BOX, "ec": INK, "lw": 0.8, "zorder": 2, "mutation_aspect": 6}
    rounded = "round,pad=0,rounding_size=0.02"
    axes.add_patch(FancyBboxPatch(corner, width, height, boxstyle=rounded, **look))
    text = {"ha": "center", "va": "center", "color": INK, "zorder": 3}
    axes.text(x, y + 0.12, name, fontsize=9, weight="bold", **text)
    axes.text(x, y - 0.06, says, fontsize=6, **text)
    axes.text(x, y - 0.18, size, fontsize=5.5, **text)


def save(figure: plt.Figure, path: Path) -> None:
    """Write a figure as SVG that is the same in every run."""
    with plt.rc_context({"svg.hashsalt": "house", "svg.fonttype": "path"}):
        figure.savefig(path, format="svg", metadata={"Date": None})
    plt.close(figure)


def main() -> None:
    """Count both trees, write the table and the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", default=BEFORE, help="commit to compare with")
    past, present = tree_at(parser.parse_args().before), tree_of(ROOT / PACKAGE)
    figure, (left, right) = plt.subplots(1, 2, figsize=(15, 8), layout="constrained")
    draw_modules(left, past)
    left.set_title(f"Before: {len(past.sources)} files, drawn by import floor")
    draw_wings(right, present, every=True)
    right.set_title(f"Now: {len(SAYS)} wings of {len(present.sources)} files, arrows only down")
    save(figure, ROOT / "figures" / "house.svg")
    figure, axes = plt.subplots(figsize=(8, 7), layout="constrained")
    draw_wings(axes, present, every=False)
    save(figure, ROOT / "figures" / "wings.svg")
    before, now = counts(past), counts(present)
    rows = [f"| {key} | {before[key]} | {now[key]} |" for key in now]
    table = "\n".join(["| | before | now |", "|---|---|---|", *rows])
    text = (
        "# The house, before and after it was redrawn into wings\n\n"
        "`python analyses/house.py`. Functions are counted without their docstrings.\n\n"
        f"{table}\n\n![Imports before and after](../../figures/house.svg)\n"
    )
    (ROOT / "analyses" / "results" / "house.md").write_text(text, encoding="utf-8")
    print(table)


if __name__ == "__main__":
    main()
