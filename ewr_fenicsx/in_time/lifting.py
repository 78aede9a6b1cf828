"""Bodies that overlap where a motion in time begins are moved apart first.

A series cut short lets bodies overlap a little. A step makes up for all of it, and what has a mass of its own would fly
off at that way over the length of the step: the faster, the shorter it is.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from ewr_fenicsx.in_time.compiled_loop import UNILATERAL
from ewr_fenicsx.in_time.time_stepping import State, TimeScheme

_ROUNDING = 1e-12  # of what makes up a gap


def lift_out(scheme: TimeScheme, state: State) -> State:
    """The nearest state, by the inertia of a step, in which no bodies overlap; itself where none do, or none is found.

    Source (least distance programming): Lawson & Hanson (1974), Solving Least Squares Problems, chapter 23.
    """
    closes = scheme.kind == UNILATERAL
    rows, clearance = scheme.rows[closes], scheme.initial_gap[closes]
    position = scheme.contraction @ state.position
    gap = rows @ position + clearance
    if np.all(gap >= -_ROUNDING * (np.abs(rows) @ np.abs(position) + np.abs(clearance))):
        return state
    size, depth = np.linalg.norm(rows, axis=1).max(), np.abs(gap).max()
    system, wanted = np.vstack([rows.T / size, -gap / depth]), np.append(np.zeros(position.size), 1.0)
    try:
        left = wanted - system @ nnls(system, wanted)[0]
    except RuntimeError:  # it changes its mind for ever
        return state
    if left[-1] <= _ROUNDING:
        return state
    way = -left[:-1] / left[-1] * depth / size
    return State(state.position + scheme.expansion @ way, state.velocity)
