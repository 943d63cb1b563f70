"""Thousands of seeded problems, tolerances 1e-3 to 1e-11: what is returned must be true, what is refused say why.

Smooth ones with a closed form, at scales of 1e-100 to 1e100 and with stiff layers, must be solved.  Kinks and steps at
random places in time and in x, ends on both sides of a singularity, ends next to a conjugate point, kinks of φ⁴ and
features narrower than a mesh may be refused.  Every answer is compared, along the whole path, with a closed form or
with an independent integration (DOP853 in pieces, its start corrected until it meets the end).
"""

import argparse
import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import casadi_galerkin as cg

WORST = 5.0  # an answer off by more tolerances is wrong
ORACLE = 1e-12  # relative error of the integrations
TIMES = 1001
SLOW = 10.0  # seconds of processor time that no run should take


@dataclass(frozen=True)
class Trial:
    """A problem of a kind, and what its path must be: `exact(path, times)` -> (d, K)."""

    kind: str
    problem: cg.BoundaryProblem
    exact: Any
    smooth: bool = False


def integrated(acceleration, end, cuts=(), surface=None):
    """The path of x'' = acceleration from the start of an answer to the same end, corrected by Newton's method.

    Parameters
    ----------
    acceleration : (t, x, v, side) -> (d,), with side the sign of `surface`, None without
    end : (d,)
    cuts : times at which it is not smooth
    surface : (x) -> number at whose zeros it is not smooth
    """

    def flow(x, v, times):
        d, found, side = len(x), [], None if surface is None else np.sign(surface(x)) or np.sign(surface(v))
        y, t, stops = np.append(x, v), times[0], [*(c for c in cuts if times[0] < c < times[-1]), times[-1]]
        while t < times[-1]:
            stop = next(s for s in stops if s > t)
            inner = np.nextafter(stop, t) if stop < times[-1] else stop

            def crossing(t, y, side=side):
                return side * surface(y[:d])

            events = [] if surface is None else [crossing]
            for event in events:
                event.terminal, event.direction = True, -1
            piece = solve_ivp(
                lambda t, y, side=side: np.append(y[d:], acceleration(t, y[:d], y[d:], side)),
                (t, inner), y, "DOP853", dense_output=True, events=events, rtol=3e-14, atol=1e-16,
            )  # fmt: skip
            last = piece.t[-1] if piece.status == 1 else stop
            inside = (times >= t if not found else times > t) & (times <= last)
            found.append(piece.sol(np.clip(times[inside], t, piece.t[-1]))[:d])
            y, t = piece.y[:, -1], last
            side = -side if piece.status == 1 else side
        return np.concatenate(found, axis=1), y[:d]

    def exact(path, times):
        x, v = path.x[:, 0], path.velocity[:, 0]
        for _ in range(6):
            reached = flow(x, v, times)[1]
            step = 1e-7 * max(np.max(np.abs(v)), 1e-3)
            slopes = [(flow(x, v + step * e, times)[1] - reached) / step for e in np.eye(len(v))]
            v = v - np.linalg.solve(np.array(slopes).T, reached - end)
        return flow(x, v, times)[0]

    return exact


def star(random, width=0.0):
    """L = m(t) |v - x*'|²/2 + V(x - x*), V convex: x* solves it, and nothing else does."""
    d, t = int(random.integers(1, 3)), ca.SX.sym("t")
    span = (float(random.uniform(-2, 0)), float(random.uniform(0.5, 4)))

    def component():
        frequency, phase, center = random.uniform(0.5, 12), random.uniform(0, 6), random.uniform(*span)
        shapes = [ca.sin(frequency * t + phase), ca.exp(0.5 * ca.sin(frequency * t)) + t]
        if width:
            shapes = [1 / (1 + ((t - center) / width) ** 2), ca.tanh((t - center) / width)]
        return random.uniform(0.5, 2) * shapes[random.integers(2)] + random.uniform(-1, 1) * t

    path = ca.vertcat(*(component() for _ in range(d)))
    known = ca.Function("known", [t], [path, ca.jacobian(path, t)])
    stiffness, quartic = 10 ** random.uniform(-1, 3), random.uniform(0, 2)
    coupling, ripple = random.uniform(-0.9, 0.9), random.uniform(0, 0.45)

    def lagrangian(t, x, v):
        at, rate = known(t)
        u, w = x - at, v - rate
        kinetic = ca.dot(w, w) / 2 + (coupling * w[0] * w[1] if d == 2 else 0)
        return (1 + ripple * ca.sin(3 * t)) * kinetic + stiffness * ca.dot(u, u) / 2 + quartic * ca.dot(u, u) ** 2

    ends = [np.array(known(s)[0]).ravel() for s in span]
    return lagrangian, span, ends, lambda times: np.array(known.map(len(times))(times[None])[0]).reshape(d, -1)


