"""The wings of the package and what they import: `figures/wings.svg`, for CONTRIBUTING.md.

python -m analyses.engine.wings
"""

from __future__ import annotations

import ast
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "bayes_inertia"
# Rows of the picture from top to bottom; within a row wings do not know each other.
FLOORS = (
    ("app",),
    ("report", "studies"),
    ("observability", "diagnosis", "design"),
    ("inference", "flight"),
    ("physics", "importing", "conventions"),
    ("campaign",),
    ("faults",),
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
    "faults": "what is wrong with telemetry",
    "tables": "any file to columns",
    "maths": "quaternions, inertia tensors",
}
INK, FAINT, BOX = "#1f2933", "#7b8794", "#e4edf5"
BOX_HEIGHT = 0.52


@dataclass(frozen=True)
class Tree:
    """The modules of one state of the package."""

    sources: dict[str, str]  # {module name without the package's: source text}

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


def wing_of(module: str) -> str:
    """The wing of a module: its first part.

    >>> wing_of("physics.effects.rate_bias")
    'physics'
    """
    return module.split(".")[0]


def draw_wings(axes: Axes, tree: Tree) -> None:
    """Every wing as a box, with the arrows that are not implied by others."""
    pairs = ((wing_of(a), wing_of(b)) for a, b in tree.imports())
    arrows = {(a, b) for a, b in pairs if a != b and {a, b} <= set(SAYS)}
    place = {
        wing: ((k + 0.5) / len(row), -float(i))
        for i, row in enumerate(FLOORS)
        for k, wing in enumerate(row)
    }
    for a, b in _not_implied(arrows):
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
    with plt.rc_context({"svg.hashsalt": "wings", "svg.fonttype": "path"}):
        figure.savefig(path, format="svg", metadata={"Date": None})
    plt.close(figure)


def main() -> None:
    """Draw the picture."""
    figure, axes = plt.subplots(figsize=(8, 7), layout="constrained")
    draw_wings(axes, tree_of(ROOT / PACKAGE))
    save(figure, ROOT / "figures" / "wings.svg")


if __name__ == "__main__":
    main()
