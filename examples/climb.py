"""A supersonic aircraft climbs to 20 km and Mach 1 in the least time: tables of thrust, drag, lift and air.

The thrust depends on Mach number and altitude (A. E. Bryson, M. N. Desai, W. C. Hoffman, Journal of Aircraft 6, 1969);
the lower corner of their table is filled as others have done.  Cubic splines go through all tables.  Bounds on altitude
and Mach number keep the answer inside of them; where they are left, the answer is refused.

J. T. Betts (2010) found 324.975 s with splines that are smoother where drag rises.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

PUBLISHED = 324.975  # s
RADIUS, GRAVITY, WING, IMPULSE = 6378.145, 9.80665e-3, 49.2386, 1600.0  # km, km/s², m², s
KM, MACH = np.arange(0.0, 25.0, 2.0), np.arange(0.0, 1.9, 0.2)
FEET = 0.3048 * np.array([0.0, 5, 10, 15, 20, 25, 30, 40, 50, 70])  # 1000 of them, in km
AERODYNAMIC = [0.0, 0.4, 0.8, 0.9, 1.0, 1.2, 1.4, 1.6, 1.8]  # Mach numbers
POUNDS = """
24.2 24.0 20.3 17.3 14.5 12.2 10.2 5.7 3.4 0.1   28.0 24.6 21.1 18.1 15.2 12.8 10.7 6.5 3.9 0.2
28.3 25.2 21.9 18.7 15.9 13.4 11.2 7.3 4.4 0.4   30.8 27.2 23.8 20.5 17.3 14.7 12.3 8.1 4.9 0.8
34.5 30.3 26.6 23.2 19.8 16.8 14.1 9.4 5.6 1.1   37.9 34.3 30.4 26.8 23.3 19.8 16.8 11.2 6.8 1.4
36.1 38.0 34.9 31.3 27.3 23.6 20.1 13.4 8.3 1.7  36.1 36.6 38.5 36.1 31.6 28.1 24.2 16.2 10.0 2.2
36.1 35.2 42.1 38.7 35.7 32.0 28.1 19.3 11.9 2.9  36.1 33.8 45.7 41.3 39.8 34.6 31.1 21.7 13.3 3.1
"""  # thrust in 1000 pounds, by Mach number and altitude


thrust = cg.table(4.448222 * np.array(POUNDS.split(), dtype=float).reshape(10, 10), MACH, FEET)  # kN
density = cg.table([1.225, 1.007, 0.8193, 0.6601, 0.5258, 0.4135, 0.3119, 0.2279, 0.1665, 0.1216, 0.08891, 0.06451,
                 0.04694], KM)  # kg/m³  # fmt: skip
sound = cg.table([340.3, 332.5, 324.6, 316.5, 308.1, 299.5, *[295.1] * 5, 296.4, 297.7], KM)  # m/s
lift = cg.table([3.44, 3.44, 3.44, 3.58, 4.44, 3.44, 3.01, 2.86, 2.44], AERODYNAMIC)
drag = cg.table([0.013, 0.013, 0.013, 0.014, 0.031, 0.041, 0.039, 0.036, 0.035], AERODYNAMIC)
induced = cg.table([0.54, 0.54, 0.54, 0.75, 0.79, 0.78, 0.89, 0.93, 0.93], AERODYNAMIC)


def mach(x):
    """The Mach number at an altitude in km and a speed in km/s."""
    return 1e3 * x[1] / sound(x[0])


def rates(t, x, u):
    """Of altitude, speed, climb angle and mass in t; u is the angle of attack."""
    height, speed, climb, mass = (x[i] for i in range(4))
    at, radius = mach(x), 1 + height / RADIUS
    pressure, push, weight = 5e2 * density(height) * speed**2 * WING, thrust(at, height), GRAVITY / radius**2
    slowing = pressure * (drag(at) + induced(at) * lift(at) * u[0] ** 2)
    rising = push * ca.sin(u[0]) + pressure * lift(at) * u[0]
    along = 1e-3 * (push * ca.cos(u[0]) - slowing) / mass - weight * ca.sin(climb)
    turned = 1e-3 * rising / mass / speed + ca.cos(climb) * (speed / (RADIUS * radius) - weight / speed)
    return [speed * ca.sin(climb), along, turned, -push / (1e3 * GRAVITY * IMPULSE)]


def problem():
    """From just above the ground to 20 km, level at both ends."""
    return cg.ControlProblem(
        rates=rates,
        t_span=(0.0, 300.0),
        start=[0.0, 0.129314, 0.0, 19.050864],
        end=[19.99488, 0.295092, 0.0, None],
        controls=1,
        running_cost=lambda t, x, u: 1,
        duration_bounds=(100.0, 800.0),
        control_bounds=(-0.35, 0.35),
        position_bounds=([0.0, 0.01, -0.8, 10.0], [FEET[-1], 1.0, 0.8, 20.0]),
        path_constraint=(lambda t, x, u: mach(x), MACH[0], MACH[-1]),
    )


def main():
    """Solve on 30 intervals."""
    return cg.solve(problem(), cg.Galerkin(degree=4), intervals=30)


def draw(path):
    """Draw altitude over Mach number; returns the figure."""
    axes, x = cg.panels(size=(6.0, 4.0)), path(np.linspace(*path.t[[0, -1]], 400))
    axes.plot(1e3 * x[1] / np.array(sound(ca.DM(x[0]).T)).ravel(), x[0])
    axes.set(title=f"Minimum time to climb: {path.cost:.1f} s", xlabel="Mach number", ylabel="altitude in km")
    return axes.figure


if __name__ == "__main__":
    answer = main()
    print(answer)
    print(f"  {answer.cost:.3f} s, published {PUBLISHED} s; fuel {1e3 * np.ptp(answer.x[3]):.1f} kg")
    draw(answer).savefig("climb.png")
