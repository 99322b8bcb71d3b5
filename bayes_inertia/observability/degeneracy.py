"""Degeneracies: stated from physics, checked in numbers.

With a body turned by its own wheels, J w + G H is constant or driven by what is known of the
wheels. Whatever scales J and everything known of the wheels alike changes no measurement; motions
w that span only a line or a plane show J only through J w (Ferguson's paper, section on
identifiability; Wensing et al. 2018).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import axes_to_body
from bayes_inertia.files import vocabulary
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.objective import prior_equations, prior_rows
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.observability.limits import LIMITS
from bayes_inertia.physics.actuators import ties_of_scale

_GAIN_PREFIX = "wheel_torque_gain."
_SAYS = vocabulary("observability")["degenerate"]


@dataclass(frozen=True)
class Degeneracy:
    """Something that the campaign cannot tell apart.

    Parameters
    ----------
    name : str
        "common wheel gain", "size of J", "wheel at rest", "single axis", "single plane" or
        "no attitude".
    exact : bool
        Whether nothing at all tells, as opposed to weak terms.
    in_sd : bool
        Whether the fit's sd contains it; False: the sd is conditional on what the statement
        assumes.
    parameters : tuple of str
        Names of the fitted parameters that it concerns.
    information_ratio : float or None
        Data information along the degenerate direction over that along J's part of it alone;
        None where the other part is not fitted.
    says : str
        One or two plain sentences.
    """

    name: str
    exact: bool
    in_sd: bool
    parameters: tuple[str, ...]
    information_ratio: float | None
    says: str


def data_information(estimate: Estimate) -> np.ndarray:
    """Fisher information of the data on the f free parameters, nuisances integrated out.

    Returns (f, f).
    """
    free = estimate.free
    prior, _ = prior_equations(estimate.model, estimate.theta, free)
    return inverse(estimate.covariance[np.ix_(free, free)]) - prior


def in_words(names: Sequence[str], weights: np.ndarray) -> str:
    """A direction as people say it: J's terms, then what goes with them.

    `weights` (f,). Terms below three tenths of the largest are left out.

    Examples
    --------
    >>> in_words(("Jxx", "Jyy", "K1"), np.array([0.7, 0.65, -0.4]))
    'Jxx+Jyy with -K1'
    >>> in_words(("Jxx", "K1", "K2"), np.array([0.01, -0.7, 0.7]))
    'K1-K2'
    """
    weights = np.asarray(weights, float)
    size = np.abs(weights)
    order = [i for i in np.argsort(-size, kind="stable") if size[i] >= 0.3 * size.max()]
    main = (
        [i for i in order if names[i] in inertia_tensor.ELEMENTS]
        or [i for i in order if names[i].startswith("K") and "." not in names[i]]
        or order
    )
    sign = np.sign(weights[min(main)])
    first = _sum(names, sign * weights, sorted(main))
    rest = _sum(names, sign * weights, sorted(set(order) - set(main)))
    return f"{first} with {rest}" if rest else first


def _sum(names: Sequence[str], weights: np.ndarray, index: list[int]) -> str:
    return "".join(("-" if weights[i] < 0 else "+") + names[i] for i in index).removeprefix("+")


def stated_degeneracies(estimate: Estimate) -> tuple[Degeneracy, ...]:
    """Degeneracies by the campaign's layout, each with a number where the fit holds both sides."""
    ties = ties_of_scale(estimate.model.campaign)
    only_wheels = [tie["device"] for tie in ties] == ["wheels"]
    return (
        _common_gain(estimate) if only_wheels else _size_of_J(estimate, ties),
        *_resting_wheels(estimate),
        *_unturned_axes(estimate),
        *_no_attitude(estimate),
    )


