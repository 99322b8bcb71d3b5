"""Writes a campaign as raw logs in every format that `import` reads, and compares what comes back.

    python -m analyses.imports.formats [CAMPAIGN] [--fit] [--out FOLDER]

Every format gets one log of all slews, with units, clocks and conventions of its own. The imported
campaign is held against the native one, channel by channel. With --fit the optimizer estimates J
and K of the native campaign and of those imports whose format rounds, and their shift is given in
standard deviations. The page is `results/imports/import_formats.md`.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import bayes_inertia
from analyses import results_of
from analyses.imports import formats_messages as messages
from analyses.imports import formats_tables as tables
from analyses.imports.formats_base import LogChannels, Written, utc_texts
from analyses.imports.mapping_text import head_of_mapping
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.importing.import_logs import import_logs

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
FIRST_UTC = np.datetime64("2026-03-01T12:00:00", "ns")
FORMATS: Mapping[str, Callable[[LogChannels, Path, np.datetime64], Written]] = {
    "CSV": tables.write_csv,
    "CSV of a spreadsheet (semicolons, decimal commas, UTF-16)": tables.write_spreadsheet,
    "TSV": tables.write_tsv,
    "Parquet": tables.write_parquet,
    "HDF5": tables.write_hdf5,
    "netCDF 4": tables.write_netcdf4,
    "netCDF 3": tables.write_netcdf3,
    "MAT 5, structs": tables.write_mat5,
    "MAT 7.3, structs": tables.write_mat73,
    "MAT 5, timeseries saved as structs": tables.write_timeseries,
    "AEM 1.0 KVN": messages.write_aem1,
    "AEM 1.0 XML": messages.write_aem1_xml,
    "AEM 2.0 KVN": messages.write_aem2,
    "AEM 2.0 XML": messages.write_aem2_xml,
    "JSON lines": messages.write_json,
    "npz of Basilisk recorders": messages.write_basilisk,
    "text of NASA 42": messages.write_42,
}
CHANNELS = ("rate", "wheel_torque", "wheel_momentum", "attitude")
ROUNDED = 1e-8  # Relative difference above which a format rounds.


@dataclass(frozen=True)
class Comparison:
    """How an import differs from the native campaign."""

    name: str  # the format
    what: str  # its clock, units and conventions
    time_s: float  # largest difference of a time stamp [s]
    # Largest difference of each channel, relative to its largest reading.
    relative: Mapping[str, float]
    campaign: Campaign  # the imported campaign


def channels_of(campaign: Campaign) -> LogChannels:
    """All slews of a campaign one after the other."""
    join = {
        name: np.concatenate([getattr(slew, name) for slew in campaign.slews]) for name in CHANNELS
    }
    time = np.concatenate([slew.start + slew.time for slew in campaign.slews])
    return LogChannels(np.round(time, 9), *(join[name] for name in CHANNELS))


def stated_slews(campaign: Campaign) -> str:
    """The slews of a mapping."""
    slews = ""
    for slew in campaign.slews:
        # A millisecond more on both sides, for stamps that a format rounds.
        ends = (slew.start + slew.time[0] - 1e-3, slew.start + slew.time[-1] + 1e-3)
        start, end = (utc_texts(np.array([at]), FIRST_UTC)[0] + "Z" for at in ends)
        slews += f'\n[[slews]]\nname = "{slew.name}"\nstart = "{start}"\nend = "{end}"\n'
    return slews


def compared(
    name: str,
    write: Callable[[LogChannels, Path, np.datetime64], Written],
    campaign: Campaign,
    folder: Path,
) -> Comparison:
    """One format there and back."""
    folder.mkdir(parents=True)
    native = channels_of(campaign)
    written = write(native, folder, FIRST_UTC)
    mapping = folder / "mapping.toml"
    head = head_of_mapping(campaign) + stated_slews(campaign)
    mapping.write_text(head + written.streams, encoding="utf-8")
    imported = read_campaign(import_logs(written.files, mapping, folder / "campaign").folder)
    return _difference(name, written.what, campaign, imported)


def _difference(name: str, what: str, native: Campaign, imported: Campaign) -> Comparison:
    time, worst = 0.0, dict.fromkeys(CHANNELS, 0.0)
    for old, new in zip(native.slews, imported.slews, strict=True):
        stamps = (old.start + old.time) - (new.start + new.time)
        stamps -= native.slews[0].start - imported.slews[0].start
        time = max(time, float(np.abs(stamps).max()))
        for channel in CHANNELS:
            before, after = getattr(old, channel), getattr(new, channel)
            if not np.array_equal(np.isfinite(before), np.isfinite(after)):
                raise ValueError(f"{name}: {channel} has other readings than the native campaign")
            if channel == "attitude":  # q and -q are one attitude.
                after = after * np.sign(np.sum(before * after, axis=1, keepdims=True))
            size = np.nanmax(np.abs(before))
            worst[channel] = max(worst[channel], float(np.nanmax(np.abs(after - before)) / size))
    return Comparison(name, what, time, worst, imported)


def largest_shift(native: Campaign, imported: Campaign) -> float:
    """Largest shift of J and K between the estimates of two campaigns."""
    from bayes_inertia import Model, estimate

    first, second = (estimate(Model(campaign)) for campaign in (native, imported))
    return float(np.max(np.abs(second.theta - first.theta)[:9] / first.sd[:9]))


def page(campaign: Campaign, rows: list[Comparison], shifts: Mapping[str, float]) -> str:
    """The table of all formats."""
    lines = [
        "# Raw logs in 17 formats",
        "",
        f"Campaign: {campaign.name}.",
        "Made by `python -m analyses.imports.formats CAMPAIGN --fit`. Each row is one log of all",
        "slews, imported with a mapping. Differences are the largest ones to the native campaign,",
        "relative to the largest reading of the channel. Where a format itself rounds (42 prints",
        "six decimals), the last column says by how many standard deviations the estimates of J",
        "and K shift.",
        "",
        "| format | clock, units, conventions | time [s] | rate | torque | momentum | attitude "
        "| shift [sd] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        shift = f"{shifts[row.name]:.3f}" if row.name in shifts else "-"
        numbers = " | ".join(f"{row.relative[channel]:.1e}" for channel in CHANNELS)
        lines.append(f"| {row.name} | {row.what} | {row.time_s:.1e} | {numbers} | {shift} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write, import and compare every format."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", nargs="?", type=Path, default=EXAMPLE)
    parser.add_argument("--fit", action="store_true", help="estimate J and K where a format rounds")
    parser.add_argument("--out", type=Path, default=results_of(__file__))
    given = parser.parse_args()
    campaign = read_campaign(given.campaign)
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for number, (name, write) in enumerate(FORMATS.items()):
            rows.append(compared(name, write, campaign, Path(folder) / f"{number:02}"))
            worst = max(rows[-1].relative.values())
            print(f"{name}: largest relative difference {worst:.1e}, time {rows[-1].time_s:.1e} s")
        shifts = {}
        for row in rows if given.fit else []:
            if max(row.relative.values()) > ROUNDED:
                shifts[row.name] = largest_shift(campaign, row.campaign)
                print(f"{row.name}: J and K shift by at most {shifts[row.name]:.3f} sd")
    given.out.mkdir(parents=True, exist_ok=True)
    write_atomically(given.out / "import_formats.md", page(campaign, rows, shifts))


if __name__ == "__main__":
    main()
