"""A CCSDS Attitude Comprehensive Message (CCSDS 504.0-B-2) that holds J, K and their covariance.

J stands in the block of physical properties, with the signs of the package (see `ccsds_apm`). The
standard has no place for scale factors, nor for a covariance of the inertia tensor: both are
user-defined entries, K1 to K3 dimensionless, covariances in the units of the two parameters.
"""

from __future__ import annotations

from datetime import UTC, datetime

from bayes_inertia.report.export.ccsds_apm import PLACES, SAYS_OF_TENSOR
from bayes_inertia.report.export.content import (
    ExportedResult,
    comment_lines,
    guarded_digits,
    one_line,
    tensor_digits,
)

_NO_EPOCH = "EPOCH_TZERO is when this message was made: no entry depends on time"
_ELEMENTS = tuple(f"I{key}" for key in PLACES)


def ccsds_acm_text(result: ExportedResult) -> str:
    """The whole message, keyword-value form."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    digits = tensor_digits(result, result.inertia_locked_B)
    lines = [
        "CCSDS_ACM_VERS = 2.0",
        *(f"COMMENT {line}" for line in comment_lines(result, _NO_EPOCH)),
        f"CREATION_DATE = {now}",
        "ORIGINATOR = BAYES_INERTIA",
        "",
        "META_START",
        f"OBJECT_NAME = {one_line(result.campaign)}",
        "TIME_SYSTEM = UTC",
        f"EPOCH_TZERO = {now}",
        "META_STOP",
        "",
        "PHYS_START",
        *(f"COMMENT {line}" for line in SAYS_OF_TENSOR),
        "INERTIA_REF_FRAME = SC_BODY_1",
        *(f"I{key} = {digits[i][j]} [kg*m**2]" for key, (i, j) in PLACES.items()),
        "PHYS_STOP",
        "",
        "USER_START",
        "COMMENT K = diag(K1, K2, K3): K times the reading is the rate in sensor axes plus bias",
        "COMMENT COV_A_B: covariance of A and B, lower triangle, kg*m**2 for I, none for K",
        *_scale_factors(result),
        *_covariances(result),
        "USER_STOP",
        "",
    ]
    return "\n".join(lines)


def _scale_factors(result: ExportedResult) -> list[str]:
    return [f"USER_DEFINED_{p.name} = {guarded_digits(p.new, p.sd)}" for p in result.scale_factors]


def _covariances(result: ExportedResult) -> list[str]:
    names = (*_ELEMENTS, *(p.name for p in result.scale_factors))
    return [
        f"USER_DEFINED_COV_{a}_{b} = {result.covariance[i, j]:.8e}"
        for i, a in enumerate(names)
        for j, b in enumerate(names[: i + 1])
    ]
