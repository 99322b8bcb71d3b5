"""Are the stated units, signs, axes and clocks those of the data? Physics answers before any fit.

Enters: a campaign and what its description states.
Leaves: whether they are consistent, and if not, the single change of convention that mends it.
"""
