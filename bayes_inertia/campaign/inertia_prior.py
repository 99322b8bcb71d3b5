"""Prior of the inertia tensor, as known before flight."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.checks import require, require_positive
from bayes_inertia.maths.tensor_elements import COLUMNS_OF_ELEMENTS, ROWS_OF_ELEMENTS
from bayes_inertia.maths.values import array_dataclass


@array_dataclass
class InertiaPrior:
    """Pre-flight knowledge of the inertia tensor.

    Parameters
    ----------
    tensor : (3, 3) array
        The tensor in body axes [kg m^2]; its products are tensor elements, Jxy = J[0, 1].
    relative_sigma : float
        Standard deviation of each diagonal element, as a fraction of it.
    product_sigma : float
        Standard deviation of each product of inertia [kg m^2].
    includes_wheel_spin : bool, optional
        Whether `tensor` holds the wheels' spin inertia (J_locked) or not (J).

    Raises
    ------
    CampaignError
        If no body has the tensor, or a standard deviation is not positive.

    Examples
    --------
    >>> InertiaPrior(np.diag([3., 2., 2.]), 0.04, 0.03).sd.round(3).tolist()
    [0.12, 0.08, 0.08, 0.03, 0.03, 0.03]
    """

    tensor: np.ndarray
    relative_sigma: float
    product_sigma: float
    includes_wheel_spin: bool = False

    def __post_init__(self) -> None:
        tensor = np.array(self.tensor, dtype=float)
        _require_physical(tensor)
        object.__setattr__(self, "tensor", tensor)
        require_positive(self.relative_sigma, "inertia.relative_sigma")
        require_positive(self.product_sigma, "inertia.product_sigma")

    @property
    def elements(self) -> np.ndarray:
        """Prior means (6,) of the elements Jxx, Jyy, Jzz, Jxy, Jxz, Jyz [kg m^2]."""
        return self.tensor[ROWS_OF_ELEMENTS, COLUMNS_OF_ELEMENTS]

    @property
    def sd(self) -> np.ndarray:
        """Prior standard deviations (6,) of the elements [kg m^2]."""
        return np.concatenate(
            [self.relative_sigma * np.diag(self.tensor), np.full(3, self.product_sigma)]
        )


def _require_physical(tensor: np.ndarray) -> None:
    """Raise `CampaignError` unless a body can have this tensor (3, 3)."""
    key = "inertia.tensor"
    shape = f"shape {tensor.shape} is not (3, 3)"
    require(tensor.shape == (3, 3), key, shape, "give three rows of three numbers")
    finite = bool(np.all(np.isfinite(tensor)))
    require(finite, key, "an element is not finite", "give finite numbers")
    require(
        np.allclose(tensor, tensor.T, rtol=1e-9, atol=1e-9 * np.abs(tensor).max()),
        key,
        "the tensor is not symmetric",
        "give J[i][j] = J[j][i], products as tensor elements",
    )
    moments = np.linalg.eigvalsh(tensor)
    require(
        bool(np.all(0.5 * moments.sum() > moments)),  # second moments of mass are positive
        key,
        f"no body has principal moments {', '.join(f'{m:.6g}' for m in moments)} kg m^2",
        "each must be positive and at most the sum of the other two: "
        "check the sign of the products and the units",
    )
