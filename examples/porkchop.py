"""A porkchop plot: what every launch date and flight time between two planets costs; 2,500 Lambert transfers.

Both planets move on ellipses in one plane.  One problem is built once, to a tolerance; ends and time span are its
variations.  Only the first needs a guess: each starts from the nearest that is solved, and so all go round the Sun in
the planets' direction.  They are solved one after the other, or by any executor of processes: ``with
ProcessPoolExecutor() as pool: main(pool)``, or ``main(client.get_executor())`` on a cluster of Dask's.
"""

import casadi as ca
import numpy as np

import casadi_galerkin as cg

MU = 4 * np.pi**2  # au³/year², the Sun's gravitational parameter
KILOMETRES_A_SECOND = 4.74047  # in one au/year
INNER = {"axis": 1.0, "eccentricity": 0.017, "perihelion": 1.8, "anomaly": 0.0}  # like the Earth's orbit
OUTER = {"axis": 1.524, "eccentricity": 0.093, "perihelion": 5.9, "anomaly": 1.2}  # like that of Mars
LAUNCHES, FLIGHTS = np.linspace(1.2, 2.0, 50), np.linspace(0.4, 1.1, 50)  # years
TOLERANCE = 1e-8


def state(orbit, t):
    """Position in au and velocity in au/year of a planet at time t, by Kepler's equation; (2,) each."""
    a, e = orbit["axis"], orbit["eccentricity"]
    rate = np.sqrt(MU / a**3)
    anomaly = mean = orbit["anomaly"] + rate * t
    for _ in range(20):
        anomaly -= (anomaly - e * np.sin(anomaly) - mean) / (1 - e * np.cos(anomaly))
    c, s, b = np.cos(anomaly), np.sin(anomaly), np.sqrt(1 - e**2)
    along = np.array([np.cos(orbit["perihelion"]), np.sin(orbit["perihelion"])])
    axes = np.stack((along, [-along[1], along[0]]))
    return a * np.array([c - e, b * s]) @ axes, a * rate / (1 - e * c) * np.array([-s, b * c]) @ axes


def transfer(launch, flight):
    """One variation: ends and times."""
    start, end = state(INNER, launch)[0], state(OUTER, launch + flight)[0]
    return {"start": start, "end": end, "t_span": (launch, launch + flight)}


def arc(variation):
    """An arc round the Sun in the planets' direction as guess: times and positions.

    Half-way the arc is as far out as a circle on which that angle would take the time of the flight.
    """
    start, end, (launch, arrival) = variation["start"], variation["end"], variation["t_span"]
    radii = np.linalg.norm([start, end], axis=1)
    first = np.arctan2(start[1], start[0])
    swept = (np.arctan2(end[1], end[0]) - first) % (2 * np.pi)
    middle = (MU * ((arrival - launch) / swept) ** 2) ** (1 / 3)
    part = np.linspace(0, 1, 11)
    radius = radii[0] + part * (radii[1] - radii[0]) + 4 * part * (1 - part) * (middle - np.mean(radii))
    angle = first + part * swept
    return np.linspace(launch, arrival, len(part)), radius * np.array([np.cos(angle), np.sin(angle)])


def variations():
    """All transfers, launch date slowest; the first with its guess."""
    first, *others = [transfer(launch, flight) for launch in LAUNCHES for flight in FLIGHTS]
    return [{**first, "guess": arc(first)}, *others]


def problem():
    """The problem in the Sun's field that all transfers are variations of."""
    first = transfer(LAUNCHES[0], FLIGHTS[0])
    return cg.BoundaryProblem(lambda t, x, v: ca.dot(v, v) / 2 + MU / ca.norm_2(x), **first)


def main(executor=None):
    """Solve all; returns the sweep and the cost in km/s, (launch dates, flight times)."""
    transfers = cg.sweep(problem(), variations(), tol=TOLERANCE, executor=executor)
    ends = [(state(INNER, t)[1], state(OUTER, t + flight)[1]) for t in LAUNCHES for flight in FLIGHTS]
    momenta = np.array([path.momentum[:, [0, -1]] for path in transfers])  # velocities of a unit mass
    cost = KILOMETRES_A_SECOND * np.linalg.norm(momenta - np.swapaxes(ends, 1, 2), axis=1).sum(axis=1)
    return transfers, cost.reshape(len(LAUNCHES), len(FLIGHTS))


def draw(answer):
    """Draw lines of equal cost over launch date and flight time, and the cheapest transfer; returns the figure."""
    cost, axes = answer[1], cg.panels()
    levels = np.floor(np.nanmin(cost)) + np.array([0, 1, 2, 3, 5, 7, 10, 14, 20, 30])
    areas = axes.contourf(LAUNCHES, FLIGHTS, cost.T, levels, cmap="cividis", extend="max")
    axes.figure.colorbar(areas, label="changes of velocity in km/s", ticks=levels)
    i, j = np.unravel_index(np.nanargmin(cost), cost.shape)
    axes.plot(LAUNCHES[i], FLIGHTS[j], "w*", markersize=12)
    text = {"xytext": (8, 6), "textcoords": "offset points", "color": "w"}
    axes.annotate(f"{cost[i, j]:.2f} km/s", (LAUNCHES[i], FLIGHTS[j]), **text)
    axes.set(title=f"{cost.size} transfers", xlabel="launch date in years", ylabel="flight time in years")
    return axes.figure


if __name__ == "__main__":
    answer = transfers, cost = main()
    print(transfers)
    print(f"{len(transfers.jumps)} transfers seem on another branch than their neighbors")
    i, j = np.unravel_index(np.nanargmin(cost), cost.shape)
    print(f"cheapest: {cost[i, j]:.3f} km/s, launch {LAUNCHES[i]:.3f}, flight {FLIGHTS[j]:.3f} years")
    transfers.to_npz("porkchop.npz")  # what every transfer has at both ends
    draw(answer).savefig("porkchop.png")
