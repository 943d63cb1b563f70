"""Length and damping of a pendulum from noisy measurements of its angle: a boundary solve inside IPOPT.

The Lagrangian of a damped motion carries the factor e^{ct}.  The boundary problem is one CasADi Function of ends and
parameters, so the least-squares problem is a graph around it, with exact derivatives of first and second order.  Both
ends of the path are unknown too: they are measured no better than the rest.  How sure the fit is follows from the
sensitivities of the fitted path.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

GRAVITY = 9.81  # m/s²
DURATION, INTERVALS = 1.5, 30  # s; one measurement a joint, 20 a second
NOISE, SEED = 0.02, 0  # rad, standard deviation of a measurement
TRUE = np.array([1.1, -0.35, 0.8, 0.4])  # angles at both ends in rad, length in m, damping rate in 1/s
FIRST = np.array([1.0, 0.0])  # first guess of length and damping
NAMES, UNITS = ("start", "end", "length", "damping"), ("rad", "rad", "m", "1/s")


def lagrangian(t, x, v, p):
    """Kinetic minus potential energy for unit mass, grown at the damping rate; p holds length and damping."""
    length, damping = p[0], p[1]
    return ca.exp(damping * t) * (length**2 * v[0] ** 2 / 2 + GRAVITY * length * ca.cos(x[0]))


def swing(values):
    """The boundary problem for the ends, length and damping given."""
    return cg.BoundaryProblem(lagrangian, (0.0, DURATION), values[:1], values[1:2], parameters=values[2:])


def measured(seed):
    """Angles at the joints with seeded noise, in rad; (N + 1,)."""
    exact = cg.solve(swing(TRUE), tol=1e-10, guess=lambda t: [1.1 * np.cos(3 * t)])
    times = np.linspace(0, DURATION, INTERVALS + 1)
    return exact(times)[0] + np.random.default_rng(seed).normal(0.0, NOISE, INTERVALS + 1)


def main(seed=SEED):
    """Fit; returns the estimates, their covariance (in the order of `NAMES`), the measurements and the fitted path."""
    angles, method = measured(seed), cg.Galerkin(degree=4)
    problem = swing([angles[0], angles[-1], *FIRST])
    first = cg.solve(problem, method, INTERVALS, guess=angles[None, :])
    path = cg.solution_function(problem, method, INTERVALS, guess=first)
    z = ca.MX.sym("z", 4)
    x = path(start=z[0], end=z[1], parameters=z[2:], guess=first.polynomial.values)["x"]
    residual = (x.T - angles) / NOISE
    nlp = {"x": z, "f": ca.sumsqr(residual) / 2}
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    fit = ca.nlpsol("fit", "ipopt", nlp, quiet)
    answer = fit(x0=[angles[0], angles[-1], *FIRST])
    if not fit.stats()["success"]:
        raise RuntimeError(f"IPOPT stopped with {fit.stats()['return_status']}")
    estimate = np.array(answer["x"]).ravel()
    fitted = cg.solve(swing(estimate), method, INTERVALS, guess=first)
    by = cg.sensitivity(fitted)
    slope = np.hstack([by.x[name][0] for name in ("start", "end", "parameters")]) / NOISE
    return estimate, np.linalg.inv(slope.T @ slope), angles, fitted


def draw(answer):
    """Draw measurements, the fitted path and the true one; returns the figure."""
    _, _, angles, path = answer
    axes, times = cg.panels(), np.linspace(0, DURATION, 300)
    true = cg.solve(swing(TRUE), path.method, INTERVALS, guess=path)
    axes.errorbar(path.t, angles, NOISE, fmt=".", color="0.5", label="measured")
    axes.plot(times, path(times)[0], label="fitted")
    axes.plot(times, true(times)[0], "--", label="true")
    axes.set(title="Length and damping from measured angles", xlabel="t in s", ylabel="angle in rad")
    axes.legend(fontsize="small")
    return axes.figure


if __name__ == "__main__":
    answer = estimate, covariance, _, _ = main()
    for name, unit, value, true, error in zip(NAMES, UNITS, estimate, TRUE, np.sqrt(np.diag(covariance)), strict=True):
        print(f"{name:8} {value:8.4f} ± {error:.4f} {unit:4} true {true:g}")
    draw(answer).savefig("fit_pendulum.png")
