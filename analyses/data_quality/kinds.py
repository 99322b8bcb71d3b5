"""The kinds of dirt that `telemetry_faults.py` tries, with the channel they need."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analyses.data_quality.faults import Injector, RawCampaign
from analyses.data_quality.faults_in_readings import (
    axis_missing,
    coloured,
    fixes_while_slewing,
    outlier_fixes,
    outliers,
    quantised,
    saturated,
    stuck,
    text_cells,
    unsigned_tachometer,
    wrong_commands,
    wrong_noise,
    zeros,
)
from analyses.data_quality.faults_in_time import (
    clock_glitch,
    clock_jump,
    dropped_rows,
    duplicated_rows,
    float32_times,
    gap,
    late_row_period,
    lost_commands,
    lost_tachometer,
    out_of_order,
)


@dataclass(frozen=True)
class Kind:
    """One kind of dirt."""

    name: str  # as in the tables of the study
    inject: Injector  # makes it
    needs: str = "rate"  # channel without which it cannot be
    demanded: bool = False  # whether the fit must end trusted; it may stop with an error otherwise
    sizes: tuple[float, float] = (0.3, 3.0)  # range of random sizes
    # What comes first where kinds are combined: 0 what the sensors do, 1 what the telemetry does
    # to cells, 2 what it does to rows and times.
    stage: int = 0

    def possible(self, raw: RawCampaign) -> bool:
        """Whether a campaign has what the dirt needs."""
        if self.needs == "true_attitude":
            return bool(raw.attitude)
        return bool(raw.names(self.needs))

    def size(self, rng: np.random.Generator) -> float:
        """A random size, log-uniform in its range."""
        return float(np.exp(rng.uniform(*np.log(self.sizes))))


_TACHOMETER = "wheel_momentum"
# The injectors of rows and times.
_ROWS = (
    Kind("dropped rows", dropped_rows, demanded=True),
    Kind("gap", gap),
    Kind("duplicated rows", duplicated_rows(False)),
    Kind("conflicting duplicates", duplicated_rows(True)),
    Kind("packets out of order", out_of_order),
    Kind("clock jumps ahead 1 s", clock_jump(1.0), sizes=(0.02, 3.0)),
    Kind("clock jumps back 1 s", clock_jump(-1.0), sizes=(0.02, 3.0)),
    Kind("single wrong stamps", clock_glitch),
    Kind("stamps jitter 5 %", late_row_period, sizes=(0.03, 1.0)),
    Kind("float32 times, 12 days", float32_times(1.0e6), sizes=(1.0, 1.0)),
    Kind("float32 times, 1 year", float32_times(3.2e7), sizes=(1.0, 1.0)),
)
_READINGS = (
    Kind("outliers in rate", outliers("rate"), demanded=True),
    Kind("outliers in tachometers", outliers(_TACHOMETER), _TACHOMETER, demanded=True),
    Kind("outliers in fixes", outlier_fixes, "attitude", demanded=True),
    Kind("zeros for lost rates", zeros("rate")),
    Kind("zeros for lost commands", zeros("wheel_torque"), "wheel_torque"),
    Kind("single wrong commands", wrong_commands, "wheel_torque"),
    Kind("one rate axis stuck 3 s", stuck("rate", 1), demanded=True),
    Kind("all rate axes stuck 3 s", stuck("rate", None), demanded=True),
    Kind("one tachometer stuck 3 s", stuck(_TACHOMETER, 1), _TACHOMETER, demanded=True),
    Kind("commands stuck 3 s", stuck("wheel_torque", None), "wheel_torque"),
    Kind("saturated, range stated", saturated(True), sizes=(0.5, 1.5)),
    Kind("saturated, range not stated", saturated(False), sizes=(0.5, 1.5)),
    Kind("one axis missing in part", axis_missing, sizes=(0.3, 2.0)),
    Kind("good fixes while slewing", fixes_while_slewing(0.0), "true_attitude"),
    Kind("blurred fixes while slewing", fixes_while_slewing(0.2), "true_attitude"),
    Kind("commands not recorded 5 s", lost_commands, "wheel_torque"),
    Kind("tachometers not recorded 5 s", lost_tachometer, _TACHOMETER),
    Kind("tachometers without sign", unsigned_tachometer, _TACHOMETER, sizes=(1.0, 1.0)),
    Kind("coloured rate, phi 0.5", coloured(0.5)),
    Kind("coloured rate, phi 0.9", coloured(0.9)),
    Kind("coloured rate, phi 0.99", coloured(0.99)),
    Kind("quantised rate", quantised("rate")),
    Kind("quantised tachometers", quantised(_TACHOMETER), _TACHOMETER),
    Kind("rate noise stated 3 too small", wrong_noise("rate", 1 / 3), demanded=True),
    Kind("rate noise stated 3 too large", wrong_noise("rate", 3.0)),
    Kind(
        "tachometer noise stated 3 too small",
        wrong_noise(_TACHOMETER, 1 / 3),
        _TACHOMETER,
        demanded=True,
    ),
    Kind(
        "fix noise stated 3 too small",
        wrong_noise("attitude", 1 / 3),
        "attitude",
        demanded=True,
    ),
    Kind("fix noise stated 3 too large", wrong_noise("attitude", 3.0), "attitude"),
)
_CELLS = (
    Kind("NaN as text in rate", text_cells("rate", "NaN")),
    Kind("-1e31 in rate", text_cells("rate", "-1e31")),
    Kind("-1e31 in tachometers", text_cells(_TACHOMETER, "-1e31"), _TACHOMETER),
    Kind("NaN as text in commands", text_cells("wheel_torque", "NaN"), "wheel_torque"),
)
KINDS = {
    kind.name: replace(kind, stage=stage)
    for stage, kinds in ((2, _ROWS), (0, _READINGS), (1, _CELLS))
    for kind in kinds
}
