"""Errors of devices planted into other spacecraft, which another simulator flew.

    python -m analyses.naming.planted_devices [--simulator FILE] [--seeds 2] [--kinds cubesat ...]
    python -m analyses.naming.planted_devices --page

The simulator is no part of the repository: without its file the study is skipped. It flies a right
campaign; then one device is made wrong in what was telemetered of it, so that no equation of the
package serves as truth. The error is as large as an ideal test finds in 99 % among all candidates,
in a direction of its own, but never more than two sds of its prior. Appends a row a campaign to
`results/naming/planted_devices.jsonl`; campaigns whose rows are there are left out; writes
`planted_devices.md`. About a minute of processor time a campaign.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from analyses import made_rows, results_of, rows_of
from analyses.calibration.spacecraft import asked_for, flown, true_parameters
from analyses.naming.devices import POWER, size_found
from analyses.naming.fixed_shape_campaigns import scaled
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.errors import BayesInertiaError
from bayes_inertia.files import write_atomically
from bayes_inertia.physics.effects import by_name

ROWS = results_of(__file__) / "planted_devices.jsonl"
FIRST_SEED = 401
LARGEST = 2.0  # [prior sd] of an error: what is larger is no likely error
MEMS_AXES = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])

Table = np.ndarray  # (n, 1 + columns): time [s], then what was telemetered


def late(table: Table, tau: np.ndarray) -> Table:
    """Readings that are of a moment `tau` earlier than their stamps."""
    return np.column_stack([table[:, 0] + tau[0], table[:, 1:]])


def early(table: Table, tau: np.ndarray) -> Table:
    """What is told a time `tau` before it acts."""
    return late(table, -tau)


def too_weak(table: Table, gain: np.ndarray) -> Table:
    """Commands smaller than what acted by a factor."""
    return np.column_stack([table[:, 0], table[:, 1:] / (1.0 + gain[0])])


def turned(table: Table, angle: np.ndarray) -> Table:
    """Vectors seen in axes that are turned."""
    return np.column_stack([table[:, 0], table[:, 1:] @ Rotation.from_rotvec(angle).as_matrix()])


def turned_mems(table: Table, angle: np.ndarray) -> Table:
    """As `turned`, of a gyro whose axes are not the body's."""
    in_body = np.column_stack([table[:, 0], table[:, 1:] @ MEMS_AXES])
    again = turned(in_body, angle)
    return np.column_stack([again[:, 0], again[:, 1:] @ MEMS_AXES.T])


def offset(table: Table, value: np.ndarray) -> Table:
    """Readings with a constant error."""
    return np.column_stack([table[:, 0], table[:, 1:] + value])


def scale(table: Table, value: np.ndarray) -> Table:
    """Readings with an error in proportion to themselves."""
    return np.column_stack([table[:, 0], table[:, 1:] * (1.0 + value)])


def turned_attitude(table: Table, angle: np.ndarray) -> Table:
    """Attitudes of a star tracker that is turned in its mounting."""
    seen = Rotation.from_quat(table[:, 1:]) * Rotation.from_rotvec(angle)
    return np.column_stack([table[:, 0], seen.as_quat()])


class Planted(NamedTuple):
    """An error: in which spacecraft's stream, what it does, and what the package calls it."""

    kind: str
    stream: str
    does: Callable[[Table, np.ndarray], Table]
    effect: str


PLANTED = (
    Planted("wheels_mtq", "dipole", too_weak, "gain[torquers]"),
    Planted("wheels_mtq", "dipole", turned, "direction[torquers]"),
    Planted("thrusters", "torque", too_weak, "gain[thrusters]"),
    Planted("thrusters", "torque", turned, "direction[thrusters]"),
    Planted("two_gyros", "mems", late, "delay[mems]"),
    Planted("two_gyros", "mems", turned_mems, "misalignment[mems]"),
    Planted("cubesat", "magnetometer", offset, "offset[magnetometer]"),
    Planted("cubesat", "magnetometer", scale, "scale[magnetometer]"),
    Planted("cubesat", "magnetometer", turned, "misalignment[magnetometer]"),
    Planted("two_trackers", "tracker_2", turned_attitude, "misalignment[tracker 2]"),
    Planted("gyro_4skew", "gyro", late, "rate_sensor_delay"),
    Planted("gyro_2axis", "gyro", late, "rate_sensor_delay"),
    Planted("tracker_in_slew", "gyro", turned, "rate_sensor_misalignment"),
    Planted("pyramid", "gyro", turned, "rate_sensor_misalignment"),
    Planted("cmg", "gimbal", early, "delay[cluster]"),
    Planted("gyroless", "tracker", late, "star_tracker_time_offset"),
    Planted("torque_only", "gyro", late, "rate_sensor_delay"),
    Planted("speeds_only", "gyro", turned, "rate_sensor_misalignment"),
)


