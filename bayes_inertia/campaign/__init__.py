"""What was flown: slews, hardware, and what was known before.

Enters: a campaign folder (`campaign.toml` and one table a slew), or objects built in a notebook.
Leaves: a checked `Campaign` in SI units and radians, with one convention of signs and senses.
"""
