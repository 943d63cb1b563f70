"""Trajectory optimization: the discrete Lagrange-d'Alembert equations as constraints of a nonlinear program.

The cost is the quadrature of ℓ(t, x, v, u), the controls are values at the quadrature points, and IPOPT or fatrop
chooses all of them.  `chain` numbers the unknowns and the equations; `embedding`, `pointwise` and `graph` make the
nonlinear program with its derivatives, and `program_bounds` its bounds; `optimizer` solves it, and
`continuous_controls` chooses among controls that act alike, and `constraint_violation` checks what was found;
`solver_error` estimates how far from the optimum that may be, `second_variation` tells minima from saddles, and
`failure_report` reports failures.  `transcription` combines all this and starts from a guess, which `initial_guess`
reads; after a failure `retries` tries other guesses.  `control_function` is the same as one CasADi Function, and
`several_starts` also starts from random guesses.  `refinement` meets a tolerance, by `error_estimate`, `better_mesh`,
`phases`, where controls switch or bend (`switching`, `bends`), and `touches` of bounds.
This folder imports all that stand before `boundary`, but neither `boundary` nor `stepping`.
"""
