"""How likely a set of effects is before the data are seen.

It is as likely as not that nothing is missing. Beside what acts there is one thing more in one of
ten campaigns. Sets of one size are alike (Scott and Berger, Annals of Statistics 38, 2010).
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln

# Beforehand: that something is missing, and that there is one thing more beside what acts.
_MISSING, _FURTHER = 0.5, 0.1


def log_prior_of_set(size: int, members: int) -> float:
    """Log probability beforehand of one set of effects.

    `members`: how many there are to choose from; "no name" is one of them.

    Examples
    --------
    >>> [round(float(np.exp(log_prior_of_set(size, 10))), 4) for size in (0, 1, 2)]
    [0.5, 0.045, 0.001]
    """
    choices = gammaln(members + 1) - gammaln(size + 1) - gammaln(members - size + 1)
    if size == 0:
        return float(np.log(1.0 - _MISSING))
    return float(np.log(_MISSING * (1.0 - _FURTHER) * _FURTHER ** (size - 1)) - choices)


def cost_of_further(size: int, further: int, members: int) -> float:
    """What it costs to claim further effects beside a set.

    `members`: how many there are to choose from; "no name" is one of them. Returns: by how much the
    log evidence of the larger set must exceed that of the smaller one.

    Examples
    --------
    >>> round(cost_of_further(1, 1, 30), 2), cost_of_further(2, 0, 30)
    (4.98, 0.0)
    """
    return log_prior_of_set(size, members) - log_prior_of_set(size + further, members)
