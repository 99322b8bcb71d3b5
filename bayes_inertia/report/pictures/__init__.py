"""Pictures: pure functions `draw_...` that return a matplotlib `Figure`, by subject a file.

What enters is a result (a posterior, the content of diagnosis.json, a comparison of plans).
A picture of something that the result does not have (no star tracker, no predicted momentum)
is None. To add a picture, add a file here and put its figure into a `Picture` of a section.
"""
