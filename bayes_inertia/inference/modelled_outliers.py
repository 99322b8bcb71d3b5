"""Outliers that Student-t noise took for what they are: a record of them, nothing is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from bayes_inertia.faults.fault import Dirt
from bayes_inertia.inference.laplace import Estimate, plain_series
from bayes_inertia.inference.noise_parameters import channel_rules
from bayes_inertia.inference.outliers import FALSE_ALARM
from bayes_inertia.maths.robust_scale import SD_OVER_MAD


def with_modelled_outliers(estimate: Estimate) -> Estimate:
    """The estimate with a record of each outlier in the channels of Student-t noise.

    A reading counts as one where Gaussian noise of the spread that the middle of its channel shows
    would not reach once in a thousand campaigns.

    `estimate`: with the noise that its model was asked for. Returns: the same but for the records
    of its campaign; the very object where there is none.
    """
    records = _records(estimate)
    if not records:
        return estimate
    campaign = estimate.model.campaign
    campaign = replace(campaign, dirt=(*campaign.dirt, *records))
    return replace(estimate, model=replace(estimate.model, campaign=campaign))


def _records(estimate: Estimate) -> tuple[Dirt, ...]:
    """One record a channel and slew."""
    rules, slews = channel_rules(estimate.model), estimate.model.campaign.slews
    if not any(rule.heavy for rule in rules):
        return ()
    series, records = plain_series(estimate), []
    for channel, rule in zip(estimate.model.channels, rules, strict=True):
        if not rule.heavy:
            continue
        numbers = np.concatenate([np.abs(z[np.isfinite(z)]) for z in series[channel.name]])
        spread = SD_OVER_MAD * float(np.median(numbers))
        limit = spread * float(stats.norm.isf(0.5 * FALSE_ALARM / len(numbers)))
        for slew, z in zip(slews, series[channel.name], strict=True):
            # Star-tracker fixes stand one after the other, without the rows between them.
            given = channel.readings(estimate.model.campaign, slew).row
            rows = given[(np.abs(np.nan_to_num(z[: len(given)])) > limit).any(axis=1)]
            if len(rows):
                note = f"{len(rows)} row{'s' if len(rows) > 1 else ''} in Student-t noise"
                listed = tuple(int(row) for row in rows)
                records.append(Dirt("outliers", channel.name, slew.name, listed, "modelled", note))
    return tuple(records)
