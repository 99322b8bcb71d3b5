"""Ranks, standardised errors and coverage of the fits of `ranks.py`."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

RANKED = 99  # posterior draws that the truth is ranked among: ranks 0 to 99
LEVELS = (0.5, 0.9, 0.99)
# The truth's rank among the package's draws, and among draws with two deliberate errors.
RANKS = {
    "rank": "posterior",
    "rank_shrunk": "sd shrunk by 20 %",
    "rank_held": "start states and bias held at their best values",
}


def band(n: int, level: float, *, seed: int = 0, trials: int = 4000) -> float:
    """Half width of the simultaneous band for the ECDF of n uniform ranks.

    It contains the whole ECDF with probability `level` (Säilynoja, Bürkner and Vehtari 2022, by
    simulation). In standard errors sqrt(p (1 - p) / n).

    >>> 2.5 < band(200, 0.95, trials=500) < 3.6
    True
    """
    ranks = np.random.default_rng(seed).integers(0, RANKED + 1, (trials, n))
    return float(np.quantile([np.abs(departure(r)).max() for r in ranks], level))


def departure(ranks: np.ndarray) -> np.ndarray:
    """ECDF of ranks minus that of uniform ones, in standard errors.

    At each possible rank but the last (99,).
    """
    p = np.arange(1, RANKED + 1) / (RANKED + 1)
    below = np.searchsorted(np.sort(ranks), np.arange(RANKED), side="right") / len(ranks)
    return (below - p) / np.sqrt(p * (1.0 - p) / len(ranks))


def uniformity(table: pd.DataFrame) -> pd.DataFrame:
    """Largest departure of each ECDF of ranks, by study and parameter.

    And the band (95 %) for all nine parameters at once.
    """
    rows = []
    for study, group in table.groupby("study", sort=False):
        n = group.campaign.nunique()
        limit = band(n, 0.95 ** (1 / group.parameter.nunique()))
        for parameter, fits in group.groupby("parameter", sort=False):
            for key in RANKS:
                largest = float(np.abs(departure(fits[key].to_numpy())).max())
                rows.append(
                    {
                        "study": study,
                        "parameter": parameter,
                        "ranks": key,
                        "largest": largest,
                        "band": limit,
                        "leaves": largest > limit,
                    }
                )
    return pd.DataFrame(rows)


def coverage(table: pd.DataFrame) -> pd.DataFrame:
    """How often intervals contain the truth, by study, parameter, level and kind.

    With 95 % Clopper-Pearson intervals.
    """
    rows = []
    for (study, parameter), fits in table.groupby(["study", "parameter"], sort=False):
        z = (fits.truth - fits["mean"]) / fits.sd
        for level in LEVELS:
            low, high = (fits[f"q{100 * (0.5 + half):g}"] for half in (-level / 2, level / 2))
            inside = {
                "sd": z.abs() <= stats.norm.ppf(0.5 + level / 2),
                "quantiles": (fits.truth >= low) & (fits.truth <= high),
            }
            for kind, hits in inside.items():
                interval = stats.binomtest(int(hits.sum()), len(hits)).proportion_ci(0.95)
                rows.append(
                    {
                        "study": study,
                        "parameter": parameter,
                        "level": level,
                        "kind": kind,
                        "share": hits.mean(),
                        **interval._asdict(),
                    }
                )
    return pd.DataFrame(rows)


def scores(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and sd of z = (truth - mean) / sd by study and parameter.

    And the contraction: how much of the prior's variance the data removed.
    """
    z = table.assign(
        z=(table.truth - table["mean"]) / table.sd,
        contraction=1.0 - (table.sd / table.prior_sd) ** 2,
    )
    return (
        z.groupby(["study", "parameter"], sort=False)
        .agg(mean_z=("z", "mean"), sd_z=("z", "std"), contraction=("contraction", "median"))
        .reset_index()
    )