def error_of(campaign: Campaign, name: str, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """An effect's parameters that an ideal test finds, and their size [prior sd]."""
    (effect,) = (e.in_campaign(campaign) for e in by_name([name]))
    values, size, length = size_found(effect, campaign, rng)
    size = min(size, LARGEST / length)
    parameters = [np.atleast_1d(value) for value in scaled(values, size).values()]
    return np.concatenate(parameters), size * length


def row_of(simulator: Path, kind: str, effect: str, seed: int) -> dict:
    """One campaign flown, one device made wrong, and the diagnosis."""
    (planted,) = (one for one in PLANTED if (one.kind, one.effect) == (kind, effect))
    row: dict = {"kind": kind, "effect": effect, "seed": seed}
    with tempfile.TemporaryDirectory() as folder:
        clean, truth = flown(simulator, kind, seed, Path(folder))
        value, row["prior_sds"] = error_of(clean, effect, np.random.default_rng(seed))
        for path in Path(folder).glob(f"campaign/streams/slew_*_{planted.stream}.csv"):
            head = path.read_text().partition("\n")[0]
            table = planted.does(np.loadtxt(path, delimiter=",", skiprows=1), value)
            np.savetxt(path, table, "%.12g", ",", header=head, comments="")
        campaign = read_campaign(Path(folder) / "campaign")
    began = process_time()
    try:
        row |= _diagnosed(campaign, truth, seed)
    except BayesInertiaError as error:
        row["error"] = str(error)
    return row | {"seconds": process_time() - began}


def _diagnosed(campaign: Campaign, truth: dict, seed: int) -> dict:
    diagnosis = diagnose(campaign, seed=seed)
    quoted = quoted_parameters(diagnosis)
    true = true_parameters(truth)[: len(quoted.mean)]
    return {
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "ambiguous_with": [list(names) for names in diagnosis.ambiguous_with],
        "quoted_z": ((quoted.mean - true) / quoted.sd).tolist(),
    }


def is_found(row: dict) -> bool:
    """Whether the error is named, alone or as one of the answers."""
    answers = (row.get("named", ()), *row.get("ambiguous_with", ()))
    return any(row["effect"] in names for names in answers)


def page(rows: list[dict]) -> str:
    """The table of the study."""
    lines = [
        "# Errors of devices in other spacecraft",
        "",
        "Made by `python -m analyses.naming.planted_devices`: right campaigns of an independent",
        "simulator, one device made wrong in its telemetry, as much as an ideal test finds in",
        f"{100 * POWER:.0f} % (at most {LARGEST:g} sds of its prior). The",
        "spacecraft are those of [spacecraft](../calibration/spacecraft.md).",
        "",
        "| spacecraft | error | campaigns | size [prior sd] | named, or an answer | only name "
        "| other name | largest z of J and K |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind, _, _, effect in PLANTED:
        own = [row for row in rows if (row["kind"], row["effect"]) == (kind, effect)]
        if own:
            lines.append(f"| {kind} | {effect} | {_counted(own)} |")
    lines.append(f"| all | | {_counted(rows)} |")
    return "\n".join(lines) + "\n"


def _counted(rows: list[dict]) -> str:
    found = [row for row in rows if is_found(row)]
    alone = [row for row in found if row["verdict"] == "named"]
    wrong = [row for row in rows if row.get("named") and not is_found(row)]
    largest = max((np.abs(row["quoted_z"]).max() for row in rows if "quoted_z" in row), default=0.0)
    size = np.median([row["prior_sds"] for row in rows])
    counts = f"{len(found)} | {len(alone)} | {len(wrong)}"
    return f"{len(rows)} | {size:.2f} | {counts} | {largest:.1f}"


def main() -> None:
    """Fly, plant, diagnose and write."""
    options = asked_for(__doc__, seeds=2)
    if options is None:
        return
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    wanted = [(p, s) for s in seeds for p in PLANTED if p.kind in options.kinds]
    cases = [{"kind": p.kind, "effect": p.effect, "seed": s} for p, s in wanted]
    for row in made_rows(ROWS, () if options.page else cases, partial(row_of, options.simulator)):
        told = row.get("error") or (row["verdict"], row["named"], row["ambiguous_with"])
        print(row["kind"], row["effect"], row["seed"], told, f"{row['seconds']:.0f} s", flush=True)
    write_atomically(ROWS.with_suffix(".md"), page(rows_of(ROWS)))


if __name__ == "__main__":
    main()
