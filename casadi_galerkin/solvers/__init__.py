"""Solving ∇S = 0, the discrete Euler-Lagrange equations of all intervals at once, and verifying what was found.

`stationarity` makes of the one graph the three Functions that Newton's method needs.  `newton`, `rootfinder` and
`ipopt` find a point, `second_variation` tells conjugate points and the Morse index, `solver` gives the solvers their
names.
This folder imports `calculus` and `functional`.
"""
