"""Where the package stands: the time of a solve alone, to the same true error, beside what its users use today.

Peers, each at its own best discretization for each error:

* this package: `Transcription.solve`, verification and momenta included;
* hand-written CasADi: Gauss collocation of the first-order system y = (x, v) with all stage values as unknowns, as a
  skilled user writes it: a pointwise map, or its expansion to scalars; sparse exact Jacobian; Newton's rootfinder with
  a sparse linear solver, stopped at a tenth of the error asked for.  The best of its variants counts;
* SciPy's `solve_bvp` with vectorized right-hand side and analytic Jacobian, at its loosest tolerance that does, from
  several numbers of joints and from the mesh that it has found itself.  The best of these counts.

All start from the same guess, and from the same family of meshes.  An error is the largest of x between
and at the joints (the collocation's from its polynomials), relative to the largest component, against a closed form or
a solution that is finer by several digits.  Times are medians of warm solves, in turns.  Building is not counted.

Run it alone on a quiet machine; it takes a few minutes.  Given the name of a file, it draws the table into it.
"""

import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from functools import partial
from statistics import median

import casadi as ca
import numpy as np
import scipy
from scipy.integrate import solve_bvp

import casadi_galerkin as cg
from casadi_galerkin.calculus.discrete_calculus import DiscreteCalculus
from casadi_galerkin.calculus.nodes import differentiation_matrix, lagrange_values

ERRORS = (1e-6, 1e-9, 1e-12)
DEGREES = (4, 5, 6, 8, 10, 12, 15, 20)
COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48, 64, 96, 128, 192, 256)
WITHIN = np.linspace(0, 1, 12)  # parts of an interval at which errors are taken
CANDIDATES = 3  # discretizations with the fewest unknowns that are timed
FEW, TRIALS, REPEATS = 3, 31, 15  # runs of every discretization, of those that may be the best, and of the best
NEAR = 1.5  # times the least time that may be the least in truth
LINEAR_SOLVERS = "csparse", "qr"
JOINTS = 20, 50, 100  # of first meshes of `solve_bvp`


@dataclass(frozen=True)
class Case:
    """A boundary problem with its accelerations, its path if that is known, a guess, and a family of meshes."""

    name: str
    lagrangian: Callable
    acceleration: Callable  # (x, v) -> (d,)
    t_span: tuple[float, float]
    start: np.ndarray
    end: np.ndarray
    guess: Callable  # t (K,) -> (d, K)
    exact: Callable | None = None  # t (K,) -> (d, K)
    grading: Callable = lambda s: s  # [0, 1] -> [0, 1]

    def mesh(self, intervals):
        """Joints of so many intervals."""
        first, last = self.t_span
        joints = first + (last - first) * self.grading(np.linspace(0, 1, intervals + 1))
        joints[0], joints[-1] = first, last
        return joints

    @property
    def problem(self):
        """As the package takes it."""
        return cg.BoundaryProblem(self.lagrangian, self.t_span, list(self.start), list(self.end))


def straight(start, end, t_span):
    """Line between the ends."""
    start, end = np.array(start, dtype=float), np.array(end, dtype=float)
    return lambda t: start[:, None] + (end - start)[:, None] * (np.asarray(t) - t_span[0]) / (t_span[1] - t_span[0])


def kepler(eccentricity=0.6, half=1.0):
    """Arc through the pericenter; the guess turns evenly at the distance of the ends."""

    def exact(t):
        anomaly = np.array(t, dtype=float)
        for _ in range(60):
            anomaly -= (anomaly - eccentricity * np.sin(anomaly) - t) / (1 - eccentricity * np.cos(anomaly))
        return np.array([np.cos(anomaly) - eccentricity, np.sqrt(1 - eccentricity**2) * np.sin(anomaly)])

    start, end = exact(np.array([-half, half])).T
    radius, angle = np.hypot(*end), np.arctan2(end[1], end[0])
    return Case(
        "Kepler arc, e = 0.6",
        lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x),
        lambda x, v: -x / ca.sqrt(ca.dot(x, x)) ** 3,
        (-half, half),
        start,
        end,
        lambda t: radius * np.array([np.cos(angle * t / half), np.sin(angle * t / half)]),
        exact,
    )


