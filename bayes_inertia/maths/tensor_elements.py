"""The elements of an inertia tensor: their names, their order, and where they stand in it.

It imports no JAX, so that a campaign is read without it.
"""

from __future__ import annotations

ELEMENTS = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz")
ROWS_OF_ELEMENTS, COLUMNS_OF_ELEMENTS = (
    tuple("xyz".index(name[k]) for name in ELEMENTS) for k in (-2, -1)
)
