"""A long splitting: from motions near a solution to where Newton's method arrives, at next to no Newton steps.

An iteration costs a small share of a Newton step. Where pairs bounce, or weights are far from the defaults, it takes
thousands of them, and an extrapolation that looks far back; in the end at the samples of the balance itself, where
what the two have in common is the solution.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.solver.newton_path import SHORT, follow_path, limit_corners, run_and_follow
from ewr_fenicsx.solver.snes import Attempt, LinearSolver
from ewr_fenicsx.solver.splitting import NEAR_ENOUGH, Effort, Split, Splitting, are_projections, resample, settle
from ewr_fenicsx.solver.warm_starts import pick_first

LONG = Effort(iterations=4000, patience=1500, window=40)
WORK = 12 * 10**7  # iterations at most, times the entries of a state
SOFTNESSES = (1.0, 0.1)  # of the splittings, in turn: one may lead where another stalls
# Defects at which Newton's method is tried: at the samples of a splitting, then at those of the balance.
COARSE_GOAL, FINE_GOALS = 1e-3, (1e-4, 1e-5, 1e-6)
# How many times apart residual and defect may be for a start to be tried before the last goal: further, where weights
# are far off, nothing arrives. And the defect from which it hardly ever does.
APART, HOPELESS = 10.0, 0.05
NEWTON_STEPS, MOST_STEPS = 25, 75  # a run, and after which no other start is tried: those that arrive take fewer


def split_at_length(
    balance: HarmonicBalance,
    forces: ComplexArray,
    motion: ComplexArray,
    tolerance: float,
    linear_solver: LinearSolver,
) -> Attempt | None:
    """Newton's path, and at last Newton's method, from where a long splitting ends or from ever closer to there.

    Args:
        balance: The balance.
        forces, motion: Where it begins: ``(n_h, m)`` [N], [m], which need not fit each other.
        tolerance, linear_solver: As in ``solve``.

    Returns:
        The best attempt, with the Newton steps of all; None where no splitting came near anything.
    """
    if not are_projections(balance):
        return None
    return pick_first(_arrive(balance, _approach(balance, forces, motion), tolerance, linear_solver))


def _arrive(
    balance: HarmonicBalance, starts: Iterator[tuple[RealArray, bool]], tolerance: float, linear_solver: LinearSolver
) -> Iterator[Attempt]:
    """Attempts from starts: a short path while closer ones follow; from the last a long one, and a run of Newton."""
    steps = 0
    for start, last in starts:
        path = follow_path(balance, start, tolerance, limit_corners(balance) if last else SHORT)
        if path is not None:
            steps += path.iterations
            yield path
        if path is None or last:
            run = run_and_follow(balance, start, tolerance, linear_solver, NEWTON_STEPS, near=True)
            steps += run.iterations
            yield run
        if steps >= MOST_STEPS:
            return


def _approach(balance: HarmonicBalance, forces: ComplexArray, motion: ComplexArray) -> Iterator[tuple[RealArray, bool]]:
    """Starts that are worth a Newton run, ever closer to where a splitting ends, and whether each is the last one."""
    try:
        for softness in SOFTNESSES:
            splitting = Splitting(balance, softness=softness)
            found = _settle(splitting, splitting.join(forces, motion), COARSE_GOAL)
            unknowns, near = splitting.unknowns(found.state), found.defect <= NEAR_ENOUGH * COARSE_GOAL
            if _fits(balance, unknowns, found.defect) if near else found.defect <= HOPELESS:
                yield unknowns, not near
            if near:
                break
        else:
            return
        splitting = Splitting(balance, balance.basis.samples, softness)
        state = resample(found.state, splitting)
        for goal in FINE_GOALS:
            found = _settle(splitting, state, goal)
            state, unknowns = found.state, splitting.unknowns(found.state)
            last = goal == FINE_GOALS[-1] or found.defect > NEAR_ENOUGH * goal
            if last or _fits(balance, unknowns, found.defect):
                yield unknowns, last
            if last:
                return
    except np.linalg.LinAlgError:  # as next to a mode without damping
        return


def _settle(splitting: Splitting, state: RealArray, goal: float) -> Split:
    return settle(splitting, state, goal, LONG._replace(iterations=min(LONG.iterations, WORK // state.size)))


def _fits(balance: HarmonicBalance, unknowns: RealArray, defect: float) -> bool:
    """Whether residual and defect tell of about the same distance."""
    residual = balance.measure_residual(unknowns)
    return bool(defect <= APART * residual <= APART**2 * defect)
