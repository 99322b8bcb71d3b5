"""The result of a fit: an ArviZ DataTree with units, and the summary an engineer reads.

Groups: `posterior` (chain, draw; one variable a parameter), `prior`, `derived` (principal
moments), `sample_stats` (lp), `log_prior`, `log_likelihood` (of each slew),
`log_likelihood_reading` and `posterior_predictive` (thinned draws), `observed_data`,
`constant_data`, and `estimate` (the optimizer's result and both covariances). After an ambiguous
diagnosis also `averaged`: J, K and principal moments, whichever effect of the set is the true one.
`posterior_groups` builds them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import path_of
from bayes_inertia.inference.likelihood_summary import LikelihoodSummary, summary_of
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.maths.printed import NOT_GIVEN, Card, parameter_lines, parameter_text, shown_as
from bayes_inertia.maths.robust_scale import sd_of_interval
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.parameters import after_changes_of_J, base_count, parameter_vectors
from bayes_inertia.sealing import blaming, is_sealed, write_sealed
from bayes_inertia.tables.isolated import check_readable

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

FORMAT = "bayes-inertia-posterior/1"
_ADVICE = "`bayes-inertia resume RUN` writes it again from the run's chains"
# What stands first in summary.json.
_SUMMARY_ORDER = (
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
_NINETY = (0.05, 0.5, 0.95)
# Other measures of what the slews support, for comparison: nothing is quoted from them.
_OTHER_MEASURES = ("hc3_sd", "cr2_sd", "cr2_dof")


def _robust_sd(robust: Any, sd: float) -> float | None:
    """What the slews support, never below the sample's own sd; None of a single slew."""
    return max(float(robust), sd) if np.isfinite(robust) else None


def _moments(draws: np.ndarray) -> dict[str, np.ndarray]:
    """Principal moments of draws (n, d), smallest first."""
    moments = inertia_tensor.principal_moments(draws[:, :6])
    return {f"I{i + 1}": moments[:, i] for i in range(3)}


def _ratios(draws: np.ndarray) -> dict[str, np.ndarray]:
    """Elements of J over the trace, and principal moments over the largest, of draws (n, d)."""
    trace, moments = draws[:, :3].sum(axis=1), _moments(draws)
    ratios = {f"{n}/trace": draws[:, i] / trace for i, n in enumerate(ELEMENTS)}
    return ratios | {f"{n}/I3": moments[n] / moments["I3"] for n in ("I1", "I2")}


def _card(posterior: Posterior) -> Card:
    """Whether to trust it, J and K as quoted, and all parameters."""
    summary = posterior.summary()
    trust = "trusted" if summary["trusted"] else f"not trusted: {'; '.join(summary['reasons'])}"
    told = summary["parameters"]
    if posterior.is_scale_untied:
        # An sd of the size of J would be the prior's.
        told = summary["ratios"] | {n: p for n, p in told.items() if n not in ELEMENTS}
    quoted = {
        name: (p["mean"], math.nan if p["quoted_sd"] is None else p["quoted_sd"])
        for name, p in told.items()
    }
    lines = (
        f"Posterior of {summary['campaign']}, {len(posterior.samples):,} draws: {trust}",
        *parameter_lines(quoted),
    )
    rows = tuple(
        (
            name,
            parameter_text(name, *quoted[name], p["unit"]),
            f"{p['prior_sd']:.2g}",
            # What is wrong with a refused fit may pass for that.
            NOT_GIVEN if p["quoted_sd"] is None else "yes" if p.get("observable", True) else "no",
        )
        for name, p in told.items()
    )
    return Card(lines, ("parameter", "mean ± quoted sd", "prior sd", "determined"), rows)


