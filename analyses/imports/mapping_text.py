"""The part of a mapping that is not about the raw files: the prior and the hardware."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.campaign import Campaign


def head_of_mapping(campaign: Campaign) -> str:
    """The mapping without streams and slews."""
    prior, sensor, star = campaign.inertia, campaign.rate_sensor, campaign.star_tracker
    assert star is not None
    wheels = "".join(
        f'\n[[wheels]]\nname = "{wheel.name}"\naxis = {list(wheel.axis_B)}\n'
        f"spin_inertia = {wheel.spin_inertia}\nmomentum_sigma = {wheel.momentum_sigma}\n"
        for wheel in campaign.wheels
    )
    return f"""\
format = "bayes-inertia-mapping/1"
name = "{campaign.name}"

[inertia]
tensor = {np.asarray(prior.tensor).tolist()}
relative_sigma = {prior.relative_sigma}
product_sigma = {prior.product_sigma}
includes_wheel_spin = {str(prior.includes_wheel_spin).lower()}
{wheels}
[rate_sensor]
sigma = {list(sensor.sigma)}
scale_factor = {list(sensor.scale_factor)}
scale_factor_sigma = {list(sensor.scale_factor_sigma)}
bias = {list(sensor.bias)}
bias_sigma = {list(sensor.bias_sigma)}

[star_tracker]
boresight = {list(star.boresight_B)}
sigma_cross = {star.sigma_cross}
sigma_roll = {star.sigma_roll}
"""
