"""Wrong keys of columns of all kinds of spacecraft: does doctor name them, and accuse no right one?

    python -m analyses.imports.conventions_kinds [--simulator FILE] [--seeds 1] [--kinds cmg ...]
    python -m analyses.imports.conventions_kinds --page

Campaigns are those of `analyses.calibration.spacecraft`, flown by its simulator and described by
keys alone; without its file the study is skipped. One key of a description is made wrong at a time.
Appends a row a key to `results/imports/conventions_kinds.jsonl`, keys whose rows are there are left
out; writes `conventions_kinds.md`. Some five seconds of processor time a key.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from time import process_time
from typing import Any

import tomlkit

from analyses import made_rows, results_of, rows_of
from analyses.calibration.spacecraft import ABOUT, FIRST_SEED, asked_for, flown
from analyses.pages.table import table_lines
from bayes_inertia.app.told_torques import check_conventions
from bayes_inertia.files import write_atomically

ROWS = results_of(__file__) / "conventions_kinds.jsonl"
CLOCK_S = 4.0  # by which a clock is made wrong, and how near to right its offset must be
NEAR_S = 0.4
SORTS = ("unit", "order", "sign", "frame", "clock")
# The campaigns of a kind, described without a sensor.
WITHOUT = {"cubesat_gyroless": ("cubesat", "gyro")}


def _swapped(values: Sequence) -> list:
    return [values[1], values[0], *values[2:]]


def _negated(values: Sequence, which: Sequence[int]) -> list:
    """Some numbers, vectors or names of columns with the other sign."""
    return [_other_sign(v) if k in which else v for k, v in enumerate(values)]


def _other_sign(value: Any) -> Any:
    if isinstance(value, str):
        return f"-{value}"
    return [-x for x in value] if isinstance(value, Sequence) else -value


# What was made wrong, the key, and what it does to the key's value.
Wrong = tuple[str, str, Callable[[Any], Any]]


def _other(value: str) -> Callable[[Any], str]:
    return lambda _: value


def _of_columns(key: str, unit: str, count: int, sign_of: str = "") -> Iterator[Wrong]:
    """Another unit, exchanged columns, each sign and all; `sign_of`: the vectors of the columns."""
    signs = sign_of or f"{key}.names"
    if unit:
        yield f"unit {unit}", f"{key}.unit", _other(unit)
    yield "order", f"{key}.names", _swapped
    for k in range(count):
        yield f"sign of {k + 1}", signs, partial(_negated, which=[k])
    yield "sign of all", signs, partial(_negated, which=range(count))


def _of_gyro(name: str, axes: int) -> Iterator[Wrong]:
    yield from _of_columns(f"sensors.{name}.rate", "deg/s", axes, f"sensors.{name}.axes")


def _of_torque(name: str) -> Iterator[Wrong]:
    yield from _of_columns(f"actuators.{name}.torque", "mN m", 3)
    yield "frame", f"actuators.{name}.torque.frame", _other("inertial")


_CLOCK: Wrong = ("clock", "sensors.gyro.rate.offset_s", lambda _: CLOCK_S)
WRONG: dict[str, Sequence[Wrong]] = {
    "gyro_2axis": (*_of_gyro("gyro", 2), _CLOCK),
    "gyro_4skew": (*_of_gyro("gyro", 4), _CLOCK),
    "two_gyros": (
        *_of_gyro("mems", 3),
        ("frame", "sensors.mems.axes", lambda axes: [list(row) for row in zip(*axes, strict=True)]),
    ),
    "thrusters": tuple(_of_torque("thrusters")),
    "body_torque": tuple(_of_torque("known")),
    "wheels_mtq": tuple(_of_columns("actuators.torquers.dipole", "mA m^2", 3)),
    "cmg": (
        *_of_columns("actuators.cluster.gimbal_angle", "deg", 4),
        ("sign of all spin axes", "actuators.cluster.spin_axes_at_zero",
         partial(_negated, which=range(4))),
        ("sign of a spin axis", "actuators.cluster.spin_axes_at_zero",
         partial(_negated, which=[1])),
    ),
    "cubesat": (
        *_of_columns("sensors.sun sensor.direction", "", 3),
        *_of_columns("sensors.magnetometer.direction", "nT", 3),
        *_of_columns("sensors.magnetometer.reference", "uT", 3),
        ("sign of the Sun", "sensors.sun sensor.reference_N", partial(_negated, which=range(3))),
    ),
}  # fmt: skip
WRONG |= {kind: WRONG[of] for kind, (of, _) in WITHOUT.items()}


def _place(document: Any, key: str) -> tuple[Any, str]:
    """The table that holds a key, and its last word."""
    *words, last = key.split(".")
    for word in words:
        is_list = isinstance(document, list)
        document = (
            next(entry for entry in document if entry["name"] == word)
            if is_list
            else document[word]
        )
    return document, last


def value_of(text: str, key: str) -> Any:
    """The value of a key in a description; None where it is not there."""
    table, last = _place(tomlkit.parse(text).unwrap(), key)
    return table.get(last)


def with_wrong(text: str, key: str, change: Callable[[Any], Any]) -> str:
    """A description with another value of a key."""
    document = tomlkit.parse(text)
    table, last = _place(document, key)
    table[last] = change(value_of(text, key))
    return tomlkit.dumps(document)


def is_right(text: str, key: str, mended: Any) -> bool:
    """Whether a proposed value is that of the right description."""
    right = value_of(text, key)
    if key.endswith("offset_s"):
        return bool(abs(mended - (right or 0.0)) < NEAR_S)
    if isinstance(right, list) and not isinstance(right[0], str):
        flat = [[x for row in rows for x in (row if isinstance(row, list) else [row])]
                for rows in (right, mended)]  # fmt: skip
        return all(abs(a - b) < 1e-6 for a, b in zip(*flat, strict=True))
    return bool(right == mended)


@cache
def _folder(simulator: Path, kind: str, seed: int) -> tuple[tempfile.TemporaryDirectory, Path]:
    """The campaign's folder, and what keeps it."""
    kept = tempfile.TemporaryDirectory()
    of, sensor = WITHOUT.get(kind, (kind, ""))
    flown(simulator, of, seed, Path(kept.name))
    folder = Path(kept.name) / "campaign"
    document = tomlkit.parse((folder / "campaign.toml").read_text())
    sensors = [each for each in document.unwrap()["sensors"] if each["name"] != sensor]
    if sensor:
        (folder / "campaign.toml").write_text(tomlkit.dumps(document | {"sensors": sensors}))
    return kept, folder