@shown_as(_card)
@array_dataclass
class Posterior:
    """A finished fit: draws, prior, predictions and what the fit says about itself.

    Build one with `bayes_inertia.fit`, or load a saved one with `Posterior.load`. Fits of one seed
    have equal `samples`; `==` compares when and in how long they were made too.

    Parameters
    ----------
    tree : xarray.DataTree
        ArviZ's groups: `posterior` (chain, draw; one variable a parameter, with its unit), `prior`,
        `sample_stats` (lp), `log_prior`, `log_likelihood` (of each slew, which ArviZ leaves out one
        at a time), `log_likelihood_reading` and `posterior_predictive` (thinned draws),
        `observed_data`, `constant_data`. A chain is one ensemble, its walkers one after the other:
        R-hat compares what is independent. Beside them `derived` (principal moments),
        `estimate` (the optimizer's result and its covariances) and, where J and K are averaged over
        what may be true, `averaged`.

    Examples
    --------
    >>> posterior = Posterior.load("run/posterior.nc")  # doctest: +SKIP
    >>> posterior.trusted  # doctest: +SKIP
    True
    >>> posterior.summary()["parameters"]["Jxy"]["quoted_sd"]  # doctest: +SKIP
    8.7e-05
    >>> posterior.tree["posterior"]["Jxy"].attrs["units"]  # doctest: +SKIP
    'kg m^2'
    """

    tree: xr.DataTree

    def __post_init__(self) -> None:
        own = getattr(self.tree, "attrs", {}).get("format") == FORMAT
        advice = "give the posterior.nc or the tree of a fit by this package"
        require(own, "tree", f"the format is not {FORMAT}", advice)

    @classmethod
    def load(cls, path: str | Path) -> Posterior:
        """Read a saved posterior.

        Parameters
        ----------
        path : str or Path
            Of a finished run, or of its posterior.nc.

        Returns
        -------
        Posterior

        Raises
        ------
        CampaignError
            If the file is not one.
        """
        import xarray as xr

        path = path_of(path, "path")
        path = path / "posterior.nc" if path.is_dir() else path
        advice = "give the folder of a finished run, or its posterior.nc"
        require(path.is_file(), str(path), "no such file", advice)
        intact = is_sealed(path, _ADVICE)
        if not intact:
            # Of an earlier version, or damaged: then it could end this process.
            check_readable(path, "check_tree", _ADVICE)
        with blaming(path, intact=intact, advice=_ADVICE):
            tree = xr.open_datatree(path, engine="h5netcdf").load()
            tree.close()
        try:
            posterior = cls(tree)
        except CampaignError as error:
            raise error.inside(str(path)) from None
        if not intact:
            with blaming(path, intact=False, advice=_ADVICE), np.errstate(over="raise"):
                posterior.summary()
                # What is no text cannot be written to a page.
                json.dumps(posterior.attributes, ensure_ascii=False).encode("utf-8")
        return posterior

    def save(self, path: str | Path) -> Path:
        """Write the tree as netCDF, atomically.

        Parameters
        ----------
        path : str or Path
            Replaced if it exists.

        Returns
        -------
        Path
            Where it was written.
        """

        # In memory: HDF5 can end the process where the disk has no room.
        content = BytesIO()
        self.tree.to_netcdf(content, engine="h5netcdf")
        with content.getbuffer() as written:
            return write_sealed(path, written)

    @property
    def names(self) -> list[str]:
        """Parameter names in the order of the flat vector."""
        return [str(n) for n in self.tree["estimate"].coords["parameter"].values]

    @cached_property
    def samples(self) -> np.ndarray:
        """All draws (n, d) in the order of `names`."""
        group: Any = self.tree["posterior"]
        return np.stack([group[name].values.ravel() for name in self.names], -1)

    @cached_property
    def averaged_samples(self) -> np.ndarray:
        """As `samples`; J and K averaged over an ambiguous set where there is one."""
        tree: Any = self.tree
        averaged, sampled = tree.get("averaged", {}), tree["posterior"]
        groups = [averaged if name in averaged else sampled for name in self.names]
        named = zip(self.names, groups, strict=True)
        return np.stack([group[name].values.ravel() for name, group in named], -1)

    @property
    def inertia(self) -> np.ndarray:
        """All draws of J as tensors (n, 3, 3) [kg m^2], in the order of `samples`."""
        return np.asarray(inertia_tensor.tensor(self.samples[:, :6]))

    @property
    def attributes(self) -> dict[str, Any]:
        """What the fit says about itself: `diagnostics`, `fit`, `gates`, `effects`, `seed`, ..."""
        return json.loads(self.tree.attrs["bayes_inertia"])

    @property
    def trusted(self) -> bool:
        """Whether every gate is passed."""
        return all(gate["passed"] for gate in self.attributes["gates"])

    @cached_property
    def quoted_factor(self) -> float | None:
        """What the sds of the draws are multiplied by to be quoted; None where none can be.

        Slews that disagree widen the sds of a result that is trusted. One that is not has no sd to
        quote, unless all that fails is that something has no name, and J and K hold what it may
        have done (`analyses/results/calibration/unmodelled_disturbance.md`).
        """
        content = self.attributes
        failed = {gate["name"] for gate in content["gates"] if not gate["passed"]}
        if not failed:
            return float((content["fit"].get("dispersion") or {}).get("factor", 1.0))
        allowed_for = any(name.endswith("_remainder") for name in content["effects"])
        unnamed = "diagnosed" in failed and failed <= {"diagnosed", "explained"}
        return 1.0 if unnamed and allowed_for else None

    @cached_property
    def likelihood(self) -> LikelihoodSummary | None:
        """What the campaign alone tells of J and K, with the sds that are quoted.

        Where J changed during the campaign, it is the one after that. None where no sd can be
        quoted.
        """
        quoted = self._quoted()
        if quoted is None:
            return None
        prior_mean, prior = self._at_the_end(*self._normal_prior)
        prior_sd = np.sqrt(np.diag(prior))
        correlated = "prior_correlation" in self.tree["estimate"]
        correlation = prior / np.outer(prior_sd, prior_sd) if correlated else None
        name = str(self.attributes.get("campaign"))
        told = summary_of(name, *quoted, prior_mean, prior_sd, correlation)
        own = self.attributes.get("slew_digests", {}).get("own", ())
        ties = self.attributes.get("scale_of_J")
        untied = ties is not None and all(tie.get("former") for tie in ties)
        return replace(told, is_scale_untied=untied, learnt_from=tuple(own))

    @property
    def _normal_prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (d,) and covariance (d, d) of the prior that counted beside the data."""
        estimate: Any = self.tree["estimate"]
        # Of a logarithmic prior the one that counted in the covariance; not in older files.
        own = "normal_" if "normal_prior_sd" in estimate else ""
        sd, correlation = np.array(estimate[f"{own}prior_sd"]), np.eye(len(self.names))
        if "prior_correlation" in estimate:
            correlation = np.array(estimate["prior_correlation"])
        return np.array(estimate[f"{own}prior_mean"]), correlation * np.outer(sd, sd)

    @cached_property
    def _widening(self) -> np.ndarray:
        """What draws about their mean are multiplied by (d, d) to scatter as far as is quoted.

        The data's information is divided by the square of the factor, the prior's is not: slews
        say nothing of how wrong that is.
        """
        factor = self.quoted_factor or 1.0
        covariance = np.array(self.tree["estimate"]["covariance"])
        if factor == 1.0:
            return np.eye(len(covariance))
        # In units in which the prior is white.
        root = np.linalg.cholesky(self._normal_prior[1])
        shares, directions = np.linalg.eigh(
            np.linalg.solve(root, np.linalg.solve(root, covariance).T)
        )
        wider = factor / np.sqrt(1.0 + np.clip(shares, 0.0, 1.0) * (factor**2 - 1.0))
        return np.linalg.solve(root.T, ((directions * wider) @ directions.T).T @ root.T).T

    def _quoted(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Mean (n,) and covariance (n, n) of J after its changes, and K, as quoted."""
        if self.quoted_factor is None:
            return None
        estimate, n = self.tree["estimate"], base_count(self.names)
        theta, covariance = np.array(estimate["theta"]), np.array(estimate["covariance"])
        wider = self._widening @ covariance @ self._widening.T
        mean, covariance = self._at_the_end(theta, wider)
        if not self._is_averaged(self.names[0]):
            return mean, covariance
        # Along each parameter, as what is quoted.
        low, middle, high = np.quantile(self.averaged_samples[:, :n], _NINETY, axis=0)
        more = np.maximum(1.0, sd_of_interval(low, high) / self.samples[:, :n].std(0))
        return middle + (mean - theta[:n]), covariance * np.outer(more, more)

    def _at_the_end(self, mean: np.ndarray, covariance: Any) -> tuple[np.ndarray, np.ndarray]:
        """J after its changes, and K, (n,) and (n, n), from all parameters."""
        sums = after_changes_of_J(self.names)
        told = np.flatnonzero(sums.any(axis=0))
        sums, covariance = sums[:, told], np.array(covariance)[np.ix_(told, told)]
        return sums @ mean[told], sums @ covariance @ sums.T

    @property
    def as_prior(self) -> GaussianPrior | None:
        """J and K as this fit knows them, for the next campaign; None where it is not to be used.

        A fit with it is the joint fit of both campaigns, each with a rate bias of its own; slews of
        one campaign that share a bias are known better fitted together. What this fit quotes beyond
        its model's sds does not move the next one, and is counted in what that quotes. Where J
        changed during the campaign, it is the one after that.
        """
        quoted = self._quoted()
        if quoted is None:
            return None
        estimate, names = self.tree["estimate"], tuple(self.names[: base_count(self.names)])
        at, covariance = self._at_the_end(np.array(estimate["theta"]), estimate["covariance"])
        sums = after_changes_of_J(self.names)
        beyond = self._beyond(lambda theta: theta @ sums.T)
        slews = self.attributes.get("slew_digests", {})
        known: dict[str, Any] = {
            "includes_wheel_spin": self.attributes.get("includes_wheel_spin"),
            "learnt_from": [*slews.get("own", ()), *slews.get("former", ())],
            "scale_of_J": self.attributes.get("scale_of_J", ()),
        }
        if not self.trusted:
            return GaussianPrior(names, *quoted, beyond_sd=beyond, **known)
        more = np.diag(quoted[1] - covariance)
        beyond = np.sqrt(beyond**2 + np.maximum(more, 0.0))
        return GaussianPrior(names, at, covariance, beyond_sd=beyond, **known)

    @cached_property
    def _shifts(self) -> np.ndarray:
        """How a former result, taken as prior, may move all parameters (k, d), of one sd each."""
        estimate, key = self.tree["estimate"], "prior_beyond_shifts"
        return np.array(estimate[key]) if key in estimate else np.zeros((1, len(self.names)))

    def _beyond(self, of: Callable[[np.ndarray], Any]) -> np.ndarray:
        """What a former result, taken as prior, adds to quoted sds of numbers of draws (n, d)."""
        at = np.array(self.tree["estimate"]["theta"])[None]
        return np.linalg.norm(of(at + self._shifts) - of(at), axis=0)

    def widened(self, draws: np.ndarray) -> np.ndarray:
        """Draws scattered as far as what is quoted.

        Parameters
        ----------
        draws : (n, d) array
            `samples` or `averaged_samples`.

        Returns
        -------
        (m, d) array
            Without tensors that no body can have.
        """
        draws = np.atleast_2d(parameter_vectors(draws, len(self.names), "draws"))
        noise = np.random.default_rng(0).standard_normal((len(draws), len(self._shifts)))
        wider = self._scattered(draws) + noise @ self._shifts
        return wider[inertia_tensor.is_physical(wider[:, :6])]

    def _scattered(self, draws: np.ndarray) -> np.ndarray:
        """Draws (n, d) as far from their mean as the slews scatter."""
        more = self._widening - np.eye(len(self._widening))
        return draws + (draws - draws.mean(axis=0)) @ more.T

    def summary(self) -> dict[str, Any]:
        """The content of summary.json.

        Returns
        -------
        dict
            Parameters with mean, sd, the sd to quote (None where none can be) and quantiles;
            principal moments; diagnostics; gates.
        """
        tree: Any = self.tree
        content = {"campaign": None} | self.attributes
        content["format"] = "bayes-inertia-summary/1"
        content["trusted"] = self.trusted
        content["reasons"] = [gate["says"] for gate in content["gates"] if not gate["passed"]]
        content["parameters"] = self._parameters()
        content["derived"] = self._rows(_moments)
        robust_sds = tree["estimate"]["robust_principal_sd"]
        for row, robust in zip(content["derived"].values(), robust_sds, strict=True):
            row |= {"robust_sd": _robust_sd(robust, row["sd"]), "unit": "kg m^2"}
        prior = np.stack([tree["prior"][n].values.ravel() for n in ELEMENTS], -1)
        sds = before = {n: x.std(ddof=1) for n, x in _ratios(prior).items()}
        if "preflight_sd" in tree["estimate"]:
            before = {n: x.std(ddof=1) for n, x in _ratios(self._preflight(prior)).items()}
        content["ratios"] = self._rows(_ratios)
        for name, row in content["ratios"].items():
            contraction = float(1.0 - (row["sd"] / before[name]) ** 2)
            row |= {"unit": "", "prior_sd": float(sds[name]), "contraction": contraction}
        content["likelihood"] = None if self.likelihood is None else self.likelihood.json()
        content["as_prior"] = None if self.as_prior is None else self.as_prior.json()
        others = [key for key in content if key not in _SUMMARY_ORDER]
        return {key: content[key] for key in [*_SUMMARY_ORDER, *others]}

    def to_dataframe(self) -> pd.DataFrame:
        """The parameters of `summary` as a table.

        Returns
        -------
        pandas.DataFrame
            One row a parameter, one column a number; `quoted_sd` is the one to use, and not a
            number where none can be quoted.
        """
        from pandas import DataFrame

        rows = self.summary()["parameters"].items()
        table = {
            name: {key: math.nan if x is None else x for key, x in row.items()}
            for name, row in rows
        }
        return DataFrame.from_dict(table, orient="index")

    def _parameters(self) -> dict[str, Any]:
        """All parameters as they stand in summary.json."""
        estimate: Any = self.tree["estimate"]
        rows = self._rows(lambda draws: dict(zip(self.names, draws.T, strict=True)))
        for i, (name, row) in enumerate(rows.items()):
            contraction = self._contraction(i, row["sd"])
            row |= {
                "robust_sd": _robust_sd(estimate["robust_sd"][i], row["sd"]),
                **{key: float(estimate[key][i]) for key in _OTHER_MEASURES if key in estimate},
                **self._decisive_slew(i),
                "unit": str(self.tree["posterior"][name].attrs.get("units", "")),
                "prior_sd": float(estimate["prior_sd"][i]),
                "contraction": contraction,
                "observable": contraction > LIMITS.observable_above and not self._is_size(name),
            }
        return rows

    def _preflight(self, prior: np.ndarray) -> np.ndarray:
        """Draws (n, 6) of J before former results too, about the mean of the prior's."""
        sd: Any = self.tree["estimate"]["preflight_sd"]
        noise = np.random.default_rng(0).normal(size=prior.shape)
        return prior.mean(axis=0) + np.array(sd)[:6] * noise

    def _contraction(self, i: int, sd: float) -> float:
        """Share of a parameter's prior variance that the data took away, former results' too."""
        estimate: Any = self.tree["estimate"]
        log_sd = float(estimate["prior_log_sd"][i]) if "prior_log_sd" in estimate else np.nan
        if np.isfinite(log_sd):
            # A factor of a few, up or down, is no matter of sds in the parameter's unit.
            return float(1.0 - (np.log(self.samples[:, i]).std(ddof=1) / log_sd) ** 2)
        prior_sd = estimate.get("preflight_sd", estimate["prior_sd"])
        return float(1.0 - (sd / float(prior_sd[i])) ** 2)

    def _rows(self, of: Callable[[np.ndarray], dict[str, np.ndarray]]) -> dict[str, Any]:
        """What summary.json says of numbers, by what they are of draws (n, d)."""
        sampled = of(self.samples)
        is_wider = self.quoted_factor not in (None, 1.0)
        wider = of(self._scattered(self.samples)) if is_wider else sampled
        beyond = self._beyond(lambda draws: np.stack([*of(draws).values()], -1)).tolist()
        rows = {}
        for (name, draws), added in zip(of(self.averaged_samples).items(), beyond, strict=True):
            q05, q50, q95 = (float(q) for q in np.quantile(draws, _NINETY))
            quoted = None
            if self.quoted_factor is not None and not self._is_size(name):
                factor = float(wider[name].std() / sampled[name].std())
                quoted = factor * float(sd_of_interval(q05, q95))
                # What a former result, taken as prior, adds.
                quoted = float(np.hypot(quoted, added)) if added else quoted
            rows[name] = {
                # Thin long tails rule the mean of an average over models.
                "mean": q50 if self._is_averaged(name) else float(draws.mean()),
                # Of the model that was fitted, before any average over models.
                "sd": float(sampled[name].std(ddof=1)),
                "quoted_sd": quoted,
                "q05": q05,
                "q50": q50,
                "q95": q95,
            }
        return rows

    def _is_size(self, name: str) -> bool:
        """Whether it tells the size of J where nothing ties that: an sd would be the prior's."""
        return self.is_scale_untied and name in (*ELEMENTS, "I1", "I2", "I3")

    @property
    def is_scale_untied(self) -> bool:
        """Whether nothing ties the absolute size of J, which then is the prior's."""
        return self.attributes.get("scale_of_J") == []

    @property
    def sized_samples(self) -> np.ndarray:
        """The draws (n, size), J at its mean trace where nothing ties its size."""
        samples = np.array(self.samples)
        if self.is_scale_untied:
            trace = samples[:, :3].sum(axis=1, keepdims=True)
            samples[:, :6] *= trace.mean() / trace
        return samples

    def _is_averaged(self, name: str) -> bool:
        """Whether draws are an average over models: thin long tails rule the mean of one."""
        if "averaged" not in self.tree:
            return False
        return name in self.tree["averaged"] or name not in self.names

    def _decisive_slew(self, i: int) -> dict[str, Any]:
        """The slew without which a parameter would be known worst, with its sds."""
        estimate: Any = self.tree["estimate"]
        if "sd_without_slew" not in estimate or len(estimate["slew"]) < 2:
            return {}
        sds = estimate["sd_without_slew"].values[:, i]
        most = int(np.argmax(sds))
        slew = str(estimate["slew"].values[most])
        answer = {"decisive_slew": slew, "sd_without_it": float(sds[most])}
        if "sd_with_slew_again" in estimate:
            answer["sd_with_it_again"] = float(estimate["sd_with_slew_again"].values[most, i])
        return answer
