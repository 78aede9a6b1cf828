"""A long splitting: from motions near a solution to where Newton's method arrives, at next to no Newton steps.

An iteration costs a small share of a Newton step. Where pairs bounce, or weights are far from the defaults, it takes
thousands of them, and an extrapolation that looks far back; in the end at the samples of the balance itself, where
what the two have in common is the solution.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.snes import Attempt, LinearSolver, run_newton
from ewr_fenicsx.splitting import NEAR_ENOUGH, Effort, Split, Splitting, are_projections, resample, settle

LONG = Effort(iterations=4000, patience=1500, window=40)
WORK = 12 * 10**7  # iterations at most, times the entries of a state
SOFTNESSES = (1.0, 0.1)  # of the splittings, in turn: one may lead where another stalls
# Defects at which Newton's method is tried: at the samples of a splitting, then at those of the balance.
COARSE_GOAL, FINE_GOALS = 1e-3, (1e-4, 1e-5, 1e-6)
# Residual over the defect, above which the samples matter so much that Newton's method is not tried yet; and the
# defect from which it hardly ever arrives.
TELLING, HOPELESS = 10.0, 0.5
NEWTON_STEPS, MOST_STEPS = 25, 75  # a run, and after which no other is begun: those that arrive take fewer


def split_at_length(
    balance: HarmonicBalance,
    forces: ComplexArray,
    motion: ComplexArray,
    tolerance: float,
    linear_solver: LinearSolver,
) -> Attempt | None:
    """Newton from where a long splitting ends, or from ever closer to there.

    Args:
        balance: The balance.
        forces, motion: Where it begins: ``(n_h, m)`` [N], [m], which need not fit each other.
        tolerance, linear_solver: As in ``solve``.

    Returns:
        The best attempt, with the Newton steps of all; None where no splitting came near anything.
    """
    if not are_projections(balance):
        return None
    attempts: list[Attempt] = []
    steps = 0
    for unknowns in _approach(balance, forces, motion):
        attempts.append(run_newton(balance, unknowns, tolerance, linear_solver, NEWTON_STEPS, near=True))
        steps += attempts[-1].iterations
        if attempts[-1].converged or steps >= MOST_STEPS:
            break
    return replace(min(attempts), iterations=steps) if attempts else None


def _approach(balance: HarmonicBalance, forces: ComplexArray, motion: ComplexArray) -> Iterator[RealArray]:
    """Unknowns that are worth a Newton run, ever closer to where a splitting ends."""
    try:
        for softness in SOFTNESSES:
            splitting = Splitting(balance, softness=softness)
            found = _settle(splitting, splitting.join(forces, motion), COARSE_GOAL)
            near = found.defect <= NEAR_ENOUGH * COARSE_GOAL
            if _is_telling(splitting, found) if near else found.defect <= HOPELESS:
                yield splitting.unknowns(found.state)
            if near:
                break
        else:
            return
        splitting = Splitting(balance, balance.basis.samples, softness)
        state = resample(found.state, splitting)
        for goal in FINE_GOALS:
            found = _settle(splitting, state, goal)
            state = found.state
            last = goal == FINE_GOALS[-1] or found.defect > NEAR_ENOUGH * goal
            if last or _is_telling(splitting, found):
                yield splitting.unknowns(state)
            if last:
                return
    except np.linalg.LinAlgError:  # as next to a mode without damping
        return


def _settle(splitting: Splitting, state: RealArray, goal: float) -> Split:
    return settle(splitting, state, goal, LONG._replace(iterations=min(LONG.iterations, WORK // state.size)))


def _is_telling(splitting: Splitting, found: Split) -> bool:
    """Whether the residual is no larger than a defect explains."""
    residual = np.linalg.norm(splitting.balance.residual(splitting.unknowns(found.state)))
    return bool(found.defect <= TELLING * residual <= TELLING**2 * found.defect)
