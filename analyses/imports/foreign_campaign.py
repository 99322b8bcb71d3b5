"""A campaign comes back from another mission's raw logs: its numbers and its posterior.

    python -m analyses.imports.foreign_campaign [CAMPAIGN] [--out FILE.md] [--optimum-only]

writes `results/imports/foreign_campaign.md`. The campaign (by default
`../shared/data/basilisk/clean_varied`) is written as raw logs by `foreign_logs.py`, imported from
them, and fitted; so is the native campaign with the same readings, twice, with other seeds: the two
native fits show what the sampler's own error is. A log without a pause, whose rests are made by the
same physics as its slews (`continuous_log.py`), is cut by the defaults and held against the same
slews cut as flown.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np

from analyses import results_of
from analyses.imports.continuous_log import continuous_log
from analyses.imports.foreign_logs import ForeignLogs, write_foreign_logs
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.importing.import_logs import import_logs
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.physics.forward_model import Model

DATA = Path(__file__).parents[3] / "shared" / "data" / "basilisk" / "clean_varied"
NAMES = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3")
CHANNELS = ("time", "rate", "wheel_torque", "wheel_momentum", "attitude")


def moments(posterior: Posterior) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, sd and Monte Carlo standard error of J and K."""
    import arviz as az

    data = posterior.tree["posterior"].dataset
    values = {name: np.asarray(data[name]) for name in NAMES}
    mean = np.array([values[name].mean() for name in NAMES])
    sd = np.array([values[name].std() for name in NAMES])
    error = np.array([float(az.mcse(values[name], method="mean")) for name in NAMES])
    return mean, sd, error


def largest_difference(native: Campaign, imported: Campaign) -> dict[str, float]:
    """Largest difference of the numbers of each channel; infinite where rows differ."""
    differences = dict.fromkeys(CHANNELS, 0.0)
    for a, b in zip(native.slews, imported.slews, strict=True):
        for channel in CHANNELS:
            x, y = np.asarray(getattr(a, channel)), np.asarray(getattr(b, channel))
            same = x.shape == y.shape and bool((np.isnan(x) == np.isnan(y)).all())
            largest = float(np.nanmax(np.abs(x - y))) if same else np.inf
            differences[channel] = max(differences[channel], largest)
    return differences


def compared(
    name: str, native: Sequence[np.ndarray], other: Sequence[np.ndarray]
) -> tuple[str, float, float]:
    """A row of the table: largest differences of the means and of the sds."""
    difference = np.abs(other[0] - native[0])
    in_errors = float((difference / np.hypot(native[2], other[2])).max())
    in_sds = float((difference / native[1]).max())
    wider = other[1] / native[1]
    row = f"| {name} | {in_errors:.1f} | {in_sds:.3f} | {wider.min():.3f} to {wider.max():.3f} |"
    return row, in_errors, in_sds


def optima(campaigns: dict[str, Campaign]) -> list[str]:
    """Rows of a table: the optimum of J and K against that of the first campaign."""
    rows = []
    first = None
    for name, campaign in campaigns.items():
        estimate = optimizer.estimate(Model(campaign, (), None), seed=1)
        theta, sd = np.asarray(estimate.theta)[:9], np.asarray(estimate.sd)[:9]
        first = first or (theta, sd)
        moved, wider = np.abs(theta - first[0]) / first[1], sd / first[1]
        rows.append(f"| {name} | {moved.max():.1g} | {wider.min():.3f} to {wider.max():.3f} |")
    return rows


