"""What the calibration flies: the paper's slews, weak data, fewer sensors, more effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.errors import SettingsError
from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.constant_torque import ConstantTorque
from bayes_inertia.physics.effects.rate_sensor_misalignment import RateSensorMisalignment

# Between rows of telemetry [s]: slow telemetry, so that a fit takes a second.
_PERIOD = 1.0
# The spacecraft of the paper; its constant torque [N m].
_TORQUE_SIGMA = 5e-6


@dataclass(frozen=True)
class CalibrationCase:
    """One kind of campaign.

    Parameters
    ----------
    name : str
        Lower case, for ids and files.
    says : str
        What it is, in a few words.
    plan : Plan
        What is flown, each time with other angles, senses and start attitude.
    mission : Mission
        Hardware and prior.
    effects : tuple of Effect
        That act, drawn from their priors, and are fitted along.
    star_tracker : bool
        Whether its fixes are in the telemetry.
    tachometers : bool
        Whether the wheels' momentum is.
    """

    name: str
    says: str
    plan: Plan
    mission: Mission
    effects: tuple[Effect, ...] = ()
    star_tracker: bool = True
    tachometers: bool = True

    def as_measured(self, campaign: Campaign) -> Campaign:
        """A flown campaign without the readings that this case lacks.

        Parameters
        ----------
        campaign : Campaign
            With all sensors.

        Returns
        -------
        Campaign
            What is fitted.
        """
        if not self.star_tracker:
            slews = tuple(replace(slew, attitude=None) for slew in campaign.slews)
            campaign = replace(campaign, star_tracker=None, slews=slews)
        if not self.tachometers:
            wheels = tuple(replace(wheel, momentum_sigma=None) for wheel in campaign.wheels)
            slews = tuple(replace(slew, wheel_momentum=None) for slew in campaign.slews)
            campaign = replace(campaign, wheels=wheels, slews=slews)
        return campaign


def calibration_cases() -> tuple[CalibrationCase, ...]:
    """All cases, of the MOST-like spacecraft at one row a second.

    Returns
    -------
    tuple of CalibrationCase
        Data that determine everything first, weak data, then fewer sensors and more effects.

    Examples
    --------
    >>> [case.name for case in calibration_cases()][:2]
    ['five-slews', 'two-slews']
    """
    mission = most_like_mission()
    five = replace(paper_like_plan(), telemetry_period=_PERIOD)
    weak = (PlannedSlew((1.0, 0.0, 0.0), 1.0), PlannedSlew((0.0, 1.0, 1.0), 1.0))
    two = replace(five, slews=weak)
    effects = (ConstantTorque(_TORQUE_SIGMA), RateSensorMisalignment())
    return (
        CalibrationCase("five-slews", "five slews about five axes", five, mission),
        CalibrationCase("two-slews", "weak data: two slews", two, mission),
        CalibrationCase(
            "no-star-tracker", "five slews without star tracker", five, mission, star_tracker=False
        ),
        CalibrationCase(
            "no-tachometers", "five slews without tachometers", five, mission, tachometers=False
        ),
        CalibrationCase(
            "effects",
            "five slews with a constant torque and a turned rate sensor",
            five,
            mission,
            effects,
        ),
    )


def cases_named(names: Sequence[str]) -> tuple[CalibrationCase, ...]:
    """The cases of these names; all for none.

    Parameters
    ----------
    names : sequence of str
        Names of cases.

    Returns
    -------
    tuple of CalibrationCase
        In the order of the names.

    Raises
    ------
    SettingsError
        If a name is unknown.
    """
    known = {case.name: case for case in calibration_cases()}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise SettingsError(
            f"no case {unknown[0]!r}", where="cases", advice=f"choose from {', '.join(known)}"
        )
    return tuple(known[name] for name in dict.fromkeys(names)) or tuple(known.values())
