"""A type checker knows which answer belongs to which problem; mypy tells an ignored error that is none, too."""

import casadi_galerkin as cg


def optimized(problem: cg.ControlProblem) -> float:
    return cg.solve(problem, cg.Galerkin(3), 4).cost


def optimized_often(problem: cg.ControlProblem) -> float:
    return cg.transcribe(problem, cg.Galerkin(3), 4).solve(start=[0.1], guess=(lambda t: [t], lambda t: [0.0])).cost


def warm(problem: cg.ControlProblem, last: cg.ControlTrajectory) -> cg.ControlTrajectory:
    return cg.solve(problem, cg.Galerkin(3), 4, guess=last)


def found(problem: cg.BoundaryProblem) -> float:
    return cg.solve(problem, cg.Galerkin(3), 4).action


def stepped(problem: cg.InitialProblem) -> float:
    return cg.solve(problem, cg.Galerkin(3), 4).action


def with_options(problem: cg.BoundaryProblem) -> cg.Trajectory:
    return cg.solve(problem, tol=1e-6, solver=cg.newton.with_options(max_iter=9))


def refused(boundary: cg.BoundaryProblem, initial: cg.InitialProblem) -> list[float]:
    return [
        cg.solve(boundary, cg.Galerkin(3), 4).cost,  # type: ignore[attr-defined]
        cg.transcribe(boundary, cg.Galerkin(3), 4).solve().cost,  # type: ignore[attr-defined]
        cg.solve(initial, cg.Galerkin(3), 4).cost,  # type: ignore[attr-defined]
        cg.solve("problem", cg.Galerkin(3), 4).action,  # type: ignore[call-overload]
    ]