def row_of(simulator: Path, kind: str, seed: int, wrong: str) -> dict:
    """The check of one campaign, right (`wrong` empty) or with one wrong key."""
    folder = _folder(simulator, kind, seed)[1]
    text = (folder / "campaign.toml").read_text()
    key, other = "", text
    if wrong:
        key, change = next(w[1:] for w in WRONG[kind] if f"{w[0]}, {w[1]}" == wrong)
        other = with_wrong(text, key, change)
    (folder / "other.toml").write_text(other)
    began = process_time()
    check = check_conventions(folder / "other.toml")
    first = [change for change in check.changes if change.proposal == 1]
    named = [change for change in first if is_right(text, change.key, change.mended)]
    lines = [line for line in check.cannot_show if key and line.startswith(key)]
    return {
        "kind": kind,
        "seed": seed,
        "wrong": wrong,
        "verdict": check.verdict,
        "named": bool(first) and len(named) == len(first),
        "listed": bool(lines),
        "proposed": [[change.key, change.mended] for change in first],
        "misfits": check.misfits,
        "seconds": process_time() - began,
    }


ABOUT_PAGE = """Made by `python -m analyses.imports.conventions_kinds`: one key of a description
is made wrong, and `doctor` reads it. Named: each key of the first change that it proposes then has
its right value. Campaigns are those of [another simulator](../calibration/spacecraft.md), one key
after the other, so that rows of a kind are not independent. Accused: a right campaign whose verdict
is `wrong`, or for which a change is proposed. Listed: the verdict is not `wrong`, and `doctor`
lists the key under what the data cannot show. Where what is seen and what is looked at have
opposite signs, either may be wrong: no data tell which."""


def page(rows: list[dict]) -> str:
    """Tables of what was named and what was not."""
    kinds = [(k, [r for r in rows if r["kind"] == k]) for k in (*ABOUT, *WITHOUT)]
    lines = [(kind, *_cells(those)) for kind, those in kinds if those]
    head = ("spacecraft", "right ones accused", *SORTS, "all but listed ones")
    table = table_lines((*head, "processor time [s]"), [*lines, ("all", *_cells(rows))])
    missed = [
        (r["kind"], str(r["seed"]), r["wrong"], r["verdict"], _said(r))
        for r in rows
        if r["wrong"] and not r["named"]
    ]
    rest = table_lines(("spacecraft", "seed", "wrong key", "verdict", "said instead"), missed)
    head_2 = ["## Wrong keys that are not named", "", *rest, ""]
    return "\n".join(
        ["# Wrong keys of all kinds of spacecraft", "", ABOUT_PAGE, "", *table, "", *head_2]
    )


def _said(row: dict) -> str:
    """What was said of a wrong key that was not named."""
    keys = ", ".join(dict.fromkeys(key for key, _ in row["proposed"]))
    return keys or ("listed" if row["listed"] else "")


def _cells(rows: list[dict]) -> tuple[str, ...]:
    """Right campaigns accused, keys named by their sort and in all, median seconds."""
    right = [r for r in rows if not r["wrong"]]
    accused = sum(map(is_accused, right))
    wrong = [r for r in rows if r["wrong"]]
    by_sort = [[r for r in wrong if r["wrong"].startswith(sort)] for sort in SORTS]
    shown = [r for r in wrong if is_shown(r)]
    seconds = sorted(r["seconds"] for r in rows)[len(rows) // 2]
    named = [_named(those) for those in (*by_sort, shown)]
    return (f"{accused} of {len(right)}", *named, f"{seconds:.1f}")


def is_accused(row: dict) -> bool:
    """Whether doctor calls a description wrong, or proposes a change."""
    return row["verdict"] == "wrong" or bool(row["proposed"])


def is_shown(row: dict) -> bool:
    """Whether doctor does not list a wrong key under what the data cannot show."""
    return row["named"] or row["verdict"] == "wrong" or not row["listed"]


def _named(rows: list[dict]) -> str:
    return f"{sum(r['named'] for r in rows)} of {len(rows)}" if rows else ""


def main() -> None:
    """Simulate, check and write."""
    options = asked_for(__doc__, seeds=1)
    if options is None:
        return
    others = [kind for kind, (of, _) in WITHOUT.items() if of in options.kinds]
    cases = [
        {"kind": kind, "seed": seed, "wrong": wrong}
        for kind in (*options.kinds, *others)
        for seed in range(FIRST_SEED, FIRST_SEED + options.seeds)
        for wrong in ("", *(f"{what}, {key}" for what, key, _ in WRONG.get(kind, ())))
    ]
    for row in made_rows(ROWS, () if options.page else cases, partial(row_of, options.simulator)):
        said = "named" if row["named"] else "listed" if row["listed"] else ""
        print(row["kind"], row["seed"], row["wrong"] or "right", row["verdict"], said, flush=True)
    write_atomically(ROWS.with_suffix(".md"), page(rows_of(ROWS)))


if __name__ == "__main__":
    main()
