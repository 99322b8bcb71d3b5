"""Slews in closed loop: what is planned, and what becomes of it.

What enters: a `Plan` (slews, rests, fixes), a `Mission` (the spacecraft as it is, and what was
known of its inertia before flight) and a `Controller`.

What leaves: a `Flight` (telemetry as a `Campaign`, and the truth), campaign folders with their
truth, and the final attitude errors that draws of J and K lead to.
"""
