"""Units as the field spells them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.unit_factors import QUANTITIES, to_si_with, unit_factor

DEGREE = math.pi / 180.0
RIGHT = {
    "rate": {
        "rad/s": 1.0,
        "rad s-1": 1.0,
        "rad.s-1": 1.0,
        "rad s^-1": 1.0,
        "rad/sec": 1.0,
        "[rad/s]": 1.0,
        "mrad/s": 1e-3,
        "urad/s": 1e-6,
        "deg/s": DEGREE,
        "deg s-1": DEGREE,
        "deg/sec": DEGREE,
        "DEG/SEC": DEGREE,
        "(deg/s)": DEGREE,
        "degrees/s": DEGREE,
        "°/s": DEGREE,
        "dps": DEGREE,
        "mdeg/s": DEGREE / 1e3,
        "deg/h": DEGREE / 3600.0,
        "°/h": DEGREE / 3600.0,
        "deg/hr": DEGREE / 3600.0,
        "arcsec/s": DEGREE / 3600.0,
        "asec/s": DEGREE / 3600.0,
        "arcmin/s": DEGREE / 60.0,
        "rpm": 2 * math.pi / 60.0,
        "mdps": DEGREE / 1e3,
        "rad per second": 1.0,
        "deg_per_s": DEGREE,
        "RAD/S": 1.0,
        '"/s': DEGREE / 3600.0,
        "arc-sec/s": DEGREE / 3600.0,
        "as/s": DEGREE / 3600.0,
        "mas/s": DEGREE / 3.6e6,
        "Hz": None,
        "1/min": None,
    },
    "wheel_speed": {
        "RPM": 2 * math.pi / 60.0,
        "rev/min": 2 * math.pi / 60.0,
        "1/min": 2 * math.pi / 60.0,
        "/min": 2 * math.pi / 60.0,
        "min^-1": 2 * math.pi / 60.0,
        "U/min": 2 * math.pi / 60.0,
        "r/min": 2 * math.pi / 60.0,
        "rotations per minute": 2 * math.pi / 60.0,
        "krpm": 2e3 * math.pi / 60.0,
        "kRPM": 2e3 * math.pi / 60.0,
        "rev/s": 2 * math.pi,
        "rps": 2 * math.pi,
        "rad/s": 1.0,
        "Hz": 2 * math.pi,
        "Hertz": 2 * math.pi,
        "1/s": None,
    },
    "wheel_torque": {
        "N m": 1.0,
        "N*m": 1.0,
        "N.m": 1.0,
        "N-m": 1.0,
        "N·m": 1.0,
        "Nm": 1.0,
        "newton meter": 1.0,
        "mN m": 1e-3,
        "mN*m": 1e-3,
        "mN.m": 1e-3,
        "mNm": 1e-3,
        "uNm": 1e-6,
        "µN m": 1e-6,
        "μNm": 1e-6,
        "N mm": 1e-3,
        "ozf in": 0.00706155,
        "oz-in": 0.00706155,
        "ft lb": 1.35581795,
        "Ncm": 0.01,
        "Nmm": 1e-3,
        "Newton-meters": 1.0,
        "N": None,
        "Nms": None,
        "m/N": None,
    },
    "wheel_momentum": {
        "N m s": 1.0,
        "Nms": 1.0,
        "N.m.s": 1.0,
        "N-m-s": 1.0,
        "mNms": 1e-3,
        "mN m s": 1e-3,
        "kg m^2/s": 1.0,
        "kg m2/s": 1.0,
        "kg m² s-1": 1.0,
        "kg*m**2/s": 1.0,
        "Js": 1.0,
        "lb ft s": 1.35581795,
        "Nm": None,
    },
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "h": 3600.0},
    "angle": {"deg": DEGREE, "rad": 1.0, "arcsec": DEGREE / 3600.0, "mrad": 1e-3},
    "magnetic_field": {"T": 1.0, "nT": 1e-9, "uT": 1e-6, "G": 1e-4, "gauss": 1e-4, "mG": 1e-7},
    "position": {"m": 1.0, "km": 1e3, "ft": 0.3048},
}
CASES = [(q, unit, factor) for q, units in RIGHT.items() for unit, factor in units.items()]


@pytest.mark.parametrize(("quantity", "unit", "factor"), CASES)
def test_units_as_the_field_spells_them(quantity, unit, factor):
    if factor is None:
        with pytest.raises(CampaignError, match=f"write .*{QUANTITIES[quantity][1][:6]}"):
            unit_factor(quantity, unit)
    else:
        assert unit_factor(quantity, unit) == pytest.approx(factor, rel=1e-6)


@pytest.mark.parametrize(
    "unit", ["", "-", "degC", "smoots", "rad//s", "(", "1e400 s", "import os", "s**99999", "0*s"]
)
def test_what_is_no_unit_is_refused(unit):
    for quantity in QUANTITIES:
        with pytest.raises(CampaignError, match=r"write|no unit|not a known"):
            unit_factor(quantity, unit)


def test_counts_have_a_scale_and_an_offset():
    counts = np.array([0, 2048, 4095])
    torque = to_si_with(counts, "mN m", "wheel_torque", scale=0.01, offset=-20.48)
    assert torque == pytest.approx([-0.02048, 0.0, 0.02047], abs=1e-15)
