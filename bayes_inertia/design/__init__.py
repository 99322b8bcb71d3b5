"""Which slews to fly next.

What enters: a mission (spacecraft and prior of J), a goal, limits, and optionally the fit of a
campaign flown before. What leaves: a plan within all limits with the accuracy and the margins to
expect of it (`designer`), plans side by side (`comparison`), the slew that tells two effects apart
(`separating_slew`), and the correction slew to expect (`correction_slew`).
"""
