"""What no amount of data of this kind can tell apart: stated from physics before any sampling, and checked in numbers.

With a body turned by its own wheels, J w + G H is constant or driven by what is known of the wheels. Whatever
scales J and everything known of the wheels alike changes no measurement; motions w that span only a line or a
plane show J only through J w (Ferguson's paper, section on identifiability; Wensing et al. 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.linear_algebra import inverse

# A direction with less than this part of the typical information counts as exactly degenerate.
EXACT_BELOW = 1e-6
# An axis counts as not turned about when its rms rate is below this part of the main axis's, or below the noise.
_NOT_TURNED = 0.02
_GAIN = "wheel_torque_gain."


@dataclass(frozen=True)
class Degeneracy:
    """Something that the campaign cannot tell apart.

    Attributes
    ----------
    name : "common wheel gain", "wheel at rest", "single axis", "single plane", "no wheels" or "no attitude".
    exact : whether nothing at all tells, as opposed to weak terms.
    in_sd : whether the fit's sd contains it; False: the sd is conditional on what the statement assumes.
    parameters : names of the fitted parameters that it concerns.
    information_ratio : data information along the degenerate direction over that along J's part of it alone; None where
        the other part is not fitted.
    says : one or two plain sentences.
    """

    name: str
    exact: bool
    in_sd: bool
    parameters: tuple[str, ...]
    information_ratio: float | None
    says: str


def data_information(at: Estimate) -> np.ndarray:
    """What the data say of the free parameters (f, f), nuisances integrated out, in inverse squares of their units."""
    free = at.free
    slope = prior_rows(at.model, at.theta)[0][free]
    return inverse(at.covariance[np.ix_(free, free)]) - np.diag(slope**2)


def in_words(names: Sequence[str], weights: np.ndarray, threshold: float = 0.3) -> str:
    """A direction as people say it: J's terms, then what goes with them; terms below `threshold` of the largest are left out.

    >>> in_words(("Jxx", "Jyy", "K1"), np.array([0.7, 0.65, -0.4]))
    'Jxx+Jyy with -K1'
    >>> in_words(("Jxx", "K1", "K2"), np.array([0.01, -0.7, 0.7]))
    'K1-K2'
    """
    weights = np.asarray(weights, float)
    order = [
        i
        for i in np.argsort(-np.abs(weights), kind="stable")
        if abs(weights[i]) >= threshold * np.abs(weights).max()
    ]
    main = (
        [i for i in order if names[i] in inertia_tensor.ELEMENTS]
        or [i for i in order if names[i] in ("K1", "K2", "K3")]
        or order
    )
    sign = np.sign(weights[min(main)])
    first = _sum(names, sign * weights, sorted(main))
    rest = _sum(names, sign * weights, sorted(set(order) - set(main)))
    return f"{first} with {rest}" if rest else first


def _sum(names: Sequence[str], weights: np.ndarray, index: list[int]) -> str:
    return "".join(("-" if weights[i] < 0 else "+") + names[i] for i in index).removeprefix("+")


def stated_degeneracies(at: Estimate) -> tuple[Degeneracy, ...]:
    """What the campaign's layout makes impossible or hard to tell, each with a number where the fit holds both sides."""
    campaign = at.model.campaign
    found = [
        *(_no_wheels(at) if not campaign.wheels else _common_gain(at)),
        *_resting_wheels(at),
        *_turned_axes(at),
        *_no_attitude(at),
    ]
    return tuple(found)


