"""What the prompt shows of every public object is short, and says what it is."""

from inspect import isclass

import casadi as ca
import numpy as np
import pytest
from constrained import on_sphere, spatial, unit_length
from control_problems import cart_pole, double_integrator, everything
from scenes import BY_NAME, bratu, bratu_problem, kepler, pendulum

import casadi_galerkin as cg

LINES, CHARACTERS = 12, 900
METHOD = cg.Galerkin(4)


def chain(masses=14):
    """Masses on springs."""
    return cg.BoundaryProblem(
        lambda t, x, v: ca.sumsqr(v) / 2 - ca.sumsqr(x[1:] - x[:-1]) / 2, (0, 1), [0.1] * masses, [1.1] * masses
    )


def falling():
    return cg.InitialProblem(kepler(1.0), (0.0, 20.0), [1.0, 0.0], velocity=[0.0, 1.1])


def steps():
    return cg.solve(falling(), METHOD, 100)


def phases():
    """A cart that bounces."""
    first = double_integrator(end=[1.0], end_velocity=[None])
    second = double_integrator(t_span=(1.0, 2.0), start=[None], start_velocity=[None], end=[0.5])
    return cg.Phases([first, second], links=[lambda x, v: (x, -v)])


def failure():
    with pytest.raises(cg.ConvergenceError) as caught:
        cg.solve(cg.BoundaryProblem(bratu(10.0), (0, 1), [0.0], [0.0]), METHOD, 10)
    return caught.value


def rates(last):
    return [{"parameters": [rate]} for rate in np.linspace(0.1, last, 8)]


def rotation(x):
    return [-x[1], x[0]]


def constrained():
    """A spherical pendulum with friction that ends at rest somewhere at a given height."""
    return cg.BoundaryProblem(
        spatial,
        (0, 1),
        on_sphere((1.0, 0.0)),
        [None] * 3,
        constraint=unit_length,
        force=lambda t, x, v: -v,
        end_conditions=lambda x0, x1: x1[2] - x0[2] / 2,
    )


def buckling():
    """A rod under a load."""
    return cg.BoundaryProblem(
        lambda s, x, v, p: v[0] ** 2 / 2 + p[0] * ca.cos(x[0]), (0, 1), [0.0], [0.0], parameters=[5.0]
    )


