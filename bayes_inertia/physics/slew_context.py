"""What an effect sees: the slew it acts in, the state at one instant, and the simulated slew."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from jax import Array

from bayes_inertia.errors import EffectError
from bayes_inertia.maths.values import array_tuple


@array_tuple
class SlewContext(NamedTuple):
    """What an effect may know about the slew it acts in, on the integration grid of n points.

    Parameters
    ----------
    index : () array
        Number of the slew in the campaign, from 0.
    slews : () array
        How many slews the campaign has.
    start : () array
        First row of the slew on the campaign's clock [s].
    middle : () array
        Middle of the whole campaign on that clock [s].
    time : (n,) array
        The grid, from the slew's own zero [s].
    step : (n,) array
        Time to the next grid point [s]; 0 in padding.
    torque : (n, wheels) array
        Commanded motor torque on the wheels [N m].
    wheel_axes_B : (3, wheels) array
        Unit spin axes as columns, body frame.
    spin_inertia : (wheels,) array
        Spin inertias [kg m^2].
    boresight_B : (3,) array
        Unit boresight of the star tracker, body frame.
    rate_axes : (n, 3) array
        C_rate of the rate sensor, one row a sensor axis; the body axes without rate sensor.
    lost_command : (n,) array of int, optional
        Number from 1 of the piece of a gap in the commands that begins at each grid point; 0 where
        the command is known. None if all are.
    lost_command_sd : (n, wheels) array, optional
        How far the torque may be off there, one sd [N m]; None where `lost_command` is.
    fix_group : (n,) array of int, optional
        Number from 0 of the nearest group of star-tracker fixes. None where nothing asks for it.
    """

    index: Array  # type: ignore[assignment]  # hides tuple.index, which nobody needs
    slews: Array
    start: Array
    middle: Array
    time: Array
    step: Array
    torque: Array
    wheel_axes_B: Array
    spin_inertia: Array
    boresight_B: Array
    rate_axes: Array
    lost_command: Array | None = None
    lost_command_sd: Array | None = None
    fix_group: Array | None = None


@array_tuple
class Environment(NamedTuple):
    """What surrounds the spacecraft, in inertial axes, zero where unknown.

    Each is (3,), with leading axes of rows and slews where there are many, or whatever stands for
    it there, such as the coefficients of a polynomial.

    Parameters
    ----------
    magnetic_field_N : (3,) array
        Magnetic field [T].
    position_N : (3,) array
        Position from the planet's centre [m].
    """

    magnetic_field_N: Any
    position_N: Any


@array_tuple
class State(NamedTuple):
    """The state at one instant, as an effect sees it.

    Parameters
    ----------
    attitude : (4,) array
        Quaternion, body from inertial, scalar last.
    rate_B : (3,) array
        Body rate [rad/s].
    wheel_momentum : (wheels,) array
        Wheel momentum relative to the body [N m s].
    effect_states : (k,) array
        The effect's own states.
    inertia_B : (3, 3) array
        J_locked in this slew: the inertia of everything, wheels included [kg m^2].
    magnetic_field_N : (3,) array
        Magnetic field in inertial axes [T].
    position_N : (3,) array
        Position from the planet's centre in inertial axes [m].
    inputs : mapping of str to (k,) array, optional
        What devices do at that instant, by the names of `Slew.inputs`; see `input`.
    """

    attitude: Array
    rate_B: Array
    wheel_momentum: Array
    effect_states: Array
    inertia_B: Array
    magnetic_field_N: Array
    position_N: Array
    inputs: Mapping[str, Array] | None = None

    def input(self, name: str) -> Array:
        """What a device does at that instant.

        Integration steps end where an input jumps or bends: within a step the value is the one
        before the jump or the one after, never a mix.

        Parameters
        ----------
        name : str
            Of the device or input, listed in the effect's `inputs`.

        Returns
        -------
        (k,) array
            As many numbers as a reading has.

        Raises
        ------
        EffectError
            If the effect does not list the input.
        """
        if self.inputs is None or name not in self.inputs:
            what = f"the input {name!r} is not listed"
            advice = f'write `inputs = ("{name}",)` beside the `name` of the effect'
            raise EffectError(what, where="state.input", advice=advice)
        return self.inputs[name]


@array_tuple
class Trajectory(NamedTuple):
    """The simulated slew on the integration grid of n points.

    Parameters
    ----------
    time : (n,) array
        The grid, from the slew's own zero [s].
    attitude : (n, 4) array
        Quaternions, body from inertial, scalar last.
    rate_B : (n, 3) array
        Body rate [rad/s].
    wheel_momentum : (n, wheels) array
        Wheel momentum relative to the body [N m s].
    effect_states : (n, k) array
        The effect's own states.
    inputs : mapping of str to (n, k) array, optional
        What devices do, by the names of `Slew.inputs`.
    """

    time: Array
    attitude: Array
    rate_B: Array
    wheel_momentum: Array
    effect_states: Array
    inputs: Mapping[str, Array] | None = None
