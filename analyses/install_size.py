"""What an installation takes on the disk: the package's dependencies, and theirs.

    python analyses/install_size.py

writes `results/install_size.json`. It reads what is installed here.
"""

from __future__ import annotations

import json
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

from bayes_inertia.files import write_atomically

RESULT = Path(__file__).parent / "results" / "install_size.json"


def needed(name: str) -> set[str]:
    """All distributions that one needs, itself included; extras left out."""
    found, open_names = set(), [name]
    while open_names:
        found.add(current := open_names.pop())
        requirements = map(Requirement, distribution(current).requires or ())
        wanted = {
            requirement.name.lower().replace("_", "-")
            for requirement in requirements
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        }
        open_names += sorted(wanted - found)
    return found


def size(name: str) -> int:
    """Bytes of the installed files of a distribution."""
    paths = (Path(str(file.locate())) for file in distribution(name).files or ())
    return sum(path.stat().st_size for path in paths if path.is_file())


def main() -> None:
    """Measure and write."""
    sizes = {name: size(name) for name in sorted(needed("bayes-inertia"))}
    write_atomically(RESULT, json.dumps(sizes, indent=1) + "\n")
    print(f"{sum(sizes.values()) / 1e9:.2f} GB")


if __name__ == "__main__":
    main()