SHORT = BY_NAME["short pendulum"].problem
MESH = np.linspace(0, 1, 101)
CASES = {
    "Trajectory": lambda: cg.solve(SHORT, METHOD, 100),
    "Trajectory of many components": lambda: cg.solve(chain(), METHOD, 20),
    "Trajectory to a tolerance": lambda: cg.solve(SHORT, tol=1e-9),
    "Trajectory of steps": steps,
    "ControlTrajectory": lambda: cg.solve(double_integrator(), cg.Galerkin(3), 40),
    "ControlTrajectory of all at once": lambda: cg.solve(everything(), cg.Galerkin(3), 6),
    "ControlTrajectory to a tolerance": lambda: cg.solve(cart_pole(), tol=1e-3),
    "Transcription": lambda: cg.transcribe(SHORT, METHOD, 100),
    "AdaptiveTranscription": lambda: cg.transcribe(SHORT, tol=1e-9),
    "Transcription of many components": lambda: cg.transcribe(chain(), METHOD, 100),
    "ControlTranscription": lambda: cg.transcribe(cart_pole(), METHOD, 100),
    "Sweep": lambda: cg.sweep(bratu_problem(), rates(3.0), METHOD, 6),
    "Sweep with failures": lambda: cg.sweep(bratu_problem(), rates(3.7), METHOD, 6),
    "Branch": lambda: cg.continuation(bratu_problem(), [4.0], intervals=10),
    "BranchPoint": lambda: cg.continuation(buckling(), [20.0], intervals=6).branch_points[0],
    "Branch with others": lambda: cg.continuation(buckling(), [500.0], intervals=16, branches=30),
    "Fold": lambda: cg.continuation(bratu_problem(), [4.0], intervals=10).folds[0],
    "Paths": lambda: cg.paths(cg.BoundaryProblem(pendulum, (0, 5), [None], [None]), cg.Galerkin(6), 8, count=8),
    "Paths of a coarse mesh": lambda: cg.paths(BY_NAME["long pendulum, index 0"].problem, cg.Galerkin(1), 12, count=1),
    "Comparison": lambda: cg.compare(SHORT, METHOD, 50),
    "Comparison of many components": lambda: cg.compare(chain(), METHOD, 4),
    "Trade": lambda: cg.trade(SHORT, [cg.Galerkin(degree) for degree in range(1, 9)], [2]),
    "Row": lambda: cg.trade(SHORT, [METHOD], [4]).rows[0],
    "Row of a failure": lambda: cg.trade(SHORT, [METHOD, cg.Galerkin(2)], [4]).rows[1],
    "Sensitivity": lambda: cg.sensitivity(cg.solve(bratu_problem(), METHOD, 100)),
    "Sensitivity of many components": lambda: cg.sensitivity(cg.solve(chain(), METHOD, 20)),
    "Sensitivity of an optimum": lambda: cg.sensitivity(cg.solve(double_integrator(), cg.Galerkin(3), 4)),
    "Geometry": lambda: cg.geometry(steps(), symmetry=rotation),
    "Geometry without symmetry": lambda: cg.geometry(cg.solve(SHORT, METHOD, 100)),
    "PiecewisePolynomial": lambda: cg.solve(chain(), METHOD, 20).polynomial,
    "ControlPath": lambda: cg.solve(double_integrator(), cg.Galerkin(3), 40).control,
    "DiscreteCalculus": lambda: cg.DiscreteCalculus(METHOD, MESH),
    "BoundaryProblem": lambda: SHORT,
    "BoundaryProblem of many components": chain,
    "BoundaryProblem with parameters": bratu_problem,
    "BoundaryProblem with a constraint, a force and end conditions": constrained,
    "BoundaryProblem of given energy": lambda: cg.BoundaryProblem(pendulum, (0, 5), [None], periodic=True, energy=0.5),
    "InitialProblem": falling,
    "InitialProblem with a constraint": lambda: cg.InitialProblem(
        spatial, (0, 1), on_sphere((1.0, 0.0)), velocity=[0.0, 1.0, 0.0], constraint=unit_length
    ),
    "ControlProblem": everything,
    "Phases": phases,
    "PhasesTrajectory": lambda: cg.solve(phases(), cg.Galerkin(3), 2),
    "ControlProblem with bounds": cart_pole,
    "Galerkin": lambda: METHOD,
    "Galerkin of another kind": lambda: cg.Galerkin(40, cg.chebyshev_points(40), cg.lobatto(60)),
    "Quadrature": lambda: cg.gauss(40),
    "Quadrature of one's own": lambda: cg.Quadrature(MESH[1:], np.full(100, 0.01)),
    "Solver": lambda: cg.newton,
    "Solver with options": lambda: cg.ipopt.with_options(max_iter=50, tol=1e-9),
    "Limits": lambda: cg.Limits(),
    "ConvergenceError's path": lambda: failure().path,
}


@pytest.mark.parametrize("name", CASES)
def test_repr_is_short_and_says_what_it_is_and_not_where(name):
    shown = repr(CASES[name]())
    assert len(shown.splitlines()) <= LINES
    assert len(shown) <= CHARACTERS
    assert " at 0x" not in shown
    assert "<lambda>" not in shown


def test_every_public_class_is_shown():
    public = {name for name in dir(cg) if isclass(getattr(cg, name)) and not issubclass(getattr(cg, name), Exception)}
    assert public == {name.split()[0] for name in CASES} - {"ConvergenceError's"}
