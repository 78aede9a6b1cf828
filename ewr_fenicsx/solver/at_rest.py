"""Rest: the static solution of the laws under mean loads, where motions in time and bodies hanging on friction start.

What decides the mean of friction by which a body hangs is weak beside the laws' limits (``mean_friction.py``): from
full stick Newton's method creeps towards it, most of all in the plane of contact. Springs that hold pairs in place lead
near it in few steps, which with one harmonic cost next to nothing. The motion around it comes on top.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.loading_history import hold_in_place
from ewr_fenicsx.solution.periodic_motion import PeriodicMotion
from ewr_fenicsx.solver.ladder import climb
from ewr_fenicsx.solver.snes import Attempt, LinearSolver, run_newton

REST = 1e-8  # residual of a static solution
LEVELS = (1, 3, 5, 9, 15, 23, 31, 47, 63)  # highest harmonics of the sets that are climbed through


def start_at_rest(
    problem: ContactProblem, balance: HarmonicBalance, tolerance: float, linear_solver: LinearSolver
) -> Attempt:
    """Newton up through growing sets of harmonics from rest, and beside it the harmonics of full stick."""
    rest, steps = find_rest(problem)
    forces, rigid = balance.full_stick
    if rest is None:
        unknowns = balance.pack(forces, rigid)
        residual = float(np.linalg.norm(balance.residual(unknowns)))
        return Attempt(unknowns, residual, steps, "no static solution was found", False)
    begin = lambda level: (np.vstack([rest.forces[:1], level.full_stick[0][1:]]), rest.rigid)  # noqa: E731
    climbed = climb(balance, tolerance, linear_solver, LEVELS, begin=begin)
    return replace(climbed, iterations=steps + climbed.iterations)


def find_rest(problem: ContactProblem) -> tuple[PeriodicMotion | None, int]:
    """The static solution under the means of the load and of normal forces that are given, if found; Newton steps."""
    static, steps = keep_means(problem), 0
    balance = HarmonicBalance(static.system)
    start = balance.pack(*balance.full_stick)
    if balance.hangs_on_friction:
        held = HarmonicBalance(hold_in_place(static).system, balance.force_unit)
        found = run_newton(held, held.pack(*held.full_stick), REST, "elimination")
        steps += found.iterations
        start = found.unknowns if found.converged else start
    found = run_newton(balance, start, REST, "elimination")
    steps += found.iterations
    return PeriodicMotion(static, *balance.unpack(found.unknowns)) if found.converged else None, steps


def keep_means(problem: ContactProblem) -> ContactProblem:
    """The problem without all that oscillates in what is given: loads and prescribed normal forces."""
    groups = [
        (pairs, replace(laws, normal_force=laws.normal_force.get(0, 0.0)))
        if isinstance(laws.normal_force, Mapping)
        else (pairs, laws)
        for pairs, laws in problem.groups
    ]
    return replace(problem, frequency=0.0, laws=groups, load={h: f for h, f in problem.loads.items() if h == 0})
