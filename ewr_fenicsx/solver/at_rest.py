"""Rest: the static solution of the laws under mean loads, where motions in time and bodies hanging on friction start.

What decides the mean of friction by which a body hangs is weak beside the laws' limits (``mean_friction.py``): from
full stick Newton's method creeps towards it, most of all in the plane of contact. Springs that hold pairs in place lead
near it in few steps, which with one harmonic cost next to nothing. The motion around it comes on top.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.loading_history import hold_in_place
from ewr_fenicsx.solver.ladder import FINE_LEVELS, climb, start_cold, start_from_splitting
from ewr_fenicsx.solver.snes import Attempt, LinearSolver, run_newton
from ewr_fenicsx.solver.splitting import Splitting
from ewr_fenicsx.solver.warm_starts import pick_first

REST, REST_STEPS = 1e-8, 40  # residual of a static solution, and Newton steps a run where bodies hang on friction
# Friction over its own, in turn, on each of the ways to where springs hold pairs in place; and least weights of the
# mean force in its equation, in turn, where Newton does not go on from there at once.
GRIPS, SHARES = ((1.0,), (1.5, 1.2, 1.0)), (0.1, 0.01, 0.001)
SLIPPING = 0.2  # residual of rest and what oscillates at full stick, from where on a splitting leads somewhere


def begins_at_rest(balance: HarmonicBalance) -> bool:
    """Whether bodies hang on friction, or float and may be held by it, in the plane of contact or at 0 Hz."""
    return balance.hangs_on_friction and (balance.system.model.tangents > 1 or not np.any(balance.compliance.omega))


def start_at_rest(
    problem: ContactProblem,
    balance: HarmonicBalance,
    tolerance: float,
    linear_solver: LinearSolver,
    limit: int | None = None,
) -> Attempt:
    """A cold start where rest takes the place of full stick on average: see ``ladder.start_cold``.

    Where little slips, a splitting creeps like Newton's method, and is left out.
    """
    rest, steps = find_rest(problem)
    if rest is None:
        cold = start_cold(balance, tolerance, linear_solver, limit=limit)
        return replace(cold, iterations=steps + cold.iterations)

    def begin(level: HarmonicBalance) -> tuple[ComplexArray, RealArray]:
        return np.vstack([rest.forces[:1], level.full_stick[0][1:]]), rest.rigid

    def join(splitting: Splitting) -> RealArray:
        forces, rigid = begin(splitting.balance)
        return splitting.join(forces, splitting.balance.compliance.motion(forces, rigid))

    def attempt() -> Iterator[Attempt]:
        if balance.measure_residual(balance.pack(*begin(balance))) > SLIPPING:
            yield start_from_splitting(balance, tolerance, linear_solver, join)
        yield climb(balance, tolerance, linear_solver, FINE_LEVELS, limit=limit, begin=begin)

    found = pick_first(attempt())
    return replace(found, iterations=steps + found.iterations)


def find_rest(problem: ContactProblem) -> tuple[PeriodicMotion | None, int]:
    """The static solution under the means of the load and of normal forces that are given, if found; Newton steps."""
    static = keep_means(problem)
    balance = HarmonicBalance(static.system)
    held = None
    if balance.hangs_on_friction:
        held = pick_first(_hold(static, balance.force_unit, grips) for grips in GRIPS)
    found = pick_first(_come_to_rest(static, balance, held))
    rest = PeriodicMotion(static, *balance.unpack(found.unknowns)) if found.converged else None
    return rest, found.iterations + (held.iterations if held else 0)


def _come_to_rest(static: ContactProblem, balance: HarmonicBalance, held: Attempt | None) -> Iterator[Attempt]:
    """From where springs hold pairs in place, if that was found; at last from full stick."""
    for shares in ((), SHARES) if held and held.converged else ():
        levels = (HarmonicBalance(static.system, balance.force_unit, share) for share in (*shares, 0.0))
        yield _run_through(levels, held.unknowns)
    yield run_newton(balance, balance.pack(*balance.full_stick), REST, "elimination")


def _hold(static: ContactProblem, force_unit: float, grips: Sequence[float]) -> Attempt:
    """Newton to where springs hold pairs in place, with so many times their friction, in turn, the last one their own.

    With more friction pairs that slip are fewer; those that ought to stick are hard to find among those that slip.
    """
    held = hold_in_place(static)
    levels = []
    for grip in grips:
        laws = [(pairs, replace(laws, friction=grip * np.asarray(laws.friction))) for pairs, laws in held.groups]
        levels.append(HarmonicBalance(replace(held, laws=laws).system, force_unit))
    return _run_through(levels, levels[0].pack(*levels[0].full_stick))


def _run_through(levels: Iterable[HarmonicBalance], start: RealArray) -> Attempt:
    """Newton on balances in turn, each from where it ended on the one before: the last attempt, with all steps."""
    steps = 0
    for level in levels:
        found = run_newton(level, start, REST, "elimination", REST_STEPS)
        steps, start = steps + found.iterations, found.unknowns
    return replace(found, iterations=steps)


def keep_means(problem: ContactProblem) -> ContactProblem:
    """The problem without all that oscillates in what is given: loads and prescribed normal forces."""
    groups = [
        (pairs, replace(laws, normal_force=laws.normal_force.get(0, 0.0)))
        if isinstance(laws.normal_force, Mapping)
        else (pairs, laws)
        for pairs, laws in problem.groups
    ]
    load = {h: f for h, f in problem.loads.items() if h == 0}
    return replace(problem, frequency=0.0, laws=groups, load=load, rho_tangential=None)  # weighs velocities
