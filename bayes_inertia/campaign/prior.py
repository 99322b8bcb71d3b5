"""What was known of J and K before a campaign, all together: a Gaussian with correlations.

A former result is such a prior: `prior_in` reads it from the summary of its run.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayes_inertia import errors
from bayes_inertia.campaign.hardware import numbers, one_an_axis, require_key, require_sd
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.errors import CampaignError, members
from bayes_inertia.files import path_of, read_bytes, text_of
from bayes_inertia.maths.printed import Card, parameter_card, shown_as
from bayes_inertia.maths.tensor_elements import COLUMNS_OF_ELEMENTS, ELEMENTS, ROWS_OF_ELEMENTS
from bayes_inertia.maths.values import array_dataclass, json_ready
from bayes_inertia.sealing import read_sealed_json
from bayes_inertia.tables.aem_file import message_blocks

# Where a result keeps the prior that it is for the next campaign.
SUMMARY_FILE, SUMMARY_KEY = "summary.json", "as_prior"
# What lies in a copy of a campaign whose description names a run.
COPY_FILE = "prior.json"
# Format of a result that `export` wrote.
EXPORT_FORMAT = "bayes-inertia-export/1"
# Blocks of an attitude comprehensive message (CCSDS 504.0-B-2) that speak of J, K and their
# covariance, whether they hold rows, and what is entered beside the standard's own keywords.
_OF_MESSAGE = {"": False, "PHYS": False, "USER": False}
_ENTERED = "USER_DEFINED_"
_NUMBER_OF_MESSAGE = re.compile(r"I[XYZ]{2}|K\d+|COV_\w+")
# Comments of `export` on why its numbers are less than they seem.
_CAUTION = re.compile(r"(?:NOTE|WARNING): (.*)")
_NAME = re.compile(rf"{'|'.join(ELEMENTS)}|K[1-9]\d*")
_MOMENTS = ("Jxx", "Jyy", "Jzz")


def _card(prior: GaussianPrior) -> Card:
    """What it says of each parameter, or of its logarithm; correlations are left out."""
    values = (
        (f"log {name}", "", mean, sd)
        if name in prior.logarithmic
        else (name, "kg m^2" if name in ELEMENTS else "", mean, sd)
        for name, mean, sd in zip(prior.names, prior.mean, prior.sd, strict=True)
    )
    return parameter_card(f"GaussianPrior of {', '.join(prior.names)}", "mean ± sd", values)


@shown_as(_card)
@array_dataclass
class GaussianPrior:
    """J and K before a campaign, with what goes along with what.

    Of parameters that it does not name the campaign's own priors hold. A tensor that no body can
    have has no probability, whatever the covariance.

    Parameters
    ----------
    names : tuple of str
        Elements of J and scale factors: "Jxx" to "Jyz", "K1", "K2", ...
    mean : (k,) array
        Of each [kg m^2, 1]; of a logarithmic one, of its logarithm.
    covariance : (k, k) array
        Of all.
    lower, upper : (k,) arrays, optional
        Ends of what each may be; None for none.
    logarithmic : tuple of str, optional
        Names of those whose logarithm is Gaussian: moments of inertia known to a factor.
    beyond_sd : (k,) array, optional
        How far the mean may be off beyond the covariance: by what a former result quotes more than
        its model says, correlated as the covariance is. It does not move a fit, and is counted in
        what the fit quotes.
    includes_wheel_spin : bool, optional
        Whether its J holds the wheels' spin inertia (J_locked); a campaign that states the other
        takes it over. None: as `Campaign.inertia` says.
    learnt_from : tuple of str, optional
        `Slew.digest` of the slews that a former result knows it from: no campaign that holds one of
        them takes it, since its telemetry would count twice.
    scale_of_J : tuple of mappings, optional
        What tied the absolute size of J in a former result: `device`, `by` and `relative_sd` of
        each. A campaign with this prior has its size from there too.

    Raises
    ------
    CampaignError
        If shapes do not fit, a name stands twice, or the covariance is none.

    Examples
    --------
    >>> prior = GaussianPrior(("Jxx", "K1"), [3.3, 1.0], [[4e-4, 1e-5], [1e-5, 1e-6]])
    >>> prior.sd
    array([0.02 , 0.001])
    >>> prior.inflated(1e-3).sd.round(5)
    array([0.02027, 0.00141])
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray
    lower: np.ndarray | None = None
    upper: np.ndarray | None = None
    logarithmic: tuple[str, ...] = ()
    beyond_sd: np.ndarray | None = None
    includes_wheel_spin: bool | None = None
    learnt_from: tuple[str, ...] = ()
    scale_of_J: tuple[Mapping[str, Any], ...] = ()

    def __post_init__(self) -> None:
        key = "prior"
        texts = dict.fromkeys(("names", "logarithmic", "learnt_from"), str)
        for field, kind in {**texts, "scale_of_J": Mapping}.items():
            listed = members(getattr(self, field), kind, f"key {key}.{field}")
            object.__setattr__(self, field, listed)
        for field in ("mean", "covariance", "lower", "upper", "beyond_sd"):
            value = getattr(self, field)
            if value is not None or field in ("mean", "covariance"):
                object.__setattr__(self, field, numbers(value, f"{key}.{field}"))
        names = self.names
        k, advice = len(names), "give one number a name, and one covariance a pair"
        vectors = (self.mean, self.lower, self.upper, self.beyond_sd)
        fits = all(x is None or x.shape == (k,) for x in vectors)
        fits = fits and self.covariance.shape == (k, k)
        require_key(k > 0 and fits, key, f"{k} names do not fit the numbers", advice)
        require_key(len(set(names)) == k, f"{key}.names", "a name is used twice", "give each once")
        unknown = [name for name in names if not _NAME.fullmatch(name)]
        what = f"{unknown[:1]} is no element of J and no scale factor"
        advice = f"choose among {', '.join(ELEMENTS)} and K1, K2, ..."
        require_key(not unknown, f"{key}.names", what, advice)
        known, what = set(self.logarithmic) <= set(names), "names what has no mean"
        require_key(known, f"{key}.logarithmic", what, "name it under names too")
        signed, what = set(self.logarithmic) & set(ELEMENTS[3:]), "a product may be negative"
        require_key(not signed, f"{key}.logarithmic", what, "name moments and scale factors")
        finite = bool(np.isfinite(self.mean).all() and np.isfinite(self.covariance).all())
        require_key(finite, key, "a number is not finite", "give finite numbers")
        self._require_covariance(f"{key}.covariance")
        self._require_ends(key)

    @classmethod
    def of_principal_moments(
        cls,
        principal_moments: ArrayLike,
        relative_sd: ArrayLike,
        axes_sd_deg: float,
        *,
        axes_B: ArrayLike | None = None,
        scale_factors: ArrayLike = (),
        scale_factors_sd: ArrayLike | None = None,
    ) -> GaussianPrior:
        """Principal moments known to a factor, about axes known to an angle.

        Logarithms of the moments are Gaussian, and the axes are turned by three small Gaussian
        angles. The prior has the means and covariance that logarithms of the diagonal of J and its
        products of inertia then have.

        Parameters
        ----------
        principal_moments : (3,) array
            Medians [kg m^2].
        relative_sd : float or (3,) array
            Sd of their logarithms, 0.2 at most: as a fraction of each.
        axes_sd_deg : float
            Sd of the turn about each axis [deg], above 0, 10 at most.
        axes_B : (3, 3) array, optional
            Rows are the principal axes in body axes, as CAD has them; None for the body axes.
        scale_factors : sequence of float, optional
            Medians of K1, K2, ...; none to leave K as the campaign states it.
        scale_factors_sd : float or array, optional
            Sd of their logarithms: as a fraction of each; 0.03 if left out.

        Returns
        -------
        GaussianPrior
            Of J, and of K where it is given.

        Raises
        ------
        CampaignError
            If no body has these moments, the axes are not orthonormal, or an sd is out of range.

        Examples
        --------
        >>> prior = GaussianPrior.of_principal_moments([3.3, 2.2, 1.6], 0.05, 2.0)
        >>> prior.sd.round(3)  # of the logarithms of Jxx, Jyy, Jzz, then of the products
        array([0.05 , 0.05 , 0.05 , 0.039, 0.06 , 0.021])
        """
        medians = numbers(principal_moments, "prior.principal_moments")
        axes = np.eye(3) if axes_B is None else numbers(axes_B, "prior.axes_B")
        sds = np.array(one_an_axis(relative_sd, 3, "prior.relative_sd"))
        (angle,) = one_an_axis(axes_sd_deg, 1, "prior.axes_sd_deg")
        _require_principal(medians, sds, angle, axes)
        elements = _elements_of(medians, sds, np.radians(angle), axes)
        scale_factors = np.atleast_1d(numbers(scale_factors, "prior.scale_factors"))
        known = len(scale_factors)
        what, advice = "there are no scale_factors that it belongs to", "give their medians, or 1"
        require_key(known > 0 or scale_factors_sd is None, "prior.scale_factors_sd", what, advice)
        positive, what = known == 0 or min(scale_factors) > 0.0, "one is not above 0"
        require_key(positive, "prior.scale_factors", what, "try 1")
        sd = 0.03 if scale_factors_sd is None else scale_factors_sd
        of_K = one_an_axis(sd, known, "prior.scale_factors_sd")
        names = (*ELEMENTS, *(f"K{i + 1}" for i in range(known)))
        covariance = np.zeros((6 + known, 6 + known))
        covariance[:6, :6] = np.cov(elements.T)
        covariance[6:, 6:] = np.diag(np.square(of_K))
        mean = np.concatenate([elements.mean(0), np.log(scale_factors)])
        return cls(names, mean, covariance, logarithmic=(*_MOMENTS, *names[6:]))

    def _require_ends(self, key: str) -> None:
        low = -np.inf if self.lower is None else self.lower
        high = np.inf if self.upper is None else self.upper
        ordered = bool(np.all(np.less(low, high)))
        advice = "give lower < upper, infinite where there is no end"
        require_key(ordered, f"{key}.lower", "no value lies between lower and upper", advice)
        nearest = np.abs(np.clip(self.mean, low, high) - self.mean) / self.sd
        for name, away in zip(self.names, nearest.tolist(), strict=True):
            what = f"the ends of {name} leave out its mean and {away:.0f} sds around it"
            advice = "move the mean between them, or widen the covariance"
            require_key(away <= LIMITS.ends_from_mean, key, what, advice)
        beyond = np.zeros(1) if self.beyond_sd is None else self.beyond_sd
        good = bool(np.isfinite(beyond).all() and (beyond >= 0.0).all())
        require_key(good, f"{key}.beyond_sd", "one is no sd", "give 0 or more")

    def _require_covariance(self, key: str) -> None:
        C, variances = self.covariance, np.diag(self.covariance)
        positive = bool((variances > 0.0).all())
        require_key(positive, key, "a variance is not above zero", "give squares of sds")
        scaled = C / np.sqrt(np.outer(variances, variances))
        symmetric = bool(np.allclose(scaled, scaled.T, rtol=0.0, atol=1e-9))
        require_key(symmetric, key, "it is not symmetric", "give C[i][j] = C[j][i]")
        definite = bool(np.linalg.eigvalsh(scaled)[0] > 0.0)
        advice = "no combination of parameters may be known exactly: widen it"
        require_key(definite, key, "it is not positive definite", advice)

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (k,), each alone."""
        return np.sqrt(np.diag(self.covariance))

    def inflated(self, relative: float) -> GaussianPrior:
        """The prior if everything may have changed a little since.

        Parameters
        ----------
        relative : float
            Sd of the change of each parameter alone: of J as a fraction of its mean moment, of K as
            a fraction of it.

        Returns
        -------
        GaussianPrior
            With the same mean.
        """
        require_sd(relative, "prior.inflate")
        known = zip(self.names, self.mean, strict=True)
        means = {n: np.exp(m) if n in self.logarithmic else m for n, m in known}
        moments = [m for n, m in means.items() if n in _MOMENTS and m > 0.0]
        size = float(np.mean(moments)) if moments else 1.0
        of_each = np.abs(self.mean)
        of_each[[name.startswith("J") for name in self.names]] = size
        of_each[[name in self.logarithmic for name in self.names]] = 1.0
        wider = self.covariance + np.diag((relative * of_each) ** 2)
        return replace(self, covariance=wider)

    def with_wheel_spin(self, spin: np.ndarray, included: bool) -> GaussianPrior:
        """The same knowledge of J with the wheels' spin inertia, or without it.

        Parameters
        ----------
        spin : (3, 3) array
            What J_locked has more than J [kg m^2].
        included : bool
            Whether the result's J holds it.

        Returns
        -------
        GaussianPrior
            Itself where it is so, or does not say.

        Raises
        ------
        CampaignError
            If a moment's logarithm is Gaussian: its sum with something known is not.
        """
        if self.includes_wheel_spin in (None, included):
            return self
        logarithmic = set(self.logarithmic) & set(ELEMENTS)
        what, advice = "its J has the wheels' spin inertia otherwise", "state [inertia] likewise"
        require_key(not logarithmic, "prior.includes_wheel_spin", what, advice)
        elements = spin[ROWS_OF_ELEMENTS, COLUMNS_OF_ELEMENTS] * (1.0 if included else -1.0)
        more = dict(zip(ELEMENTS, elements.tolist(), strict=True))
        shift = np.array([more.get(name, 0.0) for name in self.names])
        stated = {key: getattr(self, key) for key in ("mean", "lower", "upper")}
        moved = {key: value + shift for key, value in stated.items() if value is not None}
        return replace(self, includes_wheel_spin=included, **moved)

    def json(self) -> dict[str, Any]:
        """As it stands in a file.

        Returns
        -------
        dict
            Names, and lists of numbers.
        """
        stated = {field.name: getattr(self, field.name) for field in fields(self)}
        return json_ready({key: x for key, x in stated.items() if x is not None and np.size(x)})


def _require_principal(
    medians: np.ndarray, sds: np.ndarray, angle: float, axes: np.ndarray
) -> None:
    """Refuse what is no body, no frame, or known so badly that a Gaussian does not say it."""
    most, turn = LIMITS.sd_of_moments, LIMITS.sd_of_axes
    key, what = "prior.principal_moments", f"shape {medians.shape} is not (3,)"
    require_key(medians.shape == (3,), key, what, "give three numbers")
    body = bool((medians > 0.0).all() and 2.0 * medians.max() < medians.sum())
    advice = "each is above zero and less than the sum of the two others"
    require_key(body, key, "no body has these moments", advice)
    known = bool(((sds > 0.0) & (sds <= most)).all())
    wide = "known worse than that, state [inertia] with wide sigmas instead"
    require_key(known, "prior.relative_sd", f"it is not above 0 and at most {most}", wide)
    turned = 0.0 < angle <= turn
    require_key(turned, "prior.axes_sd_deg", f"it is not above 0 and at most {turn} deg", wide)
    frame = axes.shape == (3, 3) and bool(np.allclose(axes @ axes.T, np.eye(3), atol=1e-6))
    require_key(frame, "prior.axes_B", "its rows are not orthonormal", "give three unit vectors")


def _elements_of(
    medians: np.ndarray, sds: np.ndarray, angle: float, axes: np.ndarray
) -> np.ndarray:
    """Evenly spread tensors (n, 6): logarithms of the diagonal, and products of inertia."""
    from scipy.spatial.transform import Rotation
    from scipy.stats import qmc

    # Two to this power of points tell covariances to a part in a thousand.
    z = qmc.MultivariateNormalQMC(np.zeros(6), rng=0).random(2**13)
    moments = medians * np.exp(sds * z[:, :3])
    turned = axes @ Rotation.from_rotvec(angle * z[:, 3:]).as_matrix()
    tensors = np.einsum("nki,nk,nkj->nij", turned, moments, turned)
    values = tensors[:, ROWS_OF_ELEMENTS, COLUMNS_OF_ELEMENTS]
    return np.concatenate([np.log(values[:, :3]), values[:, 3:]], 1)


def prior_from_json(content: Mapping[str, Any], where: str) -> GaussianPrior:
    """The prior that `GaussianPrior.json` wrote, or that principal moments make."""
    try:
        if "principal_moments" in content:
            return GaussianPrior.of_principal_moments(**content)
        ends = {
            key: np.array([sign * np.inf if x is None else x for x in content[key]], float)
            for key, sign in (("lower", -1.0), ("upper", 1.0))
            if content.get(key) is not None
        }
        return GaussianPrior(
            tuple(map(str, content["names"])),
            np.array(content["mean"], float),
            np.array(content["covariance"], float),
            logarithmic=tuple(content.get("logarithmic", ())),
            beyond_sd=content.get("beyond_sd"),
            includes_wheel_spin=content.get("includes_wheel_spin"),
            learnt_from=tuple(content.get("learnt_from", ())),
            scale_of_J=tuple(content.get("scale_of_J", ())),
            **ends,
        )
    except CampaignError as error:
        raise error.inside(where) from None
    except (KeyError, TypeError, ValueError) as error:
        advice = "give names, mean and covariance; or principal_moments, relative_sd and "
        advice += "axes_sd_deg; or the folder of a run"
        what = f"no prior of J and K ({error})"
        raise CampaignError(what, where=where, advice=advice) from error


def prior_in(source: str | Path) -> GaussianPrior:
    """What a former result knew of J and K.

    Parameters
    ----------
    source : str or Path
        The folder of a finished run; what `export` made of one in the format "acm" or "json"; or a
        JSON file with `names`, `mean` and `covariance`, or with the arguments of
        `GaussianPrior.of_principal_moments`.

    Returns
    -------
    GaussianPrior
        The posterior of that run, effects and nuisances integrated out.

    Raises
    ------
    CampaignError
        If there is none, or its result cannot be trusted.
    """
    path = path_of(source, "prior")
    of_run = path.is_dir()
    file = path / SUMMARY_FILE if of_run else path
    finished = "the folder of a finished run (`bayes-inertia resume RUN` finishes one)"
    errors.require(
        not of_run or file.is_file(), str(path), "no finished fit is here", f"give {finished}"
    )
    if not of_run:
        text = text_of(read_bytes(file), str(file))
        if "CCSDS_ACM_VERS" in text:
            return prior_from_json(_of_message(text, str(file)), str(file))
        what = "holds no prior"
        advice = f"give {finished}, or what `export` writes: --to acm or json"
        errors.require(text.lstrip().startswith("{"), str(file), what, advice)
    content = read_sealed_json(file, f"give {finished}, or a JSON file")
    if content.get("format") == EXPORT_FORMAT:
        content = _of_export(content, str(file))
    if of_run or SUMMARY_KEY in content:
        what, advice = f"it holds no {SUMMARY_KEY!r}", "fit that campaign again with this version"
        errors.require(SUMMARY_KEY in content, str(file), what, advice)
        known = of_trusted(content[SUMMARY_KEY], str(file))
        content = {"includes_wheel_spin": content.get("includes_wheel_spin"), **known}
    return prior_from_json(content, str(file))


def _of_export(content: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The prior that a result is which `export` wrote as JSON; of effects it says nothing."""
    _require_usable([*content["notes"], *content["reasons"]], where)
    rows = content["parameters"]
    of_body = [k for k, name in enumerate(rows) if _NAME.fullmatch(name)]
    names = [list(rows)[k] for k in of_body]
    covariance = np.array(content["covariance"])[np.ix_(of_body, of_body)]
    mean = [rows[name]["new"] for name in names]
    known = {"names": names, "mean": mean, "covariance": covariance}
    said = ("includes_wheel_spin", "learnt_from", "scale_of_J")
    return known | {key: content[key] for key in said if key in content}


