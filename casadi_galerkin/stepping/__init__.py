"""The discrete Euler-Lagrange equations solved one interval after the other: initial problems and shooting.

A `stepper` rolls the map (x, p) -> (x, p) of one interval forward: the discrete Euler-Lagrange equations (paper, eqs.
euler1 and euler2), solved joint by joint.  `initial_value` solves initial problems with it, and `shooting` boundary
problems: `shooting_residual` is what the path from one start misses of the conditions on the ends.  `geometry` measures
what a path conserves.  This folder imports all that stand before `boundary`, but neither `boundary` nor `control`.
"""
