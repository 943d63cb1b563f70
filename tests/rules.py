"""The families of rules, the polynomials whose roots their points are, and those of Lagrange, each written out.

The former have as many digits as mpmath is set to.
"""

import mpmath
import numpy as np

import casadi_galerkin as cg

FAMILIES = {"gauss": (cg.gauss, 1, 0), "lobatto": (cg.lobatto, 2, -2), "radau": (cg.radau, 1, -1)}  # order 2n + last
OF_DEGREE = {
    "gauss(m)": lambda m: cg.gauss(m),
    "gauss(m+1)": lambda m: cg.gauss(m + 1),
    "lobatto(m)": lambda m: cg.lobatto(m),
    "lobatto(m+1)": lambda m: cg.lobatto(m + 1),
    "radau(m)": lambda m: cg.radau(m),
    "radau(m+1)": lambda m: cg.radau(m + 1),
}


def polynomial(name: str, n: int):
    """Function in 40 digits whose roots are the inner points on [-1, 1], and the weights on [0, 1] from a point."""

    def legendre_pair(k, x):
        a, b = mpmath.mpf(1), x
        for j in range(1, k):
            a, b = b, ((2 * j + 1) * x * b - j * a) / (j + 1)
        return (b, a) if k else (a, mpmath.mpf(0))

    def slope(k, x):
        p, q = legendre_pair(k, x)
        return k * (q - x * p) / (1 - x * x)

    if name == "gauss":
        return lambda x: legendre_pair(n, x)[0], lambda x: 1 / ((1 - x * x) * slope(n, x) ** 2)
    if name == "lobatto":
        return lambda x: slope(n - 1, x), lambda x: 1 / (n * (n - 1) * legendre_pair(n - 1, x)[0] ** 2)
    difference = lambda x: legendre_pair(n - 1, x)[0] - legendre_pair(n, x)[0]  # noqa: E731
    return difference, lambda x: (1 + x) / (2 * n * n * legendre_pair(n - 1, x)[0] ** 2)


def lagrange(nodes, j, t):
    """l_j and l_j' of the nodes at times t, by the product formula."""
    others = np.delete(nodes, j)
    value = np.prod([(t - s) / (nodes[j] - s) for s in others], axis=0)
    slope = sum(
        np.prod([(t - s) / (nodes[j] - s) for s in np.delete(others, k)] + [np.ones_like(t)], axis=0)
        / (nodes[j] - others[k])
        for k in range(len(others))
    )
    return value, slope