def double_pendulum(duration=2.0, gravity=9.81):
    """Two unit masses on unit rods, from rest at (1, 1.2); the guess is the path at nine times, joined by lines."""

    def lagrangian(t, x, v):
        kinetic = v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * ca.cos(x[0] - x[1])
        return kinetic + 2 * gravity * ca.cos(x[0]) + gravity * ca.cos(x[1])

    def acceleration(x, v):
        c, s = ca.cos(x[0] - x[1]), ca.sin(x[0] - x[1])
        first = -s * v[1] ** 2 - 2 * gravity * ca.sin(x[0])
        second = s * v[0] ** 2 - gravity * ca.sin(x[1])
        return ca.vertcat(first - c * second, 2 * second - c * first) / (2 - c**2)

    x, v = ca.SX.sym("x", 2), ca.SX.sym("v", 2)
    system = {"x": ca.vertcat(x, v), "ode": ca.vertcat(v, acceleration(x, v))}
    times = np.linspace(0, duration, 9)
    options = {"abstol": 1e-13, "reltol": 1e-13}
    states = np.array(ca.integrator("free", "cvodes", system, 0, times[1:].tolist(), options)(x0=[1, 1.2, 0, 0])["xf"])
    known = np.column_stack(([1, 1.2], states[:2]))
    return Case(
        "double pendulum, T = 2",
        lagrangian,
        acceleration,
        (0.0, duration),
        known[:, 0],
        known[:, -1],
        lambda t: np.array([np.interp(t, times, row) for row in known]),
    )


def layer(epsilon=1e-6):
    """Boundary layers of width sqrt(ε), on a mesh that is half within 40 widths of the left one."""
    width = np.sqrt(epsilon)
    return Case(
        "layer, ε = 1e-6",
        lambda t, x, v: epsilon * v[0] ** 2 / 2 + x[0] ** 2 / 2,
        lambda x, v: x / epsilon,
        (0.0, 1.0),
        np.array([1.0]),
        np.array([0.0]),
        straight([1], [0], (0, 1)),
        lambda t: np.array([(np.exp(-t / width) - np.exp((t - 2) / width)) / (1 - np.exp(-2 / width))]),
        lambda s: np.where(s < 0.8, 40 * width * s / 0.8, 40 * width + (1 - 40 * width) * (s - 0.8) / 0.2),
    )


def troesch(parameter=20.0):
    """Problem x'' = λ sinh λx; the guess solves the linearized equation, the mesh is graded towards the end."""
    return Case(
        "Troesch, λ = 20",
        lambda t, x, v: v[0] ** 2 / 2 + ca.cosh(parameter * x[0]),
        lambda x, v: parameter * ca.sinh(parameter * x),
        (0.0, 1.0),
        np.array([0.0]),
        np.array([1.0]),
        lambda t: np.array([np.sinh(parameter * t) / np.sinh(parameter)]),
        None,
        lambda s: 1 - (np.exp(13.0 * (1 - s)) - 1) / (np.exp(13.0) - 1),
    )


def chain(masses=20, duration=4.0):
    """Masses between walls, joined by stiffening springs, from rest positions to a bump."""

    def stretch(x):
        return ca.vertcat(x, 0) - ca.vertcat(0, x)

    def acceleration(x, v):
        force = stretch(x) + stretch(x) ** 3
        return force[1:] - force[:-1]

    end = 0.5 * np.sin(np.pi * np.arange(1, masses + 1) / (masses + 1)) ** 4
    return Case(
        f"chain of {masses} masses",
        lambda t, x, v: ca.dot(v, v) / 2 - ca.sum1(stretch(x) ** 2 / 2 + stretch(x) ** 4 / 4),
        acceleration,
        (0.0, duration),
        np.zeros(masses),
        end,
        straight(np.zeros(masses), end, (0, duration)),
    )


