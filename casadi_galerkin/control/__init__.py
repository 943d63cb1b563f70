"""Trajectory optimization: the discrete Lagrange-d'Alembert equations as constraints of a nonlinear program.

The cost is the quadrature of ℓ(t, x, v, u), the controls are values at the quadrature points, and IPOPT chooses all of
them.  This folder imports all that stand before `boundary`, but neither `boundary` nor `stepping`.
"""
