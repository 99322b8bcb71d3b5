"""SUCHAI-3: which number of its CAD tensor is wrong, and what turns its spin?

    python -m analyses.suchai3.tumble

One fit of all sessions (gyro and magnetometer, free rotation), one of those of 2023, and one of
those of 2024. Without wheels or a known torque only ratios of J can be had. It writes
`results/suchai3/tumble.json`, `tumble.md` and `figures/suchai3.svg`. Ten minutes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from analyses import results_of
from analyses.suchai3.campaign import CAD, DEGREE, Setup, campaign
from analyses.suchai3.page import write_page
from analyses.suchai3.spin import histories, spin_history
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model

_QUANTILES = {"low": 0.05, "median": 0.5, "high": 0.95}
DRAWS, SEED = 20_000, 3
_BEFORE_2024 = 1.0e7  # [s] after the first session, between those of 2023 and 2024
RESULTS = results_of(__file__)


@dataclass(frozen=True)
class Ratios:
    """What free rotation tells of J, from draws (n,) of each."""

    draws: dict[str, np.ndarray]  # by name

    def summary(self) -> dict[str, dict[str, float]]:
        """Median and 90 % interval of each."""
        return {
            name: dict(zip(_QUANTILES, np.quantile(values, list(_QUANTILES.values())), strict=True))
            for name, values in self.draws.items()
        }


def ratios_of(tensors: np.ndarray) -> Ratios:
    """Ratios of principal moments and the direction of the spin axis, of tensors (n, 3, 3)."""
    moments, axes = np.linalg.eigh(tensors)
    small, middle, large = moments.T
    spin_B = axes[:, :, 2] * np.sign(axes[:, 1:2, 2])
    return Ratios(
        {
            "smallest over largest": small / large,
            "middle over largest": middle / large,
            "largest minus middle, in 1000 of the largest": 1e3 * (large - middle) / large,
            "nutation over spin": np.sqrt((large - small) * (large - middle) / (small * middle)),
            "spin axis towards x [deg]": np.arcsin(spin_B[:, 0]) / DEGREE,
            "spin axis towards z [deg]": np.arcsin(spin_B[:, 2]) / DEGREE,
        }
    )


def fitted(flown: Campaign) -> Estimate:
    """One fit."""
    return estimate(Model(flown), starts=1)


def numbers_of(found: Estimate) -> dict[str, Any]:
    """What the page says of a fit."""
    flown = found.model.campaign
    rng = np.random.default_rng(SEED)
    drawn = rng.multivariate_normal(found.theta, found.covariance, size=DRAWS, method="svd")
    Jxx, Jyy, Jzz, Jxy, Jxz, Jyz = drawn[:, :6].T
    tensors = np.moveaxis(np.array([[Jxx, Jxy, Jxz], [Jxy, Jyy, Jyz], [Jxz, Jyz, Jzz]]), -1, 0)
    names, sd = found.model.space.names, np.sqrt(np.diag(found.covariance))
    rows = zip(names, found.theta.tolist(), sd.tolist(), strict=True)
    return {
        "slews": len(flown.slews),
        "rows": sum(len(slew.time) for slew in flown.slews),
        "reduced_chi2": {name: test.reduced_chi2 for name, test in found.tests.items()},
        "ratios": ratios_of(tensors).summary(),
        "parameters": {name: {"mean": mean, "sd": s} for name, mean, s in rows},
        "spread_of_slews": _dispersion(found),
    }


def _dispersion(found: Estimate) -> dict[str, float] | None:
    scatter = found.slew_scatter
    return None if scatter is None else scatter.dispersion.json()


def main() -> None:
    """Fit, and write the page."""
    flown = campaign(Setup())
    first = flown.slews[0].start
    early = [slew.start - first < _BEFORE_2024 for slew in flown.slews]
    parts = {
        "all sessions": flown,
        "sessions of 2023": flown.subset([k for k, is_early in enumerate(early) if is_early]),
        "sessions of 2024": flown.subset([k for k, is_early in enumerate(early) if not is_early]),
    }
    found = {}
    for name, part in parts.items():
        found[name] = numbers_of(fitted(part))
        print(name, found[name]["reduced_chi2"], flush=True)
    spin = spin_history(flown, found["all sessions"]["parameters"])
    content = {
        "fits": found,
        "cad": {name: row["median"] for name, row in ratios_of(CAD[None]).summary().items()},
        "spin": spin.json(),
        "torques": [history.json() for history in histories(spin)],
    }
    RESULTS.mkdir(parents=True, exist_ok=True)
    write_atomically(RESULTS / "tumble.json", json.dumps(content, indent=1) + "\n")
    write_page()


if __name__ == "__main__":
    main()
