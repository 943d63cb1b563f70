"""The mesh on which the next path should be within a tolerance, from the errors estimated on the last one.

It equidistributes the part of the path of higher degree that degree m cannot represent.  Where a higher degree does not
reduce this part, the path has a kink, and intervals are split as for a method of order 2.  Where a control leaves or
meets a bound, by the minimizers of `bends`, and where a position touches one (`touches`), there is a joint in place of
finer intervals.  Where a control switches inside an interval, its impulse ∫ u dt gives the time of the switch, and a
joint is placed there.  Two more joints are placed on either side of it, at a distance of the uncertainty of that time.
The next path then switches between them, and its switching time is about ten times more accurate.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain

import numpy as np

from casadi_galerkin.calculus.galerkin import Galerkin
from casadi_galerkin.calculus.mesh_adaptation import TARGET, equidistributed, parts_wanted, truncation_error
from casadi_galerkin.calculus.nodes import lagrange_values
from casadi_galerkin.calculus.piecewise_polynomial import sampling_parts
from casadi_galerkin.control.error_estimate import HigherDegree
from casadi_galerkin.solution.control_trajectory import ControlTrajectory

UNSMOOTH_RATIO = 0.25  # ratio of the truncation errors of both degrees above which a path is not smooth on an interval
KINK_ORDER = 2  # a jump of the acceleration inside a step h changes x by the order of h²
MOST_PARTS = 8.0  # most parts that one interval is split into at once: enough to resolve a kink in a few levels
LEAST_PARTS = 0.75  # least parts of every interval while the time of a touch is not known
MOST_BESIDE = 2.0  # most parts that an interval beside a bend is split into for what is not smooth
NARROW_RATIO = 0.25  # length over that of a neighbor below which an interval counts as one placed beside a switch
REMOVAL_DISTANCE = 1 / 3  # distance to a switch, as part of an interval, below which an old joint is removed
SWITCH_MARGIN = 3.0  # distance of the joints beside a switch over the uncertainty of its time
# least distance of joints placed at switches and bends over √tol and the duration: a switch between two joints changes
# x by the square of their distance
SWITCH_RESOLUTION = 0.05
AT_JOINT = 0.05  # distance from a joint, as part of an interval, up to which a bend is at the joint
LONGER = 1.5  # ratio of the lengths of two intervals beside a touch up to which their other ends are moved
# difference of the two estimates of a switching time, over the duration, above which both become joints
DIFFERING_ESTIMATES = 1e-4
# distance over the duration below which switches are one, such as those of two controls at a breakpoint
SAME_SWITCH = 1e-8


def better_mesh(found: HigherDegree, tol: float, cost_tol: float) -> np.ndarray:
    """Joints, in the time of the path of higher degree, with which both errors should be below their tolerances."""
    bent = bend_times(found, tol)
    mesh, parts = without_narrow(found, wanted_parts(found, bent, tol, cost_tol))
    parts = np.where(holds(mesh, bent, AT_JOINT), np.minimum(parts, 1.0), parts)
    joints = tuple(sorted((*found.higher.problem.breakpoints, *bent)))
    mesh = equidistributed(mesh, parts, MOST_PARTS, breakpoints=joints)
    mesh = symmetric_about(mesh, set(found.touch_times[1]).intersection(bent), joints)
    return with_switches(found, mesh, tol)


def least_distance(path: ControlTrajectory, tol: float) -> float:
    """Least distance of joints that are placed at switches and bends."""
    return float(SWITCH_RESOLUTION * np.sqrt(tol) * np.ptp(path.t))


def bend_times(found: HigherDegree, tol: float) -> list[float]:
    """Times at which controls leave or meet a bound, or positions touch theirs, apart from all other joints."""
    path, times, touched = found.higher, list[float](), chain(*found.touch_times)
    fixed = [path.t[0], *path.problem.breakpoints, path.t[-1], *(s.when for s in found.switches)]
    for when in (*touched, *(bend.when for bend in found.bends)):
        if np.min(np.abs(np.array(fixed + times) - when)) > least_distance(path, tol):
            times.append(when)
    return times


def wanted_parts(found: HigherDegree, bent: Sequence[float], tol: float, cost_tol: float) -> np.ndarray:
    """Parts into which every interval is to be split, where there will be joints at some bends; (N,)."""
    path, higher, degree = found.path, found.higher, found.path.method.degree
    error = beyond_degree(higher, degree)
    error *= found.change / max(np.max(error), 1e-300)
    coarse, fine = (truncation_error(p.polynomial, path.sizes) for p in (path, higher))
    kinked = fine > UNSMOOTH_RATIO * coarse
    smooth = parts_wanted(error, degree + 1, tol)
    parts = np.where(kinked & (smooth > 1), parts_wanted(error, KINK_ORDER, tol), smooth)
    parts = np.maximum(parts, parts_wanted(np.maximum(found.bound_errors, found.control_misfit), 1, tol))
    for errors, allowed in zip(found.bend_errors, (tol, cost_tol), strict=True):
        parts = np.maximum(parts, parts_wanted(errors, KINK_ORDER, allowed))
    parts = np.maximum(parts, parts_wanted(np.maximum(found.jump_effects, found.excess_effects), 1, cost_tol))
    # beside a bend a joint is to take away what is not smooth; where there is none yet, all may be due to the bend
    beside = holds(higher.t, bent, -least_distance(higher, tol) / np.diff(higher.t))
    parts = np.where(beside, np.maximum(smooth, np.minimum(parts, MOST_BESIDE)), parts)
    unknown = max(found.touch_errors, default=0.0) > tol  # on a much coarser mesh times of touches would be less known
    return np.maximum(parts, LEAST_PARTS) if unknown else parts


def beyond_degree(path: ControlTrajectory, degree: int) -> np.ndarray:
    """Distance of a path from its interpolant of a lower degree on each interval, relative to the sizes; (N,)."""
    nodes = Galerkin(degree).element.nodes
    lower = path.polynomial.values_at_parts(nodes) @ lagrange_values(nodes, sampling_parts(degree)).T
    change = path.polynomial.values_at_parts(sampling_parts(degree)) - lower
    return np.max(np.abs(change) / path.sizes[:, None, None], axis=(0, 2))


def holds(mesh: np.ndarray, times: Sequence[float], margin: float | np.ndarray) -> np.ndarray:
    """Whether any of some times is in an interval, without this part of it at either end; (N,)."""
    margins, inside = margin * np.diff(mesh), np.zeros(len(mesh) - 1, dtype=bool)
    for when in times:
        inside |= (mesh[:-1] + margins < when) & (when < mesh[1:] - margins)
    return inside


def without_narrow(found: HigherDegree, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mesh and parts without the narrow intervals around switches; an interval with a switch need not be split."""
    mesh = found.higher.t
    steps = np.concatenate(([0.0], np.diff(mesh), [0.0]))
    narrow = steps[1:-1] < NARROW_RATIO * np.maximum(steps[:-2], steps[2:])
    parts, drop = parts.copy(), np.zeros(len(mesh), dtype=bool)
    for s in found.switches:
        times = (s.when, s.joint, s.due)
        first = max(int(np.searchsorted(mesh, min(times))) - 1, 0)
        last = min(int(np.searchsorted(mesh, max(times), side="right")) - 1, len(narrow) - 1)
        while first > 0 and narrow[first]:
            first -= 1
        while last < len(narrow) - 1 and narrow[last]:
            last += 1
        parts[first : last + 1] = np.minimum(parts[first : last + 1], 1.0)
        drop[first + 1 : last + 1] |= narrow[first:last] | narrow[first + 1 : last + 1]
    keep = np.flatnonzero(~drop | np.isin(mesh, found.higher.problem.breakpoints))
    return mesh[keep], np.maximum.reduceat(parts, keep[:-1])


