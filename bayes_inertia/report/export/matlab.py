"""A MATLAB script that defines one struct with the result, all digits."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayes_inertia.report.export.content import FORMAT, ExportedResult, comment_lines, one_line


def matlab_text(result: ExportedResult) -> str:
    """A script; `run export.m` leaves the struct `bayes_inertia`."""
    says = "J: without the wheels' spin inertia, J_locked: with it; elements of the tensor [kg m^2]"
    rows = result.parameters
    fields = {
        "format": _quoted(FORMAT),
        "trusted": "true" if result.trusted else "false",
        "campaign": _quoted(result.campaign),
        "J": _matrix(result.inertia_B),
        "J_locked": _matrix(result.inertia_locked_B),
        "K": _matrix(np.array([[p.new for p in result.scale_factors]])),
        "names": _cells(p.name for p in rows),
        "units": _cells(p.unit for p in rows),
        "old": _matrix(np.array([[p.old for p in rows]])),
        "new": _matrix(np.array([[p.new for p in rows]])),
        "sd": _matrix(np.array([[p.sd for p in rows]])),
        "covariance": _matrix(result.covariance),
    }
    lines = [f"% {line}" for line in comment_lines(result, says)]
    if not result.trusted:
        lines.append("warning('bayes_inertia:untrusted', 'Do not use this result as it stands.');")
    return "\n".join([*lines, *(f"bayes_inertia.{k} = {v};" for k, v in fields.items()), ""])


def _matrix(values: np.ndarray) -> str:
    rows = (" ".join(f"{x:.17g}" for x in row) for row in values.tolist())
    return f"[{'; '.join(rows)}]"


def _quoted(text: str) -> str:
    doubled = one_line(text).replace("'", "''")
    return f"'{doubled}'"


def _cells(texts: Iterable[str]) -> str:
    return f"{{{', '.join(_quoted(text) for text in texts)}}}"
