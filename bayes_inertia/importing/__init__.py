"""From any mission's raw logs to a campaign folder.

Enters: files as a ground station exports them, and a mapping that says what their columns mean.
Leaves: a campaign folder with one table a stream, and a record of what was cut and converted.
"""
