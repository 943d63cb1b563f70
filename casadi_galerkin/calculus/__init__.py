"""The discrete calculus on piecewise polynomials, with NumPy alone (paper, sections 2 and 3).

`quadrature` has the rules (Q, w), and `nodes` the control points and their Lagrange polynomials; with a degree they are
a method, `galerkin`.  `discrete_calculus` has the embedding emb_m (paper, eq. interdef), the derivative Δ_m and the
anti-derivative ∫ Δ_w; `piecewise_polynomial` is what it embeds, and `mesh_adaptation` chooses a mesh for it.
`roundoff` has what roundoff does, `numbers` reads those that a user gives, and `cached_property` keeps what is computed
once.  This folder imports no other.
"""
