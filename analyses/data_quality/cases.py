"""Cases of `telemetry_faults.py`: folder, faults, treatment; and the row of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from analyses.data_quality.campaigns import HIDDEN, PULSED, SPACECRAFT, can_act, truth_in, written
from analyses.data_quality.faults import RawCampaign, read_raw, write_raw
from analyses.data_quality.kinds import KINDS, Kind
from analyses.data_quality.pipeline import (
    NAMES,
    Outcome,
    diagnosed,
    fitted,
    guarded,
    judged,
    uncleaned,
)

PARTS = ("table", "random", "uncleaned", "hidden", "throws", "diagnose", "fit")
# Campaigns of each spacecraft among which the random combinations choose.
_CAMPAIGNS = 6
_RANDOM = 200
_TREATMENTS: dict[str, Callable[[Path], Outcome]] = {
    "judged": judged,
    "uncleaned": uncleaned,
    "diagnosed": diagnosed,
    "fitted": fitted,
}


@dataclass(frozen=True)
class Case:
    """One folder made dirty and treated.

    `dirt` lists (kind, size); `origin` is a spacecraft, or the path of a campaign folder.
    """

    origin: str
    index: int
    dirt: tuple[tuple[str, float], ...]
    treatment: str = "judged"
    hidden: str = ""
    strength: float = 1.0
    seed: int = 0

    @property
    def label(self) -> str:
        """Unique within a part."""
        dirt = " + ".join(f"{kind} x{size:.2f}" for kind, size in self.dirt) or "clean"
        hidden = f", {self.hidden} x{self.strength:g}" if self.hidden else ""
        return f"{Path(self.origin).name} {self.index}{hidden}: {dirt}"

    def folder(self, work: Path) -> Path:
        """Of the campaign before dirt."""
        if self.origin in (*SPACECRAFT, *PULSED):
            return written(work, self.origin, self.index, self.hidden, self.strength)
        return Path(self.origin)


def dirty(case: Case, raw: RawCampaign) -> RawCampaign:
    """The campaign with the case's dirt, one kind after the other."""
    for k, (kind, size) in enumerate(case.dirt):
        raw = KINDS[kind].inject(raw, np.random.default_rng([case.seed, case.index, k]), size)
    return raw


def row_of(case: Case, work: Path) -> dict:
    """What became of a case, against its clean twin and the truth."""
    clean = case.folder(work)
    # A folder of its own: several parts may run at once.
    with TemporaryDirectory() as temporary:
        folder = write_raw(dirty(case, read_raw(clean)), Path(temporary))
        outcome = guarded(_TREATMENTS[case.treatment], folder)
    row = {
        "case": case.label,
        "origin": Path(case.origin).name,
        "index": case.index,
        "hidden": case.hidden,
        "strength": case.strength,
        "kinds": [kind for kind, _ in case.dirt],
        "sizes": [round(size, 3) for _, size in case.dirt],
        "status": outcome.status,
        "policy": outcome.policy,
        "says": outcome.says.replace(str(folder) + "/", ""),
        "dirt": _counted(outcome.dirt),
        "verdict": outcome.verdict,
        "named": list(outcome.named),
        "seconds": round(outcome.seconds, 2),
    }
    twin = outcome if not case.dirt else _twin(clean)
    return row | _distances(outcome, twin, truth_in(clean))


def _counted(dirt: tuple[dict, ...]) -> list[str]:
    """The records in short: kind, channel, treatment, rows; equal ones of several slews as one."""
    short: dict[str, int] = {}
    for d in dirt:
        key = f"{d['kind']} {d['channel']} {d['treated']}"
        short[key] = short.get(key, 0) + len(d["rows"])
    return [f"{key} ({rows})" if rows else key for key, rows in short.items()]


@lru_cache(maxsize=64)
def _twin(clean: Path) -> Outcome:
    """The clean campaign's fit, with a Laplace estimate; made once in a process."""
    return guarded(judged, clean)


def _distances(outcome: Outcome, twin: Outcome, truth: np.ndarray) -> dict:
    """Largest shift and distance from the truth in quoted sds, and of which element."""
    if outcome.theta is None:
        return {"shift": None, "z": None, "worst": "", "widened": None}
    # Of thrown bodies only the principal moments are known: no distance element by element.
    known = bool(np.isfinite(truth).all())
    z = (outcome.theta - truth) / outcome.sd if known else np.full(9, np.nan)
    # Fixes while slewing make the sd smaller than the twin's, most dirt makes it larger.
    shift = (outcome.theta - twin.theta) / np.maximum(outcome.sd, twin.sd)
    return {
        "shift": round(float(np.abs(shift).max()), 3),
        "z": round(float(np.abs(z).max()), 3) if known else None,
        "worst": NAMES[int(np.abs(z).argmax())] if known else "",
        "widened": round(float(np.median(outcome.sd / twin.sd)), 3),
    }


