"""Lines of Python that set the inertia of a Basilisk spacecraft.

For balanced wheels Basilisk's `reactionWheelStateEffector` takes Js g g^T off the hub's inertia
itself (`matrixD -= Js * gsHat_B * gsHat_B.transpose()`): the hub is given J_locked.
"""

from __future__ import annotations

from bayes_inertia.report.export.content import (
    ExportedResult,
    comment_lines,
    guarded_digits,
    tensor_digits,
)

_SAYS = (
    "J_locked, about the centre of mass, with the wheels' spin inertia: Basilisk's balanced wheels",
    "take their own part off. Elements of the tensor: row 0, column 1 is -integral of x y dm.",
)


def basilisk_text(result: ExportedResult) -> str:
    """A Python snippet for a `spacecraft.Spacecraft()` called `scObject`."""
    rows = [f"    [{', '.join(row)}]," for row in tensor_digits(result, result.inertia_locked_B)]
    K = ", ".join(guarded_digits(p.new, p.sd) for p in result.scale_factors)
    return "\n".join(
        [
            *(f"# {line}" for line in comment_lines(result, *_SAYS)),
            "scObject.hub.r_BcB_B = [[0.0], [0.0], [0.0]]  # [m]",
            "scObject.hub.IHubPntBc_B = [  # [kg*m^2]",
            *rows,
            "]",
            "# the rate sensor reads w / K; K of its axes:",
            f"rate_sensor_K = [{K}]",
            "",
        ]
    )