CASES = (kepler, double_pendulum, layer, troesch, chain)


def timed(calls, repeats=REPEATS):
    """Median seconds of each of several callables, called twice in turns: timed is the second call, which is warm."""
    seconds = [[] for _ in calls]
    for _ in range(repeats):
        for call, spent in zip(calls, seconds, strict=True):
            call()
            began = time.perf_counter()
            call()
            spent.append(time.perf_counter() - began)
    return [median(spent) for spent in seconds]


def fastest(calls):
    """Index of the fastest of several callables: after a few runs of all, more of those near the best."""
    seconds = np.array(timed(calls, FEW))
    near = np.flatnonzero(seconds <= NEAR * seconds.min())
    return int(near[np.argmin(timed([calls[i] for i in near], TRIALS))])


def truth(case):
    """The exact path, or one of degree 20 on fine intervals of the family of meshes; its own error is below 1e-13."""
    if case.exact is not None:
        return case.exact
    paths = [
        cg.solve(case.problem, cg.Galerkin(degree), mesh=case.mesh(48), guess=lambda t: case.guess(np.array([t]))[:, 0])
        for degree in (18, 20)
    ]
    times = case.mesh(400)
    difference = np.max(np.abs(paths[0](times) - paths[1](times)))
    print(f"{case.name}: two reference solutions differ by {difference:.1e}")
    return paths[1]


def inside(mesh):
    """Times at which errors are taken, (12 N,)."""
    return (mesh[:-1, None] + np.diff(mesh)[:, None] * WITHIN).ravel()


def ours(case, degree, intervals):
    """A callable that solves, and gives the path."""
    mesh = case.mesh(intervals)
    transcription = cg.transcribe(case.problem, cg.Galerkin(degree), mesh=mesh)
    guess = case.guess(DiscreteCalculus(cg.Galerkin(degree), mesh).node_times)

    return lambda: transcription.solve(guess=guess)


