"""Inference: from a model and its campaign to the posterior of J, K and the effects' parameters.

Enters: a `Model` (of `physics`). Leaves: an `Estimate` (maximum and Laplace approximation,
`optimizer`, `laplace`), a `LinearisedFit` (what follows to first order), `Chains` (`sampler`) and
a `Posterior` with its gates.
"""
