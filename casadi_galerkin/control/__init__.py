"""Trajectory optimization: the discrete Lagrange-d'Alembert equations as constraints of a nonlinear program.

The cost is the quadrature of ℓ(t, x, v, u), the controls are values at the quadrature points, and IPOPT or fatrop
chooses all of them.  `chain` numbers the unknowns and the equations; `embedding`, `pointwise` and `graph` make the
nonlinear program with its derivatives, and `program_bounds` its bounds; `optimizer` solves it, and
`constraint_violation` checks what was found; `solver_error` estimates how far from the optimum that may be,
`second_variation` tells minima from saddles, and `failure_report` says why there is no path.  `transcription` does all
this from a guess, which `initial_guess` reads; where nothing is found, `retries` has what is tried in turn.
`control_function` does it as one CasADi Function, and `several_starts` from random guesses, too.  `refinement` chooses
a mesh for a tolerance, with `error_estimate`, `jumps_in_time`, `switching` and `phases`.
This folder imports all that stand before `boundary`, but neither `boundary` nor `stepping`.
"""
