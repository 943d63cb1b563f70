"""Trajectory optimization: the discrete Lagrange-d'Alembert equations as constraints of a nonlinear program.

The cost is the quadrature of ℓ(t, x, v, u), the controls are values at the quadrature points, and IPOPT or fatrop
chooses all of them.  A problem has phases, each with a chain of intervals.  `control_numbering` numbers the unknowns
and the equations, and bounds them; `control_places` says what is embedded, evaluated and integrated where, and
`control_graph` makes the nonlinear program of it, with its derivatives and what violates it.  `optimizer` solves it,
and `continuous_controls` chooses among controls that act alike; `second_order` estimates how far from the optimum that
may be and tells minima from saddles, and `failed_optimization` reports failures.  `control_transcription`
combines all this and starts from a guess, which `initial_guess` reads; `control_answer` makes paths of what was found;
`starts` tries other guesses, too.  `control_sensitivity` differentiates an optimum, and makes a CasADi Function of it.
`control_refinement` meets a tolerance by `two_comparisons`.
This folder imports all that stand before `boundary`, but neither `boundary` nor `stepping`.
"""
