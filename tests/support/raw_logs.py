"""A small raw log with slews, and the mapping that reads it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.importing.import_logs import import_logs

MAPPING = """\
format = "bayes-inertia-mapping/1"
name = "small"

[inertia]
tensor = [[3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]
relative_sigma = 0.04
product_sigma = 0.03
includes_wheel_spin = false

[[wheels]]
name = "x"
axis = [1.0, 0.0, 0.0]
spin_inertia = 0.001
momentum_sigma = 5e-6

[rate_sensor]
sigma = 1e-4

[star_tracker]
boresight = [0.0, 0.0, 1.0]
sigma_cross = 2e-5
sigma_roll = 1e-4

[[streams]]
holds = "rate"
files = ["log*.csv"]
time = { names = ["t_ms"], kind = "ms", epoch = "campaign" }
names = ["wx", "wy", "wz"]
unit = "deg/s"
frame = "body"

[[streams]]
holds = "wheel_torque"
files = ["log*.csv"]
time = { names = ["t_ms"], kind = "ms", epoch = "campaign" }
names = ["torque"]
unit = "mN m"
acts_on = "wheel"

[[streams]]
holds = "attitude"
files = ["log*.csv"]
time = { names = ["t_ms"], kind = "ms", epoch = "campaign" }
form = "quaternion"
names = ["q1", "q2", "q3", "q4"]
scalar = "last"
maps = "inertial_to_body"
frame = "body"
"""

STEP = 0.5  # [s]
NOISE = 1e-4  # [rad/s]


def log_columns(turns: list[tuple[float, float, float]], end: float) -> dict[str, np.ndarray]:
    """Columns of a log: turns about x with (start [s], duration [s], angle [rad])."""
    rng = np.random.default_rng(2)
    time = np.arange(0.0, end, STEP)
    rate = np.zeros((len(time), 3))
    angle = np.zeros(len(time))
    for start, duration, turned in turns:
        phase = np.clip((time - start) / duration, 0.0, 1.0)
        rate[:, 0] += turned / duration * (1.0 - np.cos(2.0 * np.pi * phase))
        angle += turned * (phase - np.sin(2.0 * np.pi * phase) / (2.0 * np.pi))
    quaternion = Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0])).as_quat()
    rate += rng.normal(size=rate.shape) * NOISE
    columns = {"t_ms": 1e3 * time}
    columns |= dict(zip(("wx", "wy", "wz"), np.degrees(rate).T, strict=True))
    columns["torque"] = 1e3 * np.gradient(rate[:, 0], time)
    columns |= dict(zip(("q1", "q2", "q3", "q4"), quaternion.T, strict=True))
    return columns


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A table; NaN becomes an empty cell."""
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns)]
    lines += [",".join("" if cell != cell else str(cell) for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def edited_mapping(folder: Path, *changes: tuple[str, str], more: str = "") -> Path:
    """The mapping with some texts replaced, as a file."""
    text = MAPPING
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "mapping.toml"
    path.write_text(text + more, encoding="utf-8")
    return path


def imported(
    folder: Path, columns: dict[str, np.ndarray], *changes: tuple[str, str], more="", files=()
):
    """The import of files, or of columns as log.csv, by the mapping with some texts replaced."""
    files = files or [write_csv(folder / "log.csv", columns)]
    return import_logs(files, edited_mapping(folder, *changes, more=more), folder / "c")
