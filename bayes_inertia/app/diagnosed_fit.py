"""From a campaign to a posterior in which what was missing is fitted: the one pipeline of a
diagnosis.

`investigate` is the search itself (`diagnosis.search.diagnose`) with all that is asked of its
answer: where the model disagrees with the data, which effect explains it, how much that changes,
what to fly next, and what stays unknown. Nothing here writes. A run folder (`run_folder`) stores
the diagnosis between its two halves, so that a killed run goes on from `diagnosis.json`: `NextFit`
is all that the second half needs of the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.campaign.block_means import readings_a_mean, without_surplus_rows
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.after_campaign import CorrectionForecast, correction_forecast
from bayes_inertia.design.separating_slew import Separation, separating_slew
from bayes_inertia.diagnosis.limits import Rules
from bayes_inertia.diagnosis.quoted_parameters import (
    AlternativeParameters,
    Undetected,
    fitted_effects,
    undetected_effects,
)
from bayes_inertia.diagnosis.residuals import Disagreement, scan_residuals
from bayes_inertia.diagnosis.result import Diagnosis
from bayes_inertia.diagnosis.search import diagnose
from bayes_inertia.diagnosis.unexplained import UnexplainedSignal, unexplained_signal
from bayes_inertia.errors import CampaignError, EffectError
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.inference.settings import (
    OPEN_VERDICTS,
    STOCHASTIC_SETTINGS,
    FitContext,
    Settings,
    require_settings,
)
from bayes_inertia.inference.treatment import DirtTreatment, treated
from bayes_inertia.maths.blas_threads import on_one_blas_thread
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY
from bayes_inertia.physics.named_effects import effects_named
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.stochastic_effect import StochasticEffect
from bayes_inertia.progress import Progress, as_callback, with_bar


@dataclass(frozen=True)
class Investigation:
    """A diagnosis and what follows from it.

    Parameters
    ----------
    diagnosis : Diagnosis
        Verdict, effects named, and the fits before and after.
    disagreement_before : Disagreement
        Where residuals of the base model are not noise.
    disagreement_after : Disagreement or None
        The same after what was named; None where nothing changed.
    unexplained : UnexplainedSignal or None
        The equivalent disturbance torque; None unless the verdict is "partial" or "unknown".
    correction : CorrectionForecast or None
        The next correction slew, before and after; None unless effects were named.
    separating_slews : tuple of Separation
        For each ambiguous set the slew that best tells its first two apart, where there is one.
    blind_spots : tuple of Undetected
        How far what is too weak to be found could have moved J and K.
    readings_a_mean : int
        Readings of the rate sensor that were averaged to one; 1 where none were.
    """

    diagnosis: Diagnosis
    disagreement_before: Disagreement
    disagreement_after: Disagreement | None = None
    unexplained: UnexplainedSignal | None = None
    correction: CorrectionForecast | None = None
    separating_slews: tuple[Separation, ...] = ()
    blind_spots: tuple[Undetected, ...] = ()
    readings_a_mean: int = 1


@with_bar
@on_one_blas_thread
def investigate(
    campaign: Campaign,
    *,
    drive: Drive | None = None,
    seed: int = 0,
    library: Sequence[Effect | str] = LIBRARY,
    rules: Rules | None = None,
    as_stated: bool = False,
    progress: Progress | bool | None = None,
) -> Investigation:
    """Diagnose a campaign and ask everything of the answer.

    Parameters
    ----------
    campaign : Campaign
        What was flown.
    drive : {"commanded", "measured"} or None
        What drives the model; None for the campaign's best.
    seed : int
        Fixes everything.
    library : sequence of Effect or str
        Candidates.
    rules : Rules or None
        Thresholds of the search; None for the usual ones.
    as_stated : bool
        Take the telemetry as it is: leave no outlier out, and take the noise for white.
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.

    Returns
    -------
    Investigation
        The diagnosis and what follows from it.

    Raises
    ------
    CampaignError, EffectError, EstimateError
        As `diagnose`.

    Examples
    --------
    It takes a minute, so this is no doctest::

        investigation = investigate(read_campaign("my_campaign"))
        investigation.diagnosis.verdict, [u.effect for u in investigation.blind_spots]
    """
    diagnosis = diagnose(
        campaign,
        library=library,
        drive=drive,
        rules=rules,
        seed=seed,
        as_stated=as_stated,
        progress=progress,
    )
    base, final = diagnosis.base, diagnosis.final
    unknown = diagnosis.verdict in OPEN_VERDICTS
    changed = diagnosis.steps or any(factor > 1.0 for factor in diagnosis.noise.values())
    # A stochastic signal cannot be foretold for another slew.
    corrected = diagnosis.steps and not unknown and not diagnosis.steps[-1].stochastic
    as_callback(progress)("bounding what could hide, forecasting the next slews", 0, 0)
    return Investigation(
        diagnosis=diagnosis,
        disagreement_before=scan_residuals(base, seed=seed),
        disagreement_after=scan_residuals(final, seed=seed, stated=False) if changed else None,
        unexplained=_unexplained(diagnosis) if unknown else None,
        correction=correction_forecast(base, final, seed=seed) if corrected else None,
        separating_slews=separating_slews(diagnosis, library=library, seed=seed),
        blind_spots=undetected_effects(diagnosis),
        readings_a_mean=1 if as_stated else readings_a_mean(campaign),
    )


def _unexplained(diagnosis: Diagnosis) -> UnexplainedSignal:
    """What has no name: all that the base fit leaves, or what the names leave of it."""
    named = diagnosis.verdict == "partial"
    return unexplained_signal(diagnosis.final if named else diagnosis.base)


def separating_slews(
    diagnosis: Diagnosis, *, library: Sequence[Effect | str] = LIBRARY, seed: int = 0
) -> tuple[Separation, ...]:
    """For every ambiguous set the slew that best tells its first two apart, where there is one.

    `library`: where effects are looked up that the final model does not hold. Returns: none for a
    set without a feasible slew, or of effects that have states of their own or are stochastic.
    """
    instances = {e.name: e for e in (*effects_named(library), *diagnosis.final.model.effects)}
    slews = []
    for first, second, *_ in diagnosis.ambiguous_with:
        if any(
            isinstance(instances.get(name), StochasticEffect | None) for name in (first, second)
        ):
            continue
        with suppress(CampaignError, EffectError):
            slews.append(
                separating_slew(diagnosis.final, instances[first], instances[second], seed=seed)
            )
    return tuple(slews)


@dataclass(frozen=True)
class NextFit:
    """Fit that a diagnosis wants in full."""

    # Of the diagnosis.
    verdict: str
    effects: tuple[Effect, ...] = ()  # to fit along, with the settings that they were found with
    # What was done about dirt in the telemetry, and the noise that was measured.
    treatment: DirtTreatment = field(default_factory=DirtTreatment)
    drive: Drive = "commanded"  # what drove the model in the diagnosis
    # J and K with other effects in their place, to be averaged over.
    alternatives: tuple[AlternativeParameters, ...] = ()


@dataclass(frozen=True)
class DiagnosedFit:
    """A campaign's diagnosis and the posterior with what it named.

    Parameters
    ----------
    investigation : Investigation
        The diagnosis and what follows from it.
    posterior : Posterior
        Of J, K and the effects named, at the noise that was measured.
    """

    investigation: Investigation
    posterior: Posterior

    @property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis: verdict, effects named, candidates, steps."""
        return self.investigation.diagnosis

    @property
    def trusted(self) -> bool:
        """Whether every gate is passed: where the verdict is "unknown", one of them fails."""
        return self.posterior.trusted