def collocation(case, degree, intervals, abstol, expand, linear_solver):
    """Hand-written collocation: a callable that solves, and one that gives positions inside and the success.

    Unknowns of an interval are the states at its start and at its m stages; the stage equations and the continuity
    of the collocation polynomial close the system, positions at both ends being given.
    """
    d, mesh = len(case.start), case.mesh(intervals)
    x, v, h = ca.SX.sym("x", d), ca.SX.sym("v", d), np.diff(mesh)
    rate = ca.Function("rate", [x, v], [ca.vertcat(v, case.acceleration(x, v))])
    stages = np.array(cg.gauss(degree).points)
    nodes = np.concatenate(([0.0], stages))
    slopes, ends = differentiation_matrix(nodes)[1:], lagrange_values(nodes, np.array([1.0]))[0]
    velocities = ca.MX.sym("velocities", d, intervals + 1)
    positions = ca.MX.sym("positions", d, intervals - 1)
    inner = ca.MX.sym("inner", 2 * d, degree * intervals)
    joints = ca.vertcat(ca.horzcat(case.start, positions, case.end), velocities)
    rates = rate.map(degree * intervals)(inner[:d, :], inner[d:, :])
    equations = []
    for i in range(intervals):
        stage = slice(degree * i, degree * (i + 1))
        states = ca.horzcat(joints[:, i], inner[:, stage])
        equations.append(ca.vec(states @ ca.DM(slopes).T - h[i] * rates[:, stage]))
        equations.append(states @ ca.DM(ends) - joints[:, i + 1])
    order = [velocities[:, 0], inner[:, :degree]]
    for i in range(1, intervals):
        order += [positions[:, i - 1], velocities[:, i], inner[:, degree * i : degree * (i + 1)]]
    unknown = ca.MX.sym("unknown", sum(part.numel() for part in order) + d)
    pieces = ca.vertsplit(unknown, np.cumsum([0, *[part.numel() for part in order], d]).tolist())
    given = [ca.reshape(piece, part.shape) for piece, part in zip(pieces, [*order, velocities[:, 0]], strict=True)]
    v_all = ca.horzcat(given[0], *given[3::3], given[-1])
    x_all = ca.horzcat(*given[2:-1:3]) if intervals > 1 else ca.MX(d, 0)
    z_all = ca.horzcat(given[1], *given[4::3])
    residual = ca.Function("residual", [velocities, positions, inner], [ca.vertcat(*equations)])(v_all, x_all, z_all)
    function = ca.Function("residual", [unknown], [residual])
    options = {"linear_solver": linear_solver, "abstol": abstol, "max_iter": 100, "error_on_fail": False}
    solver = ca.rootfinder("collocation", "newton", function.expand() if expand else function, options)
    times = (mesh[:-1, None] + h[:, None] * stages).ravel()
    place = ca.Function("place", [velocities, positions, inner], [ca.vertcat(*map(ca.vec, order), velocities[:, -1])])
    step = 1e-6 * (mesh[-1] - mesh[0])

    def speed(t):
        ahead, behind = np.minimum(t + step, mesh[-1]), np.maximum(t - step, mesh[0])
        return (case.guess(ahead) - case.guess(behind)) / (ahead - behind)

    first = place(speed(mesh), case.guess(mesh[1:-1]), np.vstack((case.guess(times), speed(times))))
    basis = ca.DM(lagrange_values(nodes, WITHIN).T)
    columns = [ca.horzcat(joints[:d, i], inner[:d, degree * i : degree * (i + 1)]) @ basis for i in range(intervals)]
    paths = ca.Function("paths", [velocities, positions, inner], [ca.horzcat(*columns)])
    read = ca.Function("read", [unknown], [paths(v_all, x_all, z_all)])

    def run():
        return solver(first)

    def answer():
        return np.array(read(run())), solver.stats()["success"]

    return run, answer


def numpy_function(name, function):
    """NumPy source of an SX Function, compiled: vectorized over the last axis of its inputs; a list of its outputs."""
    names = {
        ca.OP_ADD: "({} + {})", ca.OP_SUB: "({} - {})", ca.OP_MUL: "({} * {})", ca.OP_DIV: "({} / {})",
        ca.OP_NEG: "(-{})", ca.OP_SQ: "({0} * {0})", ca.OP_SQRT: "np.sqrt({})", ca.OP_SIN: "np.sin({})",
        ca.OP_COS: "np.cos({})", ca.OP_SINH: "np.sinh({})", ca.OP_COSH: "np.cosh({})", ca.OP_INV: "(1 / {})",
        ca.OP_TWICE: "(2 * {})", ca.OP_POW: "{} ** {}", ca.OP_CONSTPOW: "{} ** {}", ca.OP_ASSIGN: "{}",
    }  # fmt: skip
    lines = [f"def {name}(y):"]
    for k in range(function.n_instructions()):
        op, out, arguments = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if op == ca.OP_INPUT:
            lines.append(f"    w{out[0]} = y[{arguments[1]}]")
        elif op == ca.OP_OUTPUT:
            lines.append(f"    r{out[1]} = w{arguments[0]}")
        elif op == ca.OP_CONST:
            lines.append(f"    w{out[0]} = {function.instruction_constant(k)!r}")
        else:
            lines.append(f"    w{out[0]} = " + names[op].format(*(f"w{i}" for i in arguments)))
    lines.append(f"    return [{', '.join(f'r{i}' for i in range(function.nnz_out(0)))}]")
    scope = {"np": np}
    exec("\n".join(lines), scope)
    return scope[name]


