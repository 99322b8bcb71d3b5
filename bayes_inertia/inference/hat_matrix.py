"""What a fit takes from each channel: the trace of its hat matrix."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.likelihood import Information
from bayes_inertia.inference.objective import block_index
from bayes_inertia.inference.point import N_BIAS


def hat_traces(
    information: Information,
    n_local: int,
    covariance: np.ndarray,
    counted: np.ndarray | None = None,
    *,
    nuisances: np.ndarray | None = None,
) -> np.ndarray:
    """Trace of the hat matrix over each channel's rows.

    `covariance` (unknowns, unknowns) [free]; `counted` (f,) [free]. `nuisances` (n_local,): which
    of a slew's nuisances are paid for; all by default. The others act all the same. Returns (3,).
    """
    total = np.zeros(len(CHANNELS))
    for s, block in enumerate(information.matrix):
        index = block_index(len(information.free) + N_BIAS, n_local, s)
        if counted is not None:
            keep = np.concatenate([counted, np.ones(len(index) - len(counted), bool)])
            index, block = index[keep], block[:, keep][:, :, keep]
        paid = np.ones(len(index), bool)
        if nuisances is not None:
            paid[-n_local:] = nuisances
        total += np.einsum("cpq,qp->c", block[:, paid], covariance[np.ix_(index, index[paid])])
    return total
