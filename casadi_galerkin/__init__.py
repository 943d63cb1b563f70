"""High-order Galerkin variational integrators, solved globally as two-point boundary-value problems on CasADi."""

from casadi_galerkin._solve import AdaptiveTranscription as AdaptiveTranscription
from casadi_galerkin._solve import sensitivity as sensitivity
from casadi_galerkin._solve import solution_function as solution_function
from casadi_galerkin._solve import solve as solve
from casadi_galerkin._solve import transcribe as transcribe
from casadi_galerkin.boundary.all_paths import Paths as Paths
from casadi_galerkin.boundary.all_paths import paths as paths
from casadi_galerkin.boundary.branch import Branch as Branch
from casadi_galerkin.boundary.branch import BranchPoint as BranchPoint
from casadi_galerkin.boundary.branch import Fold as Fold
from casadi_galerkin.boundary.continuation import continuation as continuation
from casadi_galerkin.boundary.transcription import Transcription as Transcription
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus as DiscreteCalculus
from casadi_galerkin.calculus.galerkin import Galerkin as Galerkin
from casadi_galerkin.calculus.nodes import chebyshev_points as chebyshev_points
from casadi_galerkin.calculus.nodes import equispaced_points as equispaced_points
from casadi_galerkin.calculus.nodes import lobatto_points as lobatto_points
from casadi_galerkin.calculus.piecewise_polynomial import PiecewisePolynomial as PiecewisePolynomial
from casadi_galerkin.calculus.quadrature import Quadrature as Quadrature
from casadi_galerkin.calculus.quadrature import gauss as gauss
from casadi_galerkin.calculus.quadrature import left_rectangle as left_rectangle
from casadi_galerkin.calculus.quadrature import lobatto as lobatto
from casadi_galerkin.calculus.quadrature import midpoint as midpoint
from casadi_galerkin.calculus.quadrature import radau as radau
from casadi_galerkin.calculus.quadrature import trapezoid as trapezoid
from casadi_galerkin.control.control_transcription import ControlTranscription as ControlTranscription
from casadi_galerkin.problems.boundary_problem import BoundaryProblem as BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem as ControlProblem
from casadi_galerkin.problems.initial_problem import InitialProblem as InitialProblem
from casadi_galerkin.problems.phases import Phases as Phases
from casadi_galerkin.problems.tables import table as table
from casadi_galerkin.solution.control_path import ControlPath as ControlPath
from casadi_galerkin.solution.control_trajectory import ControlTrajectory as ControlTrajectory
from casadi_galerkin.solution.errors import ConjugatePointError as ConjugatePointError
from casadi_galerkin.solution.errors import ConvergenceError as ConvergenceError
from casadi_galerkin.solution.errors import LimitReached as LimitReached
from casadi_galerkin.solution.errors import Limits as Limits
from casadi_galerkin.solution.optimal_path import PhasesTrajectory as PhasesTrajectory
from casadi_galerkin.solution.path import load as load
from casadi_galerkin.solution.plotting import panels as panels
from casadi_galerkin.solution.trajectory import Trajectory as Trajectory
from casadi_galerkin.solvers.derivatives import Sensitivity as Sensitivity
from casadi_galerkin.solvers.solver import Solver as Solver
from casadi_galerkin.solvers.solver import fatrop as fatrop
from casadi_galerkin.solvers.solver import ipopt as ipopt
from casadi_galerkin.solvers.solver import minimizer as minimizer
from casadi_galerkin.solvers.solver import newton as newton
from casadi_galerkin.solvers.solver import rootfinder as rootfinder
from casadi_galerkin.solvers.solver import sqp as sqp
from casadi_galerkin.stepping.geometry import Geometry as Geometry
from casadi_galerkin.stepping.geometry import geometry as geometry
from casadi_galerkin.stepping.shooting import shoot as shoot
from casadi_galerkin.studies.comparison import Comparison as Comparison
from casadi_galerkin.studies.comparison import compare as compare
from casadi_galerkin.studies.sweep import Sweep as Sweep
from casadi_galerkin.studies.sweep import sweep as sweep
from casadi_galerkin.studies.sweep_file import CutShort as CutShort
from casadi_galerkin.studies.trade import trade as trade
from casadi_galerkin.studies.trade_table import Row as Row
from casadi_galerkin.studies.trade_table import Trade as Trade

__version__ = "0.1.0"

_PUBLIC = sorted(
    name for name, value in globals().items() if not name.startswith("_") and not hasattr(value, "__path__")
)


def __dir__() -> list[str]:
    """List the public names; the folders, which hold the modules, are not among them."""
    return _PUBLIC
