"""What a plan promised beside what the run of its flight achieved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayes_inertia.report.formatting import listed

# Achieved over promised sds beyond it are pointed out. Those of single flights of one plan scatter
# by 2 to 7 % (one sd, 48 simulated flights of two plans; the largest was 1.12).
WORSE_THAN_PROMISED = 1.3


@dataclass(frozen=True)
class PromisedParameter:
    """One parameter: what was promised, what was achieved.

    Parameters
    ----------
    name, unit : str
        Of the parameter.
    prior_sd, promised_sd, sd : float
        Before flight, promised by the plan, and of the model in the run.
    quoted_sd : float or None
        What the run quotes; None where it is not to be used.
    """

    name: str
    unit: str
    prior_sd: float
    promised_sd: float
    sd: float
    quoted_sd: float | None

    @property
    def ratio(self) -> float:
        """Achieved over promised sd; the quoted sd, or the model's where none is quoted."""
        return (self.sd if self.quoted_sd is None else self.quoted_sd) / self.promised_sd

    def json(self) -> dict[str, Any]:
        """As it stands in a JSON document."""
        return {
            "unit": self.unit,
            "prior_sd": self.prior_sd,
            "promised_sd": self.promised_sd,
            "sd": self.sd,
            "quoted_sd": self.quoted_sd,
            "ratio": self.ratio,
        }


@dataclass(frozen=True)
class PlanPromise:
    """A plan's promise and what became of it.

    Parameters
    ----------
    plan : str
        Name of the plan.
    file : str
        From which it was read.
    promised_by : str
        Where the promised sds come from, in words.
    parameters : tuple of PromisedParameter
        Of J and K.
    effects : tuple of str
        What the run fitted along, which no promise counts.
    """

    plan: str
    file: str
    promised_by: str
    parameters: tuple[PromisedParameter, ...]
    effects: tuple[str, ...] = ()

    @property
    def worse(self) -> tuple[PromisedParameter, ...]:
        """Those known noticeably worse than promised, the worst first."""
        worse = [p for p in self.parameters if p.ratio > WORSE_THAN_PROMISED]
        return tuple(sorted(worse, key=lambda p: -p.ratio))

    @property
    def sentence(self) -> str:
        """The outcome in one sentence."""
        ratios = [p.ratio for p in self.parameters]
        if not self.worse:
            return (
                f"The promise of the plan “{self.plan}” is kept: the sds of J and K are "
                f"{min(ratios):.2f} to {max(ratios):.2f} times those promised."
            )
        times = listed([f"{p.name} {p.ratio:.2g} times" for p in self.worse])
        return (
            f"{len(self.worse)} of {len(ratios)} elements of J and K are known worse than the plan "
            f"“{self.plan}” promised: sd of {times} the promised one."
        )

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


def plan_promise(
    plan: str,
    file: str,
    promised_by: str,
    promised_sd: Mapping[str, float],
    summary: Mapping[str, Any],
) -> PlanPromise:
    """Put promised sds beside those of a run.

    `promised_sd` [kg m^2].

    Examples
    --------
    >>> row = {"unit": "kg m^2", "prior_sd": 0.1, "sd": 0.02, "quoted_sd": 0.02}
    >>> summary = {"parameters": {"Jxx": row}, "effects": []}
    >>> plan_promise("p", "p.toml", "", {"Jxx": 0.01}, summary).sentence
    '1 of 1 elements of J and K are known worse than the plan “p” promised: sd of Jxx 2 times ...'
    """
    rows = summary["parameters"]
    parameters = tuple(
        PromisedParameter(
            name,
            rows[name]["unit"],
            rows[name]["prior_sd"],
            sd,
            rows[name]["sd"],
            rows[name]["quoted_sd"],
        )
        for name, sd in promised_sd.items()
    )
    return PlanPromise(plan, file, promised_by, parameters, tuple(summary["effects"]))
