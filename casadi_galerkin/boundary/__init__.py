"""Boundary problems, all intervals at once.

A `graph` holds one problem, and a `transcription` solves it as often as wanted.  `refinement` chooses degree and mesh
for a tolerance: `first_path` finds where it begins, also by `growing_share` and `action_descent`; `levels` keeps its
graphs, and `error_estimate` judges its paths.  `adaptive_transcription` does so for one problem after the other.
`continuation` follows a path while parameters change; `several_paths` finds other paths between the same ends;
`sensitivity` differentiates.  `variations` compares problems that differ in given values, and `branches` compares their
paths.  `mass` refuses a Lagrangian without momenta to solve for, and `failure_report` says why there is no path.
This folder imports all that stand before it, but neither `stepping` nor `control`.
"""
