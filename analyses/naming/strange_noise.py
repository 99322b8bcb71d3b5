"""Noise that is not as stated, and nothing else wrong: is anything named for it?

    python -m analyses.naming.strange_noise [--seeds 3] [--kinds loud_fixes ...] [--page]

Campaigns of the package's own simulator with nothing hidden; the noise of one sensor is louder, in
one slew or one axis alone, has heavy tails, or grows with the rate. Appends a row a campaign to
`results/naming/strange_noise.jsonl`; campaigns whose rows are there are left out; writes
`strange_noise.md`. A quarter of a minute of processor time a campaign.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from analyses import made_rows, results_of, rows_of
from analyses.naming.fixed_shape import truth_of
from analyses.naming.fixed_shape_campaigns import draw
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.diagnosis.quoted_parameters import quoted_parameters
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.files import write_atomically

ROWS = results_of(__file__) / "strange_noise.jsonl"
FIRST_SEED = 7000
LOUD_SLEW = 2

Change = Callable[[Campaign, Slew, np.random.Generator], Slew]


def more_rate_noise(campaign: Campaign, slew: Slew, noise: np.ndarray) -> Slew:
    """The slew with noise (n, 3) [sigma of the rate sensor] beside that of its rates."""
    return replace(slew, rate=slew.rate + np.array(campaign.rate_sensor.sigma) * noise)


def turned(campaign: Campaign, slew: Slew, noise: np.ndarray) -> Slew:
    """The slew with its fixes turned by noise (n, 3) [sigma_cross of the star tracker]."""
    attitude, known = slew.attitude.copy(), np.isfinite(slew.attitude[:, 0])
    turns = Rotation.from_rotvec(campaign.star_tracker.sigma_cross * noise[known])
    attitude[known] = (Rotation.from_quat(attitude[known]) * turns).as_quat()
    return replace(slew, attitude=attitude)


def two_fixes(slew: Slew) -> Slew:
    """The slew with two fixes before its motion and two after it."""
    known = np.flatnonzero(np.isfinite(slew.attitude[:, 0]))
    before = slew.time[known] < 0.5 * slew.duration
    kept = np.concatenate([known[before][-2:], known[~before][:2]])
    attitude = np.full(slew.attitude.shape, np.nan)
    attitude[kept] = slew.attitude[kept]
    return replace(slew, attitude=attitude)


def _normal(rng: np.random.Generator, slew: Slew, sigmas: float) -> np.ndarray:
    return sigmas * rng.standard_normal((len(slew.time), 3))


def _tails(rng: np.random.Generator, slew: Slew) -> np.ndarray:
    return rng.standard_t(2.5, (len(slew.time), 3))


def _loud_wheels(campaign: Campaign, slew: Slew, rng: np.random.Generator) -> Slew:
    noise = 2.0 * max(w.momentum_sigma for w in campaign.wheels) * _tails(rng, slew)
    return replace(slew, wheel_momentum=slew.wheel_momentum + noise)


def _in_one_slew(change: Change) -> Change:
    return lambda c, s, rng: change(c, s, rng) if s is c.slews[LOUD_SLEW] else s


def _filtered(kernel: np.ndarray) -> Change:
    """Noise of the gyro twice as loud as its own that a filter of unit power has passed."""

    def change(campaign: Campaign, slew: Slew, rng: np.random.Generator) -> Slew:
        white = rng.standard_normal((len(slew.time) + len(kernel) - 1, 3))
        passed = np.stack([np.convolve(axis, kernel, "valid") for axis in white.T], -1)
        return more_rate_noise(campaign, slew, 2.0 * passed / np.sqrt(np.sum(kernel**2)))

    return change


# Kasdin (1995): the impulse response of a filter whose noise has a power of 1 / f.
_FLICKER = np.cumprod([1.0, *((k - 0.5) / k for k in range(1, 2000))])
# A line of five readings a period that lasts for ten of them.
_RINGING = np.exp(-np.arange(150.0) / 50.0) * np.cos(2.0 * np.pi * np.arange(150.0) / 5.0)


KINDS: dict[str, tuple[str, Change]] = {
    "as_stated": ("as stated", lambda c, s, rng: s),
    "loud_rates": (
        "gyro twice as loud",
        lambda c, s, rng: more_rate_noise(c, s, _normal(rng, s, 1.7)),
    ),
    "loud_fixes": (
        "star tracker eight times as loud, two fixes at rest",
        lambda c, s, rng: turned(c, two_fixes(s), _normal(rng, s, 8.0)),
    ),
    "one_axis": (
        "star tracker six times as loud about one axis",
        lambda c, s, rng: turned(c, s, _normal(rng, s, 6.0) * [1.0, 0.0, 0.0]),
    ),
    "one_slew_rates": (
        "gyro twice as loud in one slew",
        _in_one_slew(lambda c, s, rng: more_rate_noise(c, s, _normal(rng, s, 2.0))),
    ),
    "one_slew_fixes": (
        "star tracker four times as loud in one slew",
        _in_one_slew(lambda c, s, rng: turned(c, s, _normal(rng, s, 4.0))),
    ),
    "tails_of_rates": (
        "gyro with Student-t noise beside its own",
        lambda c, s, rng: more_rate_noise(c, s, 0.7 * _tails(rng, s)),
    ),
    "tails_of_fixes": (
        "star tracker with Student-t noise beside its own",
        lambda c, s, rng: turned(c, s, _tails(rng, s)),
    ),
    "tails_of_wheels": ("tachometers with Student-t noise beside their own", _loud_wheels),
    "with_rate": (
        "gyro whose noise grows with the rate",
        lambda c, s, rng: more_rate_noise(
            c, s, _normal(rng, s, 3.0) * np.abs(s.rate) / np.abs(s.rate).max()
        ),
    ),
    "flicker": ("gyro with flicker noise beside its own", _filtered(_FLICKER)),
    "mean_of_ten": ("gyro with means of ten readings beside its own", _filtered(np.ones(10))),
    "ringing": ("gyro with noise that rings beside its own", _filtered(_RINGING)),
}


def row_of(kind: str, seed: int) -> dict:
    """One campaign flown, its noise changed, and the diagnosis."""
    flight, rng = draw(np.random.SeedSequence(seed), (), {}, True), np.random.default_rng(seed)
    campaign, (_, change) = flight.campaign, KINDS[kind]
    slews = tuple(change(campaign, slew, rng) for slew in campaign.slews)
    diagnosis = diagnose(replace(campaign, slews=slews), seed=seed)
    quoted = quoted_parameters(diagnosis)
    return {
        "kind": kind,
        "seed": seed,
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "noise": diagnosis.noise,
        "noise_probabilities": diagnosis.noise_probabilities,
        "quoted_z": ((quoted.mean - truth_of(flight)) / quoted.sd).tolist(),
    }


def page(rows: list[dict]) -> str:
    """The table of the study."""
    lines = [
        "# Noise that is not as stated",
        "",
        "Made by `python -m analyses.naming.strange_noise`: campaigns with nothing hidden, the",
        "noise of one sensor changed. Right is `consistent`.",
        "",
        "| noise | campaigns | nothing named | `unknown` | a name | largest z of J and K |",
        "|---|---|---|---|---|---|",
    ]
    for kind, (title, _) in KINDS.items():
        own = [row for row in rows if row["kind"] == kind]
        if own:
            verdicts = [row["verdict"] for row in own]
            nothing, unknown = verdicts.count("consistent"), verdicts.count("unknown")
            largest = max(np.abs(row["quoted_z"]).max() for row in own)
            named = len(own) - nothing - unknown
            lines.append(
                f"| {title} | {len(own)} | {nothing} | {unknown} | {named} | {largest:.1f} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Fly, diagnose and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    cases = [{"kind": k, "seed": s} for s in seeds for k in options.kinds]
    for row in made_rows(ROWS, [] if options.page else cases, row_of):
        print(row["kind"], row["seed"], row["verdict"], row["named"], flush=True)
    write_atomically(ROWS.with_suffix(".md"), page(rows_of(ROWS)))


if __name__ == "__main__":
    main()
