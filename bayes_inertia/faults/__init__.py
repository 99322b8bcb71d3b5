"""Faults of telemetry: what is wrong with readings and stamps, decided once, one detector a file.

Enters: a `Series`, the readings of one sensor in the order of time, or the rows of a table.
Leaves: the `Fault`s of its readings, and what was done about each.

The nouns: a *Column* is what one column of a file holds, with its unit; a *Table* is columns with
lines; a *Series* is what one sensor read in the order of time, in SI units; a *Fault* marks some of
its readings; `Dirt` is the record of a fault, by slew and row, as summary.json lists it.

| Question | Answer | Asked by |
|---|---|---|
| in which order are rows, was a clock set back | `row_order` | reader, import |
| on which clock were they taken | `stamps` | reader |
| by which offset are clocks known to differ | `known_offsets` | import, conventions |
| is a reading one of its own, or repeated | `held` | reader, import |
| are rows missing, do they come at one step | `gaps` | reader |
| can a reading be real | `impossible`, `saturated` | reader, fit |
| does a sensor stand still | `stuck` | reader, import |
| in which steps is it rounded | `quantisation` | reader, import, conventions, fit |
| how large is its noise | `noise` | import, conventions, `stuck`, `motion_scan` |
| is a reading far from its neighbours | `outliers` | import, conventions |
| when did the body rest | `motion_scan` | import |

`campaign.inspection` holds the order in which a campaign's streams are looked at. What only a model
can tell (outliers of residuals, coloured noise, a wrong unit) is decided in `inference.cleaning`
and in `conventions`.
"""
