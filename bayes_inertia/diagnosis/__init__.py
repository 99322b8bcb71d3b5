"""What is missing in the model: where a fit disagrees with the data, and which effect explains it.

Enters: a campaign, or an estimate of one, and a library of candidate effects.
Leaves: a `Diagnosis` with its steps, the windows that disagree, the torque that nothing explains,
and what else J and K could be.

`search` leads through it: `candidates` are scored (`score_test`, `flexible_mode_search`), the best
are refitted (`refitting`, `evidence`), needless ones dropped (`pruning`), and `conclusion` reaches
the verdict by the `rules`. `residual_scan` shows where the fit disagrees, `unexplained` what is
left, `blind_spots` what could hide, `model_averaging` what an ambiguous answer means for J and K.
"""
