"""The inertia block of a CCSDS Attitude Parameter Message (CCSDS 504.0-B-2, keyword-value form).

The standard's cross products take the negative integral (504.0-B-1, 3.2.5.2.5: "assume a negative
double integral"): IXY = -integral of x y dm, which is the element of the inertia tensor and the
package's Jxy. No sign changes. Comments stand directly after INERTIA_START, where the standard
allows them.
"""

from __future__ import annotations

from bayes_inertia.report.export.content import ExportedResult, comment_lines, tensor_digits

_PLACES = {"XX": (0, 0), "YY": (1, 1), "ZZ": (2, 2), "XY": (0, 1), "XZ": (0, 2), "YZ": (1, 2)}
_SAYS = (
    "IXY, IXZ and IYZ are elements of the inertia tensor: IXY = -integral of x y dm",
    "inertia of the whole spacecraft, the wheels' spin inertia included (wheels locked)",
    "about the centre of mass; rounded two digits beyond the uncertainty",
    "block only: put it behind the attitude of a message of yours",
)


def ccsds_apm_text(result: ExportedResult) -> str:
    """The block from INERTIA_START to INERTIA_STOP."""
    sds = ", ".join(f"I{k} {result.parameter(f'J{k.lower()}').sd:.2g}" for k in _PLACES)
    comments = comment_lines(result, *_SAYS, f"standard deviations [kg*m**2]: {sds}")
    digits = tensor_digits(result, result.inertia_locked_B)
    return "\n".join(
        [
            "INERTIA_START",
            *(f"COMMENT {line}" for line in comments),
            "INERTIA_REF_FRAME = SC_BODY_1",
            *(f"I{key} = {digits[i][j]} [kg*m**2]" for key, (i, j) in _PLACES.items()),
            "INERTIA_STOP",
            "",
        ]
    )
