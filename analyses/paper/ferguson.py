"""What the analyses of Ferguson's paper share: its numbers, the simulated spacecraft, first-order
errors, results and their page.

Every analysis is one command, `python analyses/<name>.py [--quick] [--out FOLDER]`. It writes its
pictures to
`figures/`, its numbers to `analyses/results/paper/<name>.json`, and renews `analyses/PAPER.md` from
all results there are. Equal code gives equal files: all randomness is seeded, and pictures carry no
date.
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import Flight, fly
from bayes_inertia.flight.spacecraft import Controller, Spacecraft, most_like_spacecraft
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood import information_blocks
from bayes_inertia.inference.objective import normal_equations, prior_rows
from bayes_inertia.maths.inertia_tensor import ELEMENTS

ROOT = Path(__file__).resolve().parents[2]
NAMES = (*ELEMENTS, "K1", "K2", "K3")
ARCSEC = math.pi / (180.0 * 3600.0)  # [rad]
DEG = math.pi / 180.0  # [rad]
# The order of the page.
ANALYSES = (
    "paper_tables",
    "claim_misalignment",
    "claim_rate",
    "claim_torque_error",
    "claim_disturbances",
    "claim_starts",
)


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper: (9,) Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2], K1 K2 K3; `truth` None where
    nobody knows it.
    """

    initial: np.ndarray
    new: np.ndarray
    truth: np.ndarray | None = None


SIMULATION = PaperTable(  # Table 1
    np.array([3.3977, 2.1363, 1.8394, -0.0124, 0.0028, 0.0158, 1.0, 1.0, 1.0]),
    np.array([3.3461, 2.2060, 1.7965, -0.0023, 0.0017, 0.0222, 1.0099, 1.0228, 0.9792]),
    np.array([3.3311, 2.2024, 1.8033, -0.0119, 0.0027, 0.0161, 1.01, 1.02, 0.98]),
)
FLIGHT = PaperTable(  # Table 3
    np.array([3.4084, 2.1836, 1.6808, -0.0407, -0.0958, 0.0208, 1.0, 1.0, 1.0]),
    np.array([3.3853, 2.2168, 1.7868, -0.0273, -0.0033, 0.0052, 1.0072, 1.0028, 1.0037]),
)
SIMULATED_SLEW = (
    5.0 * DEG,
    349.0,
    140.0,
)  # Table 2: angle [rad], correction slew before and after [arcsec]
FLOWN_SLEW = (38.0 * DEG, 1641.0, 1020.0)  # Table 4


def tensor(theta: Sequence[float]) -> np.ndarray:
    """(3, 3) of the first six of nine parameters.

    >>> tensor(SIMULATION.truth)[0, 1].item()
    -0.0119
    """
    xx, yy, zz, xy, xz, yz = theta[:6]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def spacecraft_of(theta: Sequence[float], noise: float = 1.0, **changes) -> Spacecraft:
    """The MOST-like spacecraft with these J and K, and all its sensors `noise` times as noisy."""
    craft = most_like_spacecraft()
    sensor, tracker = craft.rate_sensor, craft.star_tracker
    noisy = {
        "wheels": tuple(replace(w, momentum_sigma=noise * w.momentum_sigma) for w in craft.wheels),
        "rate_sensor": replace(sensor, sigma=tuple(noise * s for s in sensor.sigma)),
        "star_tracker": StarTracker(
            tracker.boresight_B, noise * tracker.sigma_cross, noise * tracker.sigma_roll
        ),
    }
    return replace(
        craft,
        inertia_B=tensor(theta),
        scale_factor=tuple(float(k) for k in theta[6:9]),
        **(noisy | changes),
    )


def prior_of(
    theta: Sequence[float], relative_sigma: float = 0.04, product_sigma: float = 0.03
) -> InertiaPrior:
    """Pre-flight knowledge centred on an initial estimate."""
    return InertiaPrior(tensor(theta), relative_sigma, product_sigma)


def controller_of(theta: Sequence[float], **settings: float) -> Controller:
    """A controller that believes these J and K."""
    return Controller(tensor(theta), tuple(float(k) for k in theta[6:9]), **settings)


def flown(
    plan: Plan,
    craft: Spacecraft,
    initial: Sequence[float] = SIMULATION.initial,
    seed: int | None = 1,
    **prior: float,
) -> Flight:
    """A plan flown by a controller that believes an initial estimate, which is also the campaign's
    prior.
    """
    mission = Mission(craft, prior_of(initial, **prior))
    return fly(plan, mission, seed, controller=controller_of(initial))


