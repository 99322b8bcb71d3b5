"""What all devices have in common: their name, their input, and a gain that may be in doubt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from jax import Array

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, Parameter, scalar

if TYPE_CHECKING:
    from bayes_inertia.campaign.campaign import Campaign


@dataclass(frozen=True)
class DeviceEffect(Effect):
    """What a device of the campaign does, by its input of the same name.

    Parameters
    ----------
    device : record of `campaign.actuators`
        What is known of it before a fit.
    """

    device: Any
    by: ClassVar[str] = "torque"  # what of stated size it turns the body by

    @property
    def name(self) -> str:  # type: ignore[override]
        """The device's name."""
        return self.device.name

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The input of the device's name."""
        return (self.device.name,)

    def parameters(self, campaign: Campaign) -> tuple[Parameter, ...]:
        """The gain where it is in doubt: 1 is what the campaign states."""
        sd = self.device.gain_sigma
        return (scalar("gain", unit="", prior=Normal(1.0, sd), null=1.0),) if sd > 0.0 else ()


def gain(p: Mapping[str, Array]) -> Array | float:
    """The gain (), 1 where it is known."""
    return p.get("gain", 1.0)
