"""Strong effects of a shape that differs a little from the library's: are they named?

    python -m analyses.naming.nearly [--seeds 1] [--times 3 10 30] [--shapes "delayed wheels"]
    python -m analyses.naming.nearly --page

Each is flown by another simulator, as strong as an ideal test that knows it finds in 99 % of
campaigns, times 3, 10, 30; without tachometers such a test has no tachometers either. Appends to
`results/naming/nearly.jsonl`, a line a campaign; goes on where it stopped; with --page, writes
`nearly.md`. An hour of processor time.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import process_time

import numpy as np
from scipy.spatial.transform import Rotation

from analyses import made_rows, results_of, rows_of
from analyses.naming.fixed_shape import hash_of, quoted_z, truth_of
from analyses.naming.fixed_shape_campaigns import draw, without_tachometers
from analyses.naming.formulas import size_of
from analyses.naming.second_simulator import Disturbance, Instant, replayed
from analyses.pages.table import table_lines
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.plan_flight import Flight

FOLDER = results_of(__file__)
ROWS = FOLDER / "nearly.jsonl"
_KEY = 44_05
_TIMES = (3.0, 10.0, 30.0)


@dataclass(frozen=True)
class OfFlight(Disturbance):
    """A disturbance that knows the spacecraft and its commands."""

    flight: Flight

    @property
    def spin_inertia(self) -> np.ndarray:
        """Of the wheels [kg m^2]."""
        return np.array([w.spin_inertia for w in self.flight.spacecraft.wheels])


class DelayedWheels(OfFlight):
    """All commands act `size` milliseconds late, where the library has a first-order lag."""

    def torques(self, now):
        slew = next(s for s in reversed(self.flight.campaign.slews) if s.start <= now.t + 1e-6)
        row = np.searchsorted(slew.time, now.since - 1e-3 * self.size, side="right") - 1
        return np.zeros(3), np.asarray(slew.wheel_torque)[max(row, 0)] - now.command


class StribeckFriction(OfFlight):
    """Friction of `size` uN m that is half as large again where a wheel turns slowly."""

    def torques(self, now):
        speed = now.momentum / self.spin_inertia
        dip = 1.0 + 0.5 * np.exp(-((speed / 20.0) ** 2))
        return np.zeros(3), -1e-6 * self.size * np.tanh(speed) * dip


class TiltedFieldDipole(OfFlight):
    """A dipole of `size` mA m^2 in a field that is 5 degrees beside the campaign's."""

    def torques(self, now):
        field_B = Rotation.from_rotvec(np.radians(5.0) * np.array([0.6, -0.8, 0.0])).apply(
            now.field_B
        )
        along = np.array([0.5, -0.7, 0.5])
        return 1e-3 * self.size * np.cross(along, field_B), np.zeros(len(now.momentum))


class DriftingGain(OfFlight):
    """The wheels give `size` thousandths too much, a tenth of that more at the end."""

    def torques(self, now: Instant) -> tuple[np.ndarray, np.ndarray]:
        """More of the command."""
        first, last = self.flight.campaign.span
        drift = 1.0 + 0.1 * (now.t - first) / (last - first)
        each = np.array([1.0, -0.6, 0.4])[: len(now.command)]
        return np.zeros(3), 1e-3 * self.size * drift * each * now.command


# What flies, and the effects of the library that it nearly is.
SHAPES: Mapping[str, tuple[Callable[[float, Flight], Disturbance], tuple[str, ...]]] = {
    "delayed wheels": (DelayedWheels, ("wheel_command_lag", "rate_sensor_delay")),
    "Stribeck friction": (StribeckFriction, ("wheel_friction",)),
    "dipole in a tilted field": (TiltedFieldDipole, ("magnetic_dipole",)),
    "drifting gain": (DriftingGain, ("wheel_torque_gain",)),
}


def row_of(shape: str, seed: int, times: float, tachometers: bool) -> dict:
    """One campaign simulated and diagnosed."""
    make, right = SHAPES[shape]
    draws = np.random.SeedSequence(_KEY, spawn_key=(hash_of(shape), seed))
    flight = draw(draws, (), {}, True)

    def flown(size: float) -> Campaign:
        campaign = replayed(flight, make(size, flight), np.random.default_rng(seed))
        return campaign if tachometers else without_tachometers(campaign)

    size = times * size_of(flown)
    campaign = flown(size)
    began = process_time()
    diagnosis = diagnose(campaign, seed=seed)
    seconds = process_time() - began
    said = {name for names in (diagnosis.named, *diagnosis.ambiguous_with) for name in names}
    return {
        "shape": shape,
        "seed": seed,
        "times": times,
        "tachometers": tachometers,
        "size": size,
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "ambiguous_with": [list(names) for names in diagnosis.ambiguous_with],
        "right": bool(said & set(right)),
        "quoted_z": quoted_z(diagnosis, truth_of(flight)).tolist(),
        "seconds": seconds,
    }


def page() -> str:
    """The page of all rows."""
    rows = rows_of(ROWS)
    body = [
        [
            shape,
            "with" if measured else "without",
            *(_cell(rows, shape, measured, t) for t in _TIMES),
        ]
        for shape in SHAPES
        for measured in (True, False)
    ]
    held = [abs(z) < 1.645 for row in rows for z in row["quoted_z"]]
    lines = [
        "# Effects of nearly the library's shape",
        "",
        "Made by `python -m analyses.naming.nearly`, flown by another simulator: in how many",
        "campaigns the right name is named or in the set, and the verdicts. Sizes are times that",
        "which an ideal test finds in 99 % of campaigns.",
        "",
        *table_lines(["shape", "tachometers", *(f"{t:g} times" for t in _TIMES)], body),
        "",
        f"{sum(row['right'] for row in rows)} of {len(rows)} have the right name. 90 % intervals",
        f"of J and K hold in {100.0 * np.mean(held):.0f} % of {len(held)}.",
        "",
    ]
    return "\n".join(lines)


def _cell(rows: list[dict], shape: str, tachometers: bool, times: float) -> str:
    own = [
        row
        for row in rows
        if (row["shape"], row["tachometers"], row["times"]) == (shape, tachometers, times)
    ]
    verdicts = ", ".join(sorted({row["verdict"] for row in own}))
    return f"{sum(row['right'] for row in own)} of {len(own)} ({verdicts})" if own else ""


def main() -> None:
    """Simulate and diagnose, or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--times", type=float, nargs="+", default=_TIMES)
    parser.add_argument("--shapes", nargs="+", choices=list(SHAPES), default=list(SHAPES))
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if options.page:
        write_atomically(FOLDER / "nearly.md", page())
        return
    keys = "seed", "times", "tachometers", "shape"
    wanted = itertools.product(options.seeds, options.times, (True, False), options.shapes)
    cases = (dict(zip(keys, case, strict=True)) for case in wanted)
    for row in made_rows(ROWS, cases, row_of):
        told = [row[key] for key in (*keys, "verdict", "named", "ambiguous_with")]
        print(*told, f"{row['seconds']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
