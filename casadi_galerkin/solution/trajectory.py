"""The solution: a path that can be evaluated everywhere, with its momenta, energy and the report of the solve."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import largest_difference as difference_of_paths
from casadi_galerkin.calculus.mesh_adaptation import truncation_error
from casadi_galerkin.calculus.numbers import checked_index, counted, number, spanned, told_apart, whole_number
from casadi_galerkin.calculus.piecewise_polynomial import times_within
from casadi_galerkin.calculus.roundoff import EPS
from casadi_galerkin.functional.pointwise import at_places
from casadi_galerkin.problems.callables import with_parameters
from casadi_galerkin.problems.constrained_motion import motion_of, multipliers
from casadi_galerkin.problems.legendre_transform import legendre_transform, velocities
from casadi_galerkin.problems.phases import Phases
from casadi_galerkin.problems.problem import Problem
from casadi_galerkin.solution.error_indicators import error_indicators
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.export import Columns, by_component
from casadi_galerkin.solution.path import Path
from casadi_galerkin.solution.plotting import COLORS, axes_or_new, plot_plane
from casadi_galerkin.solution.quantity import Quantity, check_quantity, largest_difference, size_of

if TYPE_CHECKING:
    from matplotlib.animation import ArtistAnimation
    from matplotlib.axes import Axes

Kind = TypeVar("Kind", bound="Answer")
Lines: TypeAlias = Iterator[tuple[str, str]]  # names and words of lines of a summary

UNRESOLVED = 1e-3  # relative error, or indicator of one, above which a path is reported as not resolved


def index_in_words(path: Trajectory) -> str:
    """The Morse index of a path in words."""
    return "no Morse index" if path.morse_index is None else f"Morse index {path.morse_index}"


@dataclass(frozen=True)
class Comparisons:
    """A path's comparison with others of higher degree, by default none.

    Attributes
    ----------
    finer : the others, where they are paths of one problem
    errors : relative errors of the cost, and of all
    common_error : relative error that all of these have in common
    """

    finer: tuple[Any, ...] = ()
    errors: tuple[float, float] = (math.inf, math.inf)
    common_error: float = math.inf


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Answer(Path):
    """A path with the report of its solve: what all answers have.

    Attributes
    ----------
    iterations, residual, solver, build_seconds, solve_seconds, method, problem : as of a `Trajectory`
    error_estimate, asked, asked_error : as well
    variations : what knows its second variation
    find_comparisons : compares it with paths of higher degree; None for one of several phases
    """

    comparison_factor: ClassVar = 1.0  # estimated errors over differences to the paths of a higher degree
    _left: ClassVar = "residual {0.residual:.1g} times its roundoff floor"  # by the solver

    iterations: int
    residual: float
    solver: str
    build_seconds: float
    solve_seconds: float
    method: Galerkin
    problem: Problem | Phases
    variations: Any = None
    find_comparisons: Callable[[Any], Any] | None = None
    error_estimate: float | None = None
    asked: np.ndarray | float | None = None
    asked_error: float | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def amended(self: Kind, **changes: Any) -> Kind:
        """The same path with another report, and all that has been computed of it."""
        path = replace(self, **changes)
        path.__dict__.update((name, kept) for name, kept in vars(self).items() if name not in path.__dict__)
        return path

    def error_of(self, of: Quantity) -> np.ndarray:
        """Estimate the error of any quantity of the path: its difference to that of a path of a higher degree.

        That path has the same mesh; it is found once and kept for the next question.  The error is no smaller than what
        the quantity is changed by the rounding of the path.  Where an error indicator of
        `estimate_error` is larger than the difference of x, as at a kink, the error is at least that, relative to the
        largest entry.  Of a ControlTrajectory it is twice the larger difference to two paths of higher degree, and at
        least what `estimate_error` knows beside these.

        Parameters
        ----------
        of : callable, a path -> a number, or an array whose shape does not depend on the mesh, such as
            ``lambda path: path.momentum[:, -1]``

        Returns
        -------
        array of the shape of the quantity, in its units; infinite where no path of a higher degree is found

        Raises
        ------
        TypeError, ValueError
            where the quantity is not finite or no array of numbers, or has another shape on another path

        Examples
        --------
        >>> import casadi as ca
        >>> import casadi_galerkin as cg
        >>> swing = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + ca.cos(x[0]), (0, 10), start=[0.0], end=[1.0])
        >>> path = cg.solve(swing, cg.Galerkin(degree=5), intervals=10)
        >>> print(f"{path.estimate_error():.0e}, {path.error_of(lambda path: path.momentum[0, -1]):.0e}")
        5e-06, 5e-08
        """
        return self._known(of)[1]

    def asked_for(self: Kind, of: Quantity) -> Kind:
        """The path with a quantity `asked`, and its error."""
        value, change, size = self._known(of)
        asked = value if value.ndim else value.item()
        return self.amended(asked=asked, asked_error=float(np.max(change)) / (size or 1.0))

    def _known(self, of: Quantity) -> tuple[np.ndarray, np.ndarray, float]:
        """A quantity, its error as `error_of` has it, and its size."""
        check_quantity(of)
        rounding = EPS if self.variations is None else min(self.variations.rounding(), 1.0)
        value, change = largest_difference(of, self, self._comparisons.finer, rounding)
        size = size_of(value)
        return value, np.maximum(self.comparison_factor * change, self._comparisons.common_error * size), size

    @cached_property
    def _comparisons(self) -> Any:
        """Comparison with paths of higher degree: `finer`, `errors` of cost and of all, and `common_error`."""
        if self.find_comparisons is None:
            raise ValueError("a phase has no errors of its own: ask the whole path")
        try:
            return self.find_comparisons(self)
        except ConvergenceError:
            return Comparisons()

    @cached_property
    def morse_index(self) -> int | None:
        """Number of negative eigenvalues of the action's Hessian, 0 for a local minimum; computed when first used.

        The Hessian is that of the action at this path, by variations of its degree.  Its integrals are taken by twice
        as many Gauss points as that, whatever the quadrature of the method.

        It is None for a path that was found step by step; under a force, and where the momentum of a given velocity
        depends on more than that, because the path is then not a critical point of an action; where ∂²L/∂v² has a
        negative eigenvalue at a joint, because the index then grows without bound as the mesh is refined; where ∂L/∂x
        steps on the path, as that of |x| does, because no Hessian contains what that adds; and where a higher
        degree on the same mesh gives another number, because this mesh, or any mesh, does not resolve the variations.
        For an optimization it is that of the cost; see `ControlTrajectory`.
        """
        return None if self.variations is None else self.variations.negative()

    def _asked(self) -> Lines:
        """The quantity that was asked for, if any."""
        if self.asked is not None:
            value = np.array2string(np.array(self.asked), precision=12, threshold=6, edgeitems=2).replace("\n", "")
            yield "asked", f"{value}, error {self.asked_error:.1e} of its size, estimated"

    def _kind(self) -> str:
        """The kind of critical point, in words."""
        return "a local minimum" if self.morse_index == 0 else f"a saddle of Morse index {self.morse_index}"

    def _size(self) -> str:
        return counted(len(self.x), "component")

    def _lines(self) -> Lines:
        """What the summary says of the path."""
        raise NotImplementedError

    def _errors(self) -> str:
        """The known errors, in words; empty where none is known."""
        return "" if self.error_estimate is None else f"{self.error_estimate:.1e} of the path"

    def _doubts(self) -> Lines:
        """What this mesh does not resolve, or the solver has not determined, the most telling first."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """Summarize path and solve in a few lines."""
        errors = self._errors()
        lines = [
            ("method", str(self.method)),
            *self._lines(),
            *self._asked(),
            *([("error", f"{errors}, estimated")] if errors else islice(self._doubts(), 1)),
            ("solver", f"{self.solver}, {counted(self.iterations, 'iteration')}, {self._left.format(self)}"),
            ("seconds", f"{self.build_seconds:.4f} to build, {self.solve_seconds:.4f} to solve"),
        ]
        intervals = counted(len(self.t) - 1, "interval")
        return "\n".join(
            [
                f"{type(self).__name__} of {self._size()} on {spanned(self.t)}, {intervals}",
                *(f"  {name:<11} {words}" for name, words in lines),
            ]
        )


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Trajectory(Answer):
    """A critical point of the discrete action: ``path(t)`` is its position, ``path(t, 1)`` its derivative.

    Attributes
    ----------
    t : (N + 1,), joints
    x : (d, N + 1), positions at the joints
    polynomial : PiecewisePolynomial, the path between the joints; its `values` (d, N m + 1) are the node values
    momentum : (d, N + 1), by the discrete Legendre transform -∂S/∂x_0, ..., ∂S/∂x_N; of order `method.order`
    action : value of the discrete action, with the `end_action`, but without p_0·x_0 - p_N·x_N of given momenta
    iterations : of the solver
    residual : largest residual over its own roundoff floor
    solver : what found it
    build_seconds, solve_seconds : spent on building the graph and on the solve
    method : Galerkin
    problem : what was solved, with the ends, parameters and times that it was solved for
    error_estimate : estimated relative error of x, at the joints and between them; None before `estimate_error`
    asked, asked_error : the quantity `of` that a solve to a tolerance was asked for, a number or an array, and its
        estimated error over the size of its largest entry; None where none was
    integral_multipliers : (k,), μ of L + μ·g, of the problem's `integral_conditions`; of order `method.order`

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> path = cg.solve(fall, cg.Galerkin(degree=2), intervals=4)
    >>> path(0.25).round(9).tolist(), path(0.25, 1).round(9).tolist(), path.morse_index
    ([0.9375], [2.5], 0)
    >>> path.velocity[:, 0].round(9).tolist(), path.energy[0].round(9).tolist()
    ([5.0], 12.5)
    >>> path.estimate_error() < 1e-14
    True
    """

    momentum: np.ndarray
    action: float
    problem: Problem
    missed: float = 0.0  # what shooting misses the end by, relative to the size of the path
    integral_multipliers: np.ndarray = field(default_factory=lambda: np.empty(0))

    def estimate_error(self) -> float:
        """Estimate the relative error of x, at the joints and between them; kept as `error_estimate`.

        The path is compared with one of a higher degree on the same mesh: by Newton steps from it for a path between
        two ends, by `shoot` where this has found it, and by steps from the same start otherwise.  The estimate is at
        least each of three error indicators, which show a kink or a singularity that both degrees may miss: the
        relative violation of the balance of energy; the effect of jumps of the force; and, where it is large, the
        misfit of L between points.  For a path between two ends it is also at least the relative difference of the
        responses to forces in the two degrees, where this shows that the mesh does not resolve variations.  It is
        infinite where the higher degree has no solution.
        """
        if self.error_estimate is not None:
            return self.error_estimate
        difference = self._comparisons.errors[1] if self.variations is None else self.variations.difference()
        error = max(difference, self._least_error)
        self.__dict__["error_estimate"] = error  # the class is frozen
        return error

    @property
    def _least_error(self) -> float:
        """Relative error that no comparison with a path of a higher degree shows."""
        return max(self.missed, *(float(np.max(indicator)) for indicator in self._indicators))

    @cached_property
    def _indicators(self) -> tuple[np.ndarray, ...]:
        """The error indicators on every interval; (N,) each, the energy imbalance first."""
        return error_indicators(self.motion, self.polynomial, self.momentum)

    @property
    def motion(self) -> Problem:
        """The problem of L + μ·g with the multipliers of this path; without integral conditions `problem`."""
        return self.problem.with_multipliers(self.integral_multipliers.tolist())

    @cached_property
    def regularity(self) -> float | None:
        """Smallest second variation relative to the sizes of its terms; computed when first used.

        It is zero at a conjugate point, and shows how well the ends determine the path: errors are magnified by its
        inverse.  Under a force it is that of the equations' Jacobian, between its directions of smallest curvature.  It
        is None for a path that was found step by step, for one that was optimized, and where ∂L/∂x or the force steps
        on the path.
        """
        return None if self.variations is None else self.variations.smallest()

    @property
    def parameters(self) -> tuple[float, ...] | None:
        """Values of the Lagrangian's parameters p."""
        return self.problem.parameters

    @cached_property
    def velocity(self) -> np.ndarray:
        """Velocities at the joints that belong to the momenta, p = ∂L/∂v; (d, N + 1), of order `method.order`.

        NaN where none was found.  Where a mass vanishes, as at a center, they are ``path(t, 1)``, the derivative of the
        polynomial, which is of order m only.
        """
        transform = legendre_transform(self._lagrangian)
        return velocities(transform, self.t, self.x, self.momentum, self(self.t, 1))

    def multipliers(self, t: ArrayLike) -> np.ndarray:
        """Multipliers λ of the constraint at times t: its force is λ·∂g/∂x, in units of the action over t and x.

        From position and velocity by the equations of motion, of order `method.order` at the joints and m between.

        Returns
        -------
        (k,) + t.shape

        Raises
        ------
        TypeError, ValueError
            where the problem has no constraint, and for times that are not within the path's
        """
        if self.problem.constraint is None:
            raise ValueError("the problem has no constraint, so no multipliers")
        motion, times = (
            motion_of(self.motion, with_parameters(self._force(), self.parameters)),
            times_within(self.t, t),
        )
        flat = times.ravel()
        velocity, joint = self(flat, 1), np.minimum(np.searchsorted(self.t, flat), len(self.t) - 1)
        velocity = np.where(self.t[joint] == flat, self.velocity[:, joint], velocity)
        values = multipliers(motion, flat, self(flat), velocity)
        return values.reshape(len(values), *times.shape)

    def _force(self) -> ca.Function | None:
        """The force on this path, (t, x, v[, p]) -> (d,), if there is one."""
        return self.problem.force

    @cached_property
    def energy(self) -> np.ndarray:
        """Energy p·v - L at the joints, from positions and momenta; (N + 1,)."""
        return self._energy(self.t, self.x, self.momentum, self.velocity)

    def _energy(self, t: np.ndarray, x: np.ndarray, momentum: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Energies at K times, from values (d, K)."""
        (lagrangian,) = at_places(self._lagrangian, t, x, velocity)
        return np.sum(momentum * velocity, axis=0) - np.sum(lagrangian, axis=0)

    def table(self, times: ArrayLike | None = None) -> Columns:
        """Times, positions, velocities, momenta and energy, by name.

        At the joints they are those of the discrete Legendre transform, of order `method.order`; between them those of
        the polynomial, which are of order m only.

        Parameters
        ----------
        times : (K,); default all joints, and between two of them four times as many as the degree, enough to draw
        """
        columns = super().table(times)
        t = columns["t"]
        x, joints = self(t), np.minimum(np.searchsorted(self.t, t), len(self.t) - 1)
        velocity, at_joint = self(t, 1), self.t[joints] == t
        momentum, _ = at_places(legendre_transform(self._lagrangian), t, x, velocity)
        velocity = np.where(at_joint, self.velocity[:, joints], velocity)
        momentum = np.where(at_joint, self.momentum[:, joints], momentum)
        motion = by_component("velocity", velocity) | by_component("momentum", momentum)
        return {**columns, **motion, "energy": self._energy(t, x, momentum, velocity)}

    def _title(self) -> str:
        index = "" if self.morse_index is None else f", Morse index {self.morse_index}"
        return f"Degree {self.method.degree} on {counted(len(self.t) - 1, 'interval')}: action {self.action:.6g}{index}"

    def plot_phase(self, component: int = 0, axes: Axes | None = None, labels: tuple[str, str] | None = None) -> Axes:
        """Draw one component against its momentum, the start as a larger dot; returns the Matplotlib axes.

        Dots are the momenta of the discrete Legendre transform; between them the line is ∂L/∂v along the polynomial,
        which is of order m only and may jump at the joints of a coarse mesh.

        Parameters
        ----------
        component : which, from 0 to d - 1
        axes : Matplotlib axes to draw into, so that several paths make one portrait; default a new figure
        labels : names of position and momentum with units
        """
        checked_index("component", component, len(self.x))
        times = self.fine_times
        momenta, _ = at_places(legendre_transform(self._lagrangian), times, self(times), self(times, 1))
        places = np.stack((self(times)[component], momenta[component]))
        joints = np.stack((self.x[component], self.momentum[component]))
        names = (f"x[{component}]", f"p[{component}]") if labels is None else labels
        drawn = plot_plane(places, joints, axes, names, "x and p")
        drawn.plot(*joints[:, :1], "o", color=drawn.lines[-1].get_color())
        return drawn

    def animate(
        self,
        points: Callable[[np.ndarray], ArrayLike],
        axes: Axes | None = None,
        seconds: float | None = None,
        unit: str = "",
        frames: int = 100,
    ) -> ArtistAnimation:
        """Move a planar mechanism along the path; returns Matplotlib's ArtistAnimation, to show or to save.

        It is a chain of bars, whose last point leaves a trail.  The axes are scaled to hold all of it; an animation
        runs only as long as a reference to it is kept.

        Parameters
        ----------
        points : callable, positions x (d, K) at K times -> (n, 2, K), places in the plane of all ends of the bars of a
            chain, one after the other, the fixed one included
        axes : Matplotlib axes to draw into, labeled by their owner; default a new figure
        seconds : how long it runs; default the duration of the path, taken as seconds
        unit : of the time shown in the title
        frames : how many, evenly from start to end
        """
        from matplotlib.animation import ArtistAnimation

        duration = float(self.t[-1] - self.t[0]) if seconds is None else number(seconds)
        if duration is None or not 0 < duration < math.inf:
            raise ValueError(f"seconds must be a positive number, got {seconds!r}")
        times = np.linspace(self.t[0], self.t[-1], whole_number("frames", frames, 2))
        places, axes, drawn = self._places(points, times), axes_or_new(axes), list[Any]()
        axes.set_aspect("equal", "datalim")
        for k, t in enumerate(times):
            trail = axes.plot(*places[-1, :, : k + 1], color=COLORS[5])
            bars = axes.plot(*places[:, :, k].T, "o-", color=COLORS[0], linewidth=2)
            clock = f"t = {t:.3g} {unit}".rstrip()
            drawn.append([*trail, *bars, axes.text(0.5, 1.02, clock, transform=axes.transAxes, ha="center")])
        figure: Any = axes.figure
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # laid out only once, because it takes 0.2 s
        return ArtistAnimation(figure, drawn, interval=1000 * duration / frames)

    def _doubts(self) -> Lines:
        """A large truncation error, or violation of the balance of energy, as near a singularity."""
        yield from self._unresolved()
        yield from self._above(
            self._indicators[0], UNRESOLVED, "the balance of energy is missed by {:.0e} of its terms {}"
        )

    def _unresolved(self, limit: float = UNRESOLVED) -> Lines:
        """The largest truncation error, if it is above a limit, and where."""
        words = "about {:.0e} of x is left out {}; take more intervals or a higher degree"
        return self._above(self._truncation_error, limit, words)

    @property
    def _truncation_error(self) -> np.ndarray:
        """Truncation error on every interval, (N,), relative to the sizes of the components."""
        return truncation_error(self.polynomial)

    def _above(self, values: np.ndarray, accepted: float, words: str) -> Lines:
        """The largest of one value per interval, and its interval, if it is above the accepted one."""
        i = int(np.argmax(values))
        if values[i] > accepted:
            where = "between t = {} and {}".format(*told_apart(self.t[i], self.t[i + 1]))
            yield "NOT RESOLVED:", words.format(values[i], where)

    @property
    def _lagrangian(self) -> ca.Function:
        """L(t, x, v) with the parameters inserted."""
        return self.motion.numeric.lagrangian

    def _kind(self) -> str:
        """The kind of critical point, in words."""
        if self.morse_index is not None:
            return super()._kind()
        least = "" if self.regularity is None else f", its smallest variation is {self.regularity:.0e} of its terms"
        return f"no Morse index{least}"

    def _lines(self) -> Lines:
        """What the summary says of the path."""
        violation = float(np.max(self._indicators[0]))
        balance = f"{violation:.1e} of its terms" if violation > 0 else "rounding"
        yield "action", f"{self.action:.15g}, {self._kind()}"
        yield "energy", f"{self.energy[0]:.12g} at the start, its balance kept to {balance}"


def compared(path: Trajectory, finer: Trajectory) -> Comparisons:
    """A path with the one of a higher degree: the relative difference of both, and what it may not show."""
    lasting, least = float(np.ptp(finer.t) / np.ptp(path.t)), path._least_error
    difference = max(difference_of_paths(path.polynomial, finer.polynomial), abs(lasting - 1), path.missed)
    return Comparisons((finer,), (0.0, difference), least if least > difference else 0.0)
