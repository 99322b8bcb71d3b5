"""The sd of Gaussian noise from the median of its deviations, which outliers hardly move."""

from __future__ import annotations

SD_OVER_MAD = 1.4826
"""Sd of a normal distribution over its median absolute deviation."""