def with_wheels(campaign: Campaign, **changes) -> Campaign:
    """The campaign with every wheel changed alike (`momentum_sigma=None`: without tachometers)."""
    wheels: tuple[Wheel, ...] = tuple(replace(w, **changes) for w in campaign.wheels)
    slews = campaign.slews
    if changes.get("momentum_sigma", 0.0) is None:
        slews = tuple(replace(s, wheel_momentum=None) for s in slews)
    return replace(campaign, wheels=wheels, slews=slews)


def with_sensor(campaign: Campaign, **changes) -> Campaign:
    """The campaign with another belief about its rate sensor."""
    sensor: RateSensor = replace(campaign.rate_sensor, **changes)
    return replace(campaign, rate_sensor=sensor)


@dataclass(frozen=True)
class Scatter:
    """How an estimator errs to first order: mean error (d,) from a prior that is centred elsewhere,
    and covariance (d, d).
    """

    mean: np.ndarray
    covariance: np.ndarray


def scatter(
    at: Estimate,
    offset: np.ndarray,
    noise: Sequence[float] = (1.0, 1.0, 1.0),
    *,
    prior: bool = True,
) -> Scatter:
    """Error of the estimate over repetitions of the campaign, were the noise of each channel
    `noise` times what `at` has.

    `offset` (d,): prior mean minus truth. `noise`: factor of the noise of each channel, known to
    the estimator. With Hessian H = F + P, theta-hat - truth = H^-1 (P offset + what noise and
    nuisances, drawn from their own priors, push): the covariance is H^-1 (H - P) H^-1, P the rows
    of J and K only.
    """
    weights = 1.0 / np.square(np.asarray(noise, float))
    info = at.information._replace(matrix=at.information.matrix * weights[None, :, None, None])
    H, _ = normal_equations(at.model, at.point, info)
    d = len(at.free)
    P = np.zeros_like(H)
    slope, _ = prior_rows(at.model, at.theta)
    P[np.arange(d), np.arange(d)] = slope[at.free] ** 2
    if not prior:
        H, P = H - P, np.zeros_like(P)
    inverse = np.linalg.inv(H)
    return Scatter(
        inverse[:d, :d] @ P[:d, :d] @ np.asarray(offset), (inverse @ (H - P) @ inverse)[:d, :d]
    )


