"""Violations of the constraints at the point where the solver stopped."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.calculus.roundoff import largest_of, or_one
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.control.graph import Report
from casadi_galerkin.control.optimizer import Optimum
from casadi_galerkin.control.program_bounds import ProgramBounds
from casadi_galerkin.problems.bounds import bound_excess
from casadi_galerkin.problems.control_problem import ControlProblem

ZERO_TERMS = 1e-20  # terms below which a component counts as zero; the solvers' tolerances are absolute
# Least size of the terms of a rate, where its component is given as one or not at all: residuals of some roundings are
# accepted.  The solver leaves as much where a control is zero but for its tolerance, as where nothing is spent.
LEAST_RATE = 1e-7
VANISHED = 1e-13  # terms of a component over those along the guess below which they are roundoff


def equation_scales(
    problem: ControlProblem, chain: Chain, bounds: ProgramBounds, report: Report, before: np.ndarray
) -> np.ndarray:
    """Sizes relative to which the residuals of the equations are measured.

    For the equations of motion of a component it is the largest sum of the sizes of the terms of one of them along the
    path.  Where the component has vanished, these terms are roundoff, and it is the sum along the guess (`before`, by
    kind).  For a path constraint or an end condition g it is |∇g||z|, or its finite bound if that is larger.
    """
    sizes = np.where(report.sizes <= VANISHED * before, before, report.sizes)
    stated = largest_of(_bound_sizes(bounds.equations), chain.kinds)
    sizes = or_one(np.fmax(np.where(sizes > ZERO_TERMS, sizes, 0.0), stated))
    if len(chain.rated):
        least = LEAST_RATE * np.minimum(or_one(given_sizes(problem)), 1.0)
        sizes[chain.rated] = np.maximum(sizes[chain.rated], least)
    return sizes[chain.kinds]


def given_sizes(problem: ControlProblem) -> np.ndarray:
    """Largest given end and finite bound of every component that follows a rate; zero where there is none."""
    given = np.nan_to_num(np.vstack((problem.given_positions, np.array(problem.position_bounds))), posinf=0, neginf=0)
    return np.max(np.abs(given), axis=0)[problem.mechanical :]


def violations(
    problem: ControlProblem, chain: Chain, optimum: Optimum, report: Report, before: np.ndarray
) -> np.ndarray:
    """Violation of every equation, then of every unknown's bounds, relative to what is compared.

    A value outside its bounds is compared with the largest of its kind, not with itself: where an equation and a bound
    leave a single value, IPOPT moves the bound by rounding, and a value that should be zero is then as large as this
    shift.  Where all values of a kind are nearly zero, they are compared with their bounds.
    """
    bounds, unknowns = optimum.bounds, optimum.unknowns
    excess = _excess(report.equations, *bounds.equations)
    outside = _excess(unknowns, *bounds.unknowns)
    kinds = chain.unknown_kinds
    sizes, stated = largest_of(np.abs(unknowns), kinds), largest_of(_bound_sizes(bounds.unknowns), kinds)
    sizes = np.where(sizes > ZERO_TERMS, sizes, stated)[kinds]
    return np.concatenate((excess / equation_scales(problem, chain, bounds, report, before), outside / or_one(sizes)))


def _bound_sizes(sides: np.ndarray) -> np.ndarray:
    """Larger sizes of the finite ones of lower and upper bounds (2, n); zero where there is none."""
    return np.max(np.where(np.isfinite(sides), np.abs(sides), 0.0), axis=0)


def _excess(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distances of values from their bounds; infinite where the values are not finite."""
    return np.where(np.isfinite(values), bound_excess(values, low, high), np.inf)
