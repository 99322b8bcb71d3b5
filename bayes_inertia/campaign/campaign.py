"""A campaign: the slews of one spacecraft, its hardware, and what was known before."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel, require
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.saturated import in_range
from bayes_inertia.maths.printed import Card, parameter_lines, shown_as


def _card(campaign: Campaign) -> Card:
    """What was flown, with what, and what was known before."""
    slews, wheels = campaign.slews, len(campaign.wheels)
    rows = tuple(
        (s.name, f"{s.start:.6g}", f"{s.duration:.4g}", str(len(s.time)), str(s.fixes.sum()))
        for s in slews
    )
    begin, end = campaign.span
    sensors = ["star tracker"] if campaign.star_tracker else []
    sensors += [name for name, _ in campaign.more_sensors]
    prior = campaign.inertia
    known = zip(("Jxx", "Jyy", "Jzz"), prior.elements.tolist(), prior.sd.tolist(), strict=False)
    lines = (
        f"Campaign {campaign.name}: {len(slews)} slews in {end - begin:.4g} s",
        ", ".join([f"{wheels} wheels", "rate sensor", *sensors]),
        f"before flight {parameter_lines({name: (at, sd) for name, at, sd in known})[0]}",
    )
    return Card(lines, ("slew", "start [s]", "duration [s]", "rows", "fixes"), rows)


@shown_as(_card)
@dataclass(frozen=True)
class Campaign:
    """A named set of slews of one spacecraft, with its hardware and prior knowledge.

    It checks itself, so that a campaign built in a notebook meets the same demands as one that is
    read from files.

    Parameters
    ----------
    name : str
        The campaign, as printed.
    inertia : InertiaPrior
        What was known of the inertia tensor before flight.
    wheels : sequence of Wheel
        The wheels, in the order of the columns of torque and momentum; may be empty.
    rate_sensor : RateSensor
        The rate sensor.
    star_tracker : StarTracker or None
        The star tracker; None if no slew has an attitude.
    slews : sequence of Slew
        At least one, all with rates.
    dirt : sequence of Dirt, optional
        Faults of the telemetry that the reader treated, in the order of the slews.
    mission : sequence of (str, str), optional
        What reports are filed under: `name`, `spacecraft`, `operator` and `document`, as far as
        they are known.
    more_sensors : sequence of (str, hardware), optional
        Further sensors beside those above, each a `RateSensor` or `StarTracker` with the name under
        which `Slew.more` has its readings.
    prior : GaussianPrior, optional
        J and K known together, in place of what `inertia` and the rate sensor state of them: a
        former result, or correlations and bounds of one's own.

    Raises
    ------
    CampaignError
        If the parts do not fit each other.

    Examples
    --------
    >>> slew = Slew("a", 0.0, np.arange(3.0), rate=np.zeros((3, 3)))
    >>> prior, sensor = InertiaPrior(np.eye(3), 0.1, 0.1), RateSensor(sigma=1e-5)
    >>> Campaign("c", prior, (), sensor, None, (slew,)).has_commands
    False
    """

    name: str
    inertia: InertiaPrior
    wheels: tuple[Wheel, ...]
    rate_sensor: RateSensor
    star_tracker: StarTracker | None
    slews: tuple[Slew, ...]
    dirt: tuple[Dirt, ...] = ()
    mission: tuple[tuple[str, str], ...] = ()
    more_sensors: tuple[tuple[str, Any], ...] = ()
    prior: GaussianPrior | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "wheels", tuple(self.wheels))
        object.__setattr__(self, "dirt", tuple(self.dirt))
        object.__setattr__(self, "slews", tuple(self.slews))
        object.__setattr__(self, "mission", tuple(self.mission))
        object.__setattr__(self, "more_sensors", tuple(self.more_sensors))
        advice = "list at least one [[slews]] table"
        require(len(self.slews) > 0, "slews", "the campaign has no slew", advice)
        _require_different("wheels", [wheel.name for wheel in self.wheels])
        _require_different("slews", [slew.name for slew in self.slews])
        for name, sensor in self.more_sensors:
            known = isinstance(sensor, RateSensor | StarTracker) or hasattr(sensor, "stream")
            what = f"a {type(sensor).__name__} is no kind of sensor"
            advice = "give a RateSensor, a StarTracker or an object that names its stream"
            require(known, f"more_sensors.{name}", what, advice)
        for slew in self.slews:
            self._check_slew(slew)

    def _check_slew(self, slew: Slew) -> None:
        where = f"slews.{slew.name}"
        for key in ("wheel_torque", "wheel_momentum"):
            values = getattr(slew, key)
            if values is not None:
                what = f"{values.shape[1]} columns for {len(self.wheels)} wheels"
                one_a_wheel = values.shape[1] == len(self.wheels)
                require(one_a_wheel, f"{where}.{key}", what, "give one a wheel")
        require(
            slew.wheel_torque is None or bool(np.isfinite(slew.wheel_torque).all()),
            f"{where}.wheel_torque",
            "a torque is not a number",
            "the simulator needs every wheel at every row: repair the row or leave the columns out",
        )
        require(
            slew.rate is not None,
            f"{where}.rate",
            "no rate-sensor columns",
            "the method needs rate telemetry: name its columns under columns.rate",
        )
        unknown = sorted(set(slew.more or ()) - {name for name, _ in self.more_sensors})
        what = f"readings of {unknown[:1]}, which no sensor has"
        require(not unknown, f"{where}.more", what, "add the sensor to more_sensors")
        has_fix = slew.attitude is not None and bool(np.isfinite(slew.attitude).any())
        require(
            self.star_tracker is not None or not has_fix,
            f"{where}.attitude",
            "an attitude without a star tracker",
            "add [star_tracker] with its sigmas",
        )

    @property
    def has_commands(self) -> bool:
        """Whether every slew has wheel torque commands, as the `commanded` drive needs."""
        return all(s.wheel_torque is not None for s in self.slews) and len(self.wheels) > 0

    @property
    def has_tachometers(self) -> bool:
        """Whether every wheel has a tachometer of known noise, as the `measured` drive needs."""
        read = all(
            s.wheel_momentum is not None and bool(np.isfinite(s.wheel_momentum).any(axis=0).all())
            for s in self.slews
        )
        return read and all(w.momentum_sigma is not None for w in self.wheels)

    @property
    def wheel_axes_B(self) -> np.ndarray:
        """G (3, wheels): unit spin axes as columns, in body axes."""
        return np.array([w.axis_B for w in self.wheels]).reshape(-1, 3).T

    @property
    def spin_inertias(self) -> np.ndarray:
        """Js (wheels,): spin inertia of each wheel [kg m^2]."""
        return np.array([w.spin_inertia for w in self.wheels])

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment of the campaign [s], on the clock of the slews' `start`."""
        return min(s.start for s in self.slews), max(s.start + s.duration for s in self.slews)

    def subset(self, indices: Iterable[int]) -> Campaign:
        """The same campaign with some of its slews only.

        Parameters
        ----------
        indices : iterable of int
            Which slews, counted from 0.

        Returns
        -------
        Campaign
            The campaign with these slews, in this order.
        """
        slews = tuple(self.slews[i] for i in indices)
        kept = {"", *(slew.name for slew in slews)}
        return replace(self, slews=slews, dirt=tuple(d for d in self.dirt if d.slew in kept))

    def dirt_of(self, slew: str) -> tuple[Dirt, ...]:
        """Records of one slew.

        Parameters
        ----------
        slew : str
            Its name; "" for records that concern all slews.

        Returns
        -------
        tuple of Dirt
            In their order.
        """
        return tuple(record for record in self.dirt if record.slew == slew)

    def valid_readings(self, slew: Slew) -> np.ndarray:
        """Which readings of the rate sensor count: possible numbers inside its range.

        Parameters
        ----------
        slew : Slew
            A slew flown with the campaign's rate sensor.

        Returns
        -------
        (n, 3) array of bool
            False where a reading is missing or saturated.
        """
        return in_range(np.asarray(slew.rate), self.rate_sensor.range)

    def largest_rate(self, quantile: float = 0.98) -> float:
        """The largest rate that the campaign believably turned at.

        Of each slew the quantile of its rates counts, so that single outliers do not. Readings
        that are missing or saturated do not count.

        Parameters
        ----------
        quantile : float, optional
            Share of a slew's rows that turn slower.

        Returns
        -------
        float
            Norm of the readings [rad/s], of the fastest slew; 0 without any valid reading.

        Examples
        --------
        >>> slew = Slew("a", 0.0, np.arange(3.0), rate=np.diag([0.1, 0.3, 0.2]))
        >>> prior, sensor = InertiaPrior(np.eye(3), 0.1, 0.1), RateSensor(sigma=1e-5, range=0.3)
        >>> Campaign("c", prior, (), sensor, None, (slew,)).largest_rate(1.0)
        0.2
        """
        rates = [s.complete_rates(self.valid_readings(s))[1] for s in self.slews]
        return max(
            (float(np.quantile(np.linalg.norm(r, axis=1), quantile)) for r in rates if len(r)),
            default=0.0,
        )

    def scale_of_motion(self) -> tuple[float, float, float]:
        """Scales of the motion in which default priors of effects are stated.

        Returns
        -------
        rate : float
            Root mean square of the rate [rad/s], at least the rate sensor's noise.
        duration : float
            Median duration of a slew [s].
        inertia : float
            Mean principal moment of inertia [kg m^2].
        """
        readings = np.concatenate([s.complete_rates(self.valid_readings(s))[1] for s in self.slews])
        rate = float(np.sqrt(np.mean(np.sum(readings**2, axis=1)))) if len(readings) else 0.0
        duration = float(np.median([s.duration for s in self.slews]))
        return (
            max(rate, float(np.mean(self.rate_sensor.sigma))),
            duration,
            float(np.trace(self.inertia.tensor) / 3.0),
        )


def _require_different(key: str, names: list[str]) -> None:
    """Raise `CampaignError` if a name is used twice."""
    doubled = sorted({name for name in names if names.count(name) > 1})
    what = f"the name {doubled[:1]} is used twice"
    require(not doubled, key, what, "give each its own name")
