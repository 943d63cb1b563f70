"""Orders of convergence on nonlinear problems: at the joints min(2m, u), between them m + 1, velocity m.

Two are conservative, the third has quadratic friction as a force.  To each Lagrangian a term f(t) x is added
that makes x = 0.2 + 0.5 sin t its exact path: the problem stays nonlinear, and the reference has no error of its own.
For degrees 4 and 6 the errors run into roundoff before the mesh is fine enough for a clean slope (measured: slopes
scatter by 2 around 12 between 1e-8 and 1e-13, whatever the problem).  There the discrete equations are solved on in
60 digits by an implementation of their own, starting from the package's answer, which must already be right to
roundoff.
"""

from functools import cache

import casadi as ca
import mpmath
import numpy as np
import pytest
from motions import quartic, varying_mass
from rules import FAMILIES, OF_DEGREE, polynomial
from slow import slow

import casadi_galerkin as cg

BAND = 0.2
PLATEAU = 1e-12  # errors below are masked; roundoff was measured at 1e-14 in x and 5e-14 in p
POLISH = 1e-13  # how far the package's answer may be from the discrete equations' in 60 digits; momenta eps |x|/h


def quadratic_friction(t, x, v):
    return -(1 + x[0] ** 2) * ca.fabs(v) * v


MOTIONS = {  # force, Lagrangian, duration; the sense of |v| v does not change before π/2
    "varying mass": (None, varying_mass, 5.0),
    "quartic": (None, quartic, 5.0),
    "quadratic friction": (quadratic_friction, quartic, 1.5),
}
# Intervals a unit of time, by degree: past the irregular meshes, and clear of roundoff.
JOINTS = {1: (16, 20, 24), 2: (10, 13, 16), 3: (6, 8, 10)}
BETWEEN = {1: (16, 20, 24), 2: (10, 13, 16), 3: (8, 10, 12)}
RULES = {
    **OF_DEGREE,
    "left_rectangle": lambda m: cg.left_rectangle(),
    "trapezoid": lambda m: cg.trapezoid(),
    "midpoint": lambda m: cg.midpoint(),
}
DEGREE_ONE = ("left_rectangle", "trapezoid", "midpoint")
CASES = [
    (m, rule)
    for m in range(1, 4)
    for rule in RULES
    if not (rule == "lobatto(m)" and m < 2) and not (rule in DEGREE_ONE and m > 1)
]


def expected(m, rule):
    """Order at the joints, of the position between them, of the velocity."""
    r = RULES[rule](m)
    joints = min(2 * m, r.order)
    # Lobatto(m) cannot see the node polynomial of its own m points: the path is one of degree m - 1, as measured.
    inner = m if rule == "lobatto(m)" else m + 1
    return joints, min(joints, inner), inner - 1


def driven(lagrangian, force):
    """The Lagrangian with x = 0.2 + 0.5 sin t made an exact path, and that path with its velocity and momentum."""
    t, x, v = ca.SX.sym("t"), ca.SX.sym("x", 1), ca.SX.sym("v", 1)
    path = 0.2 + 0.5 * ca.sin(t)
    velocity = ca.jacobian(path, t)
    value = lagrangian(t, x, v)
    momentum = ca.gradient(value, v)
    rate = ca.jacobian(momentum, v) * ca.jacobian(velocity, t) + ca.jacobian(momentum, x) * velocity
    friction = ca.SX(0) if force is None else force(t, x, v)
    drive, p = ca.substitute([rate - ca.gradient(value, x) - friction, momentum], [x, v], [path, velocity])
    f = ca.Function("drive", [t], [drive])
    return lambda t, x, v: lagrangian(t, x, v) + f(t) * x[0], ca.Function("exact", [t], [path, velocity, p])


@cache
def motion(name):
    """The problem of a motion, its exact path, and a thousand times with that path there."""
    force, lagrangian, T = MOTIONS[name]
    full, exact = driven(lagrangian, force)
    start, end = float(exact(0)[0]), float(exact(T)[0])
    t = np.linspace(0, T, 1001)
    return cg.BoundaryProblem(full, (0, T), [start], [end], force=force), exact, t, np.array(exact(t[None, :])[:2])


@cache  # joints and the times between them are looked at in two tests, on meshes that are mostly the same
def errors(name, m, rule, intervals):
    """Root mean squares at the joints (x and p together), of x and of v between them."""
    problem, exact, t, (xs, vs) = motion(name)
    path = cg.solve(problem, cg.Galerkin(m, quadrature=RULES[rule](m)), intervals, guess=(t, xs))
    x, _, p = (np.array(values) for values in exact(path.t[None, :]))
    mean = lambda *parts: np.sqrt(sum(np.mean(part**2) for part in parts))  # noqa: E731
    return mean(path.x - x, path.momentum - p), mean(path(t) - xs), mean(path(t, 1) - vs)


