"""Forecast of a plan beside the sds of the run of its flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayes_inertia.report.formatting import NOT_GIVEN, number, unit_powers, unit_text
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.section import Section, Table, packaged
from bayes_inertia.report.words import phrase


@dataclass(frozen=True)
class PromisedParameter:
    """One parameter: what was promised, what was achieved."""

    name: str  # of the parameter
    unit: str
    prior_sd: float  # before flight, promised by the plan, and of the model in the run
    promised_sd: float
    sd: float
    quoted_sd: float | None  # what the run quotes; None where it is not to be used

    @property
    def ratio(self) -> float:
        """Achieved over promised sd; the quoted sd, or the model's where none is quoted."""
        return (self.sd if self.quoted_sd is None else self.quoted_sd) / self.promised_sd

    def json(self) -> dict[str, Any]:
        """As it stands in a JSON document."""
        told = {key: value for key, value in vars(self).items() if key != "name"}
        return told | {"ratio": self.ratio}


@dataclass(frozen=True)
class PlanPromise:
    """A plan's promise and what became of it."""

    plan: str  # name of the plan
    file: str  # from which it was read
    promised_by: str  # where the promised sds come from, in words
    parameters: tuple[PromisedParameter, ...]  # of J and K
    effects: tuple[str, ...] = ()  # what the run fitted along, which no promise counts

    @property
    def worse(self) -> tuple[PromisedParameter, ...]:
        """Those known noticeably worse than promised, the worst first."""
        worse = [p for p in self.parameters if p.ratio > LAYOUT.worse_than_promised]
        return tuple(sorted(worse, key=lambda p: -p.ratio))

    @property
    def sentence(self) -> str:
        """The outcome in one sentence."""
        return phrase("fit", "promise", self)

    def json(self) -> dict[str, Any]:
        """As it stands in a JSON document."""
        return {
            "name": self.plan,
            "file": self.file,
            "promised_by": self.promised_by,
            "sentence": self.sentence,
            "effects_fitted_along": list(self.effects),
            "parameters": {p.name: p.json() for p in self.parameters},
        }


_OF_THE_RUN = ("unit", "prior_sd", "sd", "quoted_sd")


def plan_promise(
    plan: str,
    file: str,
    promised_by: str,
    promised_sd: Mapping[str, float],
    summary: Mapping[str, Any],
) -> PlanPromise:
    """Put promised sds beside those of a run.

    >>> row = {"unit": "kg m^2", "prior_sd": 0.1, "sd": 0.02, "quoted_sd": 0.02}
    >>> summary = {"parameters": {"Jxx": row}, "effects": []}
    >>> plan_promise("p", "p.toml", "", {"Jxx": 0.01}, summary).sentence
    '1 of 1 elements of J and K are known worse than the plan “p” promised: sd of Jxx 2 times ...'
    """
    rows = summary["parameters"]
    parameters = tuple(
        PromisedParameter(name, promised_sd=sd, **{key: rows[name][key] for key in _OF_THE_RUN})
        for name, sd in promised_sd.items()
        if name in rows  # K of an axis that the run does not have
    )
    return PlanPromise(plan, file, promised_by, parameters, tuple(summary["effects"]))


_COLUMNS = {"parameter": "", "unit": "unit"} | dict.fromkeys(
    ("prior sd", "promised sd", "quoted sd", "quoted / promised"), "n"
)


def plan_promise_section(promise: PlanPromise) -> Section:
    """One table: promised and achieved sd of each parameter, and their ratio."""
    context = {"promise": promise, "table": promise_table(promise)}
    return Section("Promised and achieved", packaged("plan_promise.html"), context)


def promise_table(promise: PlanPromise) -> Table:
    """The table, for page and terminal; a ratio that is noticeable is marked."""
    rows, powers = [], unit_powers((p.unit, p.promised_sd) for p in promise.parameters)
    for p in promise.parameters:
        power = powers[p.unit]
        prior, promised = (number(x, x, power) for x in (p.prior_sd, p.promised_sd))
        quoted = NOT_GIVEN if p.quoted_sd is None else number(p.quoted_sd, p.quoted_sd, power)
        rows.append((p.name, unit_text(p.unit, power), prior, promised, quoted, f"{p.ratio:.2f}"))
    worse = [k for k, p in enumerate(promise.parameters) if p in promise.worse]
    return Table(_COLUMNS, rows, "many", worse)