def turned_axes(campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3; columns, body frame) that the slews turn about, and the rms rates (3,) [rad/s] about them, largest first, sensor noise subtracted.

    Returns the rates, then the axes.
    """
    sensor = campaign.rate_sensor
    rates = np.concatenate([s.rate for s in campaign.slews if s.rate is not None])
    rates = rates[np.isfinite(rates).all(axis=1)]
    if not len(rates):
        return np.zeros(3), np.eye(3)
    body = np.linalg.inv(sensor.axes)
    rates = (rates * np.array(sensor.scale_factor) - np.array(sensor.bias)) @ body.T
    power = rates.T @ rates / len(rates) - body @ np.diag(np.square(sensor.sigma)) @ body.T
    values, axes = np.linalg.eigh(power)
    return np.sqrt(np.maximum(values[::-1], 0.0)), axes[:, ::-1]


def _places(at: Estimate, names: Sequence[str]) -> np.ndarray:
    all_names = at.model.space.names
    return np.array([k for k, i in enumerate(at.free) if all_names[i] in names], dtype=int)


def _scale_direction(at: Estimate) -> np.ndarray:
    """Direction (f,) that scales J (without the wheels' spin inertia) as a whole."""
    J = np.array(inertia_tensor.tensor(jnp.asarray(at.theta[:6])))
    if at.model.structure.includes_wheel_spin:
        campaign = at.model.campaign
        J = J - campaign.wheel_axes_B @ np.diag(campaign.spin_inertias) @ campaign.wheel_axes_B.T
    out = np.zeros(len(at.free))
    out[_places(at, inertia_tensor.ELEMENTS)] = np.asarray(inertia_tensor.elements(jnp.asarray(J)))[
        at.free[at.free < 6]
    ]
    return out


def _ratio(at: Estimate, whole: np.ndarray, part: np.ndarray) -> float:
    information = data_information(at)
    alone = part @ information @ part
    return float(max(whole @ information @ whole, 0.0) / alone) if alone > 0.0 else 0.0


def _common_gain(at: Estimate) -> list[Degeneracy]:
    names = [at.model.space.names[i] for i in at.free]
    gains = [n for n in names if n.startswith(_GAIN)]
    says = (
        "With wheels only, J and a gain common to all wheels are exactly degenerate: scaling J, the wheels' torques and their momenta together changes no "
        "measurement. "
    )
    tachometers = at.model.structure.drive == "commanded" and bool(
        at.information.n_data[:, 2].any()
    )
    if len(gains) < len(at.model.campaign.wheels) or at.model.structure.drive == "measured":
        says += "The fit takes the wheels' calibration as known: an error of 1 % common to all of them is an error of 1 % in all of J that no sd contains."
        return [Degeneracy("common wheel gain", True, False, inertia_tensor.ELEMENTS, None, says)]
    part = _scale_direction(at)
    whole = part.copy()
    whole[_places(at, gains)] = at.theta[at.free[_places(at, gains)]]
    ratio = _ratio(at, whole, part)
    exact = ratio < EXACT_BELOW
    if tachometers and not exact:
        says += (
            f"Here the tachometers tell the gain of the torques (information left: {ratio:.2g} of that with known gains), "
            "but a scale error common to the tachometers takes its place, and no sd contains that one."
        )
    else:
        says += (
            f"The fitted gains show it: along that direction {ratio:.1g} of the information is left, "
            "and the size of J is known only as well as the gains' and its own prior."
        )
    return [
        Degeneracy(
            "common wheel gain",
            exact,
            not (tachometers and not exact),
            (*inertia_tensor.ELEMENTS, *gains),
            ratio,
            says,
        )
    ]


def _no_wheels(at: Estimate) -> list[Degeneracy]:
    part = _scale_direction(at)
    typical = float(np.trace(data_information(at)[:6, :6]) * (part @ part) / 6.0)
    ratio = float(max(part @ data_information(at) @ part, 0.0) / typical) if typical > 0 else 0.0
    says = "There are no wheels: a body that turns freely shows the ratios of J's elements and never their size, which stays as the prior says."
    return [
        Degeneracy("no wheels", ratio < EXACT_BELOW, True, inertia_tensor.ELEMENTS, ratio, says)
    ]


def _resting_wheels(at: Estimate) -> list[Degeneracy]:
    campaign, out = at.model.campaign, []
    for k, wheel in enumerate(campaign.wheels):
        torque = [s.wheel_torque[:, k] for s in campaign.slews if s.wheel_torque is not None]
        read = [s.wheel_momentum[:, k] for s in campaign.slews if s.wheel_momentum is not None]
        spans = [float(np.ptp(m[np.isfinite(m)])) for m in read if np.isfinite(m).any()]
        noise = 10.0 * (
            wheel.momentum_sigma or 0.0
        )  # more than the range of white noise in 10^5 samples
        commanded = any(np.any(t != 0.0) for t in torque)
        if commanded or not (torque or spans) or (spans and max(spans) > noise and not torque):
            continue
        own = tuple(
            at.model.space.names[i]
            for i in at.free
            if at.model.space.names[i].endswith(f"_{wheel.name}")
        )
        says = f"Wheel {wheel.name} never changes its momentum: nothing here depends on its torque gain, lag or friction; what is fitted of them is the prior."
        out.append(Degeneracy("wheel at rest", True, True, own, None, says))
    return out


def _turned_axes(at: Estimate) -> list[Degeneracy]:
    rms, axes = turned_axes(at.model.campaign)
    least = max(_NOT_TURNED * rms[0], float(np.max(at.model.campaign.rate_sensor.sigma)))
    turned = int(np.sum(rms > least))
    if turned == 3 or rms[0] == 0.0:
        return []
    exact = bool(rms[min(turned, 2)] < float(np.max(at.model.campaign.rate_sensor.sigma)))
    if turned <= 1:
        text = ", ".join(f"{x:+.3f}" for x in axes[:, 0])
        says = (
            f"All slews turn about one body axis ({text}): they show the three components of J times that axis, and nothing of the other three "
            "combinations of J; scale factors of sensor axes across it are not seen either."
        )
        return [Degeneracy("single axis", exact, True, _across(at, axes[:, 1:]), None, says)]
    text = ", ".join(f"{x:+.3f}" for x in axes[:, 2])
    says = f"All slews turn about axes in one plane: the moment of inertia about its normal ({text}) is not seen."
    return [Degeneracy("single plane", exact, True, _across(at, axes[:, 2:]), None, says)]


def _across(at: Estimate, unseen: np.ndarray) -> tuple[str, ...]:
    """Elements of J that are mainly in the block (unseen axes)^T J (unseen axes), and scale factors of sensor axes along them."""
    project = unseen @ unseen.T
    names = []
    for k, name in enumerate(inertia_tensor.ELEMENTS):
        unit = np.array(inertia_tensor.tensor(jnp.asarray(np.eye(6)[k])))
        if np.linalg.norm(project @ unit @ project) > 0.5 * np.linalg.norm(unit):
            names.append(name)
    axes = at.model.campaign.rate_sensor.axes
    names += [f"K{i + 1}" for i in range(3) if np.linalg.norm(project @ axes[i]) > 0.9]
    fitted = {at.model.space.names[i] for i in at.free}
    return tuple(n for n in names if n in fitted)


def _no_attitude(at: Estimate) -> list[Degeneracy]:
    if at.information.n_data[:, 1].any():
        return []
    ratio = _left_with_free_inertia(at)
    says = (
        "There is no star tracker fix: nothing measures the angle turned, and a scale common to the three rate sensor axes trades against J, "
        f"apart from gyroscopic terms: with J free, {ratio:.1g} of the information on that scale is left."
    )
    return [
        Degeneracy(
            "no attitude",
            ratio < EXACT_BELOW,
            True,
            (*inertia_tensor.ELEMENTS, "K1", "K2", "K3"),
            ratio,
            says,
        )
    ]


def _left_with_free_inertia(at: Estimate) -> float:
    """Information on a scale common to K1, K2 and K3 with J free, over that with J known."""
    information, tensor, scales = (
        data_information(at),
        _places(at, inertia_tensor.ELEMENTS),
        _places(at, ("K1", "K2", "K3")),
    )
    direction = np.zeros(len(at.free))
    direction[scales] = at.theta[at.free[scales]]
    slope = prior_rows(at.model, at.theta)[0][at.free[tensor]]
    pull = (information @ direction)[tensor] / slope
    alone = direction @ information @ direction
    hidden = (
        pull
        @ np.linalg.pinv(
            information[np.ix_(tensor, tensor)] / np.outer(slope, slope),
            rcond=1e-12,
            hermitian=True,
        )
        @ pull
    )
    return float(np.clip(1.0 - hidden / alone, 0.0, 1.0)) if alone > 0.0 else 0.0