def smooth(random):
    """Made of a known path."""
    lagrangian, span, ends, known = star(random)
    return Trial("smooth", cg.BoundaryProblem(lagrangian, span, *ends), lambda path, t: known(t), True)


def narrow(random):
    """The same with a feature down to a thousandth of the duration."""
    lagrangian, span, ends, known = star(random, 10 ** random.uniform(-3, -1))
    return Trial("narrow", cg.BoundaryProblem(lagrangian, span, *ends), lambda path, t: known(t))


def scaled(random):
    """The same in units of action of 1e-100 to 1e100, of length and time of 1e-50 to 1e50."""
    lagrangian, span, ends, known = star(random)
    action, length, duration = 10.0 ** (random.uniform(-1, 1, 3) * [100, 50, 50])
    problem = cg.BoundaryProblem(
        lambda t, x, v: action * lagrangian(t / duration, x / length, v * (duration / length)),
        [duration * t for t in span],
        *[length * end for end in ends],
    )
    return Trial("scaled", problem, lambda path, t: length * known(t / duration), True)


def stiff(random):
    """A boundary layer of width √ε."""
    width = 10 ** random.uniform(-5, -0.5)
    problem = cg.BoundaryProblem(lambda t, x, v: width**2 * v[0] ** 2 / 2 + x[0] ** 2 / 2, (0, 1), [1.0], [0.0])

    def exact(path, t):
        return (np.exp(-t / width) * np.expm1(-2 * (1 - t) / width) / np.expm1(-2 / width))[None]

    return Trial("stiff", problem, exact, True)


def arc(random):
    """Kepler's problem between ends less than half a revolution apart."""
    radii, angle = random.uniform(0.5, 1.5, 2), random.uniform(0.2, 2.4)
    ends = radii[0] * np.array([1.0, 0.0]), radii[1] * np.array([np.cos(angle), np.sin(angle)])
    return kepler("arc", ends, angle * np.mean(radii) ** 1.5 * random.uniform(0.7, 1.2), True)


def through(random):
    """Kepler's problem between ends on both sides of the sun, from the straight line through it."""
    radii, aside = random.uniform(0.3, 1.5, 2), random.choice([0.0, 1e-6, 1e-3])
    ends = np.array([radii[0], 0.0]), np.array([-radii[1], aside])
    return kepler("through the sun", ends, random.uniform(0.7, 4.0))


def kepler(kind, ends, duration, smooth=False):
    """Kepler's problem between two ends."""
    problem = cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + 1 / ca.norm_2(x), (0, duration), *ends)
    return Trial(kind, problem, integrated(lambda t, x, v, side: -x / np.hypot(*x) ** 3, ends[1]), smooth)


def conjugate(random):
    """Oscillator whose time span ends a little before or after a conjugate point."""
    end = np.pi * random.integers(1, 4) - random.choice([-1, 1]) * 10 ** random.uniform(-14, -2)
    problem = cg.BoundaryProblem(lambda t, x, v: (v[0] ** 2 - x[0] ** 2) / 2, (0, end), [0.0], [float(np.sin(end))])
    return Trial("conjugate", problem, lambda path, t: np.sin(t)[None])


def soliton(random):
    """The kink of φ⁴ over a long time."""
    half = random.uniform(2, 14)
    ends = [[float(np.tanh(side * half / np.sqrt(2)))] for side in (-1, 1)]
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 + (x[0] ** 2 - 1) ** 2 / 4, (-half, half), *ends)
    return Trial("soliton", problem, lambda path, t: np.tanh(t / np.sqrt(2))[None])


def step_in_time(random, named=False):
    """A stiffness that jumps, at a time that may be named."""
    when, (low, high) = random.uniform(0.1, 1.9), random.uniform(0.2, 2, 2)
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 - ca.if_else(t < when, low, high) * x[0] ** 2 / 2, (0, 2), [1.0], [-0.5],
        breakpoints=[when] if named else [],
    )  # fmt: skip
    exact = integrated(lambda t, x, v, side: -(low if t < when else high) * x, [-0.5], [when])
    return Trial("step in time, named" if named else "step in time", problem, exact, named)


def named_step(random):
    """The same, named."""
    return step_in_time(random, True)