def scipy_solver(case):
    """A callable of a tolerance and joints that solves by `solve_bvp` and gives its result."""
    d = len(case.start)
    y = ca.SX.sym("y", 2 * d)
    rate = ca.vertcat(y[d:], case.acceleration(y[:d], y[d:]))
    jacobian = ca.jacobian(rate, y)
    rows, columns = (np.array(index) for index in jacobian.sparsity().get_triplet())
    values = numpy_function("rate", ca.Function("rate", [y], [ca.densify(rate)]))
    entries = numpy_function("entries", ca.Function("entries", [y], [ca.vertcat(*jacobian.nonzeros())]))

    def right(t, y):
        return np.array([value + 0 * t for value in values(y)])

    def right_jacobian(t, y):
        full = np.zeros((2 * d, 2 * d, len(t)))
        for row, column, value in zip(rows, columns, entries(y), strict=True):
            full[row, column] = value
        return full

    left, zero, one = np.eye(d, 2 * d), np.zeros((d, 2 * d)), np.eye(d, 2 * d)
    ends = np.vstack((left, zero)), np.vstack((zero, one))

    def run(tol, joints):
        h = 1e-6 * (joints[-1] - joints[0])
        ahead, behind = np.minimum(joints + h, joints[-1]), np.maximum(joints - h, joints[0])
        guess = np.vstack((case.guess(joints), (case.guess(ahead) - case.guess(behind)) / (ahead - behind)))
        return solve_bvp(
            right,
            lambda a, b: np.concatenate((a[:d] - case.start, b[:d] - case.end)),
            joints,
            guess,
            fun_jac=right_jacobian,
            bc_jac=lambda a, b: ends,
            tol=tol,
            max_nodes=20_000,
        )

    return run


def by_scipy(case, exact, error):
    """Callables that solve to an error by `solve_bvp`, by their tolerance and number of joints."""
    run, times, found = scipy_solver(case), np.linspace(*case.t_span, 401)[1:-1], {}

    def reached(result):
        return result.success and relative(result.sol(times)[: len(case.start)], exact(times)) <= error

    for count in JOINTS:
        for tol in 10.0 ** -np.arange(3.0, 13.5, 0.5):
            result = run(tol, case.mesh(count - 1))
            if not reached(result):
                continue
            found[tol, count] = partial(run, tol, case.mesh(count - 1))
            again = run(tol, result.x)  # the mesh found beforehand, as the others have theirs
            if reached(again):
                found[tol, len(result.x)] = partial(run, tol, result.x)
            break
    return found


def smallest(case, exact):
    """Fewest intervals that reach each error, by degree: {error: [(degree, intervals), ...]}."""
    found = {error: [] for error in ERRORS}
    for degree in DEGREES:
        missing = list(ERRORS)
        for intervals in COUNTS:
            try:
                path = ours(case, degree, intervals)()
            except cg.ConvergenceError:
                continue
            times = inside(path.t)
            difference = relative(path(times), exact(times))
            while missing and difference <= missing[0]:
                found[missing.pop(0)].append((degree, intervals))
            if not missing:
                break
    return found


def relative(x, exact):
    """Largest error relative to the largest component."""
    return np.max(np.abs(x - exact)) / np.max(np.abs(exact))


def best(case, exact, error, cells):
    """Milliseconds of the three peers to one error, NaN where one fails, and the discretizations they took."""
    cells = sorted(cells, key=lambda cell: cell[0] ** 1.3 * cell[1])
    mine = [ours(case, *cell) for cell in cells]
    chosen = fastest(mine)
    theirs = {}
    for cell in cells[:CANDIDATES] + [cells[chosen]] * (chosen >= CANDIDATES):
        for expand in (True, False):
            for linear_solver in LINEAR_SOLVERS:
                run, answer = collocation(case, *cell, error / 10, expand, linear_solver)
                x, success = answer()
                if success and relative(x, exact(inside(case.mesh(cell[1])))) <= error:
                    theirs[cell, "scalars" if expand else "map", linear_solver] = run
    peer = list(theirs)[fastest(list(theirs.values()))] if theirs else None
    scipys = by_scipy(case, exact, error)
    way = list(scipys)[fastest(list(scipys.values()))] if scipys else None
    final = timed([mine[chosen]] + ([theirs[peer]] if theirs else []) + ([scipys[way]] if scipys else []))
    row = [final[0], final[1] if theirs else np.nan, final[-1] if scipys else np.nan]
    return [1e3 * value for value in row], (cells[chosen], peer, way)


