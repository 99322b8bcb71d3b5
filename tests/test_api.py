"""The public surface: a frozen list of names, closed, and documented to the last parameter."""

from __future__ import annotations

import dataclasses
import inspect
import subprocess
import sys
import typing
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas
import pytest
import xarray
from numpydoc.docscrape import NumpyDocString

import bayes_inertia as bi

# Adding a name is a decision; removing one breaks notebooks.
PUBLIC = set(
    """
    Campaign Change CorrelatedNoise DirectionSensor Dirt GaussianPrior GimballedRotors
    InertiaPrior InputStream KnownTorque Magnetorquer RateSensor Slew StarTracker Thruster Wheel
    prior_in read_campaign with_orbit write_campaign
    DroppedPart ImportedCampaign NoiseFit RestNoise SlewCut SlewWindow import_logs
    ConventionChange ConventionsCheck check_conventions
    ChannelNoise CheckedEffect Drive Effect LIBRARY LogNormal Model NoiseModel Normal
    Parameter ParameterSpace RateRandomWalk
    STOCHASTIC SlewContext State StochasticEffect Trajectory check_effect scalar to_body
    to_inertial vector
    Controller Flight Mission Orbit Plan PlannedSlew Spacecraft fly most_like_prior
    most_like_spacecraft paper_like_plan read_plan simulate write_plan
    ChannelTest Colour ColourOfAxis DirtTreatment Estimate FitContext Posterior Settings
    LogDensity estimate fit log_density update
    Execution Task TaskFailure Work WorkResult fit_many
    Fleet History SeenJump fleet history
    Degeneracy Direction InformationArrival Observability ParameterObservability observe
    AlternativeEffect AlternativeParameters BeyondPrior BinnedResiduals Candidate DiagnosedFit
    Diagnosis Disagreement Formula FormulaSearch FormulaTerm FreeSignal Hypothesis Investigation
    Match QuotedParameters Rules Spectrum Step Undetected
    UnexplainedSignal Window diagnose diagnose_and_fit investigate quoted_parameters
    AchievedErrors Contender CorrectionForecast Design Goal KeepOut Limits Margin Separation
    compare_plans design_plan next_slew separating_slew
    keep_compiled_code
    Picture Section export standard_sections write_report
    plot_attitude plot_candidates plot_fleet plot_history plot_observability plot_pairs plot_prior
    plot_ranks plot_rates plot_residuals plot_telemetry plot_trace
    BayesInertiaError CampaignError DesignError EffectError EstimateError OutputError
    SettingsError StudyError
    """.split()  # noqa: SIM905
)

# Fields that a user hands on and does not take apart: what they hold is the engine's own.
ENGINE_FIELDS = {
    "ImportedCampaign": {"logs"},
    "Model": {"structure", "data"},
    "SlewCut": {"scan"},
    "Estimate": {"point", "stated", "white", "information", "starts"},
}


def is_described(value: Any) -> bool:
    """Whether a public value is a function or class with a text of its own."""
    return callable(value) and not typing.get_origin(value)


FUNCTIONS = sorted(n for n in PUBLIC if inspect.isfunction(getattr(bi, n, None)))
CLASSES = sorted(n for n in PUBLIC if inspect.isclass(getattr(bi, n, None)))
# What hints may name that a module imports for type checking only.
FOR_HINTS = {"pd": pandas, "xr": xarray, "Mapping": Mapping, "Sequence": Sequence} | {
    name: getattr(bi, name) for name in CLASSES
}


def test_the_public_names_are_these():
    assert set(bi.__all__) == PUBLIC
    values = {name: getattr(bi, name) for name in sorted(PUBLIC)}
    assert [n for n, v in values.items() if is_described(v) and not v.__doc__] == []
    # A library of effects and the name of a type are all that is neither function nor class.
    assert PUBLIC - set(FUNCTIONS) - set(CLASSES) == {"LIBRARY", "STOCHASTIC", "Drive"}


def test_no_public_name_hides_a_module():
    modules = {path.stem for path in Path(bi.__file__).parent.iterdir()}
    assert not modules & set(bi.__all__)


def test_what_completes_after_a_dot_is_public():
    assert {name for name in dir(bi) if not name.startswith("__")} == PUBLIC


