"""Posteriors made up of random numbers, with the groups of a real one, and their pages."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from bayes_inertia.inference.posterior import FORMAT, Posterior
from bayes_inertia.report.page import render

BASE = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3")
SIGMA = {"rate": 2e-5, "attitude": 2.5e-5, "momentum": 5e-6}


@dataclass(frozen=True)
class Case:
    """What a made-up posterior looks like; `lengths`: rows of each slew, `fixes` 0: no tracker."""

    lengths: tuple[int, ...] = (60, 60, 48)
    fixes: int = 8
    drive: str = "commanded"
    extra: tuple[str, ...] = ()
    misfit: float = 1.0
    converged: bool = True
    sharpness: float = 300.0
    robust: bool = True
    name: str = "a campaign <of slews> & more"
    slew: str = "slew"


CASES = {
    "good": Case(),
    "one_slew": Case(lengths=(60,), robust=False, sharpness=1.02),
    "thrown": Case(lengths=(2100,) * 15, fixes=0, drive="measured", misfit=3.0, converged=False),
    "many_effects": Case(extra=tuple(f"wheel_friction.coulomb{i}" for i in range(1, 9))),
}


# What a browser would run, wherever it is not escaped.
ATTACK = """</script><script>window.hacked = 1</script>"'><img src=x onerror="window.hacked=1">"""
HOSTILE = Case(name=ATTACK, slew=f"<!--<script>{ATTACK}")


def make(case: Case, seed: int = 0) -> Posterior:
    """A posterior whose telemetry fits it, up to `misfit` times the stated noise."""
    rng = np.random.default_rng(seed)
    names = [*BASE, *case.extra]
    groups, telemetry = _draws(case, names, rng), _telemetry(case, rng)
    groups["/estimate"] = groups["/estimate"].merge(telemetry.pop("/residuals"))
    tree = xr.DataTree.from_dict(groups | telemetry)
    for group in ("posterior", "prior"):
        for name in names:
            tree[group][name].attrs["units"] = (
                "kg m^2" if name[0] == "J" else "" if name[0] == "K" else "N m"
            )
    tree.attrs = {"format": FORMAT, "bayes_inertia": json.dumps(attributes_of(case))}
    return Posterior(tree)


def _draws(case: Case, names: list[str], rng) -> dict[str, xr.Dataset]:
    d = len(names)
    mean = np.array([3.33, 2.2, 1.8, -0.012, 0.0026, 0.016, 1.01, 1.02, 0.98, *[1e-5] * (d - 9)])
    prior_sd = np.array([0.13, 0.09, 0.07, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, *[5e-5] * (d - 9)])
    correlation = np.eye(d)
    correlation[0, 6] = correlation[6, 0] = -0.95
    sd = prior_sd / case.sharpness
    covariance = correlation * np.outer(sd, sd)
    values = mean + rng.multivariate_normal(np.zeros(d), covariance, (2 * 8, 50))
    prior = mean + prior_sd * rng.normal(size=(1, 500, d))
    robust = 1.4**2 * covariance if case.robust else np.full((d, d), np.nan)
    slews, labels = (
        [f"{case.slew} {i + 1}" for i in range(len(case.lengths))],
        ["rate", "attitude", "momentum"],
    )
    n = np.array(
        [
            [3 * rows, 3 * case.fixes, 3 * rows * (case.drive == "commanded")]
            for rows in case.lengths
        ]
    )
    per_slew = {"slew": slews, "channel": labels}
    estimate = {
        "theta": ("parameter", mean),
        "prior_mean": ("parameter", mean),
        "prior_sd": ("parameter", prior_sd),
        "covariance": (("parameter", "parameter_2"), covariance),
        "robust_covariance": (("parameter", "parameter_2"), robust),
        "robust_sd": ("parameter", np.sqrt(np.diag(robust))),
        "robust_principal_sd": ("axis", np.sqrt(np.diag(robust))[:3]),
        "discount": (("slew", "channel"), np.full(n.shape, min(1.0, case.misfit**-2.0))),
        "slew_chi2": (("slew", "channel"), case.misfit**2 * n),
        "slew_n_data": (("slew", "channel"), n),
    }
    return {
        "/posterior": xr.Dataset(
            {name: (("chain", "draw"), values[..., i]) for i, name in enumerate(names)}
        ),
        "/prior": xr.Dataset(
            {name: (("chain", "draw"), prior[..., i]) for i, name in enumerate(names)}
        ),
        "/derived": xr.Dataset(
            {"principal_moment": (("chain", "draw", "axis"), np.sort(values[..., :3], -1))}
        ),
        "/sample_stats": xr.Dataset({"lp": (("chain", "draw"), -0.5 * rng.chisquare(d, (16, 50)))}),
        "/estimate": xr.Dataset(
            estimate, coords={"parameter": names, "parameter_2": names, **per_slew}
        ),
    }


