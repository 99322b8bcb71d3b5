"""What an installation takes on the disk: the package's dependencies, and theirs.

    python -m analyses.engine.install_size

writes `results/engine/install_size.json` and `.md`. It reads what is installed here, which must be
what tests need: pyarrow, mat-io and astropy, which the default no longer holds, are measured too.
"""

from __future__ import annotations

import json
import tomllib
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

from analyses import results_of
from bayes_inertia.files import write_atomically

RESULT = results_of(__file__) / "install_size.json"
PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
# What every installation held before it became an extra, or was replaced.
ONCE_NEEDED = ("astropy", "mat-io", "pyarrow")
# What computes, stores a posterior, and draws a report.
CORE = (
    *("jax", "jaxlib", "ml-dtypes", "numpy", "scipy", "pandas", "xarray", "h5py"),
    *("matplotlib", "contourpy", "fonttools", "kiwisolver", "pillow"),
)
# What was asked of the default installation.
ASKED = 600e6  # [bytes]


def needed(requirements: list[str]) -> set[str]:
    """All distributions that some requirements need, themselves included; extras left out."""
    found, still = set(), list(requirements)
    while still:
        requirement = Requirement(still.pop())
        name = requirement.name.lower().replace("_", "-")
        wanted = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if wanted and name not in found:
            found.add(name)
            still += distribution(name).requires or ()
    return found


def size(name: str) -> int:
    """Bytes of the installed files of a distribution."""
    paths = (Path(str(file.locate())) for file in distribution(name).files or ())
    return sum(path.stat().st_size for path in paths if path.is_file())


def page(sizes: dict[str, int], before: dict[str, int]) -> str:
    """The table as a page."""
    left_out = {name: before[name] for name in before.keys() - sizes.keys()}
    total, total_before = sum(sizes.values()), sum(before.values())
    floor = sum(sizes[name] for name in CORE)
    rows = sorted(sizes.items(), key=lambda item: -item[1])[:10]
    gone = sorted(left_out.items(), key=lambda item: -item[1])
    return "\n".join(
        [
            "# What an installation takes on the disk",
            "",
            "Files of the dependencies and theirs, in the versions of `constraints.txt`; without",
            "the bytecode that Python adds (0.15 GB where all of it is compiled).",
            "",
            "| | MB |",
            "|---|---|",
            f"| all that was needed before extras | {total_before / 1e6:.0f} |",
            *(f"| no longer: {name} | -{of / 1e6:.0f} |" for name, of in gone if of > 1e6),
            f"| default installation | {total / 1e6:.0f} |",
            f"| asked | {ASKED / 1e6:.0f} |",
            "",
            f"What computes, stores a posterior and draws a report ({', '.join(CORE)})",
            f"is {floor / 1e6:.0f} MB: no extras bring the default below what was asked.",
            "",
            "| largest | MB |",
            "|---|---|",
            *(f"| {name} | {of / 1e6:.0f} |" for name, of in rows),
            "",
            "Made by `python -m analyses.engine.install_size`.",
            "",
        ]
    )


def main() -> None:
    """Measure and write."""
    default = PROJECT["project"]["dependencies"]
    sizes = {name: size(name) for name in sorted(needed(default))}
    before = {name: size(name) for name in sorted(needed([*default, *ONCE_NEEDED]))}
    write_atomically(RESULT, json.dumps(sizes, indent=1) + "\n")
    write_atomically(RESULT.with_suffix(".md"), page(sizes, before))
    print(f"{sum(sizes.values()) / 1e9:.2f} GB, before {sum(before.values()) / 1e9:.2f} GB")


if __name__ == "__main__":
    main()
