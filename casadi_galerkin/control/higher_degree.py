"""The second solve of an error estimate: the same mesh with a higher degree, from a perturbed copy of the path.

Without the perturbation, the solver would stop at the first path wherever a change of the path hardly changes the cost,
and the two would not differ.  From the perturbed path it returns to an isolated optimum, but not where many paths cost
the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import gauss, lobatto
from casadi_galerkin.problems.problem import map_times, section_times
from casadi_galerkin.solution.control_path import ControlPath
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import waves
from casadi_galerkin.solvers.solver import Solver

HIGHER = 2  # degrees added for the error estimate; one adds nothing to a path of the other parity
WARM_START_BARRIER = 1e-4  # first barrier from an earlier path: with 1e-2 a robot arm left its path, and found none


def raised(method: Galerkin) -> Galerkin:
    """The method with `HIGHER` more degrees and quadrature points: Lobatto's where this has one at 0, else Gauss's."""
    rule = lobatto if method.quadrature.points[0] == 0 else gauss
    return Galerkin(method.degree + HIGHER, quadrature=rule(len(method.quadrature) + HIGHER))


def from_near(solver: Solver, **others: float) -> Solver:
    """The solver from an earlier path, with other options where it has none of its own."""
    return replace(solver, options={"mu_init": WARM_START_BARRIER, **others, **solver.options})


def perturbed(path: ControlTrajectory, by: float) -> ControlTrajectory:
    """A path plus a random smooth function of this part of its size; a free duration is longer by the same part."""
    before, problem, ends = path.polynomial, path.problem, path.t[[0, -1]]
    longer = ends + np.array([0.0, 0.0 if problem.duration_bounds is None else by]) * np.ptp(ends)
    mesh, times = (map_times(own, ends, longer) for own in (path.t, np.array(section_times(problem))))
    sizes = by * np.max(np.abs(before.values), axis=1)
    parts = (before.node_times - ends[0]) / np.ptp(ends)
    change = waves(np.random.default_rng(0), sizes)(parts)
    arrivals = None if before.arrivals is None else before.arrivals + change[:, before.degree :: before.degree]
    first, *breakpoints, last = times.tolist()
    return replace(
        path,
        polynomial=PiecewisePolynomial(mesh, before.nodes, before.values + change, arrivals),
        control=ControlPath(mesh, path.control.points, path.control.values, path.control.rule),
        problem=problem.found((first, last), path.parameters, tuple(breakpoints)),
    )
