"""One table of boundary problems with exact, published or computed values; `test_scenes_table.py` checks the table.

"exact" is a closed form, "published" comes from the named source, "computed" was found with independent
high-precision methods and is confirmed in the table's test by SciPy's DOP853.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import brentq

import casadi_galerkin as cg

MU = 398600.4418  # km^3/s^2, Earth
DAMPED = cg.BoundaryProblem(  # x'' + c x' + 4 x = 0, at first without friction
    lambda t, x, v, p: v[0] ** 2 / 2 - 2 * x[0] ** 2,
    (0, 2),
    [1.0],
    [0.5],
    parameters=[0.0],
    force=lambda t, x, v, p: -p[0] * v,
)


@dataclass(frozen=True)
class Scene:
    """A boundary problem, what is known of its path, and a discretization that resolves it.

    `path` is the exact path, t -> list of d CasADi expressions; `velocities` are known values of x' at the start
    and at the end; `values` known positions {t: x}; `index` the Morse index; `digits` the relative accuracy to which
    known numbers are given; `conserved` the Lagrangian's first integrals (t, x, v) -> scalar.
    """

    name: str
    lagrangian: Callable[..., Any]
    t_span: tuple[float, float]
    start: list[float | None]
    end: list[float | None]
    path: Callable[[Any], list[Any]] | None = None
    action: float | None = None
    velocities: tuple[list[float] | None, list[float] | None] = (None, None)
    values: dict[float, list[float]] = field(default_factory=dict)
    index: int | None = 0
    digits: float = 1e-13
    conserved: Callable[..., Any] | None = None
    guess: Callable[[float], list[float]] | None = None
    degree: int = 8
    mesh: np.ndarray | None = None
    intervals: int = 10

    @property
    def problem(self) -> cg.BoundaryProblem:
        return cg.BoundaryProblem(self.lagrangian, self.t_span, self.start, self.end)

    def solve(self, **options: Any) -> cg.Trajectory:
        return cg.solve(self.problem, cg.Galerkin(self.degree), mesh=self.joints, guess=self.guess, **options)

    @property
    def joints(self) -> np.ndarray:
        return np.linspace(*self.t_span, self.intervals + 1) if self.mesh is None else self.mesh


def energy(lagrangian: Callable[..., Any]) -> Callable[..., Any]:
    """First integral of an autonomous Lagrangian."""
    return lambda t, x, v: ca.dot(ca.gradient(lagrangian(t, x, v), v), v) - lagrangian(t, x, v)


def oscillator(t, x, v):
    return v[0] ** 2 / 2 - x[0] ** 2 / 2


def oscillator_problem(**changes):
    """The oscillator from 0 to 1 in unit time, or with other data."""
    fields = {"lagrangian": oscillator, "t_span": (0.0, 1.0), "start": [0.0], "end": [1.0]} | changes
    return cg.BoundaryProblem(**fields)


def pendulum(t, x, v):
    return v[0] ** 2 / 2 + ca.cos(x[0])


def troesch(rate):
    return lambda t, x, v: v[0] ** 2 / 2 + ca.cosh(rate * x[0])


def bratu(rate):
    return lambda t, x, v: v[0] ** 2 / 2 - rate * ca.exp(x[0])


def bratu_problem(rate=1.0):
    """Bratu's problem with its rate as a parameter; there are paths up to 3.51."""
    return cg.BoundaryProblem(
        lambda t, x, v, p: v[0] ** 2 / 2 - p[0] * ca.exp(x[0]), (0.0, 1.0), [0.0], [0.0], parameters=[rate]
    )


def boundary_layer(epsilon):
    return lambda t, x, v: epsilon * v[0] ** 2 / 2 + x[0] ** 2 / 2


def kepler(mu):
    return lambda t, x, v: ca.dot(v, v) / 2 + mu / ca.norm_2(x)


def catenoid(t, x, v):
    return x[0] * ca.sqrt(1 + v[0] ** 2)


def brachistochrone(t, x, v):
    return ca.sqrt((1 + v[0] ** 2) / (2 * x[0]))


def saddle(t, x, v):
    return (v[0] ** 2 + x[0] ** 2) / 2


def charged(t, x, v):
    return ca.dot(v, v) / 2 + (x[0] * v[1] - x[1] * v[0]) / 2


def free_particle(t, x, v):
    return ca.dot(v, v) / 2


def gravity(t, x, v):
    return ca.dot(v, v) / 2 - 9.81 * x[1]


def sphere(t, x, v):
    return (v[0] ** 2 + ca.cos(x[0]) ** 2 * v[1] ** 2) / 2


def damped(t, x, v):
    return ca.exp(t / 2) * (v[0] ** 2 - 4 * x[0] ** 2) / 2


