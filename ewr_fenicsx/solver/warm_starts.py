"""Newton's method from a neighbour's solution: one of another frequency, load, law or set of harmonics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.newton_step import NewtonStep
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.growing_sets import come_near_through_sets
from ewr_fenicsx.solver.snes import Attempt, LinearSolver, run_newton
from ewr_fenicsx.solver.splitting import DEAR_FROM, WORTHWHILE, Splitting, are_projections, come_near

SAME_MOTION = 1e-6  # relative difference between two motions below which they are one
# Residual of what is carried over, above which a splitting may be worth its while: less where Newton steps are dear
FAR, DEAR_FAR = 5e-3, 1e-3
# Unknowns whose rows change status, from which on a splitting goes before a guiding step to another frequency: fewer
# than elsewhere (``WORTHWHILE``), for such a start is far off, and Newton runs from it creep from kink to kink.
GUIDED_WORTHWHILE = 100
WARM_STEPS = 40  # Newton steps a run: those that lead anywhere take fewer, nearly all

Start = tuple[RealArray, bool, int]  # unknowns, whether they are near a solution, and the Newton steps that they took


def carry_over(start: PeriodicSolution, balance: HarmonicBalance) -> tuple[ComplexArray, ComplexArray, RealArray]:
    """Forces and motions ``(n_h, m)`` and rigid coordinates of another problem's solution, in this one's rows.

    Harmonics that it lacks are zero.
    """
    shape = (len(balance.basis.orders), balance.rows)
    forces, motion = np.zeros(shape, dtype=complex), np.zeros(shape, dtype=complex)
    there = start.problem.system
    moved = start.row_motion
    kept = [(j, start.orders.index(h)) for j, h in enumerate(balance.basis.orders) if h in start.orders]
    for direction, known in start.pair_forces.items():
        pairs = np.arange(known.shape[1])
        here, from_ = balance.system.row_of(direction, pairs), there.row_of(direction, pairs)
        both = (here >= 0) & (from_ >= 0)
        for j, i in kept:
            forces[j, here[here >= 0]] = known[i, here >= 0]
            motion[j, here[both]] = moved[i, from_[both]]
    return forces, motion, start.rigid if start.rigid.size == balance.rigid else balance.full_stick[1]


def go_on_from(
    start: PeriodicSolution, balance: HarmonicBalance, tolerance: float, linear_solver: LinearSolver
) -> Attempt:
    """Newton from the solution of another problem on the same model, given up where that takes many steps."""
    return try_starts(balance, list_starts(start, balance, tolerance), tolerance, linear_solver, WARM_STEPS)


def try_starts(
    balance: HarmonicBalance,
    starts: Iterable[Start],
    tolerance: float,
    linear_solver: LinearSolver,
    limit: int,
    run: Callable[..., Attempt] | None = None,
) -> Attempt | None:
    """Newton from one start after the other until it converges; the best attempt, with the steps of all; None of none.

    Args:
        balance, tolerance, linear_solver, limit: As in ``run_newton``.
        starts: As ``list_starts`` makes them.
        run: What makes an attempt of a start, called like ``run_newton``, the default.
    """
    run = run or run_newton
    runs = ((run(balance, u, tolerance, linear_solver, limit, near=near), taken) for u, near, taken in starts)
    return pick_first(replace(attempt, iterations=attempt.iterations + taken) for attempt, taken in runs)


def pick_first(attempts: Iterable[Attempt]) -> Attempt | None:
    """The first attempt that found something, no more are made, or the best; with the steps of all; None of none."""
    made = []
    for attempt in attempts:
        made.append(attempt)
        if attempt.decides:
            break
    return replace(min(made), iterations=sum(attempt.iterations for attempt in made)) if made else None


def list_starts(start: PeriodicSolution, balance: HarmonicBalance, tolerance: float) -> Iterator[Start]:
    """Where to start from another problem's solution.

    A splitting leads there, where many pairs change status, ever nearer where Newton's method creeps. Its forces serve
    as they are where they cause the same motion here (other harmonics, samples or laws). At another frequency, with
    another model or load, a guiding step makes the two fit. Where a run from there creeps from kink to kink and ends at
    a corner, steps without a shift mostly end there too, and the splitting is the other way in any joint.
    """
    forces, motion, rigid = carry_over(start, balance)
    carried = balance.pack(forces, rigid)
    moved = np.abs(balance.compliance.motion(forces, rigid) - motion).max(initial=0.0)
    same = moved <= SAME_MOTION * np.abs(motion).max(initial=0.0)
    left = balance.measure_residual(carried)
    linearise = cache(lambda: balance.linearise(carried, motion))  # once, and only where it is asked for
    least = WORTHWHILE if same else GUIDED_WORTHWHILE
    far = DEAR_FAR if same and balance.size >= DEAR_FROM else FAR
    many = left > max(far, tolerance) and balance.size >= least and linearise().unknowns_left >= least
    splits = False
    for near in list_near(balance, forces, motion, few_first=same) if many else ():
        splits = True
        yield near, True, 0
    if same or left <= tolerance:
        yield carried, True, 0
        if splits:
            return
        yield carried, False, 0
        yield step_from(linearise(), carried), False, 1
        return
    guided = step_from(linearise(), carried)
    yield guided, False, 1
    if not splits:
        yield next(split(balance, forces, motion), guided), True, 0


def list_predicted(
    balance: HarmonicBalance, forces: ComplexArray, motion: ComplexArray, rigid: RealArray
) -> Iterator[Start]:
    """Where to start from forces and motions that need not fit each other, as in ``guide``."""
    unknowns = balance.pack(forces, rigid)
    step = balance.linearise(unknowns, motion)
    held = bool(np.any(balance.held))
    if held:  # a splitting moves pairs away from where springs hold them
        yield step_from(step, unknowns), False, 1
    if step.unknowns_left >= WORTHWHILE:
        for near in split(balance, forces, motion):
            yield near, True, 0
    if not held:
        yield step_from(step, unknowns), False, 1


def split(balance: HarmonicBalance, forces: ComplexArray, motion: ComplexArray) -> Iterator[RealArray]:
    """Unknowns ever nearer a solution, where a splitting leads that begins at forces and motions as in ``guide``."""
    if are_projections(balance):
        for _, unknowns in come_near(balance, lambda splitting: splitting.join(forces, motion)):
            yield unknowns


def list_near(
    balance: HarmonicBalance, forces: ComplexArray, motion: ComplexArray, *, few_first: bool
) -> Iterator[RealArray]:
    """What ``split`` finds; where that is nothing, what splittings on few harmonics first do, if these may be tried."""
    known = None
    for known in split(balance, forces, motion):
        yield known
    if known is not None or not few_first or not are_projections(balance):
        return

    def begin(splitting: Splitting) -> RealArray:
        kept = [balance.basis.orders.index(h) for h in splitting.balance.basis.orders]
        return splitting.join(forces[kept], motion[kept])

    yield from come_near_through_sets(balance, begin)


def guide(balance: HarmonicBalance, forces: ComplexArray, motion: ComplexArray, rigid: RealArray) -> RealArray:
    """Unknowns one Newton step from a neighbour's forces and motions, ``(n_h, m)``, and rigid coordinates.

    The laws are linearised at these forces *and* motions, so that what each pair did there (open, stuck or slipping at
    every sample) carries over, and the step makes the two fit the new compliance. The forces by themselves would move
    the pairs anywhere near a resonance.
    """
    unknowns = balance.pack(forces, rigid)
    return step_from(balance.linearise(unknowns, motion), unknowns)


def step_from(step: NewtonStep, unknowns: RealArray) -> RealArray:
    """Unknowns after one whole Newton step; the same where it cannot be solved for."""
    try:
        return unknowns - step.solve(step.residual)
    except np.linalg.LinAlgError:
        return unknowns