def turned_axes(campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """Axes and rates about which the slews turn, sensor noise subtracted.

    Returns `rms` (3,): rates about the axes, largest first [rad/s]; `axes_B` (3, 3): the axes as
    columns, in the body frame.
    """
    (seen, noise), stated = campaign.body_rates, campaign
    campaign, sensor = seen, seen.gyro
    sigma = np.array(sensor.sigma) if seen is stated else np.full(3, noise)
    rates = np.concatenate(
        [s.complete_rates(campaign.valid_readings(s))[1] for s in campaign.slews]
    )
    if not len(rates):
        return np.zeros(3), np.eye(3)
    body = axes_to_body(sensor.axes)
    rates = (rates * np.array(sensor.scale_factor) - np.array(sensor.bias)) @ body.T
    power = rates.T @ rates / len(rates) - body @ np.diag(np.square(sigma)) @ body.T
    values, axes = np.linalg.eigh(power)
    return np.sqrt(np.maximum(values[::-1], 0.0)), axes[:, ::-1]


def _free_names(estimate: Estimate) -> list[str]:
    return [estimate.model.space.names[i] for i in estimate.free]


def _places(estimate: Estimate, names: Sequence[str]) -> np.ndarray:
    """Places of the parameters of these names among the free ones."""
    return np.flatnonzero(np.isin(_free_names(estimate), names))


def _scale_direction(estimate: Estimate) -> np.ndarray:
    """Direction (f,) that scales J (without the wheels' spin inertia) as a whole."""
    J = inertia_tensor.tensor(estimate.theta[:6])
    if estimate.model.structure.includes_wheel_spin:
        campaign = estimate.model.campaign
        J = J - campaign.wheel_axes_B @ np.diag(campaign.spin_inertias) @ campaign.wheel_axes_B.T
    direction = np.zeros(len(estimate.free))
    fitted = estimate.free < 6
    direction[fitted] = inertia_tensor.elements(J)[estimate.free[fitted]]
    return direction


def _common_gain(estimate: Estimate) -> Degeneracy:
    gains = [name for name in _free_names(estimate) if name.startswith(_GAIN_PREFIX)]
    model = estimate.model
    says = _SAYS["common_gain"]
    if len(gains) < len(model.campaign.wheels) or model.structure.drive == "measured":
        says += _SAYS["gain_taken"]
        return Degeneracy("common wheel gain", True, False, inertia_tensor.ELEMENTS, None, says)
    J_part, places = _scale_direction(estimate), _places(estimate, gains)
    direction = J_part.copy()
    direction[places] = estimate.theta[estimate.free[places]]
    information = data_information(estimate)
    alone = J_part @ information @ J_part
    ratio = float(max(direction @ information @ direction, 0.0) / alone) if alone > 0.0 else 0.0
    exact = ratio < LIMITS.exact_below
    read = bool(estimate.information.n_data[:, model.structure.place("momentum")].any())
    told = model.structure.drive == "commanded" and read and not exact
    says += _SAYS["gain_told" if told else "gain_shown"].format(ratio=ratio)
    concerned = (*inertia_tensor.ELEMENTS, *gains)
    return Degeneracy("common wheel gain", exact, not told, concerned, ratio, says)


def _size_of_J(estimate: Estimate, ties: Sequence[Mapping[str, Any]]) -> Degeneracy:
    """What ties the size of J, beside wheels or without them; nothing turns a free body."""
    if ties:
        sds = [tie["relative_sd"] for tie in ties]
        known = [f"known to {100 * sd:.2g} %" if sd else "taken as exact" for sd in sds]
        pairs = zip(ties, known, strict=True)
        said = " and the ".join(f"{tie['by']} of {tie['device']}, {how}" for tie, how in pairs)
        says = _SAYS["size_tied"].format(ties=said)
        concerned = (*inertia_tensor.ELEMENTS, *(f"{tie['device']}.gain" for tie in ties))
        concerned = tuple(name for name in _free_names(estimate) if name in concerned)
        return Degeneracy("size of J", False, any(sds), concerned, None, says)
    part, information = _scale_direction(estimate), data_information(estimate)
    typical = float(np.trace(information[:6, :6]) * (part @ part) / 6.0)
    ratio = float(max(part @ information @ part, 0.0) / typical) if typical > 0 else 0.0
    exact, says = ratio < LIMITS.exact_below, _SAYS["size_untied"]
    return Degeneracy("size of J", exact, True, inertia_tensor.ELEMENTS, ratio, says)


def _resting_wheels(estimate: Estimate) -> list[Degeneracy]:
    campaign, resting = estimate.model.campaign, []
    for wheel in (wheel for k, wheel in enumerate(campaign.wheels) if _rests(campaign, k)):
        fitted = tuple(n for n in _free_names(estimate) if n.endswith(f"_{wheel.name}"))
        says = _SAYS["resting_wheel"].format(wheel=wheel.name)
        resting.append(Degeneracy("wheel at rest", True, True, fitted, None, says))
    return resting


def _rests(campaign: Campaign, k: int) -> bool:
    """Whether neither the commands nor, without commands, the tachometer say that a wheel moves."""
    torque = [s.wheel_torque[:, k] for s in campaign.slews if s.wheel_torque is not None]
    if torque:
        return not any(np.any(t != 0.0) for t in torque)
    read = [s.wheel_momentum[:, k] for s in campaign.slews if s.wheel_momentum is not None]
    spans = [float(np.ptp(m[np.isfinite(m)])) for m in read if np.isfinite(m).any()]
    # More than the range of white noise in 10^5 samples.
    noise = 10.0 * (campaign.wheels[k].momentum_sigma or 0.0)
    return bool(spans) and max(spans) <= noise


def _unturned_axes(estimate: Estimate) -> list[Degeneracy]:
    campaign = estimate.model.campaign
    rms, axes_B = turned_axes(campaign)
    seen, noise = campaign.body_rates
    noise = float(np.max(seen.gyro.sigma)) if seen is campaign else noise
    turned = int(np.sum(rms > max(LIMITS.min_turned_rate_ratio * rms[0], noise)))
    if turned == 3 or rms[0] == 0.0:
        return []
    exact = bool(rms[min(turned, 2)] < noise)
    # The axis that is turned about, or the one across the plane of those that are.
    name, told, rest = ("single axis", 0, 1) if turned <= 1 else ("single plane", 2, 2)
    axis = ", ".join(f"{x:+.3f}" for x in axes_B[:, told])
    hidden = _hidden_by_rest_about(estimate, axes_B[:, rest:])
    says = _SAYS[name.replace(" ", "_")].format(axis=axis)
    return [Degeneracy(name, exact, True, hidden, None, says)]


def _hidden_by_rest_about(estimate: Estimate, axes_B: np.ndarray) -> tuple[str, ...]:
    """Elements of J mainly in the block axes^T J axes, and scale factors of sensors along them."""
    project = axes_B @ axes_B.T
    names = []
    for k, name in enumerate(inertia_tensor.ELEMENTS):
        unit = inertia_tensor.tensor(np.eye(6)[k])
        if np.linalg.norm(project @ unit @ project) > 0.5 * np.linalg.norm(unit):
            names.append(name)
    sensor = estimate.model.campaign.rate_sensor
    names += [
        f"K{i}"
        for i, axis_B in enumerate(sensor.axes if sensor else (), start=1)
        if np.linalg.norm(project @ axis_B) > 0.9
    ]
    return tuple(name for name in names if name in _free_names(estimate))


def _no_attitude(estimate: Estimate) -> list[Degeneracy]:
    tell = [channel.tells_angle for channel in estimate.model.channels]
    if estimate.information.n_data[:, tell].any():
        return []
    ratio, space = _left_with_free_inertia(estimate), estimate.model.space
    says, concerned = _SAYS["no_attitude"].format(ratio=ratio), space.names[: space.n_base]
    return [Degeneracy("no attitude", ratio < LIMITS.exact_below, True, concerned, ratio, says)]


def _left_with_free_inertia(estimate: Estimate) -> float:
    """Information on a scale common to all of K with J free, over that with J known."""
    free, theta = estimate.free, estimate.theta
    information = data_information(estimate)
    tensor = _places(estimate, inertia_tensor.ELEMENTS)
    scales = _places(estimate, estimate.model.space.names[6 : estimate.model.n_base])
    direction = np.zeros(len(free))
    direction[scales] = theta[free[scales]]
    slope = prior_rows(estimate.model, theta)[0][free[tensor]]
    gradient = (information @ direction)[tensor] / slope
    alone = direction @ information @ direction
    scaled = information[np.ix_(tensor, tensor)] / np.outer(slope, slope)
    hidden = gradient @ np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) @ gradient
    return float(np.clip(1.0 - hidden / alone, 0.0, 1.0)) if alone > 0.0 else 0.0
