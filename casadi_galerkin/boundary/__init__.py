"""Two-point boundary problems, solved for all intervals at once.

A `graph` holds one problem, and a `transcription` solves it as often as wanted.  `boundary_refinement` chooses degree
and mesh for a tolerance: `first_path` finds a first path, if necessary in a growing time, under a growing force or by
the search for `several_paths`; `error_estimate` estimates the error of each path.  `repeated_refinement` does so again
and again, for different data of one problem.  `continuation` follows a path while
parameters change, and returns a `branch`; `all_paths` finds other paths between the same ends, by the search of
`several_paths`; `sensitivity` differentiates.  `failure_report` reports failures.
This folder imports all that stand before it, but neither `stepping` nor `control`.
"""