def test_importing_does_not_load_plots_or_arviz():
    code = (
        "import sys, bayes_inertia\n"
        "assert not {'matplotlib', 'arviz', 'jinja2'} & set(sys.modules), sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


PLAN = bi.paper_like_plan()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda out: bi.write_report("x", out), "posterior: a str is no Posterior; give a Post"),
        (lambda out: bi.standard_sections("x"), "posterior: a str is no Posterior; give a Post"),
        (lambda out: bi.fit_many(3, out), "campaigns: 3 is no path; give a text"),
        (lambda out: bi.fit_many(out.parent, 3), "out: 3 is no path"),
        (lambda out: bi.write_campaign("x", out), "campaign: a str is no Campaign; give a Camp"),
        (lambda out: bi.with_orbit("x", out, "2026-01-01"), "campaign: a str is no Campaign"),
        (lambda out: bi.read_plan(3), "path: 3 is no path"),
        (lambda out: bi.fly("x", "y", 1), "plan: a str is no Plan; give a Plan: read_plan"),
        (lambda out: bi.fly(PLAN, "y", 1), "mission: a str is no Mission; give a Mission: Mis"),
        (lambda out: bi.simulate("x", "y", out, 1), "plan: a str is no Plan; give a Plan"),
        (lambda out: bi.simulate(PLAN, "y", out, 1), "mission: a str is no Mission"),
        (lambda out: bi.simulate(PLAN, "y", 3, 1), "out_folder: 3 is no path"),
        (lambda out: bi.quoted_parameters("x"), "found: a str is no Estimate or Diagnosis; give"),
        (lambda out: bi.separating_slew("x", "a", "b"), "estimate: a str is no Estimate; give"),
        (lambda out: bi.keep_compiled_code(3), "folder: 3 is no path"),
        (lambda out: bi.export(None, out, "acm"), "result: None is no path"),
        (lambda out: bi.export(out, out, ["acm"]), "to: a list is no str; choose one of json"),
    ],
)
def test_what_a_public_function_cannot_take_is_said(call, says, tmp_path):
    with pytest.raises(bi.BayesInertiaError, match=says):
        call(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def classes_in(hint: Any) -> Iterator[type]:
    """All classes that a type hint mentions."""
    if isinstance(hint, list):
        arguments: tuple = tuple(hint)
    else:
        arguments = typing.get_args(hint)
        if isinstance(hint, type) and not arguments:
            yield hint
    for argument in arguments:
        yield from classes_in(argument)


def hints(name: str) -> dict[str, Any]:
    """{parameter or field: type hint} of a public function or class."""
    value = getattr(bi, name)
    found = typing.get_type_hints(value, localns=FOR_HINTS)
    hidden = ENGINE_FIELDS.get(name, set())
    return {key: hint for key, hint in found.items() if key not in hidden and key[0] != "_"}


def test_what_a_public_function_needs_or_returns_is_public():
    public = {id(getattr(bi, name)) for name in CLASSES}
    offenders = [
        f"{name}.{key}: {used.__module__}.{used.__name__}"
        for name in (*FUNCTIONS, *CLASSES)
        for key, hint in hints(name).items()
        for used in classes_in(hint)
        if used.__module__.startswith("bayes_inertia") and id(used) not in public
    ]
    assert offenders == []


def documented(value: Any) -> tuple[list[str], bool]:
    """Parameters that a docstring documents, and whether it says what is returned."""
    text = NumpyDocString(inspect.getdoc(value) or "")
    names = [name.strip() for entry in text["Parameters"] for name in entry.name.split(",")]
    return names, bool(text["Returns"] or text["Yields"])


def parameters_of(value: Any) -> list[str]:
    """Parameters of a call, in the docstring's spelling."""
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    parameters = inspect.signature(value).parameters.values()
    return [stars.get(p.kind, "") + p.name for p in parameters if p.name not in ("self", "cls")]


def offences(name: str, value: Any) -> list[str]:
    """What the docstring of a function, method or class lacks or has too much."""
    try:
        names, returns = documented(value)
    except (ValueError, UserWarning) as error:
        return [f"{name}: {error}"]
    wanted = parameters_of(value)
    found = []
    if missing := [p for p in wanted if p not in names]:
        found.append(f"{name}: parameters not documented: {', '.join(missing)}")
    if surplus := [p for p in names if p not in wanted]:
        found.append(f"{name}: documents what is no parameter: {', '.join(surplus)}")
    if inspect.isfunction(value) or inspect.ismethod(value):
        promised = typing.get_type_hints(value, localns=FOR_HINTS).get("return")
        if promised not in (None, type(None)) and not returns:
            found.append(f"{name}: does not say what it returns")
    return found


def methods_of(owner: type) -> Iterator[tuple[str, Any]]:
    """Public methods that a class defines itself, with a text of their own."""
    for name, value in vars(owner).items():
        if name.startswith("_") or isinstance(value, property | cached_property):
            continue
        function = getattr(owner, name)
        if callable(function) and not inspect.isclass(function) and function.__doc__:
            yield name, function


def constructed_by_hand(owner: type) -> bool:
    """Whether a class says itself with which parameters it is made."""
    own = vars(owner)
    if getattr(owner, "_is_protocol", False):
        return False
    return dataclasses.is_dataclass(owner) or "__init__" in own or hasattr(owner, "_fields")


@pytest.mark.parametrize("kind", ["functions", "classes", "methods"])
def test_every_public_parameter_is_documented_and_nothing_else(kind):
    found: list[str] = []
    for name in FUNCTIONS if kind == "functions" else ():
        found += offences(name, getattr(bi, name))
    for name in CLASSES if kind == "classes" else ():
        if constructed_by_hand(getattr(bi, name)):
            found += offences(name, getattr(bi, name))
    for name in CLASSES if kind == "methods" else ():
        for method, function in methods_of(getattr(bi, name)):
            found += offences(f"{name}.{method}", function)
    assert not found, "\n".join(found)


def test_the_check_of_docstrings_can_fail():
    def described(a, b) -> int:
        """One line.

        Parameters
        ----------
        a : int
            The first.
        c : int
            No parameter.
        """
        return a + b

    assert offences("f", described) == [
        "f: parameters not documented: b",
        "f: documents what is no parameter: c",
        "f: does not say what it returns",
    ]
