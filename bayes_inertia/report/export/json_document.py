"""Everything exported, as one JSON document with all digits."""

from __future__ import annotations

import json
from dataclasses import asdict

from bayes_inertia.maths.values import json_ready
from bayes_inertia.report.export.content import FORMAT, ExportedResult, comment_lines


def json_text(result: ExportedResult) -> str:
    """A document of the schema `bayes-inertia-export/1`."""
    correction = result.correction
    content = {
        "format": FORMAT,
        "trusted": result.trusted,
        "warning": None if result.trusted else comment_lines(result)[0],
        "reasons": list(result.reasons),
        "notes": list(result.notes),
        "campaign": result.campaign,
        "source": result.source,
        "includes_wheel_spin": result.includes_wheel_spin,
        "J_kgm2": result.inertia_B.tolist(),
        "J_locked_kgm2": result.inertia_locked_B.tolist(),
        "K": [p.new for p in result.scale_factors],
        "parameters": {
            p.name: {k: v for k, v in asdict(p).items() if k != "name"} for p in result.parameters
        },
        "covariance": result.covariance.tolist(),
        "correction_slew_rad": None if correction is None else asdict(correction),
    }
    return json.dumps(json_ready(content), indent=1, allow_nan=False) + "\n"