def described(mine, peer, way):
    """Discretizations in words: degree and intervals, the variant by hand, SciPy's tolerance and first joints."""
    hand = "by hand fails" if peer is None else f"by hand {peer[0][0]} x {peer[0][1]}, {peer[1]}, {peer[2]}"
    return f"{mine[0]} x {mine[1]}; {hand}; " + ("SciPy fails" if way is None else "tol {:.0e}, {} joints".format(*way))


def main():
    """Measure all; returns {(case, error): milliseconds of this package, hand-written CasADi, SciPy}."""
    figures = {}
    for make in CASES:
        case = make()
        exact = truth(case)
        found = smallest(case, exact)
        for error in ERRORS:
            if not found[error]:
                print(f"{case.name:24} {error:6.0e}  not reached")
                continue
            figures[case.name, error], chosen = best(case, exact, error, found[error])
            mine, hand, bvp = figures[case.name, error]
            times = f"{mine:10.2f} {hand:10.2f} {bvp:10.2f} {hand / mine:10.2f}"
            print(f"{case.name:24} {error:6.0e} {times}   {described(*chosen)}", flush=True)
    return figures


def draw(figures, name):
    """Draw the table: one panel a problem, time over error, on logarithmic axes; a cross on top is a failure."""
    from matplotlib.ticker import NullLocator

    names = list(dict.fromkeys(problem for problem, _ in figures))
    *panels, words = cg.panels(2, 3, size=(8.4, 4.8), sharey=True).ravel()
    for panel, problem in zip(panels, names, strict=True):
        reached = np.array([error for error in ERRORS if (problem, error) in figures])
        times = np.array([figures[problem, error] for error in reached])
        for column, (peer, marker) in enumerate((("this", "o"), ("by hand", "s"), ("solve_bvp", "^"))):
            (line,) = panel.loglog(reached, times[:, column], marker=marker, label=peer)
            failed = reached[np.isnan(times[:, column])] * 1.25 ** (column - 1)
            top = {"transform": panel.get_xaxis_transform(), "color": line.get_color(), "in_layout": False}
            panel.plot(failed, np.full(len(failed), 0.94), "x", markeredgewidth=2, **top)
        panel.set(title=problem, xlabel="error of x", xticks=ERRORS)
        panel.xaxis.set_minor_locator(NullLocator())
        panel.invert_xaxis()
    for panel in (panels[0], panels[3]):
        panel.set_ylabel("solve alone in ms")
    words.axis("off")
    words.plot([], [], "kx", markeredgewidth=2, label="fails")
    lines = [*panels[0].lines[::2], words.lines[0]]
    words.legend(lines, [line.get_label() for line in lines], loc="center")
    words.figure.savefig(name, dpi=90)
    print(f"picture written to {name}")


if __name__ == "__main__":
    versions = f"CasADi {ca.__version__}, NumPy {np.__version__}, SciPy {scipy.__version__}"
    print(f"{date.today()}, Python {platform.python_version()}, {versions}, {platform.machine()}")
    print(f"{'milliseconds':24} {'error':>6} {'this':>10} {'by hand':>10} {'solve_bvp':>10} {'by hand/this':>10}")
    results = main()
    if len(sys.argv) > 1:
        draw(results, sys.argv[1])
    for error in ERRORS:
        ratios = [row[1] / row[0] for (_, e), row in results.items() if e == error and np.isfinite(row[1])]
        print(f"median of by hand / this at {error:g}: {np.median(ratios):.2f} over {len(ratios)} problems")
