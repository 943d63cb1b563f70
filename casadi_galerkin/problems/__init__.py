"""What a user states, checked before anything is solved.

A problem holds a Lagrangian L(t, x, v), traced once into a CasADi Function, with its ends, times, forces, constraints,
costs and bounds.  The Legendre transform p = ∂L/∂v is here too, and the equations of motion at one instant, of what a
constraint holds and of what controls push.  This folder imports `calculus`.
"""
