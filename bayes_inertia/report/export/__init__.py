"""Results for other tools: one file per format, each a pure function of an `ExportedResult`.

What enters: parameters before and after a fit, both inertia tensors, whether the result is trusted.
What leaves: the text of one file. A result that is not trusted says so in the file itself.
"""
