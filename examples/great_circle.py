"""The shortest way from New York to London on a sphere: a geodesic, by its energy functional in two angles.

The straight line of the map is near enough for full Newton steps, which is what CasADi's own rootfinder takes.
"""

import casadi as ca
import numpy as np
from show import canvas, picture, save

import casadi_galerkin as cg

RADIUS = 6371.0  # km, the Earth's mean radius
NEW_YORK = np.radians([40.6413, -73.7781])  # latitude, longitude
LONDON = np.radians([51.47, -0.4543])


def lagrangian(t, x, v):
    """Half the squared speed on the unit sphere; x holds latitude and longitude."""
    return (v[0] ** 2 + ca.cos(x[0]) ** 2 * v[1] ** 2) / 2


def main(plot=None):
    """Solve on the unit of time, so that the constant speed is the length of the arc."""
    problem = cg.BoundaryProblem(lagrangian, (0.0, 1.0), NEW_YORK, LONDON)
    path = cg.solve(problem, cg.Galerkin(degree=8), intervals=8, solver=cg.rootfinder)
    if plot:
        draw(path, plot)
    return path


def arc(path):
    """Length of the path in radians: its speed is constant, and S = arc²/2."""
    return np.sqrt(2 * path.action)


def haversine():
    """The same by the haversine formula."""
    (latitude, longitude), (other, east) = NEW_YORK, LONDON
    chord = np.sin((other - latitude) / 2) ** 2
    chord += np.cos(latitude) * np.cos(other) * np.sin((east - longitude) / 2) ** 2
    return 2 * np.arcsin(np.sqrt(chord))


def draw(path, name):
    """Draw latitude over longitude, beside the straight line of the map."""
    axes = canvas("New York to London", "longitude in degrees", "latitude in degrees", (6.0, 3.6))
    latitude, longitude = np.degrees(path(np.linspace(0, 1, 200)))
    (line,) = axes.plot(longitude, latitude, label=f"great circle, {RADIUS * arc(path):.0f} km")
    axes.plot(*np.degrees(path.x[::-1]), ".", color=line.get_color())
    axes.plot(*np.degrees(np.stack((NEW_YORK, LONDON)).T[::-1]), "--", color="0.6", label="straight on the map")
    axes.legend(loc="lower center")
    save(axes, name)


if __name__ == "__main__":
    answer = main(picture("great_circle.png"))
    print(answer)
    print(f"  length      {arc(answer):.15f} rad, exact {haversine():.15f}; {RADIUS * arc(answer):.3f} km")
