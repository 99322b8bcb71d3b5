"""Inertia tensor and rate-sensor scale factors of a spacecraft, with honest uncertainty.

They are estimated from the telemetry of a few slews.

In a notebook::

    import bayes_inertia as bi
    campaign = bi.read_campaign("my_campaign")
    posterior = bi.fit(campaign, seed=1)
    posterior.summary()["parameters"]["Jxy"]
    bi.write_report(posterior, "report.html")
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from bayes_inertia.version import __version__ as __version__

# Public names and the modules they live in, loaded on first use: plots and reports take a second to
# import. The first that computes sets JAX up, see `maths.jax_settings`; until then JAX and the
# environment stay as they are.
_PUBLIC = {
    # Campaigns: what was flown.
    "Campaign": "campaign.campaign",
    "Dirt": "faults.fault",
    "GaussianPrior": "campaign.prior",
    "InertiaPrior": "campaign.hardware",
    "CorrelatedNoise": "campaign.hardware",
    "Change": "campaign.actuators",
    "DirectionSensor": "campaign.hardware",
    "GimballedRotors": "campaign.actuators",
    "InputStream": "campaign.inputs",
    "KnownTorque": "campaign.actuators",
    "Magnetorquer": "campaign.actuators",
    "RateSensor": "campaign.hardware",
    "Slew": "campaign.slew",
    "StarTracker": "campaign.hardware",
    "Thruster": "campaign.actuators",
    "Wheel": "campaign.hardware",
    "prior_in": "campaign.prior",
    "read_campaign": "campaign.reader",
    "with_orbit": "campaign.environment",
    "write_campaign": "campaign.writer",
    # Conventions held against physics, before any fit.
    "ConventionChange": "conventions.check",
    "ConventionsCheck": "conventions.check",
    "check_conventions": "app.told_torques",
    # Raw logs of any mission.
    "DroppedPart": "importing.slew_cutting",
    "ImportedCampaign": "importing.import_logs",
    "NoiseFit": "faults.noise",
    "RestNoise": "importing.rest_noise",
    "SlewCut": "importing.slew_cutting",
    "SlewWindow": "importing.slew_cutting",
    "import_logs": "importing.import_logs",
    # The model: parameters, effects, noise, simulated motion.
    "ChannelNoise": "physics.channel_noise",
    "CheckedEffect": "physics.check_effect",
    "Drive": "physics.simulator",
    "Effect": "physics.effect",
    "LIBRARY": "physics.effects",
    "LogNormal": "physics.parameters",
    "Model": "physics.forward_model",
    "NoiseModel": "physics.channel_noise",
    "Normal": "physics.parameters",
    "Parameter": "physics.parameters",
    "ParameterSpace": "physics.parameters",
    "RateRandomWalk": "physics.effects",
    "STOCHASTIC": "physics.effects",
    "SlewContext": "physics.effect",
    "State": "physics.effect",
    "StochasticEffect": "physics.stochastic_effect",
    "Trajectory": "physics.effect",
    "check_effect": "physics.check_effect",
    "scalar": "physics.parameters",
    "to_body": "maths.quaternion",
    "to_inertial": "maths.quaternion",
    "vector": "physics.parameters",
    # Flights: plans and simulated campaigns.
    "Controller": "flight.spacecraft",
    "Flight": "flight.plan_flight",
    "Mission": "flight.mission",
    "Orbit": "flight.orbit",
    "Plan": "flight.plan",
    "PlannedSlew": "flight.plan",
    "Spacecraft": "flight.spacecraft",
    "fly": "flight.plan_flight",
    "most_like_prior": "flight.spacecraft",
    "most_like_spacecraft": "flight.spacecraft",
    "paper_like_plan": "flight.plan",
    "read_plan": "flight.plan_file",
    "simulate": "flight.simulated_campaigns",
    "write_plan": "flight.plan_file",
    # Fits.
    "ChannelTest": "inference.residual_tests",
    "Estimate": "inference.laplace",
    "Colour": "inference.noise_colour",
    "ColourOfAxis": "inference.noise_colour",
    "DirtTreatment": "inference.treatment",
    "FitContext": "inference.settings",
    "Posterior": "inference.posterior",
    "Settings": "inference.sampler",
    "LogDensity": "app.fit_campaign",
    "estimate": "inference.optimizer",
    "fit": "app.fit_campaign",
    "log_density": "app.fit_campaign",
    "update": "app.fit_campaign",
    # Many fits.
    "Execution": "studies.engine",
    "Task": "studies.work",
    "TaskFailure": "studies.work",
    "Work": "studies.work",
    "WorkResult": "studies.work",
    "fit_many": "app.many_folder",
    # J and K over campaigns, and over a fleet.
    "Fleet": "series.fleet",
    "History": "series.history",
    "SeenJump": "series.history",
    "fleet": "series.fleet",
    "history": "series.history",
    # What a campaign tells.
    "Degeneracy": "observability.degeneracy",
    "Direction": "observability.result",
    "InformationArrival": "observability.result",
    "Observability": "observability.result",
    "ParameterObservability": "observability.result",
    "observe": "observability.analysis",
    # What is missing in the model.
    "AlternativeEffect": "diagnosis.result",
    "AlternativeParameters": "diagnosis.result",
    "BeyondPrior": "diagnosis.result",
    "BinnedResiduals": "diagnosis.residuals",
    "Candidate": "diagnosis.result",
    "DiagnosedFit": "app.diagnosed_fit",
    "Diagnosis": "diagnosis.result",
    "Disagreement": "diagnosis.residuals",
    "Formula": "physics.effects",
    "FormulaSearch": "diagnosis.result",
    "FormulaTerm": "diagnosis.result",
    "FreeSignal": "diagnosis.unexplained",
    "Hypothesis": "diagnosis.result",
    "Investigation": "app.diagnosed_fit",
    "Match": "diagnosis.unexplained",
    "QuotedParameters": "diagnosis.quoted_parameters",
    "Rules": "diagnosis.limits",
    "Spectrum": "diagnosis.unexplained",
    "Step": "diagnosis.result",
    "Undetected": "diagnosis.quoted_parameters",
    "UnexplainedSignal": "diagnosis.unexplained",
    "Window": "diagnosis.residuals",
    "diagnose": "diagnosis.search",
    "diagnose_and_fit": "app.diagnosed_fit",
    "investigate": "app.diagnosed_fit",
    "quoted_parameters": "diagnosis.quoted_parameters",
    # What to fly next.
    "AchievedErrors": "design.comparison",
    "Contender": "design.comparison",
    "CorrectionForecast": "design.after_campaign",
    "Design": "design.result",
    "Goal": "design.goals",
    "KeepOut": "design.limits",
    "Limits": "design.limits",
    "Margin": "design.margins",
    "Separation": "design.separating_slew",
    "compare_plans": "studies.plan_comparison",
    "design_plan": "design.designer",
    "next_slew": "design.designer",
    "separating_slew": "design.separating_slew",
    # Compiled code kept between runs.
    "keep_compiled_code": "app.compiled_code",
    # Plots on axes of your own.
    "plot_attitude": "report.plots",
    "plot_candidates": "report.plots",
    "plot_fleet": "report.plots",
    "plot_history": "report.plots",
    "plot_observability": "report.plots",
    "plot_pairs": "report.plots",
    "plot_prior": "report.plots",
    "plot_ranks": "report.plots",
    "plot_rates": "report.plots",
    "plot_residuals": "report.plots",
    "plot_telemetry": "report.plots",
    "plot_trace": "report.plots",
    # Reports, and results for other tools.
    "export": "app.export_run",
    "Picture": "report.section",
    "Section": "report.section",
    "standard_sections": "report.fit_sections",
    "write_report": "report.page",
    # Errors.
    "BayesInertiaError": "errors",
    "CampaignError": "errors",
    "DesignError": "errors",
    "EffectError": "errors",
    "EstimateError": "errors",
    "OutputError": "errors",
    "SettingsError": "errors",
    "StudyError": "errors",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, *(name for name in globals() if name.startswith("__"))]
