"""Information of a campaign on each parameter, and why there is no more.

What enters is an `Estimate` (and, if wanted, the same in the other drive). What leaves is an
`Observability` (`analysis.observe`): for each parameter its sd, where the information comes from
and to which other unknowns it is lost; for all together what cannot be told apart (`degeneracy`).
`sentences` puts it in words, `observability_json` into a file, and `against_posterior` sets the
prediction beside a sampled posterior.
"""
