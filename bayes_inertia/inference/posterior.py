"""The result of a fit: an ArviZ DataTree with units, and the summary an engineer reads.

Groups: `posterior` (chain, draw; one variable a parameter), `prior`, `derived` (principal moments),
`sample_stats` (lp), `log_prior`, `log_likelihood` and `posterior_predictive` (thinned draws),
`observed_data`, `constant_data`, and `estimate` (the optimizer's result and both covariances).
After an ambiguous diagnosis also `averaged`: J, K and principal moments, whichever effect of the set is the true one (`averaging`).
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import asdict
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.errors import CampaignError
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.laplace import Estimate, marginal, principal_sd
from bayes_inertia.inference.likelihood import conditional_point, residuals
from bayes_inertia.inference.sampler import Chains
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.parameters import log_prior

if TYPE_CHECKING:
    import xarray as xr

FORMAT = "bayes-inertia-posterior/1"
# Draws of each ensemble kept for telemetry-sized groups.
_PREDICTED = 16
# The data have told something once they have halved the prior variance.
OBSERVABLE_ABOVE = 0.5


@array_dataclass
class Posterior:
    """A finished fit.

    Parameters
    ----------
    tree : the DataTree. Build one with `bayes_inertia.fit`, or `Posterior.load` a saved one.

    >>> Posterior.load("no_such_run/posterior.nc")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: no_such_run/posterior.nc: no such file; give the posterior.nc of a finished run
    """

    tree: xr.DataTree

    @classmethod
    def load(cls, path: str | Path) -> Posterior:
        """Read a saved posterior; CampaignError if it is not one."""
        import xarray as xr

        path = Path(path)
        if not path.is_file():
            raise CampaignError(
                "no such file", where=str(path), advice="give the posterior.nc of a finished run"
            )
        try:
            tree = xr.open_datatree(path, engine="h5netcdf").load()
        except (OSError, ValueError) as error:
            raise CampaignError(
                f"not a netCDF file ({error})", where=str(path), advice="fit again"
            ) from error
        tree.close()
        if tree.attrs.get("format") != FORMAT:
            raise CampaignError(
                f"the format is not {FORMAT}",
                where=str(path),
                advice="give a posterior.nc written by this package",
            )
        return cls(tree)

    def save(self, path: str | Path) -> Path:
        """Write the tree as netCDF, atomically."""
        return write_atomically(
            Path(path), lambda temporary: self.tree.to_netcdf(temporary, engine="h5netcdf")
        )

    @property
    def names(self) -> list[str]:
        """Parameter names in the order of the flat vector."""
        return [str(n) for n in self.tree["estimate"].coords["parameter"].values]

    @cached_property
    def samples(self) -> np.ndarray:
        """All draws (n, d) in the order of `names`."""
        group = self.tree["posterior"]
        return np.stack([group[name].values.ravel() for name in self.names], -1)

    @cached_property
    def averaged_samples(self) -> np.ndarray:
        """As `samples`, J and K averaged over the effects of an ambiguous set where there is one."""
        over = self.tree.get("averaged", {})
        return np.stack(
            [
                (over if name in over else self.tree["posterior"])[name].values.ravel()
                for name in self.names
            ],
            -1,
        )

    @property
    def attributes(self) -> dict[str, Any]:
        """What the fit says about itself: `diagnostics`, `fit`, `gates`, `effects`, `seed`, `versions`, `campaign_sha256`."""
        return json.loads(self.tree.attrs["bayes_inertia"])

    @property
    def trusted(self) -> bool:
        """Whether every gate is passed."""
        return all(gate["passed"] for gate in self.attributes["gates"])

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""
        about = self.attributes
        about["parameters"] = {name: self._parameter(i, name) for i, name in enumerate(self.names)}
        about["derived"] = self._principal_moments()
        order = (
            "format",
            "campaign",
            "trusted",
            "reasons",
            "parameters",
            "derived",
            "diagnostics",
            "fit",
            "gates",
            "effects",
        )
        about = (
            {"campaign": None}
            | about
            | {"format": "bayes-inertia-summary/1", "trusted": self.trusted}
        )
        about["reasons"] = [gate["says"] for gate in about["gates"] if not gate["passed"]]
        return {key: about[key] for key in [*order, *(k for k in about if k not in order)]}

    def _parameter(self, i: int, name: str) -> dict[str, Any]:
        estimate, draws = self.tree["estimate"], self.averaged_samples[:, i]
        prior_sd, sd = float(estimate["prior_sd"][i]), float(draws.std(ddof=1))
        robust = max(
            float(estimate["robust_sd"][i]), sd
        )  # NaN for a single slew; never below the sample's own
        contraction = 1.0 - (sd / prior_sd) ** 2
        q05, q50, q95 = (float(q) for q in np.quantile(draws, [0.05, 0.5, 0.95]))
        return {
            "mean": float(draws.mean()),
            "sd": sd,
            "robust_sd": robust if np.isfinite(robust) else None,
            "q05": q05,
            "q50": q50,
            "q95": q95,
            "unit": str(self.tree["posterior"][name].attrs.get("units", "")),
            "prior_sd": prior_sd,
            "contraction": contraction,
            "observable": bool(contraction > OBSERVABLE_ABOVE),
        }

    def _principal_moments(self) -> dict[str, Any]:
        draws = self.tree["averaged" if "averaged" in self.tree else "derived"][
            "principal_moment"
        ].values.reshape(-1, 3)
        sd = draws.std(0, ddof=1)
        robust = np.maximum(
            self.tree["estimate"]["robust_principal_sd"].values, sd
        )  # as for the parameters
        return {
            f"I{i + 1}": {
                "mean": float(draws[:, i].mean()),
                "sd": float(sd[i]),
                "robust_sd": float(robust[i]) if np.isfinite(robust[i]) else None,
                "unit": "kg m^2",
            }
            for i in range(3)
        }


def build(at: Estimate, chains: Chains, about: dict[str, Any], seed: int) -> Posterior:
    """Assemble the result of an estimate and its samples.

    Parameters
    ----------
    about : further attributes (campaign name and digest, seconds, ...). Of a diagnosis: `noise`, {channel: factor by which its noise was
        found to exceed the stated one, and was taken}, and `verdict`.
    seed : of the draws of prior, nuisances and predicted noise.
    """
    import arviz as az

    rng = np.random.default_rng([seed, 1])
    model = at.model
    ensembles, walkers, draws, d = chains.samples.shape
    flat = chains.samples.reshape(ensembles * walkers, draws, d)
    names = model.space.names
    prior = model.draw_prior(rng, 2000)
    groups: dict[str, dict[str, np.ndarray]] = {
        "posterior": {name: flat[..., i] for i, name in enumerate(names)},
        "prior": {name: prior[None, :, i] for i, name in enumerate(names)},
        "derived": {"principal_moment": inertia_tensor.principal_moments(flat[..., :6])},
        "sample_stats": {"lp": chains.log_posterior.reshape(ensembles * walkers, draws)},
        "log_prior": {"theta": np.asarray(_log_prior(model.space.constants(), flat))},
    }
    predicted, pointwise = _telemetry_groups(at, chains, rng)
    observed, constant = _observed(at)
    groups |= {
        "posterior_predictive": predicted,
        "log_likelihood": pointwise,
        "observed_data": observed,
        "constant_data": constant,
    }
    dims = {"principal_moment": ["axis"], **_TELEMETRY_DIMS}
    coords = {
        "slew": [s.name for s in model.campaign.slews],
        "wheel": [w.name for w in model.campaign.wheels],
        "axis": [1, 2, 3],
    }
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", "Found chain dimension to be longer", UserWarning
        )  # walkers are many by design
        tree = az.from_dict(groups, dims=dims, coords=coords)
    tree["estimate"] = _estimate_group(at)
    for group in ("posterior", "prior"):
        for name, unit in zip(names, model.space.units, strict=True):
            tree[group][name].attrs["units"] = unit
    for (group, name), unit in _UNITS.items():
        if name in tree[group]:
            tree[group][name].attrs["units"] = unit
    tree.attrs = {
        "format": FORMAT,
        "bayes_inertia": json.dumps(
            about | _about(at, chains, about.get("noise"), about.get("verdict"))
        ),
    }
    return Posterior(tree)


_log_prior = jax.jit(log_prior)
_turned = jax.jit(lambda q, small_rotation: quaternion.multiply(q, quaternion.exp(small_rotation)))
_AXES = {
    "rate": ["slew", "row", "sensor_axis"],
    "attitude": ["slew", "fix", "quaternion"],
    "momentum": ["slew", "row", "wheel"],
}
_TELEMETRY_DIMS = (
    _AXES
    | {"time": ["slew", "row"], "fix_time": ["slew", "fix"]}
    | {f"{c}_point": _AXES[c][:2] for c in CHANNELS}
)
_UNITS = {
    ("derived", "principal_moment"): "kg m^2",
    **{(g, "rate"): "rad/s" for g in ("posterior_predictive", "observed_data")},
    **{(g, "momentum"): "N m s" for g in ("posterior_predictive", "observed_data")},
    **{(g, "attitude"): "" for g in ("posterior_predictive", "observed_data")},
    ("constant_data", "time"): "s",
    ("constant_data", "fix_time"): "s",
    ("estimate", "residual_rate"): "stated sigma",
    ("estimate", "residual_attitude"): "stated sigma",
    ("estimate", "residual_momentum"): "stated sigma",
}


def _telemetry_groups(at: Estimate, chains: Chains, rng: np.random.Generator) -> tuple[dict, dict]:
    """Predicted telemetry with measurement noise, and pointwise log likelihoods, for thinned draws with their nuisances."""
    ensembles = len(chains.samples)
    pick = np.linspace(0, chains.samples.shape[2] - 1, _PREDICTED).astype(int)
    thinned = chains.samples[:, rng.integers(0, chains.samples.shape[1], _PREDICTED), pick].reshape(
        ensembles * _PREDICTED, -1
    )
    frozen, structure = marginal(at), at.model.structure
    shape = (ensembles, _PREDICTED)
    out: dict[str, list[np.ndarray]] = {c: [] for c in CHANNELS}
    points: dict[str, list[np.ndarray]] = {c: [] for c in CHANNELS}
    for theta in thinned:
        point = conditional_point(structure, frozen, theta, rng.standard_normal(len(frozen.root)))
        r = residuals(structure, point, at.model.data, at.stated)
        gaps = {c: np.asarray(value) for c, value in zip(CHANNELS, r, strict=True)}
        for c, values in _predicted(at, gaps).items():
            out[c].append(values)
            points[c].append(-0.5 * np.square(gaps[c]).reshape(*values.shape[:2], -1).sum(-1))
    predicted = {
        c: np.stack(v).reshape(*shape, *v[0].shape) for c, v in out.items() if v and v[0].size
    }
    norms = _log_norms(at)
    pointwise = {
        f"{c}_point": (np.stack(points[c]).reshape(*shape, *points[c][0].shape) + norms[c]).astype(
            np.float32
        )
        for c in predicted
    }
    return _with_noise(at, predicted, rng), pointwise


def _predicted(at: Estimate, gaps: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Predictions at the measurements, from residuals in stated sigmas: what is measured minus what is left."""
    telemetry, white = at.model.data.arrays.telemetry, at.stated
    rate = gaps["rate"].reshape(telemetry.rate.shape)
    found = {
        "rate": np.asarray(telemetry.rate)
        - np.einsum("srij,srj->sri", _inverses(np.asarray(white.rate)), rate)
    }
    if telemetry.attitude.size:
        turn = np.einsum(
            "srij,srj->sri",
            _inverses(np.asarray(white.attitude)),
            gaps["attitude"].reshape(*telemetry.attitude.shape[:2], 3),
        )
        found["attitude"] = np.asarray(_turned(telemetry.attitude, -turn))
    if at.model.structure.drive == "commanded" and telemetry.momentum.size:
        scale = np.asarray(white.momentum)
        left = gaps["momentum"].reshape(scale.shape) / np.where(scale > 0, scale, 1.0)
        found["momentum"] = np.asarray(telemetry.momentum) - left
    return found