def slopes(name, m, rule, densities):
    """Slopes of the three errors over three meshes, NaN for an error that reaches the plateau."""
    steps = [round(density * MOTIONS[name][2]) for density in densities]
    table = np.array([errors(name, m, rule, n) for n in steps])
    table[:, np.any(table < PLATEAU, axis=0)] = np.nan
    return -np.polyfit(np.log(steps), np.log(table), 1)[0]


WITH_FRICTION = [("quadratic friction", *case) for case in CASES]


@pytest.mark.parametrize(
    ("name", "m", "rule"),
    [("varying mass", *case) for case in CASES] + WITH_FRICTION[:2] + slow(*WITH_FRICTION[2:]),
)
def test_order_at_the_joints_is_the_smaller_of_twice_the_degree_and_the_rules(name, m, rule):
    order = expected(m, rule)[0]
    assert cg.Galerkin(m, quadrature=RULES[rule](m)).order == order
    assert abs(slopes(name, m, rule, JOINTS[m])[0] - order) <= BAND


@pytest.mark.parametrize(
    ("name", "m", "rule"), [("varying mass", *case) for case in CASES] + [("quartic", 1, rule) for rule in DEGREE_ONE]
)
def test_order_between_the_joints(name, m, rule):
    _, order, order_of_velocity = expected(m, rule)
    if order == 1 and name != "varying mass":
        order = 2  # where L is a sum of functions of x and of v, one-sided rules give the trapezoid's path
    _, position, velocity = slopes(name, m, rule, BETWEEN[m])
    assert abs(position - order) <= BAND
    assert abs(velocity - order_of_velocity) <= BAND


SIMPSON_THREE_EIGHTHS = cg.Quadrature([0, 1 / 3, 2 / 3, 1], [1 / 8, 3 / 8, 3 / 8, 1 / 8])
BOOLE = cg.Quadrature([0, 1 / 4, 1 / 2, 3 / 4, 1], [7 / 90, 32 / 90, 12 / 90, 32 / 90, 7 / 90])


@pytest.mark.parametrize(
    ("m", "rule", "orders"), [(4, SIMPSON_THREE_EIGHTHS, (2, 2, 1)), (5, BOOLE, (4, 3, 2)), (4, BOOLE, (6, 4, 3))]
)
def test_a_rule_of_low_order_for_its_points_costs_more_than_its_own_order(m, rule, orders):
    """Orders at the joints, of the position and of the velocity between them: a rule of order u < 2m - 2 loses most."""
    u = rule.order
    assert orders == (min(2 * m, u, 2 * (u - m + 1)), min(m + 1, u, u - m + 2), min(m, u - m + 1))
    assert cg.Galerkin(m, quadrature=rule).order == orders[0]
    problem, exact, t, (xs, vs) = motion("quartic")
    counts, found = (16, 20, 24), []
    for n in counts:
        path = cg.solve(problem, cg.Galerkin(m, quadrature=rule), n)
        at_joints = path.x - np.array(exact(path.t[None, :])[0])
        found.append([np.sqrt(np.mean(e**2)) for e in (at_joints, path(t) - xs, path(t, 1) - vs)])
    assert np.min(found) > PLATEAU
    slopes = -np.polyfit(np.log(counts), np.log(found), 1)[0]
    np.testing.assert_allclose(slopes, orders, rtol=0, atol=BAND)


# Degrees 4 and 6, in 60 digits

DIGITS = 60
SPAN, FIRST, LAST = 0.02, 0.5, 0.513  # so short that the leading error term is all there is
HALVES = 2  # intervals of the reference
INSIDE = (0.13, 0.38, 0.61, 0.9)  # where errors between the joints are measured, as parts of an interval
PARTIALS = {  # x, v -> F + L_x and L_v, by hand, v > 0
    "varying mass": lambda x, v: (x * v**2 - x - x**3, (1 + x**2) * v),
    "quadratic friction": lambda x, v: (-mpmath.sin(x) - (1 + x**2) * v**2, v + v**3 / 3),
}
TURNS, CONVERGED = 4, 1e-40  # of iterative refinement with the package's Hessian, each by twelve digits; the last step


@cache
def exact_rule(family, n):
    """Points and weights of `family`(n) on [0, 1] in `DIGITS` digits, which every caller works in."""
    function, weight = polynomial(family, n)
    answer = []
    for q, w in zip(FAMILIES[family][0](n).points, FAMILIES[family][0](n).weights, strict=True):
        if q in (0, 1):
            end = mpmath.mpf(1) / (n * (n - 1)) if family == "lobatto" else mpmath.mpf(1) / n**2
            assert abs(end - w) < 1e-14
            answer.append((mpmath.mpf(q), end))
        else:
            x = 2 * mpmath.mpf(q) - 1
            root = mpmath.findroot(function, (x, x + mpmath.mpf(10) ** -12))
            answer.append(((1 + root) / 2, weight(root)))
    return answer