def main() -> None:
    """Write, import, fit, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("campaign", type=Path, nargs="?", default=DATA)
    parser.add_argument("--out", type=Path, default=results_of(__file__) / "foreign_campaign.md")
    parser.add_argument("--optimum-only", action="store_true", help="do not sample posteriors")
    arguments = parser.parse_args()
    if not arguments.campaign.exists():
        parser.exit(message=f"skipped: {arguments.campaign} is not there\n")
    campaign = read_campaign(arguments.campaign)
    with tempfile.TemporaryDirectory() as folder:
        lines = _study(campaign, Path(folder), arguments.campaign.name, not arguments.optimum_only)
    write_atomically(arguments.out, "\n".join(lines) + "\n")
    print("\n".join(lines))


def _study(campaign: Campaign, folder: Path, name: str, sampled: bool) -> list[str]:
    """The page, line by line."""
    logs = {
        kind: write_foreign_logs(campaign, folder / kind, tracker=kind) for kind in ("aem", "csv")
    }
    native = logs["aem"].native
    began = perf_counter()
    imported = {
        kind: _imported(logs[kind], logs[kind].mapping, folder / f"c_{kind}") for kind in logs
    }
    seconds = (perf_counter() - began) / len(imported)
    paused = write_foreign_logs(campaign, folder / "paused", tracker="csv", between_slews=False)
    divided = _imported(paused, paused.mapping_to_cut, folder / "c_divided")
    numbers = [
        f"| {kind} | "
        + " | ".join(f"{value:.1g}" for value in largest_difference(native, c).values())
        + " |"
        for kind, c in imported.items()
    ]
    campaigns = {
        "native": native,
        "star tracker as AEM 2.0": imported["aem"],
        "as scalar-first CSV": imported["csv"],
        "logged about the slews only, cut by the defaults": divided,
    }
    return [
        "# A campaign from another mission's raw logs",
        "",
        f"`analyses/imports/foreign_campaign.py` wrote `{name}` as raw logs (gyro in deg/s "
        "against UTC, "
        "wheels in rpm and mN m against GPS seconds, star tracker as AEM 2.0 or as scalar-first "
        "body-to-inertial CSV; three rates, three clocks that are off, one log for all slews) and "
        f"imported them; one import takes {seconds:.1f} s.",
        "",
        "Largest differences of the imported numbers (SI units):",
        "",
        f"| star tracker | {' | '.join(CHANNELS)} |",
        f"|---{'|---' * len(CHANNELS)}|",
        *numbers,
        "",
        "Optima of J and K against the native one, the largest of nine, in its sds:",
        "",
        "| campaign | optimum, in sd | ratio of sds |",
        "|---|---|---|",
        *optima(campaigns),
        "",
        f"The log with pauses between the slews has {_rows(divided)} rows, the native campaign "
        f"{_rows(native)}.",
        *(_posteriors(campaigns) if sampled else []),
        *_without_a_pause(campaign, folder, sampled),
    ]


def _rows(campaign: Campaign) -> int:
    return sum(len(slew.time) for slew in campaign.slews)


def _without_a_pause(template: Campaign, folder: Path, sampled: bool) -> list[str]:
    """A log whose rests physics made, cut by the defaults, against the slews as flown."""
    whole, flown = continuous_log(template)
    logs = write_foreign_logs(whole, folder / "whole", tracker="csv", between_slews=False)
    cut = _imported(logs, logs.mapping_to_cut, folder / "c_whole")
    campaigns = {"native": flown, "cut by the defaults": cut}
    starts = [abs(a.start - b.start) for a, b in zip(flown.slews, cut.slews, strict=True)]
    return [
        "",
        "## One log without a pause",
        "",
        f"{len(flown.slews)} slews and the rests between them in one log of "
        f"{whole.slews[0].duration:.0f} s, all from one integration in closed loop "
        "(`analyses/imports/continuous_log.py`); nothing is stated about the slews. The "
        "defaults keep "
        f"{_rows(cut)} rows, the slews as flown have {_rows(flown)}; their beginnings differ by at "
        f"most {max(starts):.1f} s.",
        "",
        "| campaign | optimum, in sd | ratio of sds |",
        "|---|---|---|",
        *optima(campaigns),
        *(_posteriors(campaigns) if sampled else []),
    ]


def _posteriors(campaigns: dict[str, Campaign]) -> list[str]:
    """Sampled posteriors against the native one."""
    first = moments(fit(campaigns["native"], seed=1))
    again = compared("native, another seed", first, moments(fit(campaigns["native"], seed=2)))[0]
    others = [
        compared(name, first, moments(fit(campaign, seed=3 + k)))[0]
        for k, (name, campaign) in enumerate(campaigns.items())
        if name != "native"
    ]
    return [
        "",
        "Posteriors of J and K against the native one, the largest of nine:",
        "",
        "| fit | mean, in Monte Carlo errors | mean, in sd | ratio of sds |",
        "|---|---|---|---|",
        again,
        *others,
        "",
        "The largest of nine differences that are sampling noise alone exceeds 3.0 Monte Carlo "
        "errors in 2.4 % of the cases.",
    ]


def _imported(logs: ForeignLogs, mapping: Path, folder: Path) -> Campaign:
    return read_campaign(import_logs(logs.files, mapping, folder).folder)


if __name__ == "__main__":
    main()
