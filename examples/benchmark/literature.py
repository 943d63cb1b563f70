"""Optimal control problems of the literature, solved to a tolerance: found, published, estimated error, seconds.

Every problem is stated as it was published, and begins with the default guess, but for two that have one of their own.
Costs are compared with closed forms where there are some, evaluated by functions below.  The others were computed with
this package on finer meshes or to tighter tolerances: there the published digits are what is independent.  What is
bounded is the error of the cost alone, or with ``--path`` that of all, which some problems do not reach, most of them
with singular arcs: printed is then the path attached to the error.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve

import casadi_galerkin as cg

sys.path.insert(0, str(Path(__file__).parents[1]))

import cart_pole as swing_up
import goddard as rocket
import hypersensitive as layers
import low_thrust as spiral

INF = np.inf


KNOWN = 3e-9  # relative error of the costs compared with
SECONDS = 10.0  # that a problem may take


@dataclass(frozen=True)
class Case:
    """A problem, its published cost, NaN if there is none, and it to more digits; a guess where a line is a bad one."""

    problem: cg.ControlProblem
    published: float
    exact: float
    guess: Any = None


def riccati():
    """Cost of the regulator from the flow of states and costates over its ten seconds."""
    flow = expm(10 * np.array([[0, 1, 0, 0], [0, 0, 0, -1], [-1, 0, 0, 0], [0, 0, -1, 0]]))
    return -np.linalg.solve(flow[2:, 2:], flow[2:, :2])[0, 0] / 2


def least_fuel():
    """Fuel of the moon lander: free fall, then full thrust until height and speed are zero together."""
    thrust, exhaust = 1.227, 2.349

    def missed(times):
        fall, burn = times
        gained = quad(lambda t: -exhaust * np.log(1 - thrust * t / exhaust), 0, burn, epsabs=1e-15)[0]
        speed = -0.783 - fall
        height = 1 - 0.783 * fall - fall**2 / 2 + speed * burn - burn**2 / 2 + gained
        return height, speed - burn - exhaust * np.log(1 - thrust * burn / exhaust)

    return thrust * fsolve(missed, [0.24, 1.15], xtol=1e-14)[1]


def crossing():
    """Duration of Zermelo's crossing from its headings at both ends (Bryson and Ho, equations 2.7.12 to 2.7.15)."""

    def missed(headings):
        (tan0, tan1), (sec0, sec1) = np.tan(headings), 1 / np.cos(headings)
        way = sec1 * (tan1 - tan0) - tan0 * (sec1 - sec0) + np.log((tan1 + sec1) / (tan0 + sec0))
        return sec0 - sec1 + 1.86, -way / 2 - 3.66

    return float(np.diff(np.tan(fsolve(missed, np.radians([105, 240]), xtol=1e-14)))[0])


def cycloid(friction):
    """Duration of a slide with friction: without it, in axes turned by the angle of friction, with more gravity."""
    more = np.hypot(1, friction)
    along, down = 2 * (1 + friction) / more, 2 * (1 - friction) / more
    angle = brentq(lambda a: (a - np.sin(a)) / (1 - np.cos(a)) - along / down, 0.1, 6)
    return angle * np.sqrt(down / (1 - np.cos(angle)) / (9.81 * more))


def catenary():
    """Potential energy of a chain of length 4 from a height of 1 to one of 3, at a distance of 1."""
    a = brentq(lambda a: 2 * a * np.sinh(1 / (2 * a)) - np.sqrt(4**2 - 2**2), 0.1, 1)
    lowest = 1 / 2 - a * np.arctanh(2 / 4)

    def of_length(x):
        return np.cosh((x - lowest) / a)

    return quad(lambda x: (1 + a * (of_length(x) - of_length(0))) * of_length(x), 0, 1, epsabs=1e-14)[0]


