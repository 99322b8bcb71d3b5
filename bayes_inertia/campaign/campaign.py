"""A campaign: the slews of one spacecraft, its hardware, and what was known before."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayes_inertia.campaign.actuators import Actuator, Change, Magnetorquer, Thruster
from bayes_inertia.campaign.body_rates import BodyRates, attitudes_seen, body_rates_of, turning
from bayes_inertia.campaign.hardware import (
    DirectionSensor,
    InertiaPrior,
    RateSensor,
    StarTracker,
    Wheel,
    attitude_noise,
    pairs,
    rate_noise,
    require_key,
)
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.campaign.slew import Slew, require_quaternions, utc_of
from bayes_inertia.errors import is_one_of, kind_of, members, require_kind
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
    sensors = list(campaign.sensors)
    prior = campaign.inertia
    known = zip(("Jxx", "Jyy", "Jzz"), prior.elements.tolist(), prior.sd.tolist(), strict=False)
    lines = (
        f"Campaign {campaign.name}: {len(slews)} slews in {end - begin:.4g} s",
        ", ".join([f"{wheels} wheels", *sensors]),
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
        The wheels, in the order of their columns; may be empty.
    rate_sensor : RateSensor or None
        The rate sensor; None if there is none.
    star_tracker : StarTracker or None
        The star tracker; None if no slew has an attitude.
    slews : sequence of Slew
        At least one, all with rates if there is a rate sensor.
    dirt : sequence of Dirt, optional
        Faults of the telemetry that the reader treated, in the order of the slews.
    mission : sequence of (str, str), optional
        What reports are filed under: `name`, `spacecraft`, `operator`, `document`; and `epoch`, UTC
        when the clock of `Slew.start` was zero ("1970-01-01" of datetimes), as far as known.
    more_sensors : sequence of (str, hardware), optional
        Further sensors beside those above, each a `RateSensor`, `StarTracker` or `DirectionSensor`
        with the name under which `Slew.more` has its readings.
    actuators : sequence of devices, optional
        What turns the spacecraft beside wheels: `KnownTorque`, `Magnetorquer`, `Thruster` or
        `GimballedRotors`, each with its input in every slew under `Slew.inputs`.
    changes : sequence of Change, optional
        What is known to have changed during the campaign, and when.
    prior : GaussianPrior, optional
        J and K known together, in place of what `inertia` and the rate sensor state of them: a
        former result, or correlations and bounds of one's own.
    names : tuple of str, optional
        What the rate sensor and the star tracker are called.
    reference : str, optional
        Name of the sensor whose axes are the body's: no misalignment of it is looked for. None:
        the first star tracker, else the first rate sensor.
    has_likely_inputs : bool, optional
        Whether a fit has moved the noise of inputs to the readings of the rates: once is enough.
    shared_errors : tuple of str, optional
        Channels that a fit found rounded so coarsely that readings share their errors.

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
    rate_sensor: RateSensor | None
    star_tracker: StarTracker | None
    slews: tuple[Slew, ...]
    dirt: tuple[Dirt, ...] = ()
    mission: tuple[tuple[str, str], ...] = ()
    more_sensors: tuple[tuple[str, Any], ...] = ()
    actuators: tuple[Actuator, ...] = ()
    changes: tuple[Change, ...] = ()
    prior: GaussianPrior | None = None
    names: tuple[str, str] = ("rate sensor", "star tracker")
    reference: str | None = None
    has_likely_inputs: bool = False
    shared_errors: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_kind(self.name, str, "key name")
        for key, kind in _MEMBERS.items():
            object.__setattr__(self, key, members(getattr(self, key), kind, f"key {key}"))
        for key in ("mission", "more_sensors"):
            object.__setattr__(self, key, pairs(key, getattr(self, key)))
        for key, kind in _KINDS.items():
            value = getattr(self, key)
            require_kind(value, kind if key == "inertia" else kind | None, f"key {key}")
        if self.prior is not None:
            included = self.inertia.includes_wheel_spin
            prior = self.prior.with_wheel_spin(self.wheel_spin, included)
            object.__setattr__(self, "prior", prior)
        advice = "list at least one [[slews]] table"
        require_key(len(self.slews) > 0, "slews", "the campaign has no slew", advice)
        _ = self.begin_utc  # an epoch that is no date is refused now
        _require_different("wheels", [wheel.name for wheel in self.wheels])
        _require_different("slews", [slew.name for slew in self.slews])
        self._check_devices()
        for slew in self.slews:
            self._check_slew(slew)
            self._check_inputs(slew)
        if self.prior is not None and self.prior.learnt_from:
            self._refuse_twice(self.prior.learnt_from)

    def _refuse_twice(self, former: tuple[str, ...]) -> None:
        """Refuse slews that a former result was learnt from, by their digests."""
        for slew, digest in zip(self.slews, self.slew_digests["own"], strict=True):
            what = "the former result holds this telemetry already: it would count twice"
            advice = "give a campaign that is not in it"
            require_key(digest not in former, f"slews.{slew.name}", what, advice)

    def _check_devices(self) -> None:
        for name, sensor in self.more_sensors:
            kinds = RateSensor | StarTracker | DirectionSensor
            known = isinstance(sensor, kinds) or hasattr(sensor, "stream")
            what = f"{kind_of(sensor)} is no kind of sensor"
            advice = "give a RateSensor, StarTracker, DirectionSensor, or what names its stream"
            require_key(known, f"more_sensors.{name}", what, advice)
        for key in ("rate_sensor", "star_tracker"):
            # Frames need a reference; effects turn the one against the other.
            turned = getattr(getattr(self, key), "mounting_sigma", None) is not None
            advice = f"state it of a further sensor, or fit the effect {key}_misalignment"
            what = "the first sensor of a kind is the reference of frames"
            require_key(not turned, f"{key}.mounting_sigma", what, advice)
        names = [device.name for device in (*self.actuators, *self.changes)]
        _require_different("actuators", [*names, *(wheel.name for wheel in self.wheels)])
        given = members(self.names, str, "key names")
        what, advice = f"{given!r} are not two", "name rate sensor and tracker"
        require_key(len(given) == 2, "names", what, advice)
        object.__setattr__(self, "names", given)
        _require_different("sensors", [*(name for name, _ in self._each_sensor()), *names])
        known = self.reference is None or is_one_of(self.reference, self.sensors)
        what, advice = f"no sensor is called {self.reference!r}", f"choose {list(self.sensors)}"
        require_key(known, "reference", what, advice)

    def _check_slew(self, slew: Slew) -> None:
        where = f"slews.{slew.name}"
        for key in ("wheel_torque", "wheel_momentum"):
            values = getattr(slew, key)
            columns = len(self.wheels) if values is None else values.shape[1]
            what = f"{columns} columns for {len(self.wheels)} wheels"
            require_key(columns == len(self.wheels), f"{where}.{key}", what, "give one a wheel")
        finite = slew.wheel_torque is None or bool(np.isfinite(slew.wheel_torque).all())
        advice = "the simulator needs every wheel at every row: "
        advice += "repair the row or leave the columns out"
        require_key(finite, f"{where}.wheel_torque", "a torque is not a number", advice)
        self._check_rates(slew)
        sensors = dict(self.more_sensors)
        unknown = sorted(set(slew.more or ()) - set(sensors))
        what = f"readings of {unknown[:1]}, which no sensor has"
        require_key(not unknown, f"{where}.more", what, "add the sensor to more_sensors")
        for name, readings in (slew.more or {}).items():
            _require_readings(readings, sensors[name], f"{where}.more.{name}")
        has_fix = slew.attitude is not None and bool(np.isfinite(slew.attitude).any())
        what = "an attitude without a star tracker"
        advice = "add [star_tracker] with its sigmas"
        require_key(self.star_tracker is not None or not has_fix, f"{where}.attitude", what, advice)

    def _check_inputs(self, slew: Slew) -> None:
        for device in self.actuators:
            key = f"slews.{slew.name}.inputs.{device.name}"
            given = (slew.inputs or {}).get(device.name)
            advice = "give what the device was told, zeros where it was off"
            require_key(given is not None, key, "no input of this device", advice)
            assert given is not None
            what = f"{given.width} numbers a reading, not {device.columns}"
            require_key(given.width == device.columns, key, what, "give one a column of the device")
            pulses = given.between == "on_time" and not isinstance(device, Thruster)
            what = f"on-times of a {type(device).__name__}"
            require_key(not pulses, key, what, "only thrusters have on-times: hold, line or mean")
            level = isinstance(device, Thruster) and given.between != "on_time"
            largest = float(np.abs(given.values).max()) if level else 0.0
            what = f"a level of {largest:.4g} times full thrust"
            advice = 'give shares of full thrust, 0 to 1; per cent have the unit "%"'
            require_key(largest <= LIMITS.largest_level, key, what, advice)
            field = isinstance(device, Magnetorquer) and slew.magnetic_field_N is None
            advice = "add the magnetic_field columns, in inertial axes"
            what = "the magnetic field, without which a dipole has no torque, is absent"
            require_key(not field, f"slews.{slew.name}.magnetic_field", what, advice)

    def _check_rates(self, slew: Slew) -> None:
        key, sensor = f"slews.{slew.name}.rate", self.rate_sensor
        if sensor is None:
            advice = "add the rate sensor, or leave the rates out"
            require_key(slew.rate is None, key, "rates without a rate sensor", advice)
            fixes = attitudes_seen(self, slew)[0]
            what = "neither a rate sensor nor two attitudes tell how the body turned"
            require_key(len(fixes) > 1, f"slews.{slew.name}", what, "add what measured the motion")
            return
        what = "no rate-sensor columns"
        advice = "name its columns under columns.rate, or leave the rate sensor out"
        require_key(slew.rate is not None, key, what, advice)
        _require_readings(np.asarray(slew.rate), sensor, key)

    @property
    def slew_digests(self) -> dict[str, list[str]]:
        """Digests of its slews ("own"), and of those that its prior was learnt from ("former").

        Locked wheels leave no trace in them, as in a model.
        """
        former = [] if self.prior is None else list(self.prior.learnt_from)
        own = [slew.digest for slew in self.without_locked_wheels().slews]
        return {"own": own, "former": former}

    @property
    def further_inputs(self) -> dict[str, int]:
        """Inputs of no device, such as a temperature, and how many numbers each has."""
        devices = {device.name for device in self.actuators} | self.sensors.keys()
        told = (item for slew in self.slews for item in (slew.inputs or {}).items())
        return {name: stream.width for name, stream in told if name not in devices}

    @property
    def sensors(self) -> dict[str, Any]:
        """The hardware of every sensor by its name; the first of a kind before the further ones."""
        return dict(self._each_sensor())

    def _each_sensor(self) -> Iterator[tuple[str, Any]]:
        first = zip(self.names, (self.rate_sensor, self.star_tracker), strict=True)
        return ((name, x) for name, x in (*first, *self.more_sensors) if x is not None)

    @property
    def frame_reference(self) -> str:
        """The sensor whose axes are the body's: as stated, else a star tracker, else a gyro."""
        kinds = (StarTracker, RateSensor, object)
        ranked = (name for kind in kinds for name, x in self.sensors.items() if isinstance(x, kind))
        return self.reference or next(ranked)

    @property
    def rate_noise(self) -> float:
        """Noise of the best axis of all rate sensors [rad/s]; infinite without one."""
        return rate_noise(self.sensors.values())

    @property
    def attitude_noise(self) -> float:
        """Noise of the sensor that sees the attitude best [rad]; infinite without one."""
        each = [slew.more or {} for slew in self.slews]
        more = {name: [of[name] for of in each if name in of] for name in self.sensors}
        return attitude_noise((x, more[name]) for name, x in self.sensors.items())

    @cached_property
    def body_rates(self) -> BodyRates:
        """Rates about the three body axes: smoothed, where the rate sensor does not tell them."""
        return body_rates_of(self)

    @property
    def with_body_rates(self) -> Campaign:
        """The campaign with a rate sensor of three axes; itself where it has a good one."""
        return self.body_rates.campaign

    @property
    def has_commands(self) -> bool:
        """Whether every slew has wheel torque commands, as the `commanded` drive needs."""
        return all(s.wheel_torque is not None for s in self.slews) and len(self.wheels) > 0

    @property
    def has_tachometers(self) -> bool:
        """Whether every wheel has a tachometer of known noise, as the `measured` drive needs.

        Wheels that are locked need none.
        """
        kept = [k for k, wheel in enumerate(self.wheels) if wheel.state != "locked"]
        given = [s.wheel_momentum for s in self.slews]
        read = all(x is not None and bool(np.isfinite(x[:, kept]).any(0).all()) for x in given)
        return read and all(self.wheels[k].momentum_sigma is not None for k in kept)

    @property
    def wheel_axes_B(self) -> np.ndarray:
        """G (3, wheels): unit spin axes as columns, in body axes."""
        return np.array([w.axis_B for w in self.wheels]).reshape(-1, 3).T

    @property
    def spin_inertias(self) -> np.ndarray:
        """Js (wheels,): spin inertia of each wheel [kg m^2]."""
        return np.array([w.spin_inertia for w in self.wheels])

    @property
    def wheel_spin(self) -> np.ndarray:
        """What J_locked has more than J (3, 3): sum of Js g g^T, locked wheels apart [kg m^2]."""
        free = np.array([wheel.state != "locked" for wheel in self.wheels], dtype=float)
        return (self.wheel_axes_B * (free * self.spin_inertias)) @ self.wheel_axes_B.T

    @property
    def begin_utc(self) -> str | None:
        """When its first slew began, a date in UTC; None where `mission` states no epoch."""
        epoch = dict(self.mission).get("epoch")
        if epoch is None:
            return None
        require_kind(epoch, str, "mission.epoch", "give UTC as a text: 2026-03-02T12:00:00")
        seconds = utc_of(epoch, "mission.epoch") + self.span[0]
        return str(np.datetime64(round(1e3 * seconds), "ms"))

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

        Raises
        ------
        CampaignError
            If there is no such slew, or none is asked for.
        """
        chosen = members(indices, int | np.integer, "key indices")
        count = len(self.slews)
        for k in chosen:
            known = not isinstance(k, bool) and -count <= k < count
            advice = f"give numbers from 0 to {count - 1}"
            require_key(known, "indices", f"there is no slew {k!r}", advice)
        slews = tuple(self.slews[k] for k in chosen)
        kept = {"", *(slew.name for slew in slews)}
        return replace(self, slews=slews, dirt=tuple(d for d in self.dirt if d.slew in kept))

    def without_locked_wheels(self) -> Campaign:
        """The same campaign where locked wheels are parts of the body, as a model takes them.

        Returns
        -------
        Campaign
            Without these wheels and their columns; itself if none is locked.
        """
        kept = [k for k, wheel in enumerate(self.wheels) if wheel.state != "locked"]
        if len(kept) == len(self.wheels):
            return self
        keys = ("wheel_torque", "wheel_momentum", "lost_command_sd")
        slews = []
        for slew in self.slews:
            given = {key: getattr(slew, key) for key in keys}
            columns = {k: x[:, kept] for k, x in given.items() if x is not None}
            # Without any wheel nothing was lost of its commands.
            bare = dict.fromkeys((*columns, "lost_command"))
            slews.append(replace(slew, **(columns if kept else bare)))
        return replace(self, wheels=tuple(self.wheels[k] for k in kept), slews=tuple(slews))

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
        (n, axes) array of bool
            False where a reading is missing or saturated.
        """
        if self.rate_sensor is None or slew.rate is None:
            return np.zeros((len(slew.time), 0), dtype=bool)
        return in_range(slew.rate, self.rate_sensor.range)

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
            Norm of the body rate [rad/s], of the fastest slew; 0 without any valid reading.

        Examples
        --------
        >>> slew = Slew("a", 0.0, np.arange(3.0), rate=np.diag([0.1, 0.3, 0.2]))
        >>> prior, sensor = InertiaPrior(np.eye(3), 0.1, 0.1), RateSensor(sigma=1e-5, range=0.3)
        >>> Campaign("c", prior, (), sensor, None, (slew,)).largest_rate(1.0)
        0.2
        """
        seen = self.with_body_rates
        rates = [turning(seen, s)[1] for s in seen.slews]
        norms = (np.linalg.norm(r, axis=1) for r in rates if len(r))
        return max((float(np.quantile(norm, quantile)) for norm in norms), default=0.0)

    @property
    def three_axis_gyro(self) -> RateSensor:
        """The rate sensor where it reads three axes, as flights that are simulated need it.

        Raises
        ------
        CampaignError
            If there is none, or it has another number of axes.
        """
        axes = len(self.rate_sensor.axes) if self.rate_sensor else 0
        what = f"a rate sensor of three axes is needed to fly a plan; this campaign's has {axes}"
        advice = "`fit`, `diagnose`, `observe` and `doctor` take any set of sensors"
        require_key(axes == 3, "rate_sensor.axes", what, advice)
        return self.gyro

    @property
    def gyro(self) -> RateSensor:
        """The rate sensor of a campaign that has one."""
        assert self.rate_sensor is not None
        return self.rate_sensor

    def scale_of_motion(self) -> tuple[float, float, float]:
        """Scales of the motion in which default priors of effects are stated.

        Returns
        -------
        rate : float
            Root mean square of the rate [rad/s], at least the noise of what tells it.
        duration : float
            Median duration of a slew [s].
        inertia : float
            Mean principal moment of inertia [kg m^2].
        """
        seen = self.with_body_rates
        readings = np.concatenate([turning(seen, s)[1] for s in seen.slews])
        rate = float(np.sqrt(np.mean(np.sum(readings**2, axis=1)))) if len(readings) else 0.0
        duration = float(np.median([s.duration for s in self.slews]))
        inertia = float(np.trace(self.inertia.tensor) / 3.0)
        return max(rate, self.body_rates.noise), duration, inertia


def _require_readings(readings: np.ndarray, sensor: Any, key: str) -> None:
    """Raise `CampaignError` unless readings (n, columns) are of a sensor of their kind."""
    columns, wanted = readings.shape[1], getattr(sensor, "columns", None)
    what = f"{columns} columns for {kind_of(sensor)} of {wanted}"
    advice = "give one column a sensor axis, four a quaternion, three a direction"
    require_key(wanted in (None, columns), key, what, advice)
    if isinstance(sensor, StarTracker):
        require_quaternions(readings, key)


_MEMBERS = {"wheels": Wheel, "dirt": Dirt, "slews": Slew, "changes": Change, "actuators": Actuator}
_KINDS = {
    "inertia": InertiaPrior,
    "rate_sensor": RateSensor,
    "star_tracker": StarTracker,
    "prior": GaussianPrior,
}


def _require_different(key: str, names: list[str]) -> None:
    """Raise `CampaignError` if a name is used twice."""
    doubled = sorted({name for name in names if names.count(name) > 1})
    what = f"the name {doubled[:1]} is used twice"
    require_key(not doubled, key, what, "give each its own name")
