"""Trajectory optimization: the discrete Lagrange-d'Alembert equations as constraints of a nonlinear program.

The cost is the quadrature of ℓ(t, x, v, u), the controls are values at the quadrature points, and IPOPT or fatrop
chooses all of them.  `chain` says which unknown is what; `embedding`, `pointwise` and `graph` make the program of it
with its derivatives, and `program_bounds` its bounds; `optimizer` solves it, and `constraint_violation` judges what was
found; `solver_error` tells how far from the optimum that may be, `second_variation` minima from saddles, and
`failure_report` why there is no path.  `transcription` does all this from a guess, which `initial_guess` reads, and
`attempts` says what is tried in turn where nothing is found; `control_function` does it as one CasADi Function, and
`several_starts` from random guesses, too.  `refinement` chooses a mesh for a tolerance, with `error_estimate`,
`time_witness`, `switching` and `phases`.
This folder imports all that stand before `boundary`, but neither `boundary` nor `stepping`.
"""
