"""The commands of `bayes-inertia`, one file each or one for those of a kind.

A command is its options, one call of the package, and what it prints.

What enters: words of a command line. What leaves: files in the folder given with `-o`, text for
people, an exit code. Packages that take long to load are imported inside the functions, so that
`--help` is quick.
"""
