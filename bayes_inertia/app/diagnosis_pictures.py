"""Data of a diagnosis' pictures, as plain numbers: residual maps and inferred signals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayes_inertia.app.investigation import Investigation
from bayes_inertia.diagnosis.free_signal import FreeSignal
from bayes_inertia.diagnosis.residuals import Disagreement


def pictures_json(investigation: Investigation) -> dict[str, Any]:
    """The part `pictures` of diagnosis.json.

    Returns `before` and `after` (residual maps), `torque` and `other` (signals); None where there
    is none.
    """
    before, after = investigation.disagreement_before, investigation.disagreement_after
    unknown = investigation.unexplained
    torque = None if unknown is None else unknown.torque
    other = None if unknown is None else unknown.better_signal
    return {
        "before": _residual_map(before),
        "after": None if after is None else _residual_map(after),
        "torque": None if torque is None else _signal(torque, before.slews, ("x", "y", "z")),
        "other": None if other is None else _signal(other, before.slews, None),
    }


def _residual_map(disagreement: Disagreement) -> dict[str, Any]:
    channels = {
        # From each slew's first row on: a time from an epoch would lose its seconds in rounding.
        name: {
            "components": cells.components,
            "edges": _rounded(cells.edges - cells.edges[:, :1], 8),
            "shift": _rounded(cells.shift, 4),
        }
        for name, cells in disagreement.cells.items()
    }
    return {"slews": disagreement.slews, "channels": channels}


def _signal(
    history: FreeSignal, slews: Sequence[str], components: Sequence[str] | None
) -> dict[str, Any]:
    count = history.mean.shape[-1]
    return {
        "source": history.source,
        "unit": history.unit,
        "slews": slews,
        "components": components or [f"{history.source} {i + 1}" for i in range(count)],
        "length": history.length,
        "time": _rounded(history.time - history.time[:, :1], 8),
        "mean": _rounded(history.mean, 4),
        "sd": _rounded(history.sd, 4),
    }


def _rounded(values: np.ndarray, digits: int) -> list:
    """Nested lists rounded to significant digits: pictures need no more."""
    values = np.asarray(values, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        power = 10.0 ** (digits - 1 - np.floor(np.log10(np.abs(values))))
        shown = np.where(np.isfinite(power), np.round(values * power) / power, values)
    return shown.tolist()
