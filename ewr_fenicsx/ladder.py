"""The ladder: cold starts, and the ways to a solution that Newton's method does not find by itself.

1. Growing sets of harmonics from the full-stick solution, each started at the one before: few sets, then many.
2. On a set where Newton stalls: laws with rounded corners, sharpened step by step.
3. Then: the oscillating load, traced from a small share to the whole, past folds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.continuation import BranchPoint, trace_branch
from ewr_fenicsx.reduced_model import ComplexArray, RealArray
from ewr_fenicsx.smoothing import round_corners
from ewr_fenicsx.snes import Attempt, LinearSolver, run_newton

# Highest harmonics of the sets that a cold start climbs through: few at first, more where that fails.
COARSE_LEVELS, FINE_LEVELS = (5, 15, 40), (1, 3, 5, 9, 15, 23, 31, 47, 63)
COARSE_TOLERANCE, COARSE_STEPS = 1e-3, 25  # a coarse set is only a start for the next
FIRST_LOAD_SHARE, BRANCH_POINTS = 0.02, 80  # of the oscillating load, where its tracing starts; points at most
LARGEST_TRACED = 2000  # unknowns: a path takes hundreds of Newton steps, so it is followed with few harmonics
MOST_STEPS = 500  # Newton steps after which no further path is begun
SHARP, BLUNT = 1e-7, 1e3  # widths of rounded corners, over the mean contact force, that count as sharp and as hopeless


def climb(
    balance: HarmonicBalance, tolerance: float, linear_solver: LinearSolver, fallbacks: list[str], trace: bool
) -> list[Attempt]:
    """Cold starts: full stick, then growing sets of harmonics, each started at the solution of the one before.

    First few sets, then many, from the lowest on; with ``trace``, where Newton stalls on a set, it is led there through
    laws with rounded corners, then by tracing the oscillating load. What did not work is appended to ``fallbacks``.
    """
    loaded = [h for h, f in balance.system.load.items() if np.any(f)]
    attempts: list[Attempt] = []
    for levels in (FINE_LEVELS,) if trace else (COARSE_LEVELS, FINE_LEVELS):
        below = None
        for orders in choose_sets(balance.basis.orders, levels, loaded):
            last = orders == balance.basis.orders
            level = balance if last else HarmonicBalance(balance.system.restrict(orders), balance.force_unit)
            guess = level.full_stick if below is None else embed(below.unpack(attempts[-1].unknowns), below, level)
            goal, limit = (tolerance, None) if last else (COARSE_TOLERANCE, COARSE_STEPS)
            attempts.append(run_newton(level, level.pack(*guess), goal, linear_solver, limit))
            for rung in (sharpen_corners, trace_load) if trace else ():
                spent = sum(a.iterations for a in attempts)
                if not attempts[-1].converged and level.size <= LARGEST_TRACED and spent < MOST_STEPS:
                    attempts[-1] = rung(level, goal, attempts[-1])
                    fallbacks.append(f"harmonics to {orders[-1]}: {attempts[-1].reason}")
            below = level
        if attempts[-1].converged:
            break
        if not trace:
            way = ", ".join(str(s[-1]) for s in choose_sets(balance.basis.orders, levels, loaded))
            fallbacks.append(f"harmonics to {way}: {attempts[-1].reason}")
    return attempts


def choose_sets(orders: tuple[int, ...], levels: tuple[int, ...], loaded: list[int]) -> list[tuple[int, ...]]:
    """Growing sets of harmonics up to each of ``levels``, all with the loaded ones, that end with ``orders``."""
    lowest = max([h for h in loaded if h], default=1)
    sets = [tuple(h for h in orders if h <= top) for top in levels if lowest <= top and 1.6 * top < orders[-1]]
    return [s for s in dict.fromkeys(sets) if s and s != (0,)] + [orders]


def embed(found: tuple[ComplexArray, RealArray], below: HarmonicBalance, level: HarmonicBalance):
    """Forces and rigid coordinates with harmonics added at zero."""
    forces = np.zeros((len(level.basis.orders), level.rows), dtype=complex)
    for j, h in enumerate(below.basis.orders):
        forces[level.basis.orders.index(h)] = found[0][j]
    return forces, found[1]


def sharpen_corners(balance: HarmonicBalance, tolerance: float, failed: Attempt) -> Attempt:
    """From full stick through laws with ever sharper corners to the exact ones.

    Returns:
        The solution, or the better of what was found last and the ``failed`` attempt; all Newton steps counted.
    """
    unit = balance.force_unit / np.sqrt(balance.rows)
    unknowns, steps = balance.pack(*balance.full_stick), failed.iterations
    width, reached, ratio = 1.0, None, 0.2
    while SHARP < width < BLUNT and ratio < 0.9:
        rounded = HarmonicBalance(round_corners(balance.system, width * unit), balance.force_unit)
        attempt = run_newton(rounded, unknowns, max(1e-3 * width, 0.1 * tolerance), "elimination", COARSE_STEPS)
        steps += attempt.iterations
        if attempt.converged:
            unknowns, reached = attempt.unknowns, width
            width, ratio = width * ratio, max(ratio**1.5, 0.05)
        elif reached is None:
            width *= 4.0
        else:
            ratio = np.sqrt(ratio)
            width = reached * ratio
    attempt = run_newton(balance, unknowns, tolerance, "elimination")
    steps += attempt.iterations
    if attempt.converged:
        return replace(attempt, iterations=steps, reason=f"{failed.reason}; found through laws with rounded corners")
    better = min(failed, attempt, key=lambda a: a.residual)
    return replace(better, iterations=steps, reason=f"{failed.reason}; nor through laws with rounded corners")


def trace_load(balance: HarmonicBalance, tolerance: float, failed: Attempt) -> Attempt:
    """Follow the solution from a small share of the oscillating load to the whole, by arc length, past folds.

    Returns:
        The solution, or the better of the branch's last point and the ``failed`` attempt; all Newton steps counted.
    """
    compliance = balance.compliance
    oscillates = np.array(balance.basis.orders) > 0

    def at(share: float) -> HarmonicBalance:
        motion = np.where(oscillates[:, None], share * compliance.free_motion, compliance.free_motion)
        system = replace(balance.system, compliance=replace(compliance, free_motion=motion))
        return HarmonicBalance(system, balance.force_unit)

    first = at(FIRST_LOAD_SHARE)
    attempt = run_newton(first, first.pack(*first.full_stick), tolerance, "elimination")
    steps, points = failed.iterations + attempt.iterations, 0
    if not attempt.converged:
        reason = f"{failed.reason}, nor a solution at {FIRST_LOAD_SHARE:.0%} of the oscillating load"
        return replace(failed, iterations=steps, reason=reason)
    here = BranchPoint(FIRST_LOAD_SHARE, attempt.unknowns, steps)
    branch, reach = trace_branch(at, here, 1.0, tolerance=tolerance), 0.1
    while points < BRANCH_POINTS and (point := next(branch, None)) is not None:
        points += 1
        steps += point.steps
        if point.parameter < 1.0:
            here = point
            continue
        share = (1.0 - here.parameter) / (point.parameter - here.parameter)
        guess = here.unknowns + share * (point.unknowns - here.unknowns)
        attempt = run_newton(balance, guess, tolerance, "elimination")
        steps += attempt.iterations
        if attempt.converged:
            reason = f"{failed.reason}; found by tracing the oscillating load in {points} points"
            return replace(attempt, iterations=steps, reason=reason)
        reach *= 0.3  # the step across the whole load was too long to interpolate in: again, shorter
        branch = trace_branch(at, here, 1.0, step=reach, tolerance=tolerance)
    residual = float(np.linalg.norm(balance.residual(here.unknowns)))
    reason = f"{failed.reason}; the branch was lost or too long at {here.parameter:.0%} of the oscillating load"
    better = failed if failed.residual <= residual else replace(failed, unknowns=here.unknowns, residual=residual)
    return replace(better, iterations=steps, reason=reason)
