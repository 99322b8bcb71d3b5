"""The report: one offline HTML page with the verdict first, and the pictures.

What enters are results: a `Posterior` and the content of diagnosis.json (`fit_sections`), two runs
(`comparison_sections`), an `Observability` (`observability_sections`), a design and plans that were
compared (`plan_sections`). What leaves is
a page (`page.write_report`) made of `Section`s, or a figure (`pictures`). A page has one style
sheet, and scripts that it is readable without. Numbers, units and lists are printed by
`formatting`, for the terminal too. The report reads the limits that were used from the result
(`criteria`); it never searches, fits or decides anything itself.

To add a section, write a function that returns a `Section` and append it to the list that
`standard_sections` returns.
"""