@dataclass(frozen=True)
class Everything:
    """The normal equations of an estimate for ALL its parameters, also those that were held: what
    other fits would have found.
    """

    hessian: np.ndarray
    size: int

    @classmethod
    def of(cls, at: Estimate) -> Everything:
        """At the estimate's point and noise."""
        model, point = at.model, at.point
        info = information_blocks(model, point, at.white)
        return cls(normal_equations(model, point, info)[0], model.space.size)

    def _fitted(self, free: np.ndarray) -> np.ndarray:
        return np.concatenate([free, np.arange(self.size, len(self.hessian))])

    def sd(self, free: np.ndarray) -> np.ndarray:
        """sd of the parameters `free` if they are fitted and the others known."""
        fitted = self._fitted(free)
        return np.sqrt(np.diag(np.linalg.inv(self.hessian[np.ix_(fitted, fitted)])))[: len(free)]

    def left(self, free: np.ndarray, held: np.ndarray, value: np.ndarray) -> float:
        """Sum of squared residuals [sigma^2] that `held` parameters of this `value` leave after
        `free` and all nuisances are fitted to imitate them.
        """
        fitted = self._fitted(free)
        across = self.hessian[np.ix_(fitted, held)] @ value
        return float(
            value @ self.hessian[np.ix_(held, held)] @ value
            - across @ np.linalg.solve(self.hessian[np.ix_(fitted, fitted)], across)
        )

    def unmodelled(self, free: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Error of `free` (f, h) for each unit of what is in the data but not in the fit, to first
        order.

        The fitted columns move until they imitate the held ones as well as the noise asks.
        """
        fitted = self._fitted(free)
        return np.linalg.solve(
            self.hessian[np.ix_(fitted, fitted)], self.hessian[np.ix_(fitted, held)]
        )[: len(free)]


Claim = tuple[str, str, str]  # the paper, here, agree?


@dataclass(frozen=True)
class Table:
    """A table as printed: cells are text."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Result:
    """What an analysis found, in words."""

    name: str
    title: str
    claims: Sequence[Claim]  # rows "paper", "here", "agree?"
    tables: Sequence[Table] = ()
    figures: Sequence[tuple[str, str]] = ()  # file and caption
    notes: Sequence[str] = ()  # paragraphs
    numbers: dict[str, float] = field(default_factory=dict)  # what tests and readers may use


def save_picture(figure: Figure, path: Path) -> Path:
    """Write a PNG that depends on nothing but the picture: no date, no version."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_atomically(
        path, lambda temporary: figure.savefig(temporary, dpi=150, metadata={"Software": None})
    )


def write_result(result: Result, pictures: dict[str, Figure], out: Path) -> None:
    """Write an analysis' pictures and numbers, and renew the page."""
    for name, figure in pictures.items():
        save_picture(figure, out / "figures" / name)
    folder = out / "analyses" / "results" / "paper"
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(
        folder / f"{result.name}.json",
        json.dumps(asdict(result), indent=1, ensure_ascii=False) + "\n",
    )
    write_page(out)


def write_page(out: Path) -> Path:
    """`analyses/PAPER.md` from all results under `out`."""
    found = [
        json.loads(p.read_text(encoding="utf-8"))
        for n in ANALYSES
        if (p := out / "analyses" / "results" / "paper" / f"{n}.json").is_file()
    ]
    return write_atomically(
        out / "analyses" / "PAPER.md",
        "\n".join([*_INTRODUCTION, _overview(found), *map(_section, found)]),
    )


def _overview(found: list[dict]) -> str:
    rows = [
        f"| {paper} | {verdict} |" for result in found for paper, _, verdict in result["claims"]
    ]
    return "\n".join(["## In one table", "", "| the paper says | agree? |", "|---|---|", *rows, ""])


_INTRODUCTION = (
    "# Ferguson's paper, redone",
    "",
    "P. A. Ferguson, *On-Orbit Spacecraft Inertia and Rate Sensor Scale Factor Estimation "
    "for Microsatellites* (MOST), reported four",
    "tables and argued about what disturbs the method. "
    "Each section below is one command; it takes less than five minutes on two",
    "cores, is seeded, and writes the same bytes again. "
    "The numbers come from `analyses/results/paper/`, this page from `analyses/paper/ferguson.py`.",
    "",
    "**What can be compared.** The paper's telemetry, slew axes, sampling and noise are not "
    "public, nor are its figures reproduced here:",
    "we simulate a MOST-like spacecraft in closed loop (three wheels, rate sensor 2e-5 rad/s "
    'a sample at 4 Hz, star tracker 5" across',
    'and 30" about its boresight, five slews of 30 to 60 degrees at 1 deg/s) with the '
    "paper's own J and K, and draw the pictures",
    'that correspond to its figures 3 to 6. "WLS" is the weighted-least-squares point '
    "estimate, the paper's estimator (`estimate()`).",
    "",
)


def _section(result: dict) -> str:
    lines = [
        f"## {result['title']}",
        "",
        f"`python -m analyses.paper.{result['name']}`",
        "",
        "| paper | here | agree? |",
        "|---|---|---|",
    ]
    lines += [f"| {' | '.join(row)} |" for row in result["claims"]]
    for note in result["notes"]:
        lines += ["", note]
    for table in result["tables"]:
        lines += [
            "",
            f"**{table['caption']}**",
            "",
            f"| {' | '.join(table['header'])} |",
            "|" + "---|" * len(table["header"]),
        ]
        lines += [f"| {' | '.join(row)} |" for row in table["rows"]]
    for file, caption in result["figures"]:
        lines += ["", f"![{caption}](../figures/{file})", "", f"*{caption}*"]
    return "\n".join([*lines, ""])


def run(
    description: str,
    analysis: Callable[[bool], tuple[Result, dict[str, Figure]]],
    arguments: Sequence[str] | None = None,
) -> Result:
    """The command line of an analysis: `--quick` is a coarse variant, written to a temporary folder
    unless `--out` says where.
    """
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a coarse variant, for tests")
    parser.add_argument(
        "--out", type=Path, help="folder for figures/ and analyses/ (default: this project)"
    )
    given = parser.parse_args(arguments)
    out = given.out or (Path(tempfile.mkdtemp()) if given.quick else ROOT)
    result, pictures = analysis(given.quick)
    write_result(result, pictures, out)
    for paper, here, verdict in result.claims:
        print(f"paper: {paper}\n here: {here}\nagree: {verdict}\n")
    print(f"{', '.join(pictures)} in {out / 'figures'}; {out / 'analyses' / 'PAPER.md'}")
    return result
