"""Where a fit comes from: what its result says about itself beside its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class FitContext:
    """What is known of a fit before it begins.

    Parameters
    ----------
    campaign_sha256 : str, optional
        Digest of the campaign's files.
    measured_noise : mapping of float, optional
        By channel: by which factor a diagnosis found the noise to exceed the stated one. It was
        taken in this fit.
    verdict : str, optional
        Of the diagnosis: "consistent", "named", "ambiguous" or "unknown".

    Examples
    --------
    >>> FitContext(verdict="named").attributes()
    {'campaign_sha256': None, 'verdict': 'named'}
    """

    campaign_sha256: str | None = None
    measured_noise: Mapping[str, float] | None = None
    verdict: str | None = None

    def attributes(self) -> dict[str, Any]:
        """As attributes of the result.

        Returns
        -------
        dict
            `campaign_sha256`; `verdict` and `noise` after a diagnosis.
        """
        attributes: dict[str, Any] = {"campaign_sha256": self.campaign_sha256}
        if self.verdict is not None:
            attributes["verdict"] = self.verdict
        if self.measured_noise is not None:
            attributes["noise"] = dict(self.measured_noise)
        return attributes
