"""Residuals in the page: nothing lost, and outliers kept where there are too many rows."""

import base64
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.pictures.posterior_data import channel_series
from bayes_inertia.report.pictures.style import thinned_rows
from bayes_inertia.report.residual_sections import (
    explorer_data,
    residual_channels,
    telemetry_section,
)


def unpacked(channel: dict, slew: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and residuals of one slew, as the page's script reads them."""
    part = channel["slews"][slew]
    time = np.frombuffer(base64.b64decode(part["time"]), "<f4")
    columns = [np.frombuffer(base64.b64decode(text), "<i2") for text in part["residual"]]
    return time, np.array(columns).T * channel["step"]


def test_every_residual_is_in_the_page_to_a_fraction_of_its_noise(posteriors):
    channels = residual_channels(posteriors["good"])
    content = explorer_data(channels)
    assert [c["name"] for c in content["channels"]] == [
        "rate sensor",
        "star tracker",
        "wheel momentum",
    ]
    for channel, packed in zip(channels, content["channels"], strict=True):
        for s, residual in enumerate(channel.residual):
            time, shown = unpacked(packed, s)
            assert packed["slews"][s]["rows"] == len(residual)
            np.testing.assert_allclose(time, channel.time[s], rtol=1e-6)
            np.testing.assert_allclose(shown, residual, atol=1e-3)


def test_too_many_rows_keep_their_outliers_and_say_how_many(posteriors):
    channels = residual_channels(posteriors["thrown"])
    content = explorer_data(channels)
    kept = 0
    for s, residual in enumerate(channels[0].residual):
        _, shown = unpacked(content["channels"][0], s)
        kept += shown.size
        assert content["channels"][0]["slews"][s]["rows"] == len(residual) > len(shown)
        np.testing.assert_allclose(shown.max(0), residual.max(0), atol=1e-3)
        np.testing.assert_allclose(shown.min(0), residual.min(0), atol=1e-3)
    assert kept < 1.1 * 24_000


@pytest.mark.parametrize("most", [10, 150])
def test_gaps_are_never_taken_for_extremes(most):
    values = np.full((500, 2), np.nan)
    values[100:110, 0] = np.arange(10.0)
    assert {100, 109} <= set(thinned_rows(values, most).tolist())


def test_the_middle_of_noise_is_not_left_empty():
    values = np.random.default_rng(5).normal(size=(20_000, 3))
    shown = values[thinned_rows(values, 600)]
    assert len(shown) <= 600
    # The evenly spaced half are an unbiased sample: 38 % within half a sigma.
    assert np.mean(np.abs(shown) < 0.5) > 0.19 - 4.0 * np.sqrt(0.25 / shown.size)


def test_fixes_of_a_further_star_tracker_have_times_and_small_rotations():
    fixes, dims = np.full((1, 3, 4), np.nan), ("slew", "tracker 2_fix", "quaternion")
    fixes[0, :2] = [0.0, 0.0, 0.0, 1.0]
    time = np.array([[5.0, 6.0, np.nan]])
    tree = {
        "observed_data": {"tracker 2": (dims, fixes)},
        "posterior_predictive": {"tracker 2": (("chain", "draw", *dims), fixes[None, None])},
        "estimate": {"residual_tracker 2": (("row", "axis"), np.arange(9.0).reshape(3, 3))},
        "constant_data": {
            "time": (("slew", "row"), np.arange(9.0)[None]),
            "tracker 2_fix_time": (dims[:2], time),
        },
    }
    coords = {"slew": ["slew 1"]}
    groups = {key: xarray.Dataset(values, coords=coords if key == "observed_data" else None)
              for key, values in tree.items()}  # fmt: skip
    posterior = SimpleNamespace(tree=xarray.DataTree.from_dict(groups))
    series = channel_series(posterior, "tracker 2")
    np.testing.assert_array_equal(series.time, time)
    assert series.components == ["axis 1", "axis 2", "axis 3"]
    np.testing.assert_array_equal(series.residual[0, :2], [[0, 1, 2], [3, 4, 5]])
    assert np.isnan(series.residual[0, 2]).all()


def test_a_sensor_that_is_neither_gyro_nor_tracker_is_drawn_and_explored(made):
    """Of a spacecraft that flies by a magnetometer alone, the page holds what it read."""
    tree = made("good").tree.copy(deep=True)
    for group in ("observed_data", "posterior_predictive", "estimate"):
        values = tree[group].dataset.drop_vars(
            ["rate", "attitude", "residual_rate", "residual_attitude"], errors="ignore"
        )
        renamed = {"momentum": "field", "residual_momentum": "residual_field"}
        tree[group] = xarray.DataTree(
            values.rename({old: new for old, new in renamed.items() if old in values})
        )
    tree["estimate"] = xarray.DataTree(
        tree["estimate"].dataset.assign_coords(channel=["rate", "attitude", "field"])
    )
    section = telemetry_section(Posterior(tree))
    assert [c["name"] for c in section.context["data"]["channels"]] == ["field"]
    assert [p.alt for p in section.pictures] == ["Residuals of field, slew by slew"]
