"""The one graph: the discrete functional S(X̄) = ∫ L(t, x̄, dx̄/dt) Δ_w t (paper, eq. dislag) and its derivatives.

`functional` follows the paper: embed (`embedding`), evaluate pointwise (`pointwise`), integrate (`embedding` again).
Its gradient holds the discrete Euler-Lagrange equations (paper, eqs. euler1 and euler2).  `boundary_terms` adds ends,
constraints and whatever else a problem states beside L as local terms of the same sum.  `numbering` numbers the
unknowns of a path, and `interval` writes the same equations as a map of one interval.  `buffers` call CasADi's
Functions on arrays, safely and without copies.
This folder imports `calculus` and `problems`.
"""
