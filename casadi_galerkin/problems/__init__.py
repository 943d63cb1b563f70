"""What a user states, checked before anything is solved.

A problem holds a Lagrangian L(t, x, v), traced once into a CasADi Function, with its ends, times, forces, constraints,
costs and bounds.  The Legendre transform p = ∂L/∂v is here too, and so are the equations of motion at one instant under
constraints and under controls, and the phase of a periodic path of given energy.  This folder imports `calculus`.
"""
