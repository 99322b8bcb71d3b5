"""The application: commands, folders of results, and the two calls from a campaign to its
posterior.

What enters: folders of campaigns and the words of a command line. What leaves: files in a folder
of results, text for people, exit codes; in a notebook a `Posterior` (`fit`) or a `DiagnosedFit`
(`diagnose_and_fit`). Each command has a file in `commands/`; what it writes is in the module
named after its folder (`run_folder`, `plan_folder`, ...). Who owns a folder is asked in
`result_folder` alone.
"""
