"""What a user states, checked when a problem is made, and never after.

A problem holds a Lagrangian L(t, x, v), traced once into a CasADi Function, with its ends, times, forces, constraints,
costs and bounds.  For each kind of problem a table says how its statements are read (`statements`), and rules say what
they must not contradict.  Problems that are `varied`, joined, parted or found are made of checked ones, and only what
is new in them is looked at.  `phases` joins control problems, and `tables` makes data a function that all may call.
`legendre_transform` and `constrained_motion` are the motion at one instant.  This folder imports `calculus`.
"""
