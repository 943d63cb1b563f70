"""High-order Galerkin variational integrators, solved globally as two-point boundary-value problems on CasADi."""

from casadi_galerkin.boundary import Transcription as Transcription
from casadi_galerkin.boundary import transcribe as transcribe
from casadi_galerkin.calculus import DiscreteCalculus as DiscreteCalculus
from casadi_galerkin.calculus import Galerkin as Galerkin
from casadi_galerkin.calculus import PiecewisePolynomial as PiecewisePolynomial
from casadi_galerkin.engines import ipopt as ipopt
from casadi_galerkin.engines import minimizer as minimizer
from casadi_galerkin.engines import rootfinder as rootfinder
from casadi_galerkin.nodes import chebyshev_points as chebyshev_points
from casadi_galerkin.nodes import equispaced_points as equispaced_points
from casadi_galerkin.nodes import lobatto_points as lobatto_points
from casadi_galerkin.problems import BoundaryProblem as BoundaryProblem
from casadi_galerkin.quadrature import Quadrature as Quadrature
from casadi_galerkin.quadrature import gauss as gauss
from casadi_galerkin.quadrature import left_rectangle as left_rectangle
from casadi_galerkin.quadrature import lobatto as lobatto
from casadi_galerkin.quadrature import midpoint as midpoint
from casadi_galerkin.quadrature import radau as radau
from casadi_galerkin.quadrature import trapezoid as trapezoid
from casadi_galerkin.refinement import Limits as Limits
from casadi_galerkin.solve import solve as solve
from casadi_galerkin.trajectory import ConjugatePointError as ConjugatePointError
from casadi_galerkin.trajectory import ConvergenceError as ConvergenceError
from casadi_galerkin.trajectory import Trajectory as Trajectory
