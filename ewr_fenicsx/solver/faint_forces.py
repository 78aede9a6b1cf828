"""Forces that a residual beside all forces does not tell of, as those of a joint next to a far larger preload."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.solver.snes import TIGHTEST, Attempt, LinearSolver, run_newton

# Times the tolerance that a row may leave of its own oscillating force; no more than a share of it where tolerances are
# loose, or so many times the tolerance
OWN_SHARE, LOOSE_SHARE, LOOSELY = 1e5, 1e-2, 100.0
LAST_STEPS = 10  # Newton steps to get there
# Times the tolerance that the mean friction of a pair that sticks throughout may be off, over all forces: little tells
# of it. The same of what springs would do that hold a pair in place, had it moved by all that it bends; no more than a
# share of that where tolerances are loose.
MEAN_SHARE, HELD_SHARE = 100.0, 1e-3


def attend_to_faint_forces(
    balance: HarmonicBalance, found: Attempt, tolerance: float, linear_solver: LinearSolver
) -> Attempt:
    """What was found, or closer where its residual is small beside all forces, but not beside those of some row.

    As at a lightly loaded joint beside a large preload, which may be left as it was guessed; or where only weak
    springs, or a small share of itself, decide the mean force of a pair that sticks throughout.
    """
    if not found.converged or found.usual:  # what holds with other weights is closer already
        return found
    goals = find_missed(balance, found.unknowns, tolerance)
    if not goals.size:
        return found
    none_misses = lambda unknowns: not find_missed(balance, unknowns, tolerance).size  # noqa: E731
    unknowns, taken = balance.take_whole_steps(found.unknowns, LAST_STEPS, none_misses)  # a line search may take none
    begin, goal = found.unknowns, goals.min()
    if unknowns is not None:
        begin, goal = unknowns, max(goal, balance.measure_residual(unknowns))
    closer = run_newton(balance, begin, goal, linear_solver, LAST_STEPS, near=True)
    steps = found.iterations + taken + closer.iterations
    if closer.walks:  # so faintly held that only a closer look tells
        return replace(closer, iterations=steps, detour=found.detour)
    return replace(min(closer, found), iterations=steps, reason=found.reason, converged=True, detour=found.detour)


def find_missed(balance: HarmonicBalance, unknowns: RealArray, tolerance: float) -> RealArray:
    """What rows may leave that leave more than that, beside their own forces; never less than rounding does."""
    mean = int(balance.basis.has_mean)
    left, own = (balance.place(at) for at in (balance.residual(unknowns), unknowns))
    share = min(OWN_SHARE * tolerance, max(LOOSE_SHARE, LOOSELY * tolerance))
    least = np.maximum(share * np.linalg.norm(own[mean:], axis=0), TIGHTEST)
    missed = [least[~(np.linalg.norm(left[mean:], axis=0) <= least)]]
    if mean and np.any(balance.held):
        springs = balance.static_displacement_row * balance.system.flexibility
        share = min(HELD_SHARE, MEAN_SHARE * tolerance)
        least = np.maximum(share * springs * np.linalg.norm(own, axis=0), TIGHTEST)
        missed.append(least[balance.held & ~(np.abs(left[0]) <= least)])
    if mean:
        share = MEAN_SHARE * tolerance * balance.static_row * balance.static_force_row
        least = np.maximum(share, TIGHTEST)
        loose = (share > 0) & ~(np.abs(left[0]) <= least)
        if np.any(loose):
            missed.append(least[loose & balance.linearise(unknowns).steady])
    return np.concatenate(missed)