def mass(**changes):
    """Unit mass on a line, from rest to rest."""
    fields = {
        "lagrangian": lambda t, x, v: v[0] ** 2 / 2,
        "t_span": (0.0, 1.0),
        "start": [0.0],
        "end": [1.0],
        "start_velocity": [0.0],
        "end_velocity": [0.0],
        "force": lambda t, x, v, u: u,
        "running_cost": lambda t, x, v, u: u[0] ** 2 / 2,
        "controls": 1,
    }
    return cg.ControlProblem(**(fields | changes))


def shortest(t, x, v, u):
    """The running cost of minimum time."""
    return 1


def cart_pole():
    """M. Kelly, SIAM Review 59 (2017)."""
    return Case(swing_up.problem(), 58.8077, 58.807667459)


def low_thrust():
    """From a circular orbit to one of twice the radius with the least squared thrust; the angle of arrival is free."""
    return Case(spiral.problem(), np.nan, 0.00221872638555, spiral.guess)


def bryson_denham():
    """A. E. Bryson, W. F. Denham, S. E. Dreyfus, AIAA Journal 1 (1963), with the wall at 1/9: 4/9 of 9."""
    problem = mass(end=[0.0], start_velocity=[1.0], end_velocity=[-1.0], position_bounds=(-INF, 1 / 9))
    return Case(problem, 4.0, 4.0)


def speed_limit():
    """From rest to rest, 1.5 away, with a speed and a force of at most 1: 2.5."""
    problem = mass(
        end=[1.5],
        running_cost=shortest,
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.1, 10.0),
        path_constraint=(lambda t, x, v, u: v[0], -1.0, 1.0),
    )
    return Case(problem, 2.5, 2.5)


def goddard():
    """Goddard's rocket as in COPS 3 (2004): the greatest height in its units."""
    return Case(rocket.problem(), -1.01284, -rocket.HIGHEST)


def hypersensitive():
    """A. V. Rao, K. D. Mease, Automatica 35 (1999)."""
    return Case(layers.problem(), 1.33081, layers.EXACT)


def moon_lander():
    """Soft landing with least fuel, PSOPT's manual: one switch."""
    problem = cg.ControlProblem(
        lambda t, x, v: x[1] * v[0] ** 2 / 2 - x[1] * x[0],
        (0.0, 1.5), [1.0, 1.0], [0.0, None], [-0.783, None], [0.0, None],
        force=lambda t, x, v, u: u[0] - u[0] / 2.349 * v[0],
        running_cost=lambda t, x, v, u: u[0],
        controls=1,
        control_bounds=(0.0, 1.227),
        duration_bounds=(0.1, 10.0),
        position_bounds=([-INF, 0.01], [INF, INF]),
        rates=lambda t, x, v, u: -u[0] / 2.349,
    )  # fmt: skip
    return Case(problem, 1.4204, least_fuel())


def robot_arm():
    """The arm of COPS 3 (2004), three joints in minimum time."""

    def inertia(x):
        return ((5 - x[0]) ** 3 + x[0] ** 3) / 3

    problem = cg.ControlProblem(
        lambda t, x, v: ca.dot(v, v) / 2,
        (0.0, 1.0), [4.5, 0.0, np.pi / 4], [4.5, 2 * np.pi / 3, np.pi / 4], [0.0] * 3, [0.0] * 3,
        force=lambda t, x, v, u: [u[0] / 5, u[1] / (inertia(x) * ca.sin(x[2]) ** 2), u[2] / inertia(x)],
        running_cost=shortest,
        controls=3,
        control_bounds=(-1.0, 1.0),
        position_bounds=([0.0, -np.pi, 0.0], [5.0, np.pi, np.pi]),
        duration_bounds=(0.1, 100.0),
    )  # fmt: skip
    return Case(problem, 9.1409, 9.140911746)


def regulator():
    """Double integrator, ∫ (x² + u²)/2 over [0, 10] from 1 with a free end: its Riccati equation gives the cost."""
    problem = mass(
        t_span=(0.0, 10.0), start=1.0, end=None, end_velocity=None,
        running_cost=lambda t, x, v, u: (x[0] ** 2 + u[0] ** 2) / 2,
    )  # fmt: skip
    return Case(problem, np.nan, riccati())


