"""``solve``: a contact problem's periodic solution, from a neighbour's or from cold."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.contact_problem import ContactProblem
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.ladder import climb
from ewr_fenicsx.reduced_model import ComplexArray, RealArray
from ewr_fenicsx.snes import Attempt, LinearSolver, run_newton
from ewr_fenicsx.solution import PeriodicSolution
from ewr_fenicsx.symmetry import include_idle, leave_out_idle


def solve(
    problem: ContactProblem,
    start: PeriodicSolution | None = None,
    tolerance: float = 1e-8,
    *,
    linear_solver: LinearSolver = "elimination",
    raise_on_failure: bool = True,
) -> PeriodicSolution:
    """Periodic solution of a contact problem.

    From a given start, Newton at the harmonics asked for. Cold, or where that fails, the ladder: from the linear
    full-stick solution up through growing sets of harmonics, each starting at the one before; where Newton fails at a
    set, laws with rounded corners that are sharpened step by step, then the oscillating load traced from a small share
    to the whole, past folds.

    Harmonics that are zero by symmetry are left out of the solve, and are zero in the solution (``symmetry.py``).

    Args:
        problem: The problem.
        start: A solution on the same model to start from (another frequency, friction or set of harmonics), or None.
        tolerance: Largest residual norm accepted, relative to the norm of the full-stick contact forces.
        linear_solver: ``"elimination"`` solves for the rows that change status; ``"dense"`` forms the whole Jacobian
            and leaves it to PETSc's KSP. Both take the same steps.
        raise_on_failure: Whether to raise where no solution is found, or return the best iterate.

    Raises:
        NotConverged: No solution was found; carries the best iterate and the rungs tried.
    """
    begin = time.perf_counter()
    asked, problem = problem, leave_out_idle(problem, start)
    system = problem.system
    composed = time.perf_counter()
    balance, attempts, fallbacks = None, [], []
    if system.rows.shape[0]:
        balance = HarmonicBalance(system)
        if start is not None:
            attempts.append(run_newton(balance, prolong(start, balance), tolerance, linear_solver))
            if not attempts[-1].converged:
                fallbacks.append(f"given start: {attempts[-1].reason}; cold start instead")
        for trace in (False, True):
            if not attempts or not attempts[-1].converged:
                attempts += climb(balance, tolerance, linear_solver, fallbacks, trace)
    end = time.perf_counter()
    solution = include_idle(wrap(problem, balance, attempts, tuple(fallbacks), end - begin), asked)
    solution = replace(
        solution, stages={"compose": composed - begin} | ({"newton": end - composed} if attempts else {})
    )
    if raise_on_failure and not solution.converged:
        raise NotConverged(
            f"no periodic solution at {problem.frequency:g} Hz: {solution.reason}; residual {solution.residual:.1e} "
            f"after {solution.iterations} Newton steps. Tried: {'; '.join(fallbacks)}. "
            "Try fewer harmonics, a neighbouring solution as start=, or more damping",
            best=solution,
        )
    return solution


def wrap(
    problem: ContactProblem,
    balance: HarmonicBalance | None,
    attempts: list[Attempt],
    fallbacks: tuple[str, ...],
    seconds: float,
) -> PeriodicSolution:
    """The best attempt as a solution; a problem without a balance is linear and needed none."""
    full = [a for a in attempts if a.unknowns.size == balance.size]
    best = min(full, key=lambda a: a.residual) if full else None
    forces, rigid = np.zeros((len(problem.basis.orders), 0), dtype=complex), np.zeros(0)
    if best is not None:
        forces, rigid = balance.unpack(best.unknowns)
    return PeriodicSolution(
        problem=problem,
        forces=forces,
        rigid=rigid,
        converged=best is None or best.converged,
        reason="linear" if best is None else best.reason,
        iterations=sum(a.iterations for a in attempts),
        fallbacks=fallbacks,
        residual=0.0 if best is None else best.residual,
        seconds=seconds,
        unknowns=0 if best is None else balance.size,
    )


def carry_over(start: PeriodicSolution, balance: HarmonicBalance) -> tuple[ComplexArray, ComplexArray, RealArray]:
    """Forces and motions ``(n_h, m)`` and rigid coordinates of another problem's solution, in this one's rows.

    Harmonics that it lacks are zero.
    """
    shape = (len(balance.basis.orders), balance.rows)
    forces, motion = np.zeros(shape, dtype=complex), np.zeros(shape, dtype=complex)
    there = start.problem.system
    moved = there.compliance.motion(start.forces, start.rigid)
    kept = [(j, start.orders.index(h)) for j, h in enumerate(balance.basis.orders) if h in start.orders]
    for direction, known in start.pair_forces.items():
        pairs = np.arange(known.shape[1])
        here, from_ = balance.system.row_of(direction, pairs), there.row_of(direction, pairs)
        both = (here >= 0) & (from_ >= 0)
        for j, i in kept:
            forces[j, here[here >= 0]] = known[i, here >= 0]
            motion[j, here[both]] = moved[i, from_[both]]
    return forces, motion, start.rigid if start.rigid.size == balance.rigid else balance.full_stick[1]


def prolong(start: PeriodicSolution, balance: HarmonicBalance) -> RealArray:
    """Unknowns of ``balance`` from the solution of another problem on the same model: one Newton step from its state.

    The laws are linearised at the other solution's forces *and* motions, so that what each pair did there (open, stuck
    or slipping at every sample) carries over, and the step makes forces and motions fit the new compliance. The forces
    by themselves would move the pairs anywhere near a resonance.
    """
    forces, motion, rigid = carry_over(start, balance)
    unknowns = balance.pack(forces, rigid)
    try:
        step = balance.linearise(unknowns, motion)
        return unknowns - step.solve(step.residual)
    except np.linalg.LinAlgError:
        return unknowns
