"""The ladder: cold starts, and the ways to a solution that Newton's method does not find by itself.

Each function is one way to the solution of a balance, mostly from full stick, and returns an ``Attempt`` whose
iterations are all the Newton steps that the way took:

1. ``start_from_splitting``: Newton from where operator splitting ends.
2. ``climb``: growing sets of harmonics, each started at the one before.
3. ``come_down``: from more harmonics to fewer.
4. ``sharpen_corners``: laws with rounded corners, sharpened along the branch of their solutions.
5. ``trace_damping``: damping from where little can bounce to the model's own, past folds.

``growing_load.py`` has two more, by which the oscillating load grows. Where Newton's method stalls next to a solution,
``newton_path.py`` goes on over corners. ``start_cold`` is the first, or else the second; ``at_rest.py`` begins both
elsewhere. ``climb`` may be given others, which it tries on each set of harmonics where Newton stalls.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from ewr_fenicsx.balance.balance import FIRM, HarmonicBalance
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.smoothing import round_corners
from ewr_fenicsx.model.compliance import condense
from ewr_fenicsx.solver.continuation import BalanceAt, BranchPoint, trace_branch
from ewr_fenicsx.solver.growing_sets import come_near_through_sets, embed, grow_sets
from ewr_fenicsx.solver.long_splitting import split_at_length
from ewr_fenicsx.solver.newton_path import can_follow, run_and_follow
from ewr_fenicsx.solver.snes import Attempt, LinearSolver, run_newton
from ewr_fenicsx.solver.splitting import Splitting, can_split
from ewr_fenicsx.solver.warm_starts import WARM_STEPS, pick_first, try_starts

# Highest harmonics of the sets that a cold start climbs through: few at first, more where that fails. Where springs,
# the same for every set, close the truncation, fewer and looser ones come first: that takes fewer steps.
COARSE_LEVELS, SPRING_LEVELS, FINE_LEVELS = (5, 15, 40), (3, 7, 15, 40), (1, 3, 5, 9, 15, 23, 31, 47, 63)
LAST_STEPS = 40  # Newton steps of the last set, after which its path is tried
COARSE_STEPS = 25  # a coarse set is only a start for the next:
COARSE_TOLERANCE, SPRING_TOLERANCE = 1e-3, 1e-2
FINE_TOLERANCE = 1e-5  # where sets are many: a corner far from any solution may leave less than the coarse one
CLOSE = 5e-3  # residual above which nothing on a set of harmonics is near a solution
BRANCH_POINTS, SECOND_LOOKS = 150, 4  # of a traced branch at most; times that its last step is taken again, shorter
BEGUN = 0.15  # share of the way that a branch is taken to have gone at least, where its pace is looked at
BEHIND = -2.0  # share of the way, behind its begin, at which a branch is left: it leads away
# Unknowns: a path takes hundreds of Newton steps, so it is followed with few harmonics; with rounded corners, where no
# more than the last of several sets is in the way, with some more.
LARGEST_TRACED, LARGEST_ROUNDED = 2000, 3000
LARGEST_DAMPED, DAMPED_POINTS = 500, 400  # the same where damping falls: its branch has more corners, and more points
# Damping that is added, in turn until a cold start finds a solution: over omega times the mass, plus stiffness over
# omega. And below which of it a branch is traced in equal steps of the damping, above in those of its logarithm.
DAMPINGS, LIGHT = (0.1, 3.0, 100.0, 1000.0), 1e-3
MOST_STEPS = 500  # Newton steps after which no further path is begun
SHARP = 1e-7  # width of rounded corners, over the mean contact force, that counts as sharp
BLUNT = 8.0 ** np.arange(5)  # widths in turn, where the rounded branch begins at full stick
NEAR_WIDTHS = np.array([10.0, 200.0, 4000.0])  # of corners rounded around a failed attempt, over its residual
LOST = 300.0  # norm of the unknowns, of order one, above which a rounded branch runs to infinity
BACK = 3.0  # in the logarithm of the width, behind its begin: a branch that turned there to blunt corners is left
ROUNDED_STEPS = 12  # Newton steps allowed where the rounded branch begins
SPLIT_STEPS = 25  # Newton steps a run from where it ends: those that arrive take fewer

Rung = Callable[[HarmonicBalance, float, Attempt], Attempt]


def start_cold(
    balance: HarmonicBalance,
    tolerance: float,
    linear_solver: LinearSolver,
    levels: tuple[int, ...] = COARSE_LEVELS,
    coarse_tolerance: float = COARSE_TOLERANCE,
    limit: int | None = None,
) -> Attempt:
    """Newton from where a splitting ends, or else from full stick up through growing sets of harmonics.

    Where bodies that are left to themselves never touch, there is nothing to look for.

    ``limit``: Newton steps allowed on the last set.
    """
    free = np.zeros(balance.size)
    if balance.measure_residual(free) <= tolerance:
        return run_newton(balance, free, tolerance, linear_solver)
    split = start_from_splitting(balance, tolerance, linear_solver)
    if split.decides:
        return split
    climbed = climb(balance, tolerance, linear_solver, levels, coarse_tolerance=coarse_tolerance, limit=limit)
    better = climbed if climbed.converged else min(climbed, split)
    return replace(better, iterations=split.iterations + climbed.iterations)


def begin_at_full_stick(balance: HarmonicBalance) -> Attempt:
    """The full-stick state as an attempt of no steps."""
    unknowns = balance.pack(*balance.full_stick)
    return Attempt(unknowns, balance.measure_residual(unknowns), 0, "nothing is closer than full stick", False)


def start_from_splitting(
    balance: HarmonicBalance,
    tolerance: float,
    linear_solver: LinearSolver,
    begin: Callable[[Splitting], RealArray] = Splitting.begin,
) -> Attempt:
    """Newton from where a splitting ends, or ever nearer to there; full stick where that is nowhere near a solution."""
    none = begin_at_full_stick(balance)
    if none.residual <= tolerance or not can_split(balance):
        return none
    starts = ((unknowns, True, 0) for unknowns in come_near_through_sets(balance, begin))
    return try_starts(balance, starts, tolerance, linear_solver, SPLIT_STEPS, run_and_follow) or none


def climb(
    balance: HarmonicBalance,
    tolerance: float,
    linear_solver: LinearSolver,
    levels: tuple[int, ...],
    rungs: tuple[Rung, ...] = (),
    coarse_tolerance: float = COARSE_TOLERANCE,
    limit: int | None = None,
    begin: Callable[[HarmonicBalance], tuple[ComplexArray, RealArray]] = lambda level: level.cold_start,
) -> Attempt:
    """Growing sets of harmonics, the first from where ``begin`` says, the others from the solution of the one before.

    On a set where Newton stalls, a long splitting from the same start and then ``rungs`` are tried in turn, if there
    are any. Where there are none, in large joints a set on which nothing comes near a solution is the last: on larger
    ones steps take long, and hardly any solution is found from there.
    """
    below, attempt, steps, solved = None, None, 0, None  # the latter: up to which harmonic
    for level in grow_sets(balance, levels):
        guess = begin(level) if below is None else embed(below.unpack(attempt.unknowns), below, level)
        run, goal, most = run_newton, coarse_tolerance, COARSE_STEPS
        if level is balance:
            run, goal, most = run_and_follow, tolerance, limit or (LAST_STEPS if can_follow(level) else None)
        attempt = run(level, level.pack(*guess), goal, linear_solver, most, near=below is not None)
        if rungs and below is not None and not attempt.converged:
            split = split_at_length(level, guess[0], level.compliance.motion(*guess), goal, linear_solver)
            if split is not None:
                attempt = replace(min(attempt, split), iterations=attempt.iterations + split.iterations)
        for rung in rungs:
            if not attempt.converged and steps + attempt.iterations < MOST_STEPS:
                attempt = rung(level, goal, attempt)
        steps += attempt.iterations
        below = level
        if attempt.converged:
            solved = level.basis.orders[-1]
        elif balance.size > LARGEST_TRACED and attempt.residual > CLOSE and not rungs:
            break
    if level is not balance:
        unknowns = balance.pack(*embed(level.unpack(attempt.unknowns), level, balance))
        attempt = replace(attempt, unknowns=unknowns, residual=balance.measure_residual(unknowns))
    if not attempt.converged and solved:
        attempt = replace(attempt, reason=f"{attempt.reason}; harmonics up to {solved} were solved for")
    return replace(attempt, iterations=steps)


def come_down(
    balance: HarmonicBalance, above: HarmonicBalance, found: Attempt, tolerance: float, linear_solver: LinearSolver
) -> Attempt:
    """From a solution with more harmonics to that of a balance: at once by a long splitting, or dropped one by one.

    Where bodies bounce, solutions with few harmonics may have little to do with the motion, and time stepping leads to
    none of them, but to one with more.

    Args:
        balance: The balance to solve.
        above: The same with higher harmonics as well.
        found: A solution of ``above``.
        tolerance, linear_solver: As in ``solve``.

    Returns:
        The solution, or the last attempt; with all Newton steps.
    """
    forces, rigid = above.unpack(found.unknowns)
    motion = above.compliance.motion(forces, rigid)
    few, many = len(balance.basis.orders), len(above.basis.orders)
    at_once = split_at_length(balance, forces[:few], motion[:few], tolerance, linear_solver)
    if at_once is not None and at_once.decides:
        return at_once
    steps = at_once.iterations if at_once else 0
    for kept in range(many - 1, few - 1, -1):
        level, goal = balance, tolerance
        if kept > few:
            fewer = above.system.restrict(above.basis.orders[:kept])
            level, goal = HarmonicBalance(fewer, balance.force_unit), max(tolerance, COARSE_TOLERANCE)
        attempt = pick_first(_run_or_split(level, forces[:kept], motion[:kept], rigid, goal, linear_solver))
        steps += attempt.iterations
        if not attempt.converged:
            break
        forces, rigid = level.unpack(attempt.unknowns)
        motion = level.compliance.motion(forces, rigid)
    if level is not balance:
        told = f"what solves harmonics up to {above.basis.orders[kept]} led to nothing up to {level.basis.orders[-1]}"
        attempt = replace(begin_at_full_stick(balance), reason=told)
    if at_once is not None and not attempt.converged:
        attempt = replace(min(attempt, at_once), reason=attempt.reason)
    return replace(attempt, iterations=steps)


def _run_or_split(
    level: HarmonicBalance,
    forces: ComplexArray,
    motion: ComplexArray,
    rigid: RealArray,
    goal: float,
    linear_solver: LinearSolver,
) -> Iterator[Attempt]:
    """Attempts from what was found with more harmonics: by Newton's method, then by a long splitting."""
    yield run_and_follow(level, level.pack(forces, rigid), goal, linear_solver, COARSE_STEPS, near=True)
    if split := split_at_length(level, forces, motion, goal, linear_solver):
        yield split