def van_der_pol():
    """PROPT's van der Pol oscillator: u within [-0.3, 1]."""
    problem = mass(
        t_span=(0.0, 5.0), start=1.0, end=None, end_velocity=None,
        lagrangian=lambda t, x, v: v[0] ** 2 / 2 - x[0] ** 2 / 2,
        force=lambda t, x, v, u: (1 - x[0] ** 2) * v[0] + u[0],
        running_cost=lambda t, x, v, u: x[0] ** 2 + v[0] ** 2 + u[0] ** 2,
        control_bounds=(-0.3, 1.0),
    )  # fmt: skip
    return Case(problem, 2.86726, 2.8672610452)


def zermelo():
    """Zermelo's ship in a current that grows with the distance from the shore, Bryson and Ho (1975), section 2.7."""
    problem = cg.ControlProblem(
        t_span=(0.0, 5.0),
        start=[3.66, -1.86],
        end=[0.0, 0.0],
        running_cost=lambda t, x, u: 1,
        controls=1,
        duration_bounds=(0.1, 100.0),
        rates=lambda t, x, u: [ca.cos(u[0]) - x[1], ca.sin(u[0])],
    )
    return Case(problem, 5.46, crossing())


def quadrotor(distance=3.0):
    """A plane quadrotor in minimum time, M. Hehn, R. Ritz, R. D'Andrea, Autonomous Robots 33 (2012)."""
    problem = cg.ControlProblem(
        lambda t, x, v: (v[0] ** 2 + v[1] ** 2) / 2 - 9.81 * x[1],
        (0.0, 1.0), [0.0, 0.0, 0.0], [distance, 0.0, 0.0], [0.0, 0.0, None], [0.0, 0.0, None],
        force=lambda t, x, v, u: [u[0] * ca.sin(x[2]), u[0] * ca.cos(x[2])],
        running_cost=shortest,
        controls=2,
        control_bounds=([1.0, -10.0], [20.0, 10.0]),
        duration_bounds=(0.1, 10.0),
        rates=lambda t, x, v, u: u[1],
    )  # fmt: skip
    return Case(problem, 0.898, 0.898702918)


def crane():
    """A container crane, Y. Sakawa, Y. Shindo, Automatica 18 (1982); squared controls cost a hundredth."""
    problem = cg.ControlProblem(
        lambda t, x, v: (v[0] ** 2 + v[1] ** 2 + v[2] ** 2) / 2,
        (0.0, 9.0), [0.0, 22.0, 0.0], [10.0, 14.0, 0.0], [0.0, -1.0, 0.0], [2.5, 0.0, 0.0],
        force=lambda t, x, v, u: [
            u[0] + 17.2656 * x[2], u[1], -(u[0] + 27.0756 * x[2] + 2 * v[1] * v[2]) / x[1]
        ],
        running_cost=lambda t, x, v, u: (x[2] ** 2 + v[2] ** 2 + 0.01 * (u[0] ** 2 + u[1] ** 2)) / 2,
        controls=2,
        control_bounds=([-2.83374, -0.80865], [2.83374, 0.71265]),
        path_constraint=(lambda t, x, v, u: [v[0], v[1]], [-2.5, -1.0], [2.5, 1.0]),
    )  # fmt: skip
    return Case(problem, 0.037520, 0.0375194614)


def brachistochrone(friction=0.3):
    """Sliding down with friction, N. Ashby et al., American Journal of Physics 43 (1975)."""
    problem = cg.ControlProblem(
        t_span=(0.0, 1.0),
        start=[0.0, 0.0, 0.0],
        end=[2.0, 2.0, None],
        running_cost=lambda t, x, u: 1,
        controls=1,
        duration_bounds=(0.1, 10.0),
        rates=lambda t, x, u: [
            x[2] * ca.sin(u[0]),
            x[2] * ca.cos(u[0]),
            9.81 * (ca.cos(u[0]) - friction * ca.sin(u[0])),
        ],
    )
    return Case(problem, np.nan, cycloid(friction))


