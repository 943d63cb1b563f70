"""Counts of equations and unknowns: what a mesh is too coarse for, and what fatrop cannot take stage by stage."""

from __future__ import annotations

import numpy as np

from casadi_galerkin.calculus.numbers import counted
from casadi_galerkin.control.chain import Chain
from casadi_galerkin.control.optimizer import ProgramBounds


def check_count(chain: Chain, limits: ProgramBounds) -> None:
    """Refuse more equations than unknowns, as a very coarse mesh has; what only passes states on is not counted."""
    passed = sum(states for states, *_ in chain.stages[1:]) + chain.mechanical
    equations = int(np.count_nonzero(limits.equations_lower == limits.equations_upper)) - passed
    unknowns = int(np.count_nonzero(limits.lower < limits.upper)) - passed
    if equations > unknowns:
        raise ValueError(
            f"{counted(equations, 'equation')} for {counted(unknowns, 'unknown')} on "
            f"{counted(chain.intervals, 'interval')} of degree {chain.method.degree}: take more intervals, a higher "
            "degree or more controls, or free a component"
        )


def check_stages(chain: Chain, limits: ProgramBounds) -> None:
    """Refuse what fatrop cannot take apart into stages, or takes for an error when it runs."""
    conditions = chain.problem.end_conditions
    if conditions is not None and any(conditions[0].sparsity_jac(k, 0).nnz() for k in (0, 1)):
        raise ValueError(
            "fatrop takes end_conditions on the end alone, stage by stage: give what is known of the start as "
            "start and start_velocity, or take cg.ipopt"
        )
    states, others, counts = (np.array(column) for column in zip(*chain.stages, strict=True))
    row = unknown = 0
    for i, following in enumerate(np.append(states[1:], 0)):
        own, row = row + following, row + following + counts[i]
        first, unknown = unknown, unknown + states[i] + others[i]
        equations = np.count_nonzero((limits.equations_lower == limits.equations_upper)[own:row])
        equations += np.count_nonzero((limits.lower == limits.upper)[first:unknown])
        if equations > unknown - first:
            where = f"interval {i}" if i < chain.intervals else "the end"
            raise ValueError(
                f"fatrop takes no more equations than unknowns in a stage, got {equations} for {unknown - first} "
                f"at {where}: state nothing twice, or take cg.ipopt"
            )