def _of_message(text: str, where: str) -> dict[str, Any]:
    """The prior that an attitude comprehensive message states, as `export` writes one: J_locked."""
    blocks = message_blocks(text, where, _OF_MESSAGE)
    cautions = (_CAUTION.fullmatch(line) for block in blocks for line in block.comments)
    _require_usable([caution[1] for caution in cautions if caution], where)
    stated = dict(chain.from_iterable(block.pairs.items() for block in blocks))
    units = dict(chain.from_iterable(block.units.items() for block in blocks))
    frame = stated.get("INERTIA_REF_FRAME", "SC_BODY")
    advice = "give the inertia in body axes: SC_BODY_1"
    body = frame.upper().startswith("SC_BODY")
    errors.require(body, where, f"INERTIA_REF_FRAME = {frame}", advice)
    told = {
        key.removeprefix(_ENTERED): _number(key, value, units[key], where)
        for key, value in stated.items()
        if _NUMBER_OF_MESSAGE.fullmatch(key.removeprefix(_ENTERED))
    }
    keys = [f"I{name[1:].upper()}" for name in ELEMENTS]
    keys += [key for key in told if key.startswith("K")]
    pairs = [
        [f"COV_{keys[max(i, j)]}_{keys[min(i, j)]}" for j in range(len(keys))]
        for i in range(len(keys))
    ]
    missing = {*keys, *(pair for row in pairs for pair in row)} - {*told}
    # What only a covariance names has no value.
    missing |= {part for key in told for part in key.split("_")[1:]} - {*keys}
    what = f"it states no {min(missing, key=len, default='')}"
    advice = "give names, mean and covariance in a JSON file: the standard has no place for sds"
    errors.require(not missing, where, what, advice)
    return {
        "names": [f"J{key[1:].lower()}" if key.startswith("I") else key for key in keys],
        "mean": [told[key] for key in keys],
        "covariance": [[told[pair] for pair in row] for row in pairs],
        "includes_wheel_spin": True,
        # `export` warns of ratios alone.
        "scale_of_J": [{"device": "inertia message", "by": "size", "relative_sd": 0.0}],
        "learnt_from": [x for key, x in stated.items() if key.startswith(f"{_ENTERED}SLEW_")],
    }


def _number(key: str, text: str, unit: str, where: str) -> float:
    """A number of a message; the standard knows one unit of the tensor."""
    known = unit in ("", "kg*m**2")
    errors.require(known, f"{where}, {key}", f"the unit is {unit!r}", "give kg*m**2")
    with suppress(ValueError):
        if isfinite(number := float(text)):
            return number
    what = f"{text!r} is no number"
    raise CampaignError(what, where=f"{where}, {key}", advice="write a number")


def _require_usable(cautions: Sequence[str], where: str) -> None:
    """Refuse an exported result whose sds say less than they seem."""
    what = f"the result is no prior: {'; '.join(cautions)}"
    errors.require(not cautions, where, what, "give the folder of its run, or another result")


def of_trusted[T](known: T | None, where: str) -> T:
    """What a result knows, or `CampaignError` where it quotes no sd, which None says."""
    if known is None:
        advice = "read its report, and use a result that quotes one"
        what = "the result quotes no sd: it is not to be used, and no prior"
        raise CampaignError(what, where=where, advice=advice)
    return known