def dubins():
    """The shortest way of a car that turns left, runs straight and turns left, L. E. Dubins (1957)."""
    problem = cg.ControlProblem(
        t_span=(0.0, 6.0),
        start=[0.0, 0.0, 0.0],
        end=[4.0, 4.0, np.pi],
        running_cost=lambda t, x, u: 1,
        controls=1,
        control_bounds=(-1.0, 1.0),
        duration_bounds=(0.1, 50.0),
        rates=lambda t, x, u: [ca.cos(x[2]), ca.sin(x[2]), u[0]],
    )
    return Case(problem, np.nan, np.pi + np.sqrt(20))


def chain():
    """The hanging chain of COPS 3 (2004): its slope is the control."""
    problem = cg.ControlProblem(
        t_span=(0.0, 1.0),
        start=[1.0, 0.0],
        end=[3.0, 4.0],
        running_cost=lambda t, x, u: x[0] * ca.sqrt(1 + u[0] ** 2),
        controls=1,
        rates=lambda t, x, u: [u[0], ca.sqrt(1 + u[0] ** 2)],
    )
    return Case(problem, 5.06891, catenary())


def hang_glider():
    """The farthest flight through a thermal, COPS 3 (2004), in m and s."""

    def force(t, x, v, u):
        place = (x[0] / 100 - 2.5) ** 2
        sinking = v[1] - 2.5 * (1 - place) * ca.exp(-place)
        push = 1.13 * 14 / 2 * ca.sqrt(v[0] ** 2 + sinking**2) / 100  # density, wing, mass
        drag, lift = push * (0.034 + 0.069662 * u[0] ** 2), push * u[0]
        return [-lift * sinking - drag * v[0], lift * v[0] - drag * sinking]

    problem = cg.ControlProblem(
        lambda t, x, v: (v[0] ** 2 + v[1] ** 2) / 2 - 9.81 * x[1],
        (0.0, 100.0), [0.0, 1000.0], [None, 900.0], [13.23, -1.288], [13.23, -1.288],
        force=force,
        controls=1,
        terminal_cost=lambda t, x, v: -x[0],
        control_bounds=(0.0, 1.4),
        duration_bounds=(10.0, 200.0),
    )  # fmt: skip
    return Case(problem, -1248.03, -1247.9876008, lambda t: [13.23 * t, 1000 - t])


def orbit_raising():
    """The largest circular orbit with a given thrust and time, Bryson and Ho (1975), section 2.5."""

    def force(t, x, v, u):
        thrust = 0.1405 / (1 - 0.0749 * t)
        return [thrust * ca.sin(u[0]), x[0] * thrust * ca.cos(u[0])]

    problem = cg.ControlProblem(
        lambda t, x, v: (v[0] ** 2 + (x[0] * v[1]) ** 2) / 2 + 1 / x[0],
        (0.0, 3.3207), [1.0, 0.0], [None, None], [0.0, 1.0], [0.0, None],
        force=force,
        controls=1,
        terminal_cost=lambda t, x, v: -x[0],
        position_bounds=([0.5, -INF], INF),
        end_conditions=(lambda x0, v0, x1, v1: x1[0] ** 3 * v1[1] ** 2, 1.0, 1.0),
    )  # fmt: skip
    return Case(problem, -1.525, -1.525527077)


