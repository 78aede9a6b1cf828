"""Archard's law on a periodic solution: how deep a cycle wears each pair, and how many cycles one may jump at a time.

Wear follows the pressure, the nodal force over its tributary area: with forces it would depend on the mesh.

Source: Archard (1953), doi:10.1063/1.1721448.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.solution.contact_state import OPEN, classify_contact
from ewr_fenicsx.solution.indicators import measure_sliding
from ewr_fenicsx.solution.solution import PeriodicSolution

SAMPLES = 1024  # of the period, for integrals over a cycle
SLOW = 0.1  # times the wear of all cycles on average
_RIGID = 1e-12  # flexibility of pairs to one another, over their own, below which it is rounding


def measure_wear_rate(solution: PeriodicSolution, coefficient: RealArray) -> RealArray:
    """Depth worn a cycle at each pair, ``k_w`` times the integral of ``p |v|`` over the period, ``(K_c,)`` [m].

    Args:
        solution: ``p`` is its ``pressing_force`` over the areas [Pa], ``|v|`` its ``sliding_speed``.
        coefficient: ``(K_c,)`` wear coefficients ``k_w`` [1/Pa].
    """
    period = 1 / solution.problem.frequency
    force, speed = solution.press_and_slide(SAMPLES)
    worn = coefficient * period * np.mean(force / solution.problem.model.areas * speed, axis=0)
    return np.maximum(0.0, worn)


def weigh_wear_rate(solution: PeriodicSolution, coefficient: RealArray, pace: float) -> RealArray:
    """The wear rate, and beside it what is slow: errors of a rate that is slower count over that, ``(K_c + 1,)`` [m].

    What has all but worn away is off by more than itself, and adds nothing to a depth.

    Args:
        solution, coefficient: As in ``measure_wear_rate``.
        pace: Depth that a cycle wears on average [m].
    """
    return np.append(measure_wear_rate(solution, coefficient), SLOW * pace)


def find_wear_stiffness(solution: PeriodicSolution, coefficient: RealArray) -> RealArray:
    """By how much a worn depth slows its own growth, ``diag(k_w s) K_c``, ``(K_c, K_c)`` [1/cycle].

    ``s`` is the distance slid while closed a cycle and ``K_c`` the mean contact stiffness, pressure per depth, of the
    pairs that are ever closed, those that do not wear included, with floating bodies free to follow, and what their
    laws give way by themselves (``stick_flexibility``).

    Args:
        solution: The state.
        coefficient: ``(K_c,)`` wear coefficients [1/Pa].
    """
    problem, system = solution.problem, solution.problem.system
    closed = classify_contact(solution, SAMPLES) != OPEN
    pairs = np.flatnonzero(closed.any(axis=0) & problem.opens)  # load that leaves worn ones goes to the others
    decay = np.zeros((problem.model.pairs,) * 2)
    if not pairs.size:
        return decay
    rows = system.row_of("normal", pairs)
    flexibility = system.compliance.flexibility[0].real[np.ix_(rows, rows)] + np.diag(system.stick_flexibility[rows])
    G = system.compliance.rigid_motion[rows]
    free = scipy.linalg.null_space(G.T) if G.shape[1] else np.eye(rows.size)  # force changes that are balanced
    bends = free.T @ flexibility @ free
    bends[np.abs(bends) <= _RIGID * system.flexibility[rows].max()] = 0.0
    stiffness = free @ np.linalg.pinv(bends, rcond=1e-10, hermitian=True) @ free.T
    sliding = measure_sliding((closed * solution.sliding_speed(SAMPLES))[:, pairs], 1 / problem.frequency)
    weight = coefficient[pairs] * sliding / problem.model.areas[pairs]
    wears = weight > 0  # the others keep their depth, to the last digit
    decay[np.ix_(pairs[wears], pairs[wears])] = (weight[:, None] * stiffness)[np.ix_(wears, wears)]
    return decay


def find_explicit_limit(decay: RealArray) -> float:
    """Longest stable explicit jump in cycles, ``2 / lambda_max``; past it worn surfaces oscillate.

    Args:
        decay: ``(K_c, K_c)`` of ``find_wear_stiffness``.
    """
    fastest = float(np.linalg.eigvals(decay).real.max(initial=0.0))
    return 2 / fastest if fastest > 0 else np.inf
