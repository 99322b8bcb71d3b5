"""Slews are found in logs of many rates, noises, shapes, with orbital rate and limit cycles."""

from __future__ import annotations

import numpy as np

from bayes_inertia.importing.common_clock import Logs
from bayes_inertia.importing.logged_stream import LoggedStream
from bayes_inertia.importing.mapping import parse_mapping
from bayes_inertia.importing.slew_cutting import cut_into_slews

MAPPING = """\
format = "bayes-inertia-mapping/1"
name = "random"

[inertia]
tensor = [[3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]
relative_sigma = 0.04
product_sigma = 0.03
includes_wheel_spin = false

[rate_sensor]
sigma = 1e-4

[[streams]]
holds = "rate"
files = ["a"]
names = ["x", "y", "z"]
unit = "rad/s"
frame = "body"
"""
LOGS = 60


def random_log(rng: np.random.Generator) -> tuple[LoggedStream, list[tuple[float, float]]]:
    """Rates of a log and the start and end of each slew in it."""
    slews, start = [], rng.uniform(60.0, 300.0)
    for _ in range(rng.integers(1, 7)):
        slews.append((start, start + rng.uniform(20.0, 120.0)))
        start = slews[-1][1] + rng.uniform(60.0, 600.0)
    time = np.arange(0.0, start, 1.0 / rng.choice([1.0, 2.0, 4.0, 10.0]))
    rate = np.zeros((len(time), 3))
    peak = 10 ** rng.uniform(-2.2, -0.8)
    for begin, end in slews:
        axis = rng.normal(size=3)
        phase = np.clip((time - begin) / (end - begin), 0.0, 1.0)
        ramp = np.minimum(phase, 1.0 - phase)
        shapes = (
            0.5 - 0.5 * np.cos(2.0 * np.pi * phase),
            np.clip(4.0 * ramp, 0.0, 1.0),
            2.0 * ramp,
        )
        size = peak * rng.uniform(0.4, 1.0)
        rate += np.outer(size * shapes[rng.integers(3)], axis / np.linalg.norm(axis))
        settling = np.maximum(time - end, 0.0)
        ringing = 0.03 * size * np.exp(-settling / 6.0) * np.sin(0.6 * settling)
        rate += np.outer(ringing, axis / np.linalg.norm(axis))
    rate += 1e-4 * rng.random() * rng.normal(size=3)
    rate[:, 1] -= rng.choice([0.0, 1.1e-3])  # a body that points to the Earth
    rate[:, 0] += rng.choice([0.0, 3e-5]) * np.sign(np.sin(time / 20.0))  # a limit cycle
    rate += rng.normal(size=rate.shape) * 10 ** rng.uniform(-5.5, -3.5)
    rate[rng.random(len(time)) < 0.003] *= -20.0  # outliers
    rows = np.zeros(len(time), dtype=int)
    return LoggedStream("rate", time, rate, rows, ("a",)), slews


def test_slews_of_random_logs_are_found():
    mapping = parse_mapping(MAPPING, "m.toml")
    right = 0
    for child in np.random.SeedSequence(11).spawn(LOGS):
        stream, slews = random_log(np.random.default_rng(child))
        windows = cut_into_slews(Logs({"rate": stream}, 0, False), mapping, "m.toml").windows
        right += len(windows) == len(slews) and all(
            window.start < begin + 5.0 + 0.2 * (end - begin) and window.end > end - 5.0
            for window, (begin, end) in zip(windows, slews, strict=True)
        )
    assert right >= 0.95 * LOGS
