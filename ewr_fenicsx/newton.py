"""Newton's method on the weighted residual, driven by PETSc SNES, and the ladder for cases where it fails."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from petsc4py import PETSc

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.contact_problem import ContactProblem
from ewr_fenicsx.continuation import BranchPoint, trace_branch
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.reduced_model import ComplexArray, RealArray
from ewr_fenicsx.solution import PeriodicSolution

LinearSolver = Literal["elimination", "dense"]

LEVELS = (1, 3, 5, 9, 15, 23, 31, 47, 63)  # highest harmonics of the sets that a cold start climbs through
COARSE_TOLERANCE, COARSE_STEPS = 1e-3, 25  # a coarse set is only a start for the next
FIRST_LOAD_SHARE, BRANCH_POINTS = 0.02, 80  # of the oscillating load, where its tracing starts; points at most

# Defaults under the options prefix "ewr_"; any of them can be set from the command line or in PETSC_OPTIONS.
_OPTIONS = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 2,
    "snes_max_it": 60,
}


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
    set, the oscillating load is traced from a small share to the whole, past folds.

    Args:
        problem: The problem.
        start: A solution on the same model to start from (another frequency, friction or set of harmonics), or None.
        tolerance: Largest residual norm accepted, relative to the norm of the full-stick contact forces.
        linear_solver: ``"elimination"`` solves for the rows that change status; ``"dense"`` forms the whole Jacobian and
            leaves it to PETSc's KSP. Both take the same steps.
        raise_on_failure: Whether to raise where no solution is found, or return the best iterate.

    Raises:
        NotConverged: No solution was found; carries the best iterate and the rungs tried.
    """
    begin = time.perf_counter()
    system = problem.system
    balance, attempts, fallbacks = None, [], []
    if system.rows.shape[0]:
        balance = HarmonicBalance(system)
        if start is not None:
            attempts.append(run_newton(balance, prolong(start, balance), tolerance, linear_solver))
            if not attempts[-1].converged:
                fallbacks.append(f"given start: {attempts[-1].reason}; cold start instead")
        if not attempts or not attempts[-1].converged:
            attempts += climb(balance, tolerance, linear_solver, fallbacks)
        if not attempts[-1].converged:
            fallbacks.append(f"growing harmonics: {attempts[-1].reason}; again with the load traced where Newton fails")
            attempts += climb(balance, tolerance, linear_solver, fallbacks, trace=True)
    full = [a for a in attempts if balance is not None and a.unknowns.size == balance.size]
    best = min(full, key=lambda a: a.residual) if full else None
    forces, rigid = (np.zeros((len(problem.basis.orders), 0), dtype=complex), np.zeros(0))
    if best is not None:
        forces, rigid = balance.unpack(best.unknowns)
    solution = PeriodicSolution(
        problem=problem,
        forces=forces,
        rigid=rigid,
        converged=best is None or best.converged,
        reason="linear" if best is None else best.reason,
        iterations=sum(a.iterations for a in attempts),
        fallbacks=tuple(fallbacks),
        residual=0.0 if best is None else best.residual,
        seconds=time.perf_counter() - begin,
        unknowns=0 if best is None else balance.size,
    )
    if raise_on_failure and not solution.converged:
        raise NotConverged(
            f"no periodic solution at {problem.frequency:g} Hz: {solution.reason}; residual {solution.residual:.1e} after "
            f"{solution.iterations} Newton steps. Tried: {'; '.join(fallbacks)}. "
            "Try fewer harmonics, a neighbouring solution as start=, or more damping",
            best=solution,
        )
    return solution


def climb(
    balance: HarmonicBalance, tolerance: float, linear_solver: LinearSolver, fallbacks: list[str], trace: bool = False
) -> list[Attempt]:
    """Cold start: full stick, then growing sets of harmonics.

    Without ``trace``, a coarse set on which Newton stalls is only a poorer start for the next. With it, the oscillating
    load is traced there; each such rung is appended to ``fallbacks``.
    """
    attempts: list[Attempt] = []
    level, below = None, None
    for orders in choose_levels(balance.basis.orders, [h for h, f in balance.system.load.items() if np.any(f)]):
        last = orders == balance.basis.orders
        level = balance if last else HarmonicBalance(balance.system.restrict(orders), balance.force_unit)
        guess = level.full_stick if below is None else embed(below.unpack(attempts[-1].unknowns), below, level)
        goal, limit = (tolerance, None) if last else (COARSE_TOLERANCE, COARSE_STEPS)
        attempts.append(run_newton(level, level.pack(*guess), goal, linear_solver, limit))
        if trace and not attempts[-1].converged:
            failed = attempts[-1]
            traced, steps, points = trace_load(level, goal)
            fallbacks.append(
                f"harmonics to {orders[-1]}: {failed.reason}; oscillating load traced in {points} points: {traced.reason}"
            )
            better = traced if traced.residual < failed.residual else failed
            attempts[-1] = replace(better, iterations=failed.iterations + steps)
        below = level
    return attempts


def choose_levels(orders: tuple[int, ...], loaded: list[int]) -> list[tuple[int, ...]]:
    """Growing sets of harmonics that end with ``orders``; all hold the loaded ones."""
    lowest = max([h for h in loaded if h], default=1)
    tops = [top for top in LEVELS if lowest <= top < orders[-1]]
    sets = [tuple(h for h in orders if h <= top) for top in tops]
    return [s for s in dict.fromkeys(sets) if s and s != (0,)] + [orders]


def embed(found: tuple[ComplexArray, RealArray], below: HarmonicBalance, level: HarmonicBalance):
    """Forces and rigid coordinates with harmonics added at zero."""
    forces = np.zeros((len(level.basis.orders), level.rows), dtype=complex)
    for j, h in enumerate(below.basis.orders):
        forces[level.basis.orders.index(h)] = found[0][j]
    return forces, found[1]