def sharpen_corners(balance: HarmonicBalance, tolerance: float, failed: Attempt) -> Attempt:
    """Through laws with rounded corners, along the branch of their solutions over the logarithm of the width, to exact.

    The branch begins near the failed attempt, where corners as wide as what it left over hold, or else at full stick
    with corners as wide as it takes. It is traced past folds, which the rounding moves into view.

    Returns:
        The solution, or the better of what was found last and the ``failed`` attempt; the steps of both counted.
    """
    if balance.size > LARGEST_ROUNDED:
        return failed
    unit = balance.force_unit / np.sqrt(balance.rows)

    def at(logarithm: float) -> HarmonicBalance:
        width = np.exp(np.clip(logarithm, *np.log((1e-3 * SHARP, 1e3 * BLUNT[-1])))) * unit
        return HarmonicBalance(round_corners(balance.system, width), balance.force_unit, FIRM)

    near = [w for w in failed.residual * NEAR_WIDTHS if w < 1.0]
    attempt, steps, width = failed, failed.iterations, np.inf
    for start, widths in ((failed.unknowns, near), (balance.pack(*balance.full_stick), BLUNT)):
        begun, taken = _round_until_solved(at, start, widths)
        steps += taken
        if begun is None:
            continue
        here, goal = begun, min(tolerance, 1e-3 * np.exp(begun.parameter))
        branch = trace_branch(at, begun, -2.0, step=1.0, smallest_step=1e-6, tolerance=goal)
        for point in islice(branch, BRANCH_POINTS):
            steps += point.steps
            here = point
            runs_away = here.parameter > begun.parameter + BACK or np.linalg.norm(here.unknowns) > LOST
            if here.parameter < np.log(SHARP) or runs_away:
                break
        attempt, width = run_newton(balance, here.unknowns, tolerance, "elimination"), np.exp(here.parameter)
        steps += attempt.iterations
        if attempt.converged:
            break
    reached = (
        f"corners as sharp as {width:.0e} of the contact forces" if width < np.inf else "no corners were blunt enough"
    )
    return choose_better(failed, attempt, steps, reached)