def _oscillator(T: float) -> Scene:
    return Scene(
        f"oscillator {T}",
        oscillator,
        (0.0, T),
        [0.0],
        [1.0],
        path=lambda t: [ca.sin(t) / np.sin(T)],
        action=0.5 / np.tan(T),
        velocities=([1 / np.sin(T)], [1 / np.tan(T)]),
        index=int(T // np.pi),
        conserved=energy(oscillator),
        intervals=max(4, int(2 * T)),
        degree=12,
    )


def _long_pendulum(velocity: float, action: float, index: int, guess: Callable[[float], list[float]]) -> Scene:
    return Scene(
        f"long pendulum, index {index}",
        pendulum,
        (0.0, 10.0),
        [0.0],
        [1.0],
        action=action,
        velocities=([velocity], None),
        index=index,
        digits=1e-12,
        conserved=energy(pendulum),
        guess=guess,
        degree=10,
        intervals=40,
    )


# x'(0), x'(1) of Troesch's problem: the first two from H. Vazquez-Leal et al., 2012, the others computed in 40 digits.
TROESCH = {
    5.0: (0.045750461406318740, 12.100495450777814),
    10.0: (3.5833778463081369e-4, 148.40642115601013),
    20.0: (1.64877318278040357e-8, 22026.4657494067869),
    30.0: (7.48609379504381185e-13, 3269017.37247180473),
    50.0: (1.54299987832827604e-21, 72004899337.3858795),
}


def _troesch(rate: float) -> Scene:
    gap = 2 * np.exp(-rate / 2) / rate  # distance of the solution's pole from the end; steps shrink towards it
    mesh = 1 - gap * np.expm1(np.linspace(np.log1p(1 / gap), 0, int(4 * rate) + 1))
    mesh[0] = 0
    first, last = TROESCH[rate]
    return Scene(
        f"Troesch {rate:g}",
        troesch(rate),
        (0.0, 1.0),
        [0.0],
        [1.0],
        velocities=([first], [last]),
        digits=1e-12,
        conserved=energy(troesch(rate)),
        degree=12,
        mesh=mesh,
    )


def bratu_theta(rate: float, upper: bool) -> float:
    """Root of θ = √(2λ) cosh(θ/4); the two branches meet where the slope is 1, sinh(θ/4) = 4/√(2λ)."""
    fold = 4 * np.arcsinh(4 / np.sqrt(2 * rate))
    return brentq(
        lambda th: th - np.sqrt(2 * rate) * np.cosh(th / 4), *((fold, 40.0) if upper else (0, fold)), xtol=1e-15
    )


def _bratu(rate: float, upper: bool) -> Scene:
    theta = bratu_theta(rate, upper)
    height = 2 * np.log(np.cosh(theta / 4))
    return Scene(
        f"Bratu {rate} {'upper' if upper else 'lower'}",
        bratu(rate),
        (0.0, 1.0),
        [0.0],
        [0.0],
        path=lambda t: [-2 * ca.log(ca.cosh((t - 0.5) * theta / 2) / np.cosh(theta / 4))],
        velocities=([theta * np.tanh(theta / 4)], [-theta * np.tanh(theta / 4)]),
        index=int(upper),
        conserved=energy(bratu(rate)),
        guess=(lambda t: [4 * height * t * (1 - t)]) if upper else None,
        degree=10,
        intervals=20,
    )


def _layer(epsilon: float) -> Scene:
    width = np.sqrt(epsilon)
    decay = np.exp(-2 / width)
    inner = np.linspace(0, min(1.0, 40 * width), 41)
    return Scene(
        f"boundary layer {epsilon:g}",
        boundary_layer(epsilon),
        (0.0, 1.0),
        [1.0],
        [0.0],
        path=lambda t: [ca.exp(-t / width) * (1 - ca.exp(-2 * (1 - t) / width)) / (1 - decay)],
        action=width / 2 * (1 + decay) / (1 - decay),
        velocities=([-(1 + decay) / (1 - decay) / width], None),
        degree=12,
        mesh=inner if inner[-1] == 1 else np.concatenate((inner, np.linspace(inner[-1], 1, 21)[1:])),
    )


def _catenoid(c: float, index: int) -> Scene:
    h = 0.5
    area = h + c / 2 * np.sinh(2 * h / c)  # ∫ c cosh²(t/c) dt over [-h, h], times 1/c from x √(1 + v²) = c cosh²
    return Scene(
        f"catenoid, index {index}",
        catenoid,
        (-h, h),
        [1.0],
        [1.0],
        path=lambda t: [c * ca.cosh(t / c)],
        action=c * area,
        velocities=([-np.sinh(h / c)], [np.sinh(h / c)]),
        index=index,
        conserved=energy(catenoid),
        guess=None if index == 0 else lambda t: [c * np.cosh(t / c)],
        degree=12,
        intervals=24,
    )


def great_circle_ends() -> tuple[np.ndarray, np.ndarray]:
    return np.radians([40.6413, -73.7781]), np.radians([51.47, -0.4543])


def _great_circle() -> Scene:
    a, b = great_circle_ends()
    p, q = (np.array([np.cos(e[0]) * np.cos(e[1]), np.cos(e[0]) * np.sin(e[1]), np.sin(e[0])]) for e in (a, b))
    arc = 0.86956699387483005

    def path(t):
        point = (ca.sin((1 - t) * arc) * p + ca.sin(t * arc) * q) / np.sin(arc)
        return [ca.asin(point[2]), ca.atan2(point[1], point[0])]

    return Scene(
        "great circle",
        sphere,
        (0.0, 1.0),
        a.tolist(),
        b.tolist(),
        path=path,
        action=arc**2 / 2,
        conserved=lambda t, x, v: ca.cos(x[0]) ** 2 * v[1],
        degree=12,
    )


# The catenary's parameter c solves c cosh(h/c) = 1 at h = 1/2; refined from the published 15 digits.
CATENARIES = tuple(brentq(lambda c: c * np.cosh(0.5 / c) - 1, *ends, xtol=1e-16) for ends in ((0.8, 0.9), (0.2, 0.3)))

SCENES = [
    *(_oscillator(T) for T in (1.0, 2.0, 4.0, 7.0, 10.0)),
    Scene(
        "short pendulum",
        pendulum,
        (0.0, 1.0),
        [0.0],
        [1.0],
        action=1.3310039926528,
        velocities=([1.1762198416929], [0.6812471854829]),
        values={0.5: [0.5643038922354]},
        digits=1e-12,  # given to 13 decimals
        conserved=energy(pendulum),
    ),
    # From the straight line the solve finds one of the three; the guesses lead to each.
    _long_pendulum(1.9995687170165, -3.918564307581, 0, lambda t: [3 * np.sin(np.pi * t / 10) + t / 10]),
    _long_pendulum(1.8318277309911, 7.313292826489, 1, lambda t: [2.3 * np.sin(0.668 * t)]),
    _long_pendulum(1.3287479250456, 8.853960793438, 2, lambda t: [1.45 * np.sin(0.876 * t)]),
    *(_troesch(rate) for rate in TROESCH),
    *(_bratu(rate, upper) for rate in (1.0, 3.0) for upper in (False, True)),
    *(_layer(epsilon) for epsilon in (1.0, 1e-2, 1e-4, 1e-6, 1e-8)),
    Scene(
        "Lambert",  # D. Vallado, Fundamentals of Astrodynamics, 4th edition, example 5.7; km and s
        kepler(MU),
        (0.0, 4560.0),
        [15945.34, 0.0, 0.0],
        [12214.83899, 10249.46731, 0.0],
        velocities=([2.058913, 2.915965, 0.0], [-3.451565, 0.910315, 0.0]),
        digits=1e-6,  # published to 6 decimals
        conserved=energy(kepler(MU)),
    ),
    _catenoid(CATENARIES[0], 0),
    _catenoid(CATENARIES[1], 1),
    Scene(
        "brachistochrone",
        brachistochrone,
        (0.020574461395797, 1.901527855896044),
        [0.1224174381096273],
        [1.801143615546934],
        action=2.0,
        velocities=([1 / np.tan(0.25)], [1 / np.tan(1.25)]),  # x = 1 - cos θ, t = θ - sin θ, θ from 0.5 to 2.5
        digits=1e-12,
        conserved=lambda t, x, v: x[0] * (1 + v[0] ** 2),  # twice the radius of the cycloid, 2
        degree=10,
        mesh=0.020574461395797 + 1.880953394500247 * np.linspace(0, 1, 41) ** 2,
    ),
    Scene(
        "natural end",
        saddle,
        (0.0, 1.0),
        [1.0],
        [None],
        path=lambda t: [ca.cosh(1 - t) / np.cosh(1)],
        action=np.tanh(1) / 2,
        velocities=([-np.tanh(1)], [0.0]),
        conserved=energy(saddle),
    ),
    Scene(
        "charged particle",
        charged,
        (0.0, 1.0),
        [0.0, 1.0],
        [np.sin(1.0), np.cos(1.0)],
        path=lambda t: [ca.sin(t), ca.cos(t)],
        action=0.0,
        velocities=([1.0, 0.0], [np.cos(1.0), -np.sin(1.0)]),
        conserved=energy(charged),
    ),
    Scene(
        "free particle",
        free_particle,
        (-1.0, 3.0),
        [2.0, -1.0],
        [4.0, 5.0],
        path=lambda t: [2.5 + t / 2, 0.5 + 1.5 * t],
        action=5.0,
        velocities=([0.5, 1.5], [0.5, 1.5]),
        conserved=energy(free_particle),
        degree=2,
        intervals=3,
    ),
    Scene(
        "uniform gravity",
        gravity,
        (0.0, 2.0),
        [0.0, 0.0],
        [6.0, 1.0],
        path=lambda t: [3 * t, 10.31 * t - 9.81 * t**2 / 2],
        velocities=([3.0, 10.31], [3.0, -9.31]),
        conserved=energy(gravity),
        degree=2,
        intervals=3,
    ),
    _great_circle(),
    Scene(
        "damped oscillator",
        damped,
        (0.0, 1.0),
        [1.0],
        [0.0],
        action=-0.31037741408098835,
        velocities=([0.62075482816197670], None),
        values={0.5: [0.80683882876568644]},
    ),
]
BY_NAME = {scene.name: scene for scene in SCENES}
