"""What was it that this motion was best for?  The cost of an observed motion, by an optimizer around an optimizer.

A mass is pushed from rest to rest, at the least ∫ (u² + w x²)/2 dt: the larger the weight w, the later it leaves the
origin.  Of the motion some positions are known, and w is asked for.  For each w the motion is an optimal path, so that
the distance from the observed one is a Function of w with a solve inside (`cg.solution_function`); IPOPT brings it to
zero by its exact gradient.

The observed motion is the exact one, x'''' = -w x, from its four characteristic roots.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

WEIGHT, DURATION = 300.0, 1.0  # in 1/s⁴, and s
METHOD, INTERVALS = cg.Galerkin(degree=6), 8


def observed(t, weight=WEIGHT):
    """The exact motion from 0 to 1, both at rest."""
    roots = weight**0.25 * np.exp(1j * np.pi * np.array([1, 3, 5, 7]) / 4)
    at = np.multiply.outer(np.atleast_1d([0.0, 0.0, DURATION, DURATION]), roots)
    conditions = np.exp(at) * np.array([np.ones(4), roots, np.ones(4), roots])
    amplitudes = np.linalg.solve(conditions, [0, 0, 1, 0])
    return (np.exp(np.multiply.outer(t, roots)) @ amplitudes).real


def pushed():
    """The motion that is best for a weight."""
    return cg.ControlProblem(
        lambda t, x, v, p: v[0] ** 2 / 2,
        t_span=(0.0, DURATION),
        start=[0.0],
        end=[1.0],
        start_velocity=[0.0],
        end_velocity=[0.0],
        force=lambda t, x, v, u, p: u,
        running_cost=lambda t, x, v, u, p: (u[0] ** 2 + p[0] * x[0] ** 2) / 2,
        controls=1,
        parameters=[1.0],
    )


def main():
    """Find the weight from the observed positions; returns it with the path that is best for it."""
    problem = pushed()
    first = cg.solve(problem, METHOD, INTERVALS)
    best = cg.solution_function(problem, METHOD, INTERVALS)
    weight = ca.MX.sym("weight")
    given = {name: getattr(problem, name) for name in ("start", "end", "start_velocity", "end_velocity")}
    guess = {"guess": first.polynomial.values, "controls": first.control.values}
    path = best(**given, **guess, parameters=100 * weight)["x"]  # the unknown is of order one
    distance = ca.sumsqr(path - ca.DM(observed(first.t)).T)
    quiet = {"hessian_approximation": "limited-memory", "print_level": 0, "sb": "yes", "tol": 1e-14}
    options = {"print_time": False, "ipopt": quiet}
    fitted = ca.nlpsol("fitted", "ipopt", {"x": weight, "f": 1e4 * distance}, options)(x0=1.0, lbx=0)
    found = 100 * float(fitted["x"])
    return found, cg.solve(problem.varied({"parameters": [found]}), METHOD, INTERVALS, guess=first)


def draw(found):
    """Draw the observed positions and the motion of the fitted cost; returns the figure."""
    weight, path = found
    axes = cg.panels()
    path.plot(axes, labels=["position in m"], time="t in s")
    axes.plot(path.t, observed(path.t), "o", fillstyle="none", label="observed")
    axes.set_title(f"A motion that was best for the weight {weight:.4f}/s⁴")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    by = cg.sensitivity(answer[1])
    print(answer[1])
    print(f"  weight      {answer[0]:.8f}/s⁴ fitted, {WEIGHT:g} observed")
    print(f"  derivative  {by.x['parameters'][0, 4, 0]:.6e} of the position at half time by the weight")
    draw(answer).savefig("inverse_optimal_control.png")