def _telemetry(case: Case, rng) -> dict[str, xr.Dataset]:
    slews, rows, draws = (
        [f"{case.slew} {i + 1}" for i in range(len(case.lengths))],
        max(case.lengths),
        (2, 16),
    )
    coords = {"slew": slews, "wheel": ["w1", "w2", "w3"]}
    time = np.full((len(slews), rows), np.nan)
    for s, n in enumerate(case.lengths):
        time[s, :n] = 0.5 * np.arange(n)
    clean = 0.02 * np.sin(np.nan_to_num(time) / 8.0)[..., None] * np.array([1.0, -0.5, 0.2])
    observed, predicted, residual, constant = {}, {}, {}, {"time": (("slew", "row"), time)}
    for name, last in (("rate", "sensor_axis"), ("momentum", "wheel")):
        noise = case.misfit * rng.normal(size=clean.shape)
        measured = np.isfinite(time)[..., None]
        observed[name] = (
            ("slew", "row", last),
            np.where(measured, clean + SIGMA[name] * noise, np.nan),
        )
        if name == "rate" or case.drive == "commanded":
            predicted[name] = (
                ("chain", "draw", "slew", "row", last),
                clean + SIGMA[name] * rng.normal(size=(*draws, *clean.shape)),
            )
            residual[f"residual_{name}"] = (("slew", "row", last), np.where(measured, noise, 0.0))
    if case.fixes:
        half = case.fixes // 2
        constant["fix_time"] = (
            ("slew", "fix"),
            np.array([[*t[:half], *t[np.isfinite(t)][-half:]] for t in time]),
        )
        small = rng.normal(size=(len(slews), case.fixes, 3))
        truth = Rotation.random(len(slews) * case.fixes, rng)
        fixes = truth * Rotation.from_rotvec(SIGMA["attitude"] * small.reshape(-1, 3))
        shape = (len(slews), case.fixes, 4)
        observed["attitude"] = (
            ("slew", "fix", "quaternion"),
            -fixes.as_quat().reshape(shape),
        )  # q and -q are one attitude
        predicted["attitude"] = (
            ("chain", "draw", "slew", "fix", "quaternion"),
            np.broadcast_to(truth.as_quat().reshape(shape), (*draws, *shape)),
        )
        residual["residual_attitude"] = (("slew", "fix", "body_axis"), small)
    return {
        "/observed_data": xr.Dataset(observed, coords=coords),
        "/posterior_predictive": xr.Dataset(predicted, coords=coords),
        "/constant_data": xr.Dataset(constant, coords={"slew": slews}),
        "/residuals": xr.Dataset(residual),
    }


def attributes_of(case: Case) -> dict:
    """What such a fit says about itself."""
    good, chi2 = case.misfit == 1.0, case.misfit**2
    channels = {
        "rate": True,
        "attitude": bool(case.fixes),
        "momentum": case.drive == "commanded",
        "total": True,
    }
    return {
        "campaign": case.name,
        "seed": 7,
        "campaign_sha256": None,
        "diagnostics": {
            "converged": case.converged,
            "nested_rhat_max": 1.001 if case.converged else 1.2,
            "ess_bulk_min": 9000.0,
            "ess_tail_min": 8000.0,
            "tau_max": 1.5,
            "evaluations": 20000,
            "ess_per_evaluation": 0.4,
            "seconds": 12.3,
            "acceptance": 0.8,
            "discarded": 12,
            "steps": 62,
        },
        "fit": {
            "reduced_chi2": {name: chi2 if given else None for name, given in channels.items()},
            "interval_99": {
                name: [0.95, 1.05] if given else None for name, given in channels.items()
            },
            "p_white": {
                "rate": 0.4,
                "attitude": None,
                "momentum": 0.2 if channels["momentum"] else None,
                "total": None,
            },
            "n_data": 1234,
            "discounted": not good,
            "starts_agreeing": [3, 3],
        },
        "gates": [
            {"name": "converged", "passed": case.converged, "says": "about the ensembles"},
            {
                "name": "explained",
                "passed": good,
                "says": "reduced chi^2; use robust_sd, see `diagnose`",
            },
        ],
        "effects": sorted({name.split(".")[0] for name in case.extra}),
        "drive": case.drive,
        "versions": {"bayes-inertia": "0.1.0"},
    }


@pytest.fixture
def made():
    """A made-up posterior of a kind of `CASES`, for tests that change it."""
    return lambda kind: make(CASES[kind])


@pytest.fixture
def make_case():
    """A made-up posterior of settings of a `Case`."""
    return lambda **settings: make(Case(**settings))


@pytest.fixture(scope="session")
def posteriors() -> dict[str, Posterior]:
    """One made-up posterior of every kind, not to be changed."""
    return {kind: make(case) for kind, case in CASES.items()}


@pytest.fixture(scope="session")
def pages(posteriors) -> dict[str, str]:
    """Their reports."""

    class Drawn(dict):
        """Each is drawn when a test first asks for it: a page takes seconds."""

        def __missing__(self, kind):
            return self.setdefault(kind, render(posteriors[kind]))

    return Drawn()


@pytest.fixture
def attributes():
    """What the fit of a kind of `CASES` says about itself."""
    return lambda kind: attributes_of(CASES[kind])


@pytest.fixture(scope="session")
def stated_sigma():
    """Stated sigma of each made-up channel."""
    return SIGMA


@pytest.fixture(scope="session")
def hostile() -> Posterior:
    """A posterior whose campaign and slews have names that attack the page."""
    return make(HOSTILE)
