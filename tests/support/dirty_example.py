"""The example's first two slews with dirt in the first."""

from __future__ import annotations

from pathlib import Path

import bayes_inertia

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
SLEWING = 170  # a row of the example in which the torque changes
PARTS = {"tachometers": ("wheel_momentum", "momentum_sigma"), "commands": ("wheel_torque",)}


def rows_of(text: str) -> tuple[list[str], list[list[str]]]:
    header, *lines = text.splitlines()
    return header.split(","), [line.split(",") for line in lines]


def dirty(folder: Path, change, without: str = "") -> Path:
    """The example's first two slews, the rows of the first changed."""
    folder.mkdir()
    toml = (EXAMPLE / "campaign.toml").read_text()
    head, first, second, *_ = toml.split("[[slews]]")
    left_out = PARTS.get(without, ())
    kept = [line for line in head.splitlines(True) if not line.startswith(left_out or "\0")]
    (folder / "campaign.toml").write_text("[[slews]]".join(["".join(kept), first, second]))
    for i in (1, 2):
        header, rows = rows_of((EXAMPLE / f"slew_0{i}.csv").read_text())
        changed = (change(header, rows) or rows) if i == 1 else rows
        lines = [",".join(row) for row in [header, *changed]]
        (folder / f"slew_0{i}.csv").write_text("\n".join(lines) + "\n")
    return folder


def kinds(campaign) -> list[tuple[str, str, str]]:
    return [(d.kind, d.channel, d.treated) for d in campaign.dirt]


def without_rows(*numbers: int):
    def change(header, rows):
        return [row for i, row in enumerate(rows) if i not in numbers]

    return change
