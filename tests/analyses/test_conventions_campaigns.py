"""The study of conventions takes campaigns in memory as plain data."""

from __future__ import annotations

import numpy as np

from bayes_inertia.physics.small_campaign import small_campaign


def test_plain_data_hold_the_columns_of_every_slew(analysis):
    folder = analysis("imports.conventions_folder")
    campaign = small_campaign()
    raw = folder.raw_of(campaign)
    assert len(raw.tables) == len(campaign.slews)
    for slew, table in zip(campaign.slews, raw.tables.values(), strict=True):
        assert all(isinstance(values, np.ndarray) for values in table.values())
        assert any(np.array_equal(values, slew.rate[:, 0]) for values in table.values())