def cases(part: str, basilisk: Path | None = None, delft: Path | None = None) -> list[Case]:
    """All cases of a part; those of data that are not given are left out."""
    if part == "throws":
        names = ("config_a", "config_empty") if delft is not None else ()
        return [Case(str(delft / name), 0, ()) for name in names]
    if part == "table":
        return _table(basilisk)
    if part in ("random", "uncleaned"):
        treatment = "judged" if part == "random" else "uncleaned"
        return [_random(i, treatment) for i in range(_RANDOM)]
    if part == "hidden":
        return _hidden()
    return _diagnosed() if part == "diagnose" else _fitted()


def _table(basilisk: Path | None) -> list[Case]:
    """Every kind alone on every spacecraft, beside the clean campaigns."""
    origins = list(SPACECRAFT)
    if basilisk is not None:
        origins.append(str(basilisk / "clean_varied"))
    chosen = [(origin, kind) for kind in (None, *KINDS.values()) for origin in origins]
    return [
        Case(origin, 0, () if kind is None else ((kind.name, 1.0),), seed=11)
        for origin, kind in chosen
        if kind is None or _has(origin, kind)
    ]


def _has(origin: str, kind: Kind) -> bool:
    """Whether a spacecraft has the channel that a kind of dirt needs."""
    if kind.needs == "true_attitude":
        return origin in SPACECRAFT
    return origin != "no_tachometers" or kind.needs != "wheel_momentum"


def _random(number: int, treatment: str) -> Case:
    """One to three kinds of random size on a random campaign."""
    rng = np.random.default_rng([20262, number])
    origin = str(rng.choice(SPACECRAFT))
    possible = [kind for kind in KINDS.values() if _has(origin, kind)]
    chosen = rng.choice(len(possible), int(rng.integers(1, 4)), replace=False)
    ordered = sorted((possible[k] for k in chosen), key=lambda kind: kind.stage)
    dirt = tuple((kind.name, kind.size(rng)) for kind in ordered)
    return Case(origin, int(rng.integers(_CAMPAIGNS)), dirt, treatment, seed=1000 + number)


# With a hidden effect: dirt whose treatment could swallow it.
_WITH_HIDDEN = (("outliers in rate",), ("coloured rate, phi 0.9",), ("quantised rate",))
_STRENGTHS = (1.0, 4.0, 30.0)


def _hidden() -> list[Case]:
    """Every effect of the library, easily found, alone and with dirt."""
    first, *others = SPACECRAFT
    plans = [(first, strength, ()) for strength in _STRENGTHS]
    plans += [(origin, 4.0, ()) for origin in (*others, *PULSED)]
    plans += [(origin, 30.0, ()) for origin in PULSED]
    plans += [(first, 4.0, dirt) for dirt in _WITH_HIDDEN]
    return [
        Case(origin, 0, tuple((kind, 1.0) for kind in dirt), "judged", name, strength, 12)
        for origin, strength, dirt in plans
        for name in HIDDEN
        if can_act(name, origin)
    ]


_DIAGNOSED = (
    (),
    ("outliers in rate",),
    ("outliers in tachometers",),
    ("coloured rate, phi 0.5",),
    ("coloured rate, phi 0.9",),
    ("quantised rate",),
    ("rate noise stated 3 too small",),
    ("one rate axis stuck 3 s",),
)
_DIAGNOSED_HIDDEN = tuple(
    (name, dirt)
    for name in ("wheel_command_lag", "magnetic_dipole")
    for dirt in ((), ("outliers in rate",), ("coloured rate, phi 0.5",))
)


def _diagnosed() -> list[Case]:
    """Dirt alone must be consistent; with a hidden effect, that is still named."""
    first = SPACECRAFT[0]
    alone = [
        Case(first, 1, tuple((kind, 1.0) for kind in dirt), "diagnosed", seed=13)
        for dirt in _DIAGNOSED
    ]
    return alone + [
        Case(first, 1, tuple((kind, 1.0) for kind in dirt), "diagnosed", name, 4.0, 13)
        for name, dirt in _DIAGNOSED_HIDDEN
    ]


_FITTED = (
    "outliers in rate",
    "one rate axis stuck 3 s",
    "dropped rows",
    "rate noise stated 3 too small",
    "coloured rate, phi 0.9",
)


def _fitted() -> list[Case]:
    """The full fit of what the issue of dirty telemetry asks for by name."""
    return [Case(SPACECRAFT[0], 2, ((kind, 1.0),), "fitted", seed=14) for kind in _FITTED]