@cache
def nodes_of(m):
    return [mpmath.mpf(c) for c in (0, *cg.Galerkin(m).control_points, 1)]


@cache
def basis(m, s):
    """l_j(s) and l_j'(s) by the product formula."""
    nodes, values, derivatives = nodes_of(m), [], []
    for j, node in enumerate(nodes):
        others = [o for k, o in enumerate(nodes) if k != j]
        scale = mpmath.fprod(node - o for o in others)
        values.append(mpmath.fprod(s - o for o in others) / scale)
        rest = (mpmath.fprod(s - o for i, o in enumerate(others) if i != k) for k in range(len(others)))
        derivatives.append(mpmath.fsum(rest) / scale)
    return values, derivatives


class Polished:
    """The discrete equations of one case solved in `DIGITS` digits from the package's answer."""

    def __init__(self, name, m, family, n, intervals):
        method = cg.Galerkin(m, quadrature=FAMILIES[family][0](n))
        force, lagrangian, _ = MOTIONS[name]
        problem = cg.BoundaryProblem(lagrangian, (0, SPAN), [FIRST], [LAST], force=force)
        graph = cg.transcribe(problem, method, intervals)
        path = graph.solve()
        values = path.polynomial.values[0]
        hessian = np.array(graph.hessian(values[1:-1], [FIRST], [LAST], path.t))
        self.m, self.h, self.partials = m, mpmath.mpf(SPAN) / intervals, PARTIALS[name]
        self.points = [(w, *basis(m, q)) for q, w in exact_rule(family, n)]
        self.x = [mpmath.mpf(value) for value in values]
        for turn in range(TURNS):
            gradient = self.equations()
            step = np.linalg.solve(hessian, -np.array(gradient[1:-1], dtype=float))
            if turn == 0:
                self.first_correction = np.max(np.abs(step))
                self.momentum_error = abs(-gradient[0] - mpmath.mpf(float(path.momentum[0, 0])))
            self.x[1:-1] = [value + mpmath.mpf(change) for value, change in zip(self.x[1:-1], step, strict=True)]
        assert np.max(np.abs(step)) < CONVERGED
        self.momentum = -self.equations()[0]

    def equations(self):
        """The left-hand sides, of which the first is that of the start."""
        size, m, h = len(self.x), self.m, self.h
        gradient = [mpmath.mpf(0)] * size
        for i in range(0, size - 1, m):
            for w, value, derivative in self.points:
                x = mpmath.fdot(value, self.x[i : i + m + 1])
                v = mpmath.fdot(derivative, self.x[i : i + m + 1]) / h
                fx, Lv = self.partials(x, v)
                for a in range(m + 1):
                    gradient[i + a] += w * (h * fx * value[a] + Lv * derivative[a])
        return gradient

    def at(self, interval, part):
        """x and v at a part of an interval."""
        values, derivatives = basis(self.m, part)
        local = self.x[interval * self.m : (interval + 1) * self.m + 1]
        return mpmath.fdot(values, local), mpmath.fdot(derivatives, local) / self.h


@pytest.fixture(scope="module")
def references():
    with mpmath.workdps(DIGITS):
        return {name: Polished(name, 12, "gauss", 12, HALVES) for name in PARTIALS}


HIGH = [
    (m, rule, family, m + more)
    for m in (4, 6)
    for rule, family, more in (
        ("gauss(m)", "gauss", 0),
        ("gauss(m+1)", "gauss", 1),
        ("lobatto(m)", "lobatto", 0),
        ("lobatto(m+1)", "lobatto", 1),
        ("radau(m)", "radau", 0),
    )
]


@pytest.mark.parametrize(
    ("name", "m", "rule", "family", "n"),
    [("varying mass", *HIGH[0]), *slow(*((name, *case) for name in PARTIALS for case in HIGH))[1:]],
)
@pytest.mark.slow
def test_orders_of_high_degree(references, name, m, rule, family, n):
    steps, rows = (1, 2, 3), []
    with mpmath.workdps(DIGITS):
        reference = references[name]
        for intervals in steps:
            path = Polished(name, m, family, n, intervals)
            assert path.first_correction < POLISH
            assert path.momentum_error < POLISH
            places = [
                (k, part, (k + part) / intervals * HALVES) for k in range(intervals) for part in map(mpmath.mpf, INSIDE)
            ]
            off = [(path.at(k, part), reference.at(int(half), half % 1)) for k, part, half in places]
            between = [max(abs(a[k] - b[k]) for a, b in off) for k in (0, 1)]
            rows.append([float(mpmath.log(e)) for e in (abs(path.momentum - reference.momentum), *between)])
    got = -np.polyfit(np.log(steps), rows, 1)[0]
    np.testing.assert_allclose(got, expected(m, rule), rtol=0, atol=BAND)
