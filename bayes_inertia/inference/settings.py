"""How to sample: seeds, ensembles, walkers, steps.

Where a fit comes from: what its result says about itself beside its numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_inertia.errors import SettingsError, require, require_kind
from bayes_inertia.maths.values import whole_number

if TYPE_CHECKING:
    from bayes_inertia.physics.effect import Effect

# The least that settings may ask for.
_LEAST_SETTINGS = {
    "seed": 0,
    "ensembles": 2,
    "walkers": 2,
    "steps": 4,
    "max_steps": 4,
    "threads": 1,
}


@dataclass(frozen=True)
class Settings:
    """How to sample.

    Parameters
    ----------
    seed : int
        Fixes everything.
    ensembles : int
        Independent ensembles, at least 2: convergence is judged between them. Four or more are
        safer.
    walkers : int
        Walkers in each ensemble (more, where a model has so many parameters that emcee asks for
        them).
    steps : int
        Steps of each ensemble before the gates are looked at; then as many more as it seems to
        take, at most doubled at a time, until they pass or `max_steps` is reached.
    max_steps : int
        Steps of each ensemble at most.
    target_ess : float
        Effective samples wanted of the worst parameter. 5,000 tell an sd to 1 %, and each end of a
        90 % interval to 0.03 sd.
    threads : int
        Ensembles that run at once.

    Raises
    ------
    SettingsError
        If a value is not a number of its kind, or too small.

    Examples
    --------
    >>> Settings().ensembles
    4
    >>> Settings(seed=-1)
    Traceback (most recent call last):
    bayes_inertia.errors.SettingsError: seed: is -1; give a whole number, 0 or more
    """

    seed: int = 0
    ensembles: int = 4
    walkers: int = 64
    steps: int = 28
    max_steps: int = 2304
    target_ess: float = 5_000.0
    threads: int = 2

    def __post_init__(self) -> None:
        for field in fields(self):
            value = _checked_setting(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)
        what = f"is {self.max_steps}, less than the {self.steps} of steps"
        enough, advice = self.max_steps >= self.steps, "raise it or lower steps"
        require(enough, "max_steps", what, advice, error=SettingsError)


def _checked_setting(name: str, value: Any) -> Any:
    """A setting as a number of Python's, or SettingsError if it is none of its kind, or too small.

    >>> _checked_setting("seed", np.int64(3))
    3
    """
    if name in _LEAST_SETTINGS:
        return whole_number(value, name, _LEAST_SETTINGS[name])
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (number and isfinite(value) and value > 0):
        raise SettingsError(f"is {value!r}", where=name, advice="give a number above 0")
    return float(value)


# With effects without a fixed shape each evaluation is dear; 2,000 effective samples are enough for
# limits of 95 %.
STOCHASTIC_SETTINGS = Settings(walkers=32, steps=32, target_ess=2_000.0)


def usual_settings(effects: Iterable[Effect], *, seed: int = 0) -> Settings:
    """The settings of a fit of which nobody said how to sample.

    Examples
    --------
    >>> usual_settings((), seed=3) == Settings(seed=3)
    True
    """
    # Brings JAX along, which words on telemetry do without.
    from bayes_inertia.physics.stochastic_effect import StochasticEffect

    stochastic = any(isinstance(effect, StochasticEffect) for effect in effects)
    return replace(STOCHASTIC_SETTINGS if stochastic else Settings(), seed=seed)


def require_settings(given: Any, usual: Settings) -> Settings:
    """The settings that were given, the usual ones for None, or SettingsError for anything else.

    >>> require_settings({"steps": 64}, Settings())
    Traceback (most recent call last):
    bayes_inertia.errors.SettingsError: settings: a dict is no Settings; give Settings(steps=64, ...
    """
    advice = "give Settings(steps=64, seed=1)"
    require_kind(given, Settings | None, "settings", advice, error=SettingsError)
    return given or usual


# Verdicts of a diagnosis that leave something without a name.
OPEN_VERDICTS = ("partial", "unknown")
# What stands in an ambiguous set where the effect may as well not be there.
NOTHING = "nothing"


@dataclass(frozen=True)
class FitContext:
    """What is known of a fit before it begins.

    Parameters
    ----------
    campaign_sha256 : str, optional
        Digest of the campaign's files.
    measured_noise : mapping of float, optional
        By channel: by which factor a diagnosis found the noise to exceed the stated one. It was
        taken in this fit.
    verdict : str, optional
        Of the diagnosis: "consistent", "named", "ambiguous", "formula", "partial" or "unknown".
    slew_digests : mapping, optional
        `Campaign.slew_digests` before any treatment; None of the campaign that is fitted.

    Examples
    --------
    >>> FitContext(verdict="named").attributes()
    {'campaign_sha256': None, 'verdict': 'named'}
    """

    campaign_sha256: str | None = None
    measured_noise: Mapping[str, float] | None = None
    verdict: str | None = None
    slew_digests: Mapping[str, Sequence[str]] | None = None

    def attributes(self) -> dict[str, Any]:
        """As attributes of the result.

        Returns
        -------
        dict
            `campaign_sha256`; `slew_digests`; `verdict` and `noise` after a diagnosis.
        """
        known = {
            "verdict": self.verdict,
            "noise": self.measured_noise,
            "slew_digests": self.slew_digests,
        }
        known = {key: value for key, value in known.items() if value is not None}
        return {"campaign_sha256": self.campaign_sha256} | known
