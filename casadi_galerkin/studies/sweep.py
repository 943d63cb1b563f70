"""Many variations of one problem: built once, solved here or by any executor, failures kept beside the answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

from casadi_galerkin.boundary.transcription import GraphCache, SecondVariation
from casadi_galerkin.calculus.cached_property import cached_property
from casadi_galerkin.calculus.galerkin import Galerkin, check_method
from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.functional.pointwise import by_rows
from casadi_galerkin.problems.boundary_problem import BoundaryProblem
from casadi_galerkin.problems.control_problem import ControlProblem
from casadi_galerkin.problems.problem import VARIED, check_kind
from casadi_galerkin.solution.errors import ConvergenceError
from casadi_galerkin.solution.export import Columns, File, Table, by_component
from casadi_galerkin.solution.guess import relative_distance
from casadi_galerkin.solution.path import plot_component
from casadi_galerkin.solution.plotting import Pictured
from casadi_galerkin.solution.progress import progress
from casadi_galerkin.solution.quantity import Quantity, check_asked
from casadi_galerkin.solution.trajectory import Trajectory
from casadi_galerkin.studies.parallel import (
    Answer,
    Run,
    Stated,
    Variation,
    answered,
    by_executor,
    data_vector,
    here,
    nearest,
    picklable,
    solver_of,
    varied,
)
from casadi_galerkin.studies.sweep_file import CutShort, SweepFile

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, repr=False, eq=False)
class Sweep(Table, Pictured):
    """What became of every variation, in the order of the variations.

    Attributes
    ----------
    answers : one for each variation, its Trajectory or the exception that says why there is none: a ConvergenceError,
        a CutShort where its worker failed or an interrupt came first, or whatever its guess raised
    problems : the problem of each variation

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> throws = cg.sweep(fall, [{"end": [1.0]}, {"end": [2.0]}], cg.Galerkin(degree=2), intervals=4)
    >>> throws.x.shape, throws[1](1.0).tolist(), throws.failures
    ((2, 1, 5), [2.0], {})
    """

    answers: tuple[Answer, ...]
    problems: tuple[BoundaryProblem | ControlProblem, ...]

    def __len__(self) -> int:
        return len(self.answers)

    def __getitem__(self, i: int) -> Answer:
        return self.answers[i]

    def __iter__(self) -> Iterator[Answer]:
        return iter(self.answers)

    @property
    def failures(self) -> dict[int, Exception]:
        """Number of the variation -> exception, for those without an answer."""
        return {i: answer for i, answer in enumerate(self.answers) if isinstance(answer, Exception)}

    @cached_property
    def _paths(self) -> dict[int, Trajectory]:
        """Number of the variation -> path, for those with an answer."""
        return {i: answer for i, answer in enumerate(self.answers) if isinstance(answer, Trajectory)}

    @cached_property
    def t(self) -> np.ndarray:
        """Joints, (variations, N + 1); NaN where there is no answer."""
        return self._stacked("t")

    @cached_property
    def x(self) -> np.ndarray:
        """Positions at the joints, (variations, d, N + 1); NaN where there is no answer."""
        return self._stacked("x")

    @cached_property
    def momentum(self) -> np.ndarray:
        """Momenta at the joints, (variations, d, N + 1); NaN where there is no answer."""
        return self._stacked("momentum")

    @cached_property
    def action(self) -> np.ndarray:
        """Values of the action, (variations,); NaN where there is no answer."""
        return self._stacked("action")

    @cached_property
    def cost(self) -> np.ndarray:
        """Costs of the variations of a control problem, (variations,); NaN where there is no answer."""
        if self._paths and self._of_boundary_problems():
            raise ValueError("only control problems have a cost; of boundary problems there is the action")
        return self._stacked("cost")

    def table(self) -> Columns:
        """A row for each variation: why it failed, or an empty word; parameters, action, cost, duration, both ends.

        The parameters of one that failed are those that it states.
        """
        found = [self._paths[i].problem if i in self._paths else problem for i, problem in enumerate(self.problems)]
        parameters = np.array([problem.parameters or () for problem in found])
        names = [name for name in ("action", "cost") if any(hasattr(path, name) for path in self._paths.values())]

        def ends(name: str) -> dict[str, np.ndarray]:
            """Values at the start and at the end."""
            size = self.problems[0].dimension if self.problems else 0
            rows = self._rows(lambda path: getattr(path, name)[:, [0, -1]], (size, 2))
            return by_component(f"start_{name}", rows[..., 0].T) | by_component(f"end_{name}", rows[..., 1].T)

        return {
            "failure": np.array([str(self.failures.get(i, "")) for i in range(len(self))]),
            **by_component("parameters", parameters.T),
            **{name: self._rows(attrgetter(name)) for name in names},
            "duration": self._rows(lambda path: path.t[-1] - path.t[0]),
            **ends("x"),
            **ends("momentum"),
        }

    def plot(
        self, component: int = 0, axes: Axes | None = None, labels: Sequence[str] | None = None, time: str = "t"
    ) -> Axes:
        """Draw one component of all answers into one picture, in the order of the variations; returns the axes.

        Parameters
        ----------
        component : which, from 0 to d - 1
        axes : Matplotlib axes to draw into; default a new figure
        labels : name of the component with its unit
        time : name of the time with its unit
        """
        named = [(f"variation {i}", path) for i, path in self._paths.items()]
        return plot_component(named, component, axes, labels, time)

    @cached_property
    def jumps(self) -> dict[int, int]:
        """Number of the variation -> number of its neighbor, for those that seem on another branch than their neighbor.

        A neighbor is the nearest variation that was solved and comes before.  Two variations seem on different branches
        where their Morse indices differ, or where they are further apart, one bent to meet the other's ends, than the
        larger one's size.

        Raises
        ------
        ValueError
            for a sweep of a control problem
        """
        if not self._of_boundary_problems():
            raise ValueError("jumps between branches are told for boundary problems only")
        on_other_branch, indices = dict[int, int](), dict[int, int | None]()
        graphs: GraphCache | None = None
        places = {i: data_vector(path.problem) for i, path in self._paths.items()}
        spread = np.ptp(list(places.values()), axis=0) if places else np.empty(0)
        for i, path in self._paths.items():
            problem = cast(BoundaryProblem, path.problem)
            graphs = GraphCache(problem, by_rows) if graphs is None else graphs.for_problem(problem)
            graph, before = graphs.transcription(path.method, path.t), list(indices)
            variations = SecondVariation(graph, problem, path.polynomial, path.integral_multipliers)
            indices[i] = variations.negative()  # it changes along a family at conjugate points only
            if before:
                neighbor = before[nearest(places[i], np.array([places[k] for k in before]), spread)]
                own, bent = path.polynomial.values, graph.guess_on_mesh(self._paths[neighbor], path.t).values
                away = min(relative_distance(own, bent), relative_distance(bent, own))  # either may be nearly zero
                if indices[i] != indices[neighbor] or away > 1:
                    on_other_branch[i] = neighbor
        return on_other_branch

    def _of_boundary_problems(self) -> bool:
        return all(isinstance(problem, BoundaryProblem) for problem in self.problems)

    def _stacked(self, name: str) -> np.ndarray:
        shapes = {np.shape(getattr(path, name)) for path in self._paths.values()}
        if len(shapes) != 1:
            came = "the paths have different meshes" if shapes else "no variation has an answer"
            raise ValueError(f"{came}, so there is no array of their {name}: see answers and failures")
        return self._rows(attrgetter(name), shapes.pop())

    def _rows(self, find: Callable[[Trajectory], ArrayLike], shape: tuple[int, ...] = ()) -> np.ndarray:
        """What is found of every path, (variations,) + shape; NaN where there is no answer."""
        rows = np.full((len(self.answers), *shape), np.nan)
        for i, path in self._paths.items():
            rows[i] = find(path)
        return rows

    def __repr__(self) -> str:
        """Summarize the sweep, with the first jump between branches and the reason of the first failure."""
        failures = self.failures
        text = f"Sweep of {counted(len(self), 'variation')}, {len(self) - len(failures)} solved"
        cut_short = sum(isinstance(error, CutShort) for error in failures.values())
        if cut_short:
            text += f", {cut_short} cut short"
        if self._of_boundary_problems() and self.jumps:
            i, neighbor = next(iter(self.jumps.items()))
            text += f"\n  seem on another branch than their neighbors: {len(self.jumps)}, first {i} beside {neighbor}"
        if not failures:
            return text
        first, error = next(iter(failures.items()))
        kind = "" if isinstance(error, ConvergenceError) else f"{type(error).__name__}: "
        return f"{text}\n  variation {first} is the first without an answer: {kind}{error}"


def sweep(
    problem: BoundaryProblem | ControlProblem,
    variations: Iterable[Variation],
    method: Galerkin | None = None,
    intervals: int | None = None,
    *,
    tol: float | None = None,
    of: Quantity | None = None,
    executor: Executor | None = None,
    file: File | None = None,
) -> Sweep:
    """Solve many variations of one problem; in a terminal or a notebook a progress bar appears where it lasts.

    Whatever becomes of one variation, the answers of the others are kept.  An interrupt (Ctrl-C) ends the sweep, which
    returns what it has, unless CasADi swallows it, as it does now and then.

    Parameters
    ----------
    problem : BoundaryProblem or ControlProblem
    variations : dicts of what differs from the problem: `start`, `end`, `parameters`, `t_span`; the velocities and
        momenta at the ends, the energy and `integral_values`, where the problem states them; and `guess`, as for
        `solve`, which for an executor has to be picklable (an array, a Trajectory, a module's function)
    method, intervals : as for `solve`
    tol : as for `solve`; each variation without a guess of its own starts from the path and the mesh of the nearest one
        that is solved, and so stays on its branch; see `Sweep.jumps`.  With a given energy, a variation with a
        `t_span`, the guess of its duration, starts from the straight line
    of : the quantity that `tol` is the tolerance of, as for `solve`; with an executor or a file a module's function
    executor : any Executor of processes in the sense of `concurrent.futures`; default none, one after the other.
        Not of threads: the solves of one process run one after the other
    file : name of a file in which answers are kept while they come, in chunks of some √n / 2: the same call finds them
        there, and solves only what is left.  Two sweeps that run at once need two files.  It holds pickles: open none
        that you do not trust

    Returns
    -------
    Sweep

    Raises
    ------
    TypeError, ValueError
        for input that does not fit, and for a file of another sweep, before anything is solved.  A variation that
        cannot be solved raises nothing: its ConvergenceError, or whatever its guess raised, is kept in its place

    Examples
    --------
    >>> import casadi_galerkin as cg
    >>> fall = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - 10 * x[0], (0, 1), start=[0.0], end=[0.0])
    >>> throws = cg.sweep(fall, [{"end": [height]} for height in (1.0, 2.0, 3.0)], cg.Galerkin(degree=2), intervals=4)
    >>> throws.momentum[:, 0, 0].round(6).tolist()
    [6.0, 7.0, 8.0]
    """
    check_kind(problem, BoundaryProblem, ControlProblem)
    check_method(method, optional=True)
    if isinstance(variations, (str, Mapping)) or not isinstance(variations, Iterable):
        raise TypeError(f"variations must be a sequence of dicts, got {variations!r}")
    if executor is not None and (isinstance(executor, ThreadPoolExecutor) or not isinstance(executor, Executor)):
        raise TypeError(
            "executor must be a concurrent.futures.Executor of processes, such as ProcessPoolExecutor(), as the solves "
            f"of one process run one after the other, got {executor!r}"
        )
    check_asked(of, tol)
    given = [_checked(problem, i, variation) for i, variation in enumerate(variations)]
    checked, problems = [variation for variation, _ in given], tuple(other for _, other in given)
    arguments = (problem, method, intervals, tol, of)
    run: Run = partial(here, solver_of(*arguments))  # refuses here what would fail in every worker
    kept = None
    if executor is not None or file is not None:
        picklable("of", of, "give a module's function")
        written = picklable("the problem", arguments)
        guesses = [
            picklable(f"the guess of variation {i}", variation.get("guess"), "give an array or a module's function")
            for i, variation in enumerate(checked)
        ]
        if executor is not None:
            run = partial(by_executor, executor, written)
        if file is not None:
            stated = repr([{**variation, "guess": None} for variation in checked]).encode()
            kept = SweepFile(file, written, b"".join([stated, *guesses]))
    answers = dict[int, Answer]()
    with progress("sweep", len(checked)) as advance, suppress(KeyboardInterrupt):
        for i, answer in answered(run, checked, problems if tol is not None else (), kept):
            answers[i] = answer
            advance(1)
    cut_short = CutShort("the sweep was interrupted before this variation was solved")
    return Sweep(tuple(answers.get(i, cut_short) for i in range(len(checked))), problems)


def _checked(problem: Stated, number: int, variation: Variation) -> tuple[Variation, Stated]:
    """Check one variation against the problem; returns it with checked values, and its problem."""
    fields = (*VARIED, "t_span", "guess")
    allowed = ", ".join(name for name in fields if name not in VARIED or hasattr(problem, name))
    if not isinstance(variation, Mapping):
        raise TypeError(f"variation {number} must be a dict of {allowed}, got {variation!r}")
    unknown = [key for key in variation if key not in fields]
    if unknown:
        raise ValueError(f"variation {number} has {unknown[0]!r}; what can be varied is {allowed}")
    checked = dict(variation)
    try:
        other = varied(problem, variation)
        checked |= {name: getattr(other, name) for name in checked if name != "guess"}
    except (TypeError, ValueError) as error:
        raise type(error)(f"variation {number}: {error}") from None
    return checked, other
