"""Initial problems: the start from position and momentum or velocity, and the path from the rolled steps."""

from __future__ import annotations

import time

import casadi as ca
import numpy as np

from casadi_galerkin.calculus import Galerkin, PiecewisePolynomial
from casadi_galerkin.engines import EPS, ROUNDOFF
from casadi_galerkin.problems import InitialProblem
from casadi_galerkin.stepping import Roll, Stepper, with_parameters
from casadi_galerkin.trajectory import ConvergenceError, Trajectory

DEGENERATE = 1e-13  # reciprocal condition of the scaled mass matrix below which no velocity belongs to a momentum
LEGENDRE_ITERATIONS = 100


def integrate(problem: InitialProblem, method: Galerkin, mesh: np.ndarray, verbose: int = 0) -> Trajectory:
    """Solve an initial problem step by step.

    Parameters
    ----------
    problem : InitialProblem
    method : Galerkin
    mesh : (N + 1,) joints
    verbose : 1 prints a summary

    Raises
    ------
    ConvergenceError
        naming the first step whose equations were not solved, and its time
    ValueError
        for a degenerate Lagrangian
    """
    if not isinstance(method, Galerkin):
        raise TypeError(f"method must be a Galerkin, such as Galerkin(degree=4), got {method!r}")
    began = time.perf_counter()
    p, v = start_state(problem)
    force = None if problem.force is None else with_parameters(problem.force, problem.parameters)
    stepper = Stepper(with_parameters(problem.lagrangian, problem.parameters), force, method)
    roll = verified(stepper.roll(np.array(problem.position), p, v, mesh), stepper)
    build = stepper.build_seconds
    path = trajectory(
        problem, stepper, roll, int(roll.iterations.sum()), "steps", build, time.perf_counter() - began - build
    )
    if verbose:
        print(path)
    return path
