"""The oscillating load grows from a small share to the whole, past folds: two more rungs of the ladder.

- ``grow_load``: from corner to corner, with few samples a period first.
- ``trace_load``: by arc length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ewr_fenicsx.balance.balance import FIRM, HarmonicBalance
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.solver.growing_sets import choose_samples, sample_anew
from ewr_fenicsx.solver.ladder import COARSE_STEPS, LARGEST_TRACED, choose_better, follow, start_from_splitting
from ewr_fenicsx.solver.newton_path import CLOSE, CORNERS, follow_path, limit_corners, run_and_follow
from ewr_fenicsx.solver.snes import Attempt
from ewr_fenicsx.solver.warm_starts import WARM_STEPS

FIRST_LOAD_SHARE = 0.02  # of the oscillating load, where its growth starts
GROWN_CORNERS, GROWN_WORK = 18000, 2 * 10**7  # corners at most, and times the unknowns: half a minute
BEGINS, SMALL = 2, 100  # times that it grows, with ever more samples; unknowns up to which it does with all there are


def grow_load(balance: HarmonicBalance, tolerance: float, failed: Attempt) -> Attempt:
    """From corner to corner while the oscillating load grows from a small share to the whole; then more samples.

    Where there is one solution at the begin, and damping bounds all motion on the way, that has no other end than a
    solution, but for coincidences. It has thousands of corners, the fewer the fewer samples a period the laws see. From
    the solution with few samples, those with ever more are a few steps away, or a short path. Where one is lost, the
    load grows from its begin with as many samples as it was lost with.

    Returns:
        The solution, or the ``failed`` attempt with what became of this one; the steps of both counted.
    """
    levels, steps = [sample_anew(balance, samples) for samples in choose_samples(balance)], failed.iterations
    for _ in range(BEGINS if balance.size > SMALL else len(levels)):
        grown, levels = _grow(levels, tolerance)
        steps += grown.iterations
        if not levels:
            break
    return choose_better(failed, grown, steps, "the oscillating load")


def _grow(levels: Sequence[HarmonicBalance], tolerance: float) -> tuple[Attempt, Sequence[HarmonicBalance]]:
    """The load grown on the first of some balances, which differ in samples alone, and the others' solutions in turn.

    Returns:
        An attempt, with an infinite residual where it failed: it is no solution of the last one; and the balances from
        the one on that lost the solution of the one before.
    """
    few = levels[0]
    first, begun = _begin_with_little_load(few, tolerance)
    lost = replace(begun, residual=np.inf, reason=f"no way from {FIRST_LOAD_SHARE:.0%} of it", converged=False)
    most = limit_corners(few, GROWN_CORNERS, GROWN_WORK)
    path = follow_path(few.firm, begun.unknowns, tolerance, most, first, tried=most) if begun.converged else None
    if path is None:
        return lost, []
    found, steps = path, begun.iterations + path.iterations
    if not path.residual < CLOSE:
        return replace(lost, iterations=steps, reason=path.reason), []
    for i, level in enumerate(levels):
        found = _see_more(level, found.unknowns, tolerance)
        steps += found.iterations
        if not found.converged:
            told = f"grown with {few.basis.samples} samples a period, lost with {level.basis.samples}"
            return replace(lost, iterations=steps, reason=told), levels[max(i, 1) :]
    return replace(found, iterations=steps, reason="grown from corner to corner"), []


def _see_more(level: HarmonicBalance, start: RealArray, tolerance: float) -> Attempt:
    """The solution near that with fewer samples a period: by Newton's method, or else from there along its path."""
    run = run_and_follow(level, start, tolerance, "elimination", COARSE_STEPS, near=True)
    path = None if run.converged else follow_path(level, start, tolerance, CORNERS, tried=CORNERS)
    if path is None:
        return run
    found = run_and_follow(level, path.unknowns, tolerance, "elimination", WARM_STEPS, near=True)
    return replace(found, iterations=run.iterations + path.iterations + found.iterations)


def trace_load(balance: HarmonicBalance, tolerance: float, failed: Attempt) -> Attempt:
    """Follow the solution from a small share of the oscillating load to the whole.

    Returns:
        The solution, or the better of the branch's last point and the ``failed`` attempt; the steps of both counted.
    """
    if balance.size > LARGEST_TRACED:
        return failed
    _, begun = _begin_with_little_load(balance, tolerance)
    counted = replace(failed, iterations=failed.iterations + begun.iterations)
    if not begun.converged:
        return replace(counted, reason=f"no solution at {FIRST_LOAD_SHARE:.0%} of the oscillating load")
    at = partial(load_by_share, balance)
    return follow(balance, at, FIRST_LOAD_SHARE, begun.unknowns, tolerance, counted, "of the oscillating load")


def load_by_share(balance: HarmonicBalance, share: float) -> HarmonicBalance:
    """The firm balance under a share of its oscillating load."""
    compliance = balance.compliance
    oscillates = np.array(balance.basis.orders) > 0
    motion = np.where(oscillates[:, None], share * compliance.free_motion, compliance.free_motion)
    system = replace(balance.system, compliance=replace(compliance, free_motion=motion))
    return HarmonicBalance(system, balance.force_unit, FIRM)


def _begin_with_little_load(balance: HarmonicBalance, tolerance: float) -> tuple[HarmonicBalance, Attempt]:
    """The balance where a growing load begins, and an attempt at it: from a splitting, or else from full stick."""
    first = load_by_share(balance, FIRST_LOAD_SHARE)
    split = start_from_splitting(first, tolerance, "elimination")
    if split.converged:
        return first, split
    run = run_and_follow(first, first.pack(*first.full_stick), tolerance, "elimination", COARSE_STEPS)
    return first, replace(run, iterations=split.iterations + run.iterations)