def shuttle():
    """A space shuttle's reentry to the largest latitude, J. T. Betts (2010), section 6.1; units are 1e5 ft and 10 s."""
    degree = np.pi / 180

    def rates(t, x, u):
        height, _, latitude, speed, climb, heading = (x[i] for i in range(6))
        attack, bank = u[0] / degree, u[1]
        radius, mass = 209.029 + height, 203000 / 32.174
        pressure = 0.002378 * ca.exp(-height / 0.238) * (1e4 * speed) ** 2 * 2690 / 2 / mass * 1e-3
        drag = pressure * (0.07854 - 0.0061592 * attack + 0.000621408 * attack**2)
        lift, gravity = pressure * (-0.20704 + 0.029244 * attack), 0.14076539e4 / radius**2
        along = speed / radius * ca.cos(climb)
        return [
            speed * ca.sin(climb),
            along * ca.sin(heading) / ca.cos(latitude),
            along * ca.cos(heading),
            -drag - gravity * ca.sin(climb),
            lift * ca.cos(bank) / speed + ca.cos(climb) * (speed / radius - gravity / speed),
            lift * ca.sin(bank) / (speed * ca.cos(climb)) + along * ca.sin(heading) * ca.tan(latitude),
        ]

    problem = cg.ControlProblem(
        t_span=(0.0, 200.0),
        start=[2.6, 0.0, 0.0, 2.56, -degree, np.pi / 2],
        end=[0.8, None, None, 0.25, -5 * degree, None],
        controls=2,
        terminal_cost=lambda t, x: -x[2] / degree,
        control_bounds=([-np.pi / 2, -89 * degree], [np.pi / 2, degree]),
        position_bounds=([0, -INF, -89 * degree, 1e-4, -89 * degree, -INF], [4, INF, 89 * degree, 4, 89 * degree, INF]),
        duration_bounds=(50.0, 400.0),
        rates=rates,
    )
    return Case(problem, -34.1412, -34.141184285)


CASES = {f.__name__: f for f in (
    cart_pole, low_thrust, bryson_denham, speed_limit, goddard, hypersensitive, moon_lander, robot_arm, regulator,
    van_der_pol, zermelo, quadrotor, crane, brachistochrone, dubins, chain, hang_glider, orbit_raising, shuttle,
)}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What came of a problem: its cost, the estimated and the true error of it, seconds, and the words of a refusal."""

    cost: float
    estimate: float
    error: float
    intervals: int
    seconds: float
    said: str


def outcome(case, verbose=0, **tolerance):
    """Solve a problem to a tolerance, of the path or of the cost; the estimate is that of the error which it bounds."""
    began, said = time.perf_counter(), ""
    try:
        path = cg.solve(case.problem, **tolerance, guess=case.guess, limits=cg.Limits(seconds=SECONDS), verbose=verbose)
    except cg.LimitReached as failure:
        path, said = failure.path, str(failure)
    seconds = time.perf_counter() - began
    error = abs(path.cost / case.exact - 1)
    estimate = path.cost_error if "of" in tolerance else path.error_estimate
    return Outcome(path.cost, estimate, error, len(path.t) - 1, seconds, said)


def main(names=(), tols=(1e-6,), path=False, verbose=0):
    """Print what was found of every problem; returns the outcomes."""
    print(f"{'problem':17}{'tol':>8}{'cost':>18}{'published':>12}{'error':>9}{'estimate':>9}{'intervals':>10}{'s':>7}")
    outcomes = []
    for name in names or CASES:
        case = CASES[name]()
        for tol in tols:
            one = outcome(case, verbose, tol=tol, **({} if path else {"of": lambda path: path.cost}))
            outcomes.append(one)
            print(f"{name:17}{tol:8.0e}{one.cost:18.10f}{case.published:12.6f}{one.error:9.1e}{one.estimate:9.1e}"
                  f"{one.intervals:10d}{one.seconds:7.2f} {one.said[:100]}", flush=True)  # fmt: skip
    answers = [one for one in outcomes if not one.said]
    bounded = sum(one.error <= max(one.estimate, KNOWN) for one in answers)
    refused = len(outcomes) - len(answers)
    print(f"{refused} runs without an answer; the estimate bounds the error of the cost in {bounded} of {len(answers)}")
    return outcomes


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="problems, all if none is named")
    parser.add_argument("--tols", type=float, nargs="+", default=[1e-6], help="tolerances")
    parser.add_argument("--path", action="store_true", help="bound the error of the path, too")
    parser.add_argument("--verbose", type=int, default=0)
    main(**vars(parser.parse_args()))
