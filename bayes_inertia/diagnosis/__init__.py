"""What is missing in the model: where a fit disagrees with the data, and which effect explains it.

Enters: a campaign, or an estimate of one, and a library of candidate effects.
Leaves: a `Diagnosis` with its table of hypotheses, the windows that disagree, the torque that
nothing explains, and J and K of every row.

`search` leads through it: from a clean start (`clean_start`) everything that may be missing is one
linear model (`linear_system`), every set of it one row (`hypothesis_table`), weighed again around
the best and read by the `Rules` (`table_search`). `residuals` shows where the fit
disagrees, `unexplained` what is left, `quoted_parameters` what could hide.
"""