def symmetric_about(mesh: np.ndarray, times: Iterable[float], fixed: Sequence[float]) -> np.ndarray:
    """The mesh with intervals of equal lengths on both sides of some of its joints; others stay where they are fixed.

    A path constraint that is touched there acts at the quadrature points on both sides, in the mean at the joint.
    """
    for when in times:
        k = int(np.searchsorted(mesh, when))
        before, after = mesh[k] - mesh[k - 1], mesh[k + 1] - mesh[k]
        far, place = (k - 1, when - after) if before > after else (k + 1, when + before)
        if max(before, after) > LONGER * min(before, after):
            mesh = np.unique(np.append(mesh, place))
        elif mesh[far] in (mesh[0], *fixed, mesh[-1]):
            half = min(before, after) / 2
            mesh = np.unique(np.append(mesh, [when - half, when + half]))
        else:
            mesh = np.concatenate((mesh[:far], [place], mesh[far + 1 :]))
    return mesh


def with_switches(found: HigherDegree, mesh: np.ndarray, tol: float) -> np.ndarray:
    """The mesh with joints at the switches, and on either side at the distance of the uncertainty of their times.

    There are two estimates of a switching time.  Where the given ends determine it, the impulse is accurate, but the
    switching function only to the distance of two quadrature points.  Where the ends do not determine it, all controls
    may stay at their bounds on both sides of a joint, and the switching function is more accurate.  So where the two
    estimates differ, both become joints.  A switch whose distance to a breakpoint is below the error of the path is
    taken to be at the breakpoint, because a joint beside it would be too near.  Where a rate jumps that changes its
    component in a short part of the duration, all distances are as much shorter.
    """
    switched: dict[float, float] = {}  # time of a switch -> distance of the joints on either side
    duration, breakpoints = np.ptp(mesh), found.higher.problem.breakpoints
    closest, known = least_distance(found.higher, tol), max(found.change, TARGET * tol) * duration
    shares = [1 / max(1.0, change * duration) for change in found.rate_changes]
    estimates = [(s, share, s.when) for s, share in zip(found.switches, shares, strict=True)]
    differing = DIFFERING_ESTIMATES * duration
    estimates += [(s, share, s.due) for s, share, when in estimates if abs(s.due - when) > share * differing]
    for s, share, when in estimates:
        when = next((b for b in breakpoints if abs(b - when) < known), when)
        if any(abs(when - other) < SAME_SWITCH * duration for other in switched):
            continue
        k = int(np.searchsorted(mesh[1:-1], when))
        near = min((k, k + 1), key=lambda j: abs(mesh[j] - when))
        stays = mesh[near] in (mesh[0], *breakpoints, mesh[-1])
        if not stays and abs(mesh[near] - when) < REMOVAL_DISTANCE * (mesh[k + 1] - mesh[k]):
            mesh = np.delete(mesh, near)
        uncertain = max(abs(s.when - s.joint), abs(s.due - s.joint))
        switched[when] = max(share * closest, SWITCH_MARGIN * uncertain)
    joints = np.unique(np.concatenate((mesh, list(switched))))
    for when, distance in switched.items():
        k = int(np.searchsorted(joints, when))
        wide = distance < NARROW_RATIO * np.diff(joints)[k - 1 : k + 1]
        mesh = np.append(mesh, np.array([when - distance, when + distance])[wide])
    return np.unique(np.concatenate((mesh, list(switched))))
