"""Priors wider than an effect states them."""

from __future__ import annotations

from dataclasses import replace

from bayes_inertia.physics.parameters import Parameter


def with_prior_scale(parameter: Parameter, factor: float) -> Parameter:
    """A parameter whose Gaussian priors are as many times wider; log-normal ones stay.

    Parameters
    ----------
    parameter : Parameter
    factor : float
        Multiplies each standard deviation.

    Returns
    -------
    Parameter

    Examples
    --------
    >>> from bayes_inertia.physics.parameters import Normal, scalar
    >>> lag = scalar("lag", unit="s", prior=Normal(0.0, 0.1))
    >>> with_prior_scale(lag, 8.0).priors[0].sd
    0.8
    """
    if factor == 1.0:
        return parameter
    priors = (p if p.logarithmic else replace(p, scale=factor * p.scale) for p in parameter.priors)
    return replace(parameter, priors=tuple(priors))
