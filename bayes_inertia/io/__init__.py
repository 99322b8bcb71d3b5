"""Reading and writing campaign folders: `campaign.toml` and one table of telemetry per slew.

Whatever is wrong with the files is a `CampaignError` that says what, where (file, line, key)
and what to do; nothing is ever guessed, least of all a unit or a sign.
"""

from __future__ import annotations

from bayes_inertia.io.files import check_folder, make_folder, remove_leftovers, write_atomically
from bayes_inertia.io.reader import campaign_sha256, copy_campaign, read_campaign
from bayes_inertia.io.writer import write_campaign

__all__ = ["campaign_sha256", "check_folder", "copy_campaign", "make_folder", "read_campaign", "remove_leftovers", "write_atomically", "write_campaign"]
