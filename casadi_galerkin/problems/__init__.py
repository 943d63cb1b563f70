"""What a user states, checked before anything is solved.

A problem holds a Lagrangian L(t, x, v), traced once into a CasADi Function, with its ends, times, forces, costs and
bounds.  The Legendre transform p = ∂L/∂v is here too.  This folder imports `calculus`.
"""