@with_bar
def diagnose_and_fit(
    campaign: Campaign,
    *,
    drive: Drive | None = None,
    seed: int | None = None,
    settings: Settings | None = None,
    library: Sequence[Effect | str] = LIBRARY,
    rules: Rules | None = None,
    chains: Path | None = None,
    as_stated: bool = False,
    progress: Progress | bool | None = None,
) -> DiagnosedFit:
    """Find which effect is missing, then estimate J, K and that effect, and sample their posterior.

    Parameters
    ----------
    campaign : Campaign
        What was flown.
    drive : {"commanded", "measured"} or None
        What drives the model; None for the campaign's best.
    seed : int or None
        Fixes everything; None for the seed of `settings`.
    settings : Settings or None
        Of the sampler; None for 2,000 effective samples.
    library : sequence of Effect or str
        Candidates; instances of your own may be among them.
    rules : Rules or None
        Thresholds of the search; None for the usual ones.
    chains : Path or None
        Folder in which the chains are kept while they grow.
    as_stated : bool
        Take the telemetry as it is: leave no outlier out, and take the noise for white.
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.

    Returns
    -------
    DiagnosedFit
        The diagnosis and the posterior.

    Raises
    ------
    CampaignError, EffectError, EstimateError
        As `diagnose` and `fit`.

    Examples
    --------
    It takes a minute or so, so this is no doctest::

        result = diagnose_and_fit(campaign)
        result.diagnosis.verdict, result.posterior.summary()["effects"]
        # ('named', ['wheel_command_lag'])
    """
    settings = require_settings(settings, STOCHASTIC_SETTINGS)
    if seed is not None:
        settings = replace(settings, seed=seed)
    asked: dict[str, Any] = {"drive": drive, "as_stated": as_stated, "progress": progress}
    investigation = investigate(campaign, seed=settings.seed, library=library, rules=rules, **asked)
    choice = next_fit(investigation)
    posterior = fit_after_diagnosis(campaign, choice, settings=settings, chains=chains, **asked)
    return DiagnosedFit(investigation, posterior)


def next_fit(investigation: Investigation) -> NextFit:
    """Fit that an investigation wants in full."""
    diagnosis = investigation.diagnosis
    effects = fitted_effects(diagnosis)
    drive = diagnosis.base.model.structure.drive
    treatment, others = diagnosis.treatment, diagnosis.other_rows
    return NextFit(diagnosis.verdict, effects, treatment, drive, others)


def fit_after_diagnosis(
    campaign: Campaign,
    choice: NextFit,
    *,
    settings: Settings,
    campaign_sha256: str | None = None,
    as_stated: bool = False,
    **asked: Any,
) -> Posterior:
    """The posterior with what a diagnosis named, averaged over what it could not tell apart.

    Where something is missing that has no name, a torque and an error of the rates of free shape
    are fitted along: the uncertainties of J and K then hold what they may have done.

    `asked`: drive, chains and progress, as of `fit`.
    """
    slews, treatment = campaign.slew_digests, choice.treatment
    context = FitContext(campaign_sha256, verdict=choice.verdict, slew_digests=slews)
    if choice.verdict in OPEN_VERDICTS:
        # What is missing may be part of what looks like louder noise.
        treatment = replace(treatment, level=DirtTreatment().level)
    else:
        context = replace(context, measured_noise=dict(treatment.level))
    if any(isinstance(effect, StochasticEffect) for effect in choice.effects):
        settings = replace(settings, walkers=min(settings.walkers, STOCHASTIC_SETTINGS.walkers))
    if not as_stated:
        # The rows of which the treatment speaks.
        campaign = without_surplus_rows(campaign)
    campaign = treated(campaign, treatment, choice.drive)
    asked |= {"effects": choice.effects, "alternatives": choice.alternatives, "context": context}
    return fit(campaign, settings=settings, as_stated=as_stated, **asked)
