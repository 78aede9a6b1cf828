"""Weights of one's own: the default ones in their place, and the ways from there to those asked for.

Weights far from the defaults cost Newton's method many steps, or it finds nothing. With the default ones it takes few.
Weights in between then lead on, evenly spaced in their logarithms: a long splitting takes each solution to the next
few weights at next to no Newton steps. Where it ends, Newton's path with the weights asked for leads on from corner to
corner, or else the branch of solutions is traced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.contact_system import ContactSystem
from ewr_fenicsx.problem.dashpots import read_weight
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.continuation import BalanceAt
from ewr_fenicsx.solver.ladder import BEHIND, LARGEST_TRACED, follow
from ewr_fenicsx.solver.long_splitting import split_at_length
from ewr_fenicsx.solver.newton_path import SHORT, follow_from_afar, run_and_follow
from ewr_fenicsx.solver.snes import Attempt, LinearSolver, run_newton
from ewr_fenicsx.solver.warm_starts import WARM_STEPS, go_on_from

# Shares of the way, in the logarithms of the weights, that splittings take one after the other; and how closely those
# on the way are solved.
STAGES, STAGE_TOLERANCE = (1 / 3, 2 / 3, 1.0), 1e-4
# Newton steps from the default weights' solution as it is, before: where little slips they arrive. So many at a time,
# as long as these leave less than a share of the residual.
DIRECT_STEPS, DIRECT_SHARE = 4, 0.3
WALK_STEPS = 220  # Newton steps of a walk; one is given up as soon as it would take more at its pace
# Times above or below the default ones from which weights are come to from these at once: a cold start mostly fails.
FAR = 30.0
# Unknowns above which splittings take so long that there is one stage only, and Newton steps so long that none are
# tried from the default weights' solution where it leaves more than that: few arrive.
LARGEST_STAGED, FAR_OFF = 3000, 3e-3
FURTHEST = 3.0  # share of the way, of which a trial may not go beyond: weights would overflow


def has_own_weights(problem: ContactProblem) -> bool:
    """Whether a problem gives weights of its laws, or their closure, which may cost many steps by themselves."""
    return use_default_weights(problem) is not problem


def has_far_weights(problem: ContactProblem) -> bool:
    """Whether some pair's weight is far from its default, and nothing but dashpots closes the truncation."""
    if problem.system.closures or not has_own_weights(problem):
        return False
    usual = use_default_weights(problem)
    for direction in ("normal", "tangential"):
        given, default = (read_weight(problem, direction, stated) for stated in (problem, usual))
        if given is not None and np.any((given > FAR * default) | (given < default / FAR)):
            return True
    return False


def use_default_weights(problem: ContactProblem) -> ContactProblem:
    """The problem with default weights and dashpots, which need the fewest steps; itself where it has nothing else."""
    own_closure = problem.has_springs or problem.system.closures
    if problem.rho_normal is None and problem.rho_tangential is None and not own_closure:
        return problem
    return replace(problem, rho_normal=None, rho_tangential=None, closure="dashpot")


def went_back(problem: ContactProblem) -> bool:
    """Whether a solution's problem is one that ``solve`` went back to by ``use_default_weights``, or was asked for."""
    weights = problem.rho_normal is problem.rho_tangential is None
    return weights and isinstance(problem.closure, str) and problem.closure == "dashpot"


def adopt_weights(problem: ContactProblem, other: ContactProblem) -> ContactProblem:
    """The problem with the weights and the closure of another one; itself where it has these."""
    named = {name: getattr(other, name) for name in ("rho_normal", "rho_tangential", "closure")}
    return problem if all(getattr(problem, n) is value for n, value in named.items()) else replace(problem, **named)