def trace_load(balance: HarmonicBalance, tolerance: float) -> tuple[Attempt, int, int]:
    """Follow the solution from a small share of the oscillating load to the whole, by arc length.

    Returns:
        The result at full load (or the best on the way), the Newton steps and the points that it took.
    """
    compliance = balance.compliance
    oscillates = np.array(balance.basis.orders) > 0

    def at(share: float) -> HarmonicBalance:
        motion = np.where(oscillates[:, None], share * compliance.free_motion, compliance.free_motion)
        system = replace(balance.system, compliance=replace(compliance, free_motion=motion))
        return HarmonicBalance(system, balance.force_unit)

    first = at(FIRST_LOAD_SHARE)
    attempt = run_newton(first, first.pack(*first.full_stick), tolerance, "elimination")
    steps, points = attempt.iterations, 0
    if not attempt.converged:
        reason = f"no solution at {FIRST_LOAD_SHARE:.0%} of the oscillating load ({attempt.reason})"
        return Attempt(attempt.unknowns, np.inf, steps, reason, False), steps, points
    here = BranchPoint(FIRST_LOAD_SHARE, attempt.unknowns, steps)
    branch = trace_branch(at, here, 1.0, tolerance=tolerance)
    reach = 0.1
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
            return attempt, steps, points
        reach *= 0.3  # the step across the whole load was too long to interpolate in: again, shorter
        branch = trace_branch(at, here, 1.0, step=reach, tolerance=tolerance)
    residual = float(np.linalg.norm(balance.residual(here.unknowns)))
    reason = f"the branch was lost or too long at {here.parameter:.0%} of the oscillating load"
    return Attempt(here.unknowns, residual, steps, reason, False), steps, points


def prolong(start: PeriodicSolution, balance: HarmonicBalance) -> RealArray:
    """Unknowns of ``balance`` from a solution with other harmonics or laws: common ones kept, others zero."""
    forces = np.zeros((len(balance.basis.orders), balance.rows), dtype=complex)
    for direction, known in start.pair_forces.items():
        rows = balance.system.row_of(direction, np.arange(known.shape[1]))
        for j, h in enumerate(balance.basis.orders):
            if h in start.orders:
                forces[j, rows[rows >= 0]] = known[start.orders.index(h), rows >= 0]
    rigid = start.rigid if start.rigid.size == balance.rigid else balance.full_stick[1]
    return balance.pack(forces, rigid)


@dataclass(frozen=True, eq=False)
class Attempt:
    """One run from one start: scaled unknowns, residual norm, Newton steps, and why it stopped."""

    unknowns: RealArray
    residual: float
    iterations: int
    reason: str
    converged: bool


def run_newton(
    balance: HarmonicBalance, start: RealArray, tolerance: float, linear_solver: LinearSolver, limit: int | None = None
) -> Attempt:
    """One Newton run through PETSc SNES, options under the prefix ``ewr_``."""
    options = PETSc.Options("ewr_")
    for name, value in _OPTIONS.items():
        if not options.hasName(name):
            options[name] = value
    if options.hasName("pc_type"):  # a PETSc preconditioner needs the matrix
        linear_solver = "dense"
    comm = PETSc.COMM_SELF
    snes = PETSc.SNES().create(comm)
    snes.setOptionsPrefix("ewr_")
    x, r = PETSc.Vec().createSeq(balance.size, comm=comm), PETSc.Vec().createSeq(balance.size, comm=comm)

    def evaluate(snes: PETSc.SNES, x: PETSc.Vec, r: PETSc.Vec) -> None:
        r.array[:] = balance.residual(x.array_r)

    snes.setFunction(evaluate, r)
    ksp = snes.getKSP()
    ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    if linear_solver == "dense":
        matrix = PETSc.Mat().createDense((balance.size, balance.size), comm=comm)
        matrix.setUp()

        def linearise(snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
            P.getDenseArray()[:] = balance.linearise(x.array_r).matrix()
            P.assemble()

        snes.setJacobian(linearise, matrix)
        pc.setType(PETSc.PC.Type.LU)
    else:
        shell = _Linearised()
        matrix = PETSc.Mat().createPython((balance.size, balance.size), context=shell, comm=comm)
        matrix.setUp()

        def linearise(snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
            shell.step = balance.linearise(x.array_r)

        snes.setJacobian(linearise, matrix)
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(shell)
    snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0)
    snes.setFromOptions()
    if limit is not None:
        snes.setTolerances(max_it=limit)
    x.array[:] = start
    try:
        snes.solve(None, x)
        code, found, steps = snes.getConvergedReason(), x.array.copy(), snes.getIterationNumber()
    finally:
        for item in (snes, matrix, x, r):
            item.destroy()
    residual = float(np.linalg.norm(balance.residual(found)))
    return Attempt(found, residual, steps, _REASONS.get(code, f"SNES reason {code}"), residual <= tolerance)


_REASONS = {
    PETSc.SNES.ConvergedReason.CONVERGED_FNORM_ABS: "residual below the tolerance",
    PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: "the line search found no decrease",
    PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT: "too many Newton steps",
    PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE: "the Newton matrix is singular",
    PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN: "the Newton matrix is singular",
}


class _Linearised:
    """The current Newton step as a PETSc matrix and as its exact preconditioner."""

    step = None

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.array[:] = self.step.multiply(x.array_r)

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        try:
            x.array[:] = self.step.solve(b.array_r)
        except np.linalg.LinAlgError:
            x.set(np.nan)  # SNES then stops and says that the function is not a number
