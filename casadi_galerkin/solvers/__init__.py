"""Solving ∇S = 0, the discrete Euler-Lagrange equations of all intervals at once, and verifying what was found.

`stationarity` makes the three steps that Newton's method needs out of the one graph and a `linear_solver`.
`newton`, `rootfinder` and `ipopt` find a critical point, and so does a `curve` of them, which is followed by its arc
length.  `second_variation` finds conjugate points and the Morse index, `solver` gives the solvers their names, those
of control problems included, and `deadline` stops a solve in time.  `derivatives` is for solves that are
Functions, and for derivatives by the data.
This folder imports `calculus`, `problems` and `functional`.
"""
