"""Geometry of a path: energy, momentum maps, and the Jacobians of its steps as maps of (x, p).

Without forces each step is symplectic, AᵀΩA = Ω with Ω = [0 1; -1 0], whatever its length, so det A = 1.  A symmetry
x -> x + ε ξ(x) of L and of the constraint conserves its momentum map p·ξ(x) (E. Noether) where ξ is affine, as of
translations and of rotations in Cartesian coordinates: only then it takes a path of degree m to another.  The momentum
map of any other symmetry varies by the method's order.  A force F with F·ξ = 0 changes neither.  Energy is not
conserved but, at fixed step lengths, stays within a band of the method's order.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_galerkin.calculus.roundoff import component_sizes
from casadi_galerkin.functional.pointwise import at_places
from casadi_galerkin.problems.callables import Traceable, trace
from casadi_galerkin.problems.constrained_motion import motion_of, tangents
from casadi_galerkin.problems.problem import Problem
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.guess import check_finite_values
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.stepping.initial_value import started
from casadi_galerkin.stepping.stepper import Stepper


@dataclass(frozen=True, repr=False, eq=False)
class Geometry:
    """What a path conserves.

    Attributes
    ----------
    energy_error : largest difference of the energy from its value at the start
    energy_drift : change of the energy over the whole path along its least-squares line
    momentum_map : (N + 1,), p·ξ(x) - E τ(t) at the joints; of an optimal path that of its cost, (N,), the mean over
        each interval; None if no symmetry was given
    symmetry_defect : largest change of L, or of an optimal path's I, by the symmetry along the path, over its terms;
        zero but for rounding where they have it; None if no symmetry was given
    jacobians : (N, 2d, 2d), ∂(x_{i+1}, p_{i+1})/∂(x_i, p_i); under k constraints (N, 2(d - k), 2(d - k)), of the
        components along the tangents
    unit : largest position over the largest momentum, the unit of positions over momenta for `symplecticity_defects`

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> gravity = lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x)
    >>> orbit = cg.solve(cg.InitialProblem(gravity, (0, 10), [1.0, 0.0], velocity=[0.0, 1.1]), cg.Galerkin(4), 40)
    >>> kept = cg.geometry(orbit)
    >>> kept.determinants.round(9).min().tolist(), bool(kept.symplecticity_defects.max() < 1e-13)
    (1.0, True)
    """

    energy_error: float
    energy_drift: float
    momentum_map: np.ndarray | None
    symmetry_defect: float | None
    jacobians: np.ndarray
    unit: float

    @property
    def determinants(self) -> np.ndarray:
        """Determinants of the steps' Jacobians, (N,); without forces they are 1."""
        return np.linalg.det(self.jacobians)

    @property
    def symplecticity_defects(self) -> np.ndarray:
        """Largest entry of AᵀΩA - Ω for the Jacobian A of each step, measured by `unit`, (N,); without forces 0."""
        d = self.jacobians.shape[1] // 2
        sizes = np.repeat(np.sqrt([self.unit, 1 / self.unit]), d)
        omega = np.block([[np.zeros((d, d)), np.eye(d)], [-np.eye(d), np.zeros((d, d))]])
        defect = self.jacobians.transpose(0, 2, 1) @ omega @ self.jacobians - omega
        return np.max(np.abs(defect) * np.outer(sizes, sizes), axis=(1, 2))

    def __repr__(self) -> str:
        """Summarize in a few lines."""
        determinant = self.determinants[np.argmax(np.abs(self.determinants - 1))]
        lines = [
            f"energy         error up to {self.energy_error:.1e}, drift {self.energy_drift:.1e} over the path",
            f"symplecticity  defect up to {np.max(self.symplecticity_defects):.1e}, determinant {determinant:.15g}",
        ]
        if self.momentum_map is not None:
            spread = np.ptp(self.momentum_map)
            lines.append(f"momentum map   {self.momentum_map[0]:.15g} at the start, varies by {spread:.1e}")
            lines.append(f"symmetry       changes L dt by {self.symmetry_defect:.1e} of its terms")
        return "\n".join(lines)


