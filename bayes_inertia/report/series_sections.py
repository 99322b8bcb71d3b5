"""What a series of campaigns, and a fleet, tell of J and K: sentences and sections."""

from __future__ import annotations

import numpy as np

from bayes_inertia.physics.parameters import base_names, base_units
from bayes_inertia.report.formatting import listed, number, unit_text
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures.series import draw_fleet, draw_history
from bayes_inertia.report.section import Section, Table, captioned
from bayes_inertia.report.words import phrase, sentences
from bayes_inertia.series.fleet import Fleet
from bayes_inertia.series.history import History

_PARAMETER = {"parameter": "", "unit": "extra"}
_OF_HISTORY = _PARAMETER | dict.fromkeys(("now", "sd", "change since the first"), "n")
_OF_FLEET = _PARAMETER | {
    "fleet's mean": "n",
    "sd": "n",
    "spread": "n",
    "90 % of the spread": "n extra",
    "sd of a craft alone": "n",
    "with its sisters": "n",
}
_SPREAD = "Spread: sd from craft to craft. The sds of a craft are medians over the fleet."


def history_answer(history: History) -> str:
    """One sentence: did J or K change?"""
    return phrase("plans", "history", history)


def history_table(history: History) -> Table:
    """Name, unit, value at the last campaign, change since the first, of each parameter."""
    rows: list[tuple[str, ...]] = []
    n = history.mean.shape[1]
    for k, (name, unit) in enumerate(zip(base_names(n), base_units(n), strict=True)):
        mean, sd = history.mean[:, k], history.sd[:, k]
        change = number(mean[-1] - mean[0], float(np.hypot(sd[0], sd[-1])))
        now = number(mean[-1], sd[-1]), number(sd[-1], sd[-1])
        rows.append((name, unit_text(unit), *now, change))
    return Table(_OF_HISTORY, rows, "many short")


def series_notes(series: History | Fleet) -> tuple[str, ...]:
    """What must be known of the numbers."""
    change = 0.0
    if isinstance(series, History):
        moments = series.mean[:, :3]
        change = float(np.ptp(moments, axis=0).max() / moments.mean())
    untied, left_out = series.is_scale_untied, series.left_out
    return tuple(sentences("plans", "series_notes", untied, left_out, change))


def history_sections(history: History) -> list[Section]:
    """The page of `history`, the answer first."""
    possible = [j for j in history.jumps if j.probability > LAYOUT.possible_change]
    changed = max(history.changed.values()) > LAYOUT.certain_change
    chances = listed([f"{part} {100.0 * p:.0f} %" for part, p in history.wanders.items()])
    jumps = (phrase("plans", "jump", history, jump) for jump in possible)
    result = history_table(history).section(
        "Result",
        captioned("history", draw_history(history)),
        sentence=history_answer(history),
        level="caution" if possible or changed else "good",
        more=f"Probability that it wanders from campaign to campaign: {chances}.",
        notes=(*jumps, *series_notes(history)),
    )
    return [result]


def fleet_answer(fleet: Fleet) -> str:
    """One sentence: how alike the spacecraft are, and what sisters are worth."""
    gain = np.median(fleet.alone_sd / fleet.craft_sd, axis=0)
    best, share = int(np.argmax(gain)), 100.0 * float(np.median(fleet.spread[:3] / fleet.mean[:3]))
    sharpest = fleet.names[best]
    n, apart = len(fleet.spacecraft), fleet.disagree
    return phrase("plans", "fleet", n, share, sharpest, gain[best], apart)


def fleet_table(fleet: Fleet) -> Table:
    """Name, unit, fleet's mean and sd, spread with its interval, sd of a craft alone and now."""
    rows: list[tuple[str, ...]] = []
    n = fleet.mean.size
    for k, (name, unit) in enumerate(zip(fleet.names, base_units(n), strict=True)):
        mean, sd, spread = fleet.mean[k], fleet.sd[k], fleet.spread[k]
        ends = (number(x, spread) for x in (fleet.spread_low[k], fleet.spread_high[k]))
        sds = (float(np.median(x[:, k])) for x in (fleet.alone_sd, fleet.craft_sd))
        common = number(mean, sd), number(sd, sd), number(spread, spread), " to ".join(ends)
        rows.append((name, unit_text(unit), *common, *(number(x, x) for x in sds)))
    return Table(_OF_FLEET, rows, "many short")


def fleet_sections(fleet: Fleet) -> list[Section]:
    """The page of `fleet`, the answer first."""
    result = fleet_table(fleet).section(
        "Result",
        captioned("fleet", draw_fleet(fleet)),
        sentence=fleet_answer(fleet),
        level="caution" if fleet.disagree else "good",
        notes=(_SPREAD, *series_notes(fleet)),
    )
    return [result]