def kink_in_time(random):
    """A push that sets in."""
    when, push = random.uniform(0.1, 1.9), 10 ** random.uniform(-1, 2)
    problem = cg.BoundaryProblem(
        lambda t, x, v: v[0] ** 2 / 2 + push * x[0] * ca.fmax(t - when, 0), (0, 2), [1.0], [-0.5]
    )

    def exact(path, t):
        pushed = [push * np.maximum(s - when, 0) ** 3 / 6 for s in (t, 2.0)]
        return (1 + pushed[0] + t / 2 * (-1.5 - pushed[1]))[None]

    return Trial("kink in time", problem, exact)


def kink_in_x(random):
    """A force that turns round at a wall."""
    place, pull = random.uniform(-0.4, 0.9), random.uniform(1, 12)
    problem = cg.BoundaryProblem(lambda t, x, v: v[0] ** 2 / 2 - pull * ca.fabs(x[0] - place), (0, 2), [1.0], [-0.5])
    exact = integrated(lambda t, x, v, side: np.array([-side * pull]), [-0.5], surface=lambda x: x[0] - place)
    return Trial("kink in x", problem, exact)


def step_in_x(random):
    """A stiffness that jumps at a place."""
    place, (low, high) = random.uniform(-0.4, 0.9), random.uniform(0.2, 2, 2)

    def lagrangian(t, x, v):
        u = x[0] - place
        return v[0] ** 2 / 2 - ca.if_else(u < 0, low, high) * u**2 / 2

    problem = cg.BoundaryProblem(lagrangian, (0, 2), [1.0], [-0.5])
    exact = integrated(
        lambda t, x, v, side: -(high if side > 0 else low) * (x - place), [-0.5], surface=lambda x: x[0] - place
    )
    return Trial("step in x", problem, exact)


KINDS = (
    smooth, narrow, scaled, stiff, arc, through, conjugate, soliton, step_in_time, named_step, kink_in_time, kink_in_x,
    step_in_x,
)  # fmt: skip


def trial(seed):
    """The problem of a seed, and its tolerance."""
    random = np.random.default_rng(seed)
    return KINDS[seed % len(KINDS)](random), float(10 ** random.uniform(-11, -3))


@dataclass(frozen=True)
class Outcome:
    """What came of a trial: right, refused or wrong; seconds; error over the tolerance; the words of a refusal."""

    trial: Trial
    tol: float
    verdict: str
    seconds: float
    error: float = np.nan
    said: str = ""


def outcome(seed):
    """Solve the problem of a seed, and judge its path."""
    case, tol = trial(seed)
    began = time.process_time()  # of this process alone, whatever else the cores do
    try:
        path = cg.solve(case.problem, tol=tol)
    except cg.ConvergenceError as failure:
        return Outcome(case, tol, "refused", time.process_time() - began, said=str(failure))
    seconds = time.process_time() - began
    times = np.linspace(*case.problem.t_span, TIMES)
    exact = case.exact(path, times)
    error = np.max(np.abs(path(times) - exact) / np.max(np.abs(exact), axis=1, keepdims=True))
    verdict = "right" if error <= WORST * max(tol, ORACLE) else "wrong"
    return Outcome(case, tol, verdict, seconds, error / tol)


def main(count=2000, first=0):
    """Solve so many problems and print what came of them, by kind; returns the outcomes."""
    found = []
    for seed in range(first, first + count):
        one = outcome(seed)
        found.append(one)
        if one.verdict == "wrong" or one.seconds > SLOW or (one.trial.smooth and one.verdict == "refused"):
            print(f"seed {seed}, {one.trial.kind}, tol {one.tol:.1e}: {one.verdict}, {one.error:.1f} tol off, "
                  f"{one.seconds:.1f} s {one.said}")  # fmt: skip
    print(f"{'kind':22}{'right':>8}{'refused':>9}{'wrong':>7}{'slowest/s':>11}")
    for kind in dict.fromkeys(one.trial.kind for one in found):
        group = [one for one in found if one.trial.kind == kind]
        verdicts = [one.verdict for one in group]
        counts = f"{verdicts.count('right'):8d}{verdicts.count('refused'):9d}{verdicts.count('wrong'):7d}"
        print(f"{kind:22}{counts}{max(one.seconds for one in group):11.2f}")
    smooth = [one.verdict for one in found if one.trial.smooth]
    print(f"{smooth.count('right')} of {len(smooth)} smooth ones solved")
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000, help="problems")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    main(**vars(parser.parse_args()))