def _inverses(factors: np.ndarray) -> np.ndarray:
    """Inverses of triangular factors (..., 3, 3); zero rows, where nothing was measured, stay zero."""
    empty = np.diagonal(factors, axis1=-2, axis2=-1) == 0.0
    filled = factors + np.where(empty[..., None], np.eye(3), 0.0)
    return np.linalg.inv(filled) * ~empty[..., None]


def _log_norms(at: Estimate) -> dict[str, np.ndarray]:
    """Log of the Gaussians' norms by channel (slews, rows): what pointwise densities need to be comparable."""

    def norm(diagonal: np.ndarray) -> np.ndarray:
        return np.sum(
            np.where(
                diagonal > 0,
                np.log(np.where(diagonal > 0, diagonal, 1.0)) - 0.5 * np.log(2 * np.pi),
                0.0,
            ),
            -1,
        )

    white = at.stated
    matrices = (np.diagonal(w, axis1=-2, axis2=-1) for w in (white.rate, white.attitude))
    return dict(
        zip(CHANNELS, [*(norm(m) for m in matrices), norm(np.asarray(white.momentum))], strict=True)
    )


def _with_noise(
    at: Estimate, predicted: dict[str, np.ndarray], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Predictions with measurement noise added; NaN where nothing was measured."""
    telemetry, campaign = at.model.data.arrays.telemetry, at.model.campaign
    noisy = {}
    if "rate" in predicted:
        sigma = np.asarray(campaign.rate_sensor.sigma)
        values = predicted["rate"] + (sigma * rng.standard_normal(predicted["rate"].shape)).astype(
            np.float32
        )
        noisy["rate"] = np.where(telemetry.rate_valid, values, np.float32(np.nan))
    if "attitude" in predicted:
        tracker = campaign.star_tracker
        along = np.outer(tracker.boresight_B, tracker.boresight_B)
        spread = tracker.sigma_cross * (np.eye(3) - along) + tracker.sigma_roll * along
        turn = rng.standard_normal((*predicted["attitude"].shape[:-1], 3)) @ spread
        values = _turned(predicted["attitude"], turn)
        noisy["attitude"] = np.where(np.asarray(telemetry.fix_valid)[..., None], values, np.nan)
    if "momentum" in predicted:
        sigma = np.array([w.momentum_sigma or np.nan for w in campaign.wheels])
        values = predicted["momentum"] + (
            sigma * rng.standard_normal(predicted["momentum"].shape)
        ).astype(np.float32)
        noisy["momentum"] = np.where(telemetry.momentum_valid, values, np.float32(np.nan))
    return noisy


def _observed(at: Estimate) -> tuple[dict, dict]:
    telemetry, slews = at.model.data.arrays.telemetry, at.model.campaign.slews
    rows = telemetry.rate.shape[1]
    time = np.full((len(slews), rows), np.nan)
    for i, slew in enumerate(slews):
        time[i, : len(slew.time)] = slew.time
    fixes = np.take_along_axis(time, np.asarray(telemetry.fix_row), axis=1)
    observed = {
        "rate": np.where(telemetry.rate_valid, telemetry.rate, np.nan),
        "attitude": np.where(
            np.asarray(telemetry.fix_valid)[..., None], telemetry.attitude, np.nan
        ),
        "momentum": np.where(telemetry.momentum_valid, telemetry.momentum, np.nan),
    }
    constant = {"time": time, "fix_time": np.where(telemetry.fix_valid, fixes, np.nan)}
    return {k: v for k, v in observed.items() if v.size}, {
        k: v for k, v in constant.items() if v.size
    }


def _estimate_group(at: Estimate):
    import xarray as xr

    names = list(at.model.space.names)
    robust = at.robust_covariance
    missing = np.full((len(names), len(names)), np.nan)
    covariance = missing if robust is None else robust
    series = {
        c: np.asarray(r).reshape(len(r), -1, w)
        for c, r, w in _residual_arrays(at)
        if np.asarray(r).size
    }
    variables = {
        "theta": (("parameter",), at.theta),
        "prior_mean": (("parameter",), at.model.space.mean),
        "prior_sd": (("parameter",), at.model.space.sd),
        "covariance": (("parameter", "parameter_2"), at.covariance),
        "robust_covariance": (("parameter", "parameter_2"), covariance),
        "robust_sd": (("parameter",), np.sqrt(np.diag(covariance))),
        "robust_principal_sd": (("axis",), principal_sd(at, covariance)),
        "discount": (("slew", "channel"), at.discount),
        "slew_chi2": (("slew", "channel"), at.information.chi2 / at.discount),
        "slew_n_data": (("slew", "channel"), at.information.n_data),
    }
    variables |= {f"residual_{c}": (_RESIDUAL_DIMS[c], r) for c, r in series.items()}
    coords = {
        "parameter": names,
        "parameter_2": names,
        "channel": list(CHANNELS),
        "slew": [s.name for s in at.model.campaign.slews],
    }
    return xr.DataTree(xr.Dataset(variables, coords=coords))


_RESIDUAL_DIMS = {
    "rate": ("slew", "row", "sensor_axis"),
    "attitude": ("slew", "fix", "body_axis"),
    "momentum": ("slew", "row", "wheel"),
}


def _residual_arrays(at: Estimate):
    r = residuals(at.model.structure, at.point, at.model.data, at.stated)
    return zip(CHANNELS, r, (3, 3, max(1, at.model.structure.wheels)), strict=True)


def _about(
    at: Estimate, chains: Chains, noise: Mapping[str, float] | None, verdict: str | None
) -> dict[str, Any]:
    diagnostics = asdict(chains.diagnostics)
    tests = at.tests
    return {
        "diagnostics": diagnostics,
        "fit": {
            "reduced_chi2": {key: test.reduced_chi2 for key, test in tests.items()},
            "interval_99": {key: test.interval for key, test in tests.items()},
            "p_chi2": {key: test.p_chi2 for key, test in tests.items()},
            "p_white": {key: test.p_white for key, test in tests.items()},
            "n_data": int(at.information.n_data.sum()),
            "discounted": at.discounted,
            "starts_agreeing": list(at.starts),
        },
        "gates": gates(at, chains, noise, verdict),
        "effects": [e.name for e in at.model.effects],
        "ensembles": len(chains.samples),
        "includes_wheel_spin": at.model.structure.includes_wheel_spin,
        "drive": at.model.structure.drive,
        "wheels": at.model.structure.wheels,
        "versions": {
            name: metadata.version(name)
            for name in ("bayes-inertia", "jax", "emcee", "arviz", "numpy", "scipy")
        },
    }


def gates(
    at: Estimate,
    chains: Chains,
    noise: Mapping[str, float] | None = None,
    verdict: str | None = None,
) -> list[dict[str, Any]]:
    """What must hold before the numbers are used: [{name, passed, says}], in plain words; `noise` and `verdict` as in `build`."""
    found = chains.diagnostics
    rejected = [key for key, test in at.tests.items() if test.too_large]
    small = [key for key, test in at.tests.items() if test.rejected and not test.too_large]
    loud = [f"{key} (reduced chi^2 {at.tests[key].reduced_chi2:.3g})" for key in rejected]
    louder = [
        f"{channel} {factor:.2f}" for channel, factor in (noise or {}).items() if factor > 1.0
    ]
    taken = (
        f"the noise that was measured (times what is stated: {', '.join(louder)}; of its loudest axis)"
        if louder
        else "the stated noise"
    )
    explained = f"the residuals are what the model and {taken} predict"
    if small:
        explained = f"the residuals are smaller than {taken} predicts, in {', '.join(small)}: the uncertainties are too cautious"
    if rejected:
        explained = (
            f"the model does not explain the data: {', '.join(loud)}; {'use robust_sd, ' if len(at.model.campaign.slews) > 1 else ''}"
            "look for the missing effect with `diagnose`, and do not read sd as the uncertainty"
        )
    length = (found.steps - found.discarded) / max(found.tau_max, 1.0)
    converged = f"nested R-hat {found.nested_rhat_max:.4f} (below 1.01), effective samples {min(found.ess_bulk_min, found.ess_tail_min):.0f} (at least 400), "
    converged += f"chains {length:.0f} autocorrelation times long (at least 20)"
    return [
        {
            "name": "converged",
            "passed": found.converged,
            "says": f"the ensembles {'agree' if found.converged else 'have not converged'}: {converged}",
        },
        {"name": "explained", "passed": not rejected, "says": explained},
        *(
            [{"name": "diagnosed", "passed": False, "says": _UNKNOWN}]
            if verdict == "unknown"
            else []
        ),
    ]


_UNKNOWN = "the diagnosis found that something is missing which no candidate explains: it may shift J and K by more than any sd"
