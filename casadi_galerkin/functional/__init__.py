"""The one graph: the discrete functional S(X̄) = ∫ L(t, x̄, dx̄/dt) Δ_w t (paper, eq. dislag) and its derivatives.

`functional` says the paper's sentence: embed (`embedding`), evaluate pointwise (`pointwise`, `mapping`), integrate
(`embedding` again).  Its gradient holds the discrete Euler-Lagrange equations (paper, eqs. euler1 and euler2).
`statement` adds what a problem says more than L, such as ends and constraints, as `local_terms` of the same sum, and
`end_velocities` finds those unknowns of theirs that enter nonlinearly.
`numbering` says which unknown is which value of the path, and `interval` writes the same equations as a map of one
interval.  `buffers` and `threads` call CasADi's Functions on arrays, safely and without copies.
This folder imports `calculus` and `problems`.
"""
