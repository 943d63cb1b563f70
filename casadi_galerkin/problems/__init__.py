"""What a user states, checked when a problem is made, and never after.

A problem holds a Lagrangian L(t, x, v), traced once into a CasADi Function, with its ends, times, forces, constraints,
costs and bounds: `boundary_problem`, `initial_problem` and `control_problem`, all of them a `problem`.  Each of its
fields is one of its `statements`, in the order of its arguments: what may be given, how that is read, what is kept; and
rules say what they must not contradict.  Problems that are varied, joined, parted or found are made of checked ones,
and only what is new in them is looked at.  `phases` joins control problems, `callables` traces a user's functions, and
`tables` makes data a function that all may call.  `legendre_transform` and `constrained_motion`, by `linear_equations`,
are the motion at one instant.  This folder imports `calculus`.
"""