def approach_weights(
    balance: HarmonicBalance, usual: PeriodicSolution, tolerance: float, linear_solver: LinearSolver
) -> Attempt:
    """Come to the weights of a balance from the default ones: at once, by splittings in stages, or along a path.

    Args:
        balance: The balance to solve.
        usual: The solution of the same problem with default weights and dashpots.
        tolerance, linear_solver: As in ``solve``.

    Returns:
        The solution or the last attempt, with the Newton steps of all.
    """
    neighbour, begin = usual.problem.system, balance.pack(usual.forces, usual.rigid)
    joined = not balance.system.closures  # no path leads from dashpots to springs
    at = blend_weights(neighbour, balance) if joined else None
    share, here, last, steps = 0.0, begin, None, 0
    if joined and (balance.size <= LARGEST_STAGED or balance.measure_residual(begin) <= FAR_OFF):
        last = _go_straight(balance, begin, tolerance, linear_solver)
        steps = last.iterations
        if last.converged:
            return last
    for stage in STAGES if joined and balance.size <= LARGEST_STAGED else STAGES[-1:]:
        level, goal = (balance, tolerance) if stage == 1.0 else (at(stage), max(tolerance, STAGE_TOLERANCE))
        forces, rigid = balance.unpack(here)
        last = split_at_length(level, forces, neighbour.compliance.motion(forces, rigid), goal, linear_solver)
        steps += last.iterations if last else 0
        if last is None or not last.converged:
            break
        share, here = stage, last.unknowns
    if share == 0.0 and last is None:  # as with laws that are no projections
        last = go_on_from(usual, balance, tolerance, linear_solver)
        steps += last.iterations
    if joined and not (last and last.converged) and (path := follow_from_afar(balance, begin, tolerance)):
        last, steps = path, steps + path.iterations
    if joined and not (last and last.converged) and balance.size <= LARGEST_TRACED:
        last = walk_weights(balance, at, [(share, here), (0.0, begin)], tolerance)
        steps += last.iterations
    last = last or Attempt(here, np.inf, 0, "no splitting came near a solution", False)
    return replace(last, iterations=steps)


def _go_straight(balance: HarmonicBalance, begin: RealArray, tolerance: float, linear_solver: LinearSolver) -> Attempt:
    """Newton's method from a solution with other weights, given up as soon as it does not close in fast."""
    steps, left = 0, balance.measure_residual(begin)
    while True:
        last = run_and_follow(balance, begin, tolerance, linear_solver, DIRECT_STEPS, near=True, most=SHORT)
        steps += last.iterations
        if last.decides or not last.residual < DIRECT_SHARE * left:
            return replace(last, iterations=steps)
        begin, left = last.unknowns, last.residual


def walk_weights(
    balance: HarmonicBalance, at: BalanceAt, starts: Sequence[tuple[float, RealArray]], tolerance: float
) -> Attempt:
    """Follow the branch of solutions to the weights of a balance, from the first start that there is a solution at.

    Args:
        balance: The balance to solve.
        at: Share of the way -> balance with the weights there, in the same units.
        starts: Shares of the way with unknowns ``(size,)``, scaled, near the solution there.
        tolerance: Residual norm accepted.
    """
    steps = 0
    for share, unknowns in starts:
        begin = run_newton(at(share), unknowns, tolerance, "elimination", WARM_STEPS, near=True)
        steps += begin.iterations
        if begin.converged:
            break
    else:
        return replace(begin, iterations=steps, reason="no branch begins at the default weights")
    start = replace(begin, residual=np.inf, iterations=steps, converged=False)
    rest = lambda part: at(share + (1 - share) * part)  # noqa: E731
    told = f"of the way from {share:.0%} to the asked weights"
    return follow(balance, rest, 0.0, begin.unknowns, tolerance, start, told, pace=WALK_STEPS)


def blend_weights(neighbour: ContactSystem, balance: HarmonicBalance) -> BalanceAt:
    """Share of the way -> balance with the weights there, from a neighbour's to its own, evenly in the logarithm."""
    pairs = list(zip(neighbour.laws, balance.system.laws, strict=True))

    def at(share: float) -> HarmonicBalance:
        share = min(max(share, BEHIND), FURTHEST)
        laws = tuple(
            replace(law, rho=other.rho * (law.rho / other.rho) ** share) if hasattr(law, "rho") else law
            for other, law in pairs
        )
        return HarmonicBalance(replace(balance.system, laws=laws), balance.force_unit)

    return at
