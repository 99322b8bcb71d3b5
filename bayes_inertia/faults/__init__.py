"""Faults of telemetry: what is wrong with readings and stamps, decided once, one detector a file.

Enters: a `Series`, the readings of one sensor in the order of time, or the rows of a table.
Leaves: the `Fault`s of its readings, and what was done about each.
"""