def _round_until_solved(at: BalanceAt, start: RealArray, widths: Sequence[float]) -> tuple[BranchPoint | None, int]:
    """The solution with the first of ``widths`` at which Newton finds one from ``start``, and the steps of all."""
    steps = 0
    for width in widths:
        rounded = run_newton(at(np.log(width)), start, 1e-3 * min(width, 1.0), "elimination", ROUNDED_STEPS)
        steps += rounded.iterations
        if rounded.converged:
            return BranchPoint(float(np.log(width)), rounded.unknowns, 0), steps
    return None, steps


def trace_damping(balance: HarmonicBalance, tolerance: float, failed: Attempt) -> Attempt:
    """Follow the solution from that of a strongly damped model to the model's own damping.

    Bodies that leave each other and bounce have many motions, or none that is easily found. Damping of the deformation
    alone would leave those of floating bodies as they are: the damping that is added acts on all motion.

    Returns:
        The solution, or the better of the branch's last point and the ``failed`` attempt; the steps of both counted.
    """
    system, omega = balance.system, balance.compliance.omega
    model, mean = system.model, int(balance.basis.has_mean)  # damping changes nothing of the mean
    drag = omega * model.mass + model.stiffness / omega

    def damp(added: float, least_share: float) -> HarmonicBalance:
        damped = replace(model, damping=model.damping + added * drag)
        kept, following = balance.basis.orders[mean:], system.next_rows
        moved = condense(damped, system.rows, system.load, omega, kept, next_rows=following)
        flexibility, motion = balance.compliance.flexibility.copy(), balance.compliance.free_motion.copy()
        flexibility[mean:], motion[mean:] = moved.flexibility, moved.free_motion
        compliance = replace(balance.compliance, flexibility=flexibility, free_motion=motion)
        return HarmonicBalance(replace(system, compliance=compliance), balance.force_unit, least_share)

    steps = failed.iterations
    for most in DAMPINGS:
        attempt = start_cold(damp(most, 0.0), tolerance, "elimination")
        steps += attempt.iterations
        if attempt.converged:
            break
    counted = replace(failed, iterations=steps)
    if not attempt.converged:
        return replace(counted, reason="no solution with so much damping either")
    length = np.log1p(most / LIGHT)

    def at(share: float) -> HarmonicBalance:  # a trial may go anywhere
        return damp(LIGHT * np.expm1(length * (1 - min(max(share, -0.5), 1.05))), FIRM)

    what = "of the way from strong damping"
    return follow(balance, at, 0.0, attempt.unknowns, tolerance, counted, what, DAMPED_POINTS)


