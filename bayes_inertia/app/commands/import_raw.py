"""`import`: raw logs of any mission become a campaign folder."""

from __future__ import annotations

import shlex
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.terminal import (
    headed,
    indented,
    plain_console,
    print_json,
    print_table,
    progress_bar,
    show_result,
)
from bayes_inertia.errors import SettingsError, require
from bayes_inertia.maths.printed import counted

if TYPE_CHECKING:
    from rich.console import Console

    from bayes_inertia.importing.import_logs import ImportedCampaign
    from bayes_inertia.importing.rest_noise import RestNoise
    from bayes_inertia.importing.slew_cutting import SlewWindow

START_FORMAT = "bayes-inertia-import-start/1"


def import_command(
    raw: list[Path],
    using: Path | None = None,
    start: Path | None = None,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Turn raw logs of any mission into a campaign folder.

    First `--start mapping.toml` writes a mapping with questions; fill it in. Then
    `--using mapping.toml -o CAMPAIGN` reads, converts and cuts the logs.
    """
    advice = (
        "write `--start mapping.toml` first, answer its questions, then "
        "`--using mapping.toml -o CAMPAIGN`"
    )
    exactly_one = (using is None) != (start is None)
    what = "either --start or --using is needed"
    require(exactly_one, "import", what, advice, error=SettingsError)
    if start is not None:
        _start(raw, start, as_json)
    elif using is not None:
        if out is None:
            what, advice = "no folder for the campaign", "add -o CAMPAIGN"
            raise SettingsError(what, where="import", advice=advice)
        with progress_bar() as progress:
            from bayes_inertia.importing.import_logs import import_logs
            from bayes_inertia.importing.mapped_lines import RECORD_FILE

            imported = import_logs(raw, using, out, progress=progress)
        show_result(imported.folder / RECORD_FILE, as_json, False, show_import, imported)


def _start(raw: list[Path], start: Path, as_json: bool) -> None:
    with progress_bar() as progress:
        progress("reading the columns of the logs", 0, 0)
        from bayes_inertia.importing.starting_mapping import write_starting_mapping

        started = write_starting_mapping(raw, start)
    left_over = "; ".join(_shortened(names) for names in started.left_over)
    what = f"no stream was recognised ({left_over or 'the files have times alone'})"
    advice = "it is written without one: add [[streams]] with the names of these columns"
    require(bool(started.streams), str(start), what, advice)
    if as_json:
        content = {"mapping": str(start), "questions": started.questions}
        content |= {"streams": started.streams, "not_recognised": started.left_over}
        print_json({"format": START_FORMAT, **content})
        return
    console = plain_console()
    questions = counted(started.questions, "question")
    console.print(headed(str(start), f": {questions} to answer"), soft_wrap=True)
    files = shlex.join(str(path) for path in raw) if len(raw) <= LAYOUT.files_named else "RAW..."
    console.print(f"then: bayes-inertia import {files} --using {start} -o CAMPAIGN", soft_wrap=True)
    if "rate" not in started.streams:
        console.print("no stream holds the rates, which an import needs")
    if left_over:
        console.print(f"not recognised: {left_over}", soft_wrap=True)


def _shortened(names: str) -> str:
    return textwrap.shorten(names, LAYOUT.longest_list, placeholder=" ...")


def show_import(imported: ImportedCampaign) -> None:
    """Print what an import read, cut and saw."""
    from bayes_inertia.importing.imported_folder import PICTURE_FILE, zero_of_clock
    from bayes_inertia.importing.mapped_lines import RECORD_FILE
    from bayes_inertia.report.words import dirt_sentences

    console = plain_console()
    slews, place = counted(len(imported.cut.windows), "slew"), f": {imported.folder}"
    console.print(headed(f"imported {slews}", place, style="bold green"), soft_wrap=True)
    console.print(f"times count from {zero_of_clock(imported.logs)}")
    _show_streams(imported)
    _show_slews(imported)
    _show_noise(console, imported.noises)
    for sentence in dirt_sentences([record.json() for record in imported.campaign.dirt]):
        console.print(sentence)
    if imported.logs.unused:
        console.print(f"read by no stream: {', '.join(imported.logs.unused)}")
    picture = f", {PICTURE_FILE}" if imported.cut.scan is not None else ""
    console.print(f"wrote campaign.toml, {RECORD_FILE}{picture}", soft_wrap=True)
    console.print(
        f"next: bayes-inertia doctor {imported.folder}  (do the conventions agree with physics?)",
        soft_wrap=True,
    )


def _show_streams(imported: ImportedCampaign) -> None:
    rows = []
    for key, stream in imported.logs.streams.items():
        names = [Path(file).name for file in stream.files]
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        rows.append((key, str(len(stream.time)), f"{stream.step:.4g}", names[0] + more))
    print_table(("stream", "readings", "step [s]", "files"), rows, ("files",))
    _say("imported_streams", imported.logs.streams)


def _say(what: str, *values: Any) -> None:
    """Print sentences on an import."""
    from bayes_inertia.report.words import sentences

    for line in sentences("commands", what, *values):
        plain_console().print(indented(line))


def _show_slews(imported: ImportedCampaign) -> None:
    cut = imported.cut
    rows = (
        (
            window.name,
            f"{window.start:.1f}",
            f"{window.end:.1f}",
            *_rests(window),
            "?" if window.turned is None else f"{np.degrees(window.turned):.1f}",
        )
        for window in cut.windows[: LAYOUT.slews_shown]
    )
    print_table(
        ("slew", "from [s]", "to [s]", "before (fixes)", "after (fixes)", "turned [deg]"), rows
    )
    _say("imported_slews", cut, "attitude" in imported.logs.streams, LAYOUT)


def _rests(window: SlewWindow) -> tuple[str, str]:
    """Length of the rests before and after a motion, and the fixes in them."""
    if window.motion is None or window.fixes is None:
        return "?", "?"
    lengths = (window.motion[0] - window.start, window.end - window.motion[1])
    before, after = (
        f"{max(seconds, 0.0):.1f} s ({fixes})"
        for seconds, fixes in zip(lengths, window.fixes, strict=True)
    )
    return before, after


def _show_noise(console: Console, noises: tuple[RestNoise, ...]) -> None:
    from bayes_inertia.report.formatting import exponent, unit_text

    if not noises:
        console.print("no rest is long enough to see the sensors' noise")
        return
    rows = []
    for noise in noises:
        power = exponent(max(noise.seen), 0.0)
        stated = "not stated" if noise.stated is None else _numbers(noise.stated, power)
        seen, unit = _numbers(noise.seen, power), unit_text(noise.unit, power)
        rows.append((noise.key, stated, seen, unit))
    print_table(("noise per sample", "stated", "at rest", "unit"), rows)
    _say("imported_noises", noises)


def _numbers(values: tuple[float, ...], power: int) -> str:
    """One number where all are the same."""
    from bayes_inertia.report.formatting import number

    texts = [number(value, value, power) for value in values]
    return texts[0] if len(set(texts)) == 1 else " ".join(texts)