def geometry(path: Trajectory, symmetry: Traceable | tuple[Traceable, Traceable] | None = None) -> Geometry:
    """Measure what a path conserves.

    Parameters
    ----------
    path : Trajectory of any problem, solved globally or stepwise; of a ControlProblem energy and Jacobians are those of
        its motion under the controls found
    symmetry : callable x -> (d,), the generator ξ(x) = dx/dε of a symmetry, such as ``lambda x: [-x[1], x[0]]`` of
        rotations in the plane.  Its momentum map is kept to roundoff if ξ is affine, else to the method's order.  Or a
        pair (ξ, τ), with a callable t -> τ = dt/dε, if times are moved as well, as by a scaling

    Returns
    -------
    Geometry: errors of the energy, the momentum map, whether L has the symmetry, and the Jacobians of the steps

    Raises
    ------
    TypeError, ValueError
        for a symmetry that does not return d finite components, for one of times or of rates and an optimal path, and
        where `ControlTrajectory.replay` does

    Examples
    --------
    >>> import casadi as ca
    >>> import casadi_galerkin as cg
    >>> gravity = lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x)
    >>> orbit = cg.solve(cg.InitialProblem(gravity, (0, 10), [1.0, 0.0], velocity=[0.0, 1.1]), cg.Galerkin(4), 40)
    >>> kept = cg.geometry(orbit, symmetry=lambda x: [-x[1], x[0]])  # of rotations: x × p
    >>> float(kept.momentum_map[0].round(9)), bool(np.ptp(kept.momentum_map) < 1e-13), kept.symmetry_defect < 1e-14
    (1.1, True, True)
    """
    if not isinstance(path, Trajectory):
        raise TypeError(f"geometry takes a Trajectory, got {type(path).__name__}")
    momentum = defect = None
    if symmetry is not None:
        momentum, defect = _conserved(path, *_generators(path, symmetry))
    duration = path.t[-1] - path.t[0]
    error = path.energy - path.energy[0]
    drift = np.polyfit((path.t - path.t[0]) / duration, error, 1)[0]
    problem: Problem = path.problem
    if isinstance(path, ControlTrajectory):
        problem = started(path, path.replay())
    steps, motion = jacobians(path, problem), motion_of(path.problem)
    if motion is not None:
        bases = [np.kron(np.eye(2), tangents(motion, *at)) for at in zip(path.t, path.x.T, strict=True)]
        steps = np.stack([later.T @ step @ basis for later, step, basis in zip(bases[1:], steps, bases, strict=False)])
    x, p = (component_sizes(a.reshape(1, -1))[0] for a in (path.x, path.momentum))
    return Geometry(float(np.max(np.abs(error))), float(drift), momentum, defect, steps, float(x / p))


def _generators(path: Trajectory, symmetry: Traceable | tuple[Traceable, Traceable]) -> tuple[ca.Function, ca.Function]:
    """ξ(x) and τ(t) of a symmetry; refuses what is not finite on the path."""
    of_x, of_t = symmetry if isinstance(symmetry, tuple) else (symmetry, lambda t: 0.0 * t)
    generator, times = trace("symmetry", of_x, {"x": len(path.x)}, len(path.x)), trace("symmetry", of_t, {"t": 1}, 1)
    for function, at in ((generator, path.x), (times, path.t[None, :])):
        check_finite_values("what symmetry returns", at_places(function, at)[0], path.t)
    return generator, times


def _conserved(path: Trajectory, generator: ca.Function, times: ca.Function) -> tuple[np.ndarray, float]:
    """The momentum map of a symmetry, and by what part of its terms it changes L dt, or I dt of an optimal path."""
    rule = path.method.quadrature
    points, controlled = np.array(rule.points), isinstance(path, ControlTrajectory)
    if isinstance(path, ControlTrajectory):
        if path.problem.mechanical < len(path.x) or not np.all(at_places(times, path.t[None, :])[0] == 0):
            raise ValueError("a symmetry of an optimal path moves neither times nor components that follow rates")
        function, at = path.between_points.integrand, path.between_points.along(points)
    else:
        function, at = path.motion.numeric.lagrangian, list(path.polynomial.sampled(points))
    t, x, v, *others = symbols = function.sx_in()
    value, direction, shift = function(*symbols)[0], generator(x), times(t)
    stretch, forced = ca.jacobian(shift, t), 0.0
    if not controlled and path.problem.numeric.force is not None:
        forced = ca.dot(path.problem.numeric.force(t, x, v), direction)
    moves = [(x, direction), (v, ca.jtimes(direction, x, v) - v * stretch), (t, shift)]
    kept = ca.dot(ca.gradient(value, v), direction)
    if controlled:
        costate, rate = others[1:3]
        pushed = ca.jtimes(direction, x, costate)
        further = ca.jtimes(pushed, ca.vertcat(x, costate), ca.vertcat(v, rate))
        moves += [(costate, pushed), (rate, further)]
        kept += ca.dot(ca.gradient(value, rate), pushed)
    changes = ca.vertcat(*(ca.gradient(value, symbol) * move for symbol, move in moves), value * stretch, forced)
    terms = ca.vertcat(ca.sum1(changes), ca.norm_1(changes), kept)
    change, size, means = at_places(ca.Function("terms", symbols, [ca.densify(terms)]), *at)[0]
    defect = float(np.max(np.abs(change)) / (np.max(size) or 1.0))
    if controlled:
        return means.reshape(-1, len(rule)) @ np.array(rule.weights), defect
    (directions,), (shifts,) = at_places(generator, path.x), at_places(times, path.t[None, :])
    return np.sum(path.momentum * directions, axis=0) - path.energy * shifts[0], defect


def jacobians(path: Trajectory, problem: Problem) -> np.ndarray:
    """∂(x_{i+1}, p_{i+1})/∂(x_i, p_i) of every interval of a path, (N, 2d, 2d)."""
    stepper = Stepper(problem, path.method)
    slopes = path.polynomial.at_parts(stepper.basis.points)[1]
    s = (slopes * np.diff(path.t)[:, None]).transpose(1, 0, 2)
    return stepper.jacobians(path.t, path.x, path.momentum, stepper.unknowns(path.t, path.x, path.momentum, s))
