"""An error indicator for jumps of the callables in time inside intervals.

Each quadrature point represents a share of the time, from a to b (`jump_detection`).  With z fixed at its values at
the point, the integrand I of the cost (`hamiltonian`) fulfils

    I(b, z) - I(a, z) = ∫ ∂I/∂t dt

where it is smooth in time, however fast controls change.  A jump may change the cost as much as ∫ I dt.
"""

from __future__ import annotations

import numpy as np

from casadi_galerkin.control.hamiltonian import along, integrand
from casadi_galerkin.functional.mapping import at_places
from casadi_galerkin.solution.control_trajectory import ControlTrajectory
from casadi_galerkin.solution.jump_detection import JumpDetector


def jumps_in_time(path: ControlTrajectory) -> np.ndarray:
    """Largest change of the cost by jumps in time inside of each interval; (N,)."""
    rule = path.method.quadrature
    detector, (times, *z) = JumpDetector(path.t, rule), along(path, np.array(rule.points))
    given = [np.repeat(a, len(detector.times) // len(times), axis=1) for a in z]
    values, rates, *_ = at_places(integrand(path), detector.times, *given)
    return detector.jump_effects(values[0], rates[0])
