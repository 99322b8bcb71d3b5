"""Whether simulated closed-loop slews agree in kind with those of an independent simulator (used by
`paper_tables.py`).
"""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from analyses.paper.ferguson import ARCSEC, DEG, ROOT, Table, spacecraft_of
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_flight import fly


def independent_campaign() -> Campaign | None:
    """Five slews of the same spacecraft from Basilisk, None where they are not at hand."""
    places = [
        ROOT / "bayes_inertia" / "example",
        *(p / "data" / "basilisk" / "clean" for p in (ROOT / "shared", ROOT.parent / "shared")),
    ]
    found: list[Path] = [p for p in places if (p / "campaign.toml").is_file()]
    return read_campaign(found[0]) if found else None


def measures(campaign: Campaign) -> np.ndarray:
    """(slews, 5): duration [s], largest rate [deg/s], torque [1e-3 N m] and wheel momentum [1e-3 N
    m s], correction slew [arcsec]; all from telemetry.
    """
    rows = []
    for slew in campaign.slews:
        fixed = np.flatnonzero(np.isfinite(slew.attitude).all(axis=1))
        middle = 0.5 * (slew.time[0] + slew.time[-1])
        before, after = (
            Rotation.from_quat(slew.attitude[fixed[part]]).mean()
            for part in (slew.time[fixed] < middle, slew.time[fixed] > middle)
        )
        wanted = before * Rotation.from_rotvec(slew.angle * np.array(slew.axis_B))
        left = (wanted.inv() * after).magnitude() / ARCSEC
        peaks = [1e3 * np.abs(x).max() for x in (slew.wheel_torque, slew.wheel_momentum)]
        rows.append([slew.duration, np.linalg.norm(slew.rate, axis=1).max() / DEG, *peaks, left])
    return np.array(rows)


def closed_loop_check(truth: np.ndarray, seed: int) -> tuple[Table, float] | None:
    """The same five slews by both simulators, and the largest relative difference of their
    correction slews.
    """
    other = independent_campaign()
    if other is None:
        return None
    mission = Mission(spacecraft_of(truth), other.inertia)
    ours = fly(paper_like_plan(), mission, seed).campaign
    a, b = measures(other), measures(ours)
    rows = [
        [
            s.name,
            *(
                f"{x:.3g} / {y:.3g}" if k != 4 else f"{x:.0f} / {y:.0f}"
                for k, (x, y) in enumerate(zip(a[i], b[i], strict=True))
            ),
        ]
        for i, s in enumerate(other.slews)
    ]
    header = (
        "slew",
        "duration [s]",
        "largest rate [deg/s]",
        "largest torque [10⁻³ N m]",
        "largest momentum [10⁻³ N m s]",
        "correction slew [arcsec]",
    )
    return Table(
        "The same slews by Basilisk / here, from telemetry alone (controller believes the same "
        "wrong initial estimate)",
        header,
        rows,
    ), float(np.max(np.abs(b[:, 4] / a[:, 4] - 1)))
