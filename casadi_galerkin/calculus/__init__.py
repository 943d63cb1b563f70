"""The discrete calculus on piecewise polynomials, with NumPy alone (paper, sections 2 and 3).

Here are the quadrature (Q, w), the nodes and their Lagrange polynomials, the embedding emb_m (paper, eq. interdef), the
discrete derivative Δ_m, the anti-derivative ∫ Δ_w, the choice of a mesh for a path, and what roundoff does. Numbers
that a user gives are checked here, too.  This folder imports no other.
"""