def follow(
    goal: HarmonicBalance,
    balance_at: BalanceAt,
    begin: float,
    unknowns: RealArray,
    tolerance: float,
    failed: Attempt,
    what: str,
    points: int = BRANCH_POINTS,
    pace: float = np.inf,
) -> Attempt:
    """Trace a branch by arc length, past folds, from a solution at ``begin`` to the goal at a parameter of one.

    It is left after so many ``points``, or as soon as it would take more Newton steps for the whole way than ``pace``,
    going on as it has so far.

    Returns:
        The solution, or the better of the branch's last point and the ``failed`` attempt; the steps of both counted.
    """
    here, steps, reach, furthest = BranchPoint(begin, unknowns, 0), failed.iterations, 0.1, BEGUN
    branch, looks = trace_branch(balance_at, here, 1.0, step=reach, tolerance=tolerance), 0
    for _ in range(points):
        slow = steps - failed.iterations > pace * furthest
        if slow or (point := next(branch, None)) is None:
            break
        steps += point.steps
        furthest = max(furthest, (point.parameter - begin) / (1.0 - begin))
        if point.parameter < BEHIND:
            break
        if point.parameter < 1.0:
            here = point
            continue
        share = (1.0 - here.parameter) / (point.parameter - here.parameter)
        guess = here.unknowns + share * (point.unknowns - here.unknowns)
        attempt = run_and_follow(goal, guess, tolerance, "elimination", WARM_STEPS)
        steps += attempt.iterations
        looks += 1
        if attempt.converged or looks > SECOND_LOOKS:
            return choose_better(failed, attempt, steps, f"traced to {here.parameter:.0%} {what} and beyond")
        reach *= 0.3  # the last step was too long to interpolate in: again, shorter
        branch = trace_branch(balance_at, here, 1.0, step=reach, tolerance=tolerance)
    residual = goal.measure_residual(here.unknowns)
    last = Attempt(here.unknowns, residual, 0, "", residual <= tolerance)
    return choose_better(failed, last, steps, f"the branch was lost or too long at {here.parameter:.0%} {what}")


def choose_better(failed: Attempt, attempt: Attempt, steps: int, how: str) -> Attempt:
    """A rung's attempt if it converged, else the better of both; with all Newton steps and how it went."""
    better = attempt if attempt.converged else min(failed, attempt)
    return replace(better, iterations=steps, reason=f"{how}: {attempt.reason}" if attempt.reason else how)
