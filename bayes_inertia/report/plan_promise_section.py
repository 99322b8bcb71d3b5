"""The section of a report that puts a plan's promise beside what was achieved."""

from __future__ import annotations

import math
import statistics
from typing import Any

from bayes_inertia.report.formatting import (
    NOT_GIVEN,
    listed,
    number,
    plain,
    unit_text,
)
from bayes_inertia.report.plan_promise import WORSE_THAN_PROMISED, PlanPromise
from bayes_inertia.report.section import Section, packaged

HEADINGS = ("prior sd", "promised sd", "quoted sd", "quoted / promised")


def plan_promise_section(promise: PlanPromise) -> Section:
    """One table: promised and achieved sd of each parameter, and their ratio."""
    context = {
        "sentence": promise.sentence,
        "headings": HEADINGS,
        "rows": promise_rows(promise),
        "promised_by": promise.promised_by,
        "effects": listed([plain(name) for name in promise.effects]),
    }
    return Section("Promised and achieved", packaged("plan_promise.html"), context)


def promise_rows(promise: PlanPromise) -> list[dict[str, Any]]:
    """The rows of the table, for page and terminal.

    Returns `name`, `unit`, `cells` in the order of `HEADINGS`, and whether the row is `noticeable`.
    """
    rows = []
    for p in promise.parameters:
        power = _power([q.promised_sd for q in promise.parameters if q.unit == p.unit])
        prior, promised = (number(x, x, power) for x in (p.prior_sd, p.promised_sd))
        quoted = NOT_GIVEN if p.quoted_sd is None else number(p.quoted_sd, p.quoted_sd, power)
        rows.append(
            {
                "name": p.name,
                "unit": unit_text(p.unit, power),
                "cells": (prior, promised, quoted, f"{p.ratio:.2f}"),
                "noticeable": p.ratio > WORSE_THAN_PROMISED,
            }
        )
    return rows


def _power(sds: list[float]) -> int:
    """Power of ten, a multiple of three, in which sds of one unit read best."""
    return 3 * round(math.log10(statistics.median(sds)) / 3.0)
