"""Newton's method on the weighted residual, driven by PETSc SNES, and the ladder for cases where it fails."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from petsc4py import PETSc

from ewr_fenicsx.balance import HarmonicBalance, NewtonStep
from ewr_fenicsx.contact_problem import ContactProblem
from ewr_fenicsx.continuation import BranchPoint, trace_branch
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.reduced_model import ComplexArray, RealArray
from ewr_fenicsx.solution import PeriodicSolution

LinearSolver = Literal["elimination", "dense"]

# Highest harmonics of the sets that a cold start climbs through: few at first, more where that fails.
COARSE_LEVELS, FINE_LEVELS = (5, 15, 40), (1, 3, 5, 9, 15, 23, 31, 47, 63)
COARSE_TOLERANCE, COARSE_STEPS = 1e-3, 25  # a coarse set is only a start for the next
# Added to the contact rows' diagonal, times the residual over the first one, while that is above a limit: far from the
# solution the steps are then shorter where pairs are about to change status.
SHIFT, SHIFT_ABOVE = 0.1, 1e-3
FIRST_LOAD_SHARE, BRANCH_POINTS = 0.02, 80  # of the oscillating load, where its tracing starts; points at most

MAX_STEPS = 60  # -ewr_snes_max_it
SMALLEST_DAMPING = 1e-6  # of a Newton step


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
        for trace in (False, True):
            if not attempts or not attempts[-1].converged:
                attempts += climb(balance, tolerance, linear_solver, fallbacks, trace)
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
    balance: HarmonicBalance, tolerance: float, linear_solver: LinearSolver, fallbacks: list[str], trace: bool
) -> list[Attempt]:
    """Cold starts: full stick, then growing sets of harmonics, each started at the solution of the one before.

    First few sets, then many, from the lowest on; with ``trace``, where Newton stalls on a set, the oscillating load is
    traced there. What did not work is appended to ``fallbacks``.
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
            if trace and not attempts[-1].converged:
                attempts[-1] = trace_load(level, goal, attempts[-1])
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


def trace_load(balance: HarmonicBalance, tolerance: float, failed: Attempt) -> Attempt:
    """Follow the solution from a small share of the oscillating load to the whole, by arc length, past folds.

    Returns:
        The solution, or the better of the last point on the branch and the ``failed`` attempt; all Newton steps counted.
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


def carry_over(start: PeriodicSolution, balance: HarmonicBalance) -> tuple[ComplexArray, ComplexArray, RealArray]:
    """Forces ``(n_h, m)``, motions ``(n_h, m)`` and rigid coordinates of another problem's solution, in this one's rows.

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

    The laws are linearised at the other solution's forces *and* motions, so that what each pair did there (open, stuck or
    slipping at every sample) carries over, and the step makes forces and motions fit the new compliance. The forces by
    themselves would move the pairs anywhere near a resonance.
    """
    forces, motion, rigid = carry_over(start, balance)
    unknowns = balance.pack(forces, rigid)
    try:
        step = balance.linearise(unknowns, motion)
        return unknowns - step.solve(step.residual)
    except np.linalg.LinAlgError:
        return unknowns


@dataclass(frozen=True, eq=False)
class Attempt:
    """One run from one start: scaled unknowns, residual norm, Newton steps, and why it stopped."""

    unknowns: RealArray
    residual: float
    iterations: int
    reason: str
    converged: bool


def choose_shift(step: NewtonStep, first: float) -> float:
    """Diagonal shift of a Newton step: in proportion to the residual far from the solution, none close to it."""
    norm = float(np.linalg.norm(step.residual))
    return SHIFT * norm / first if norm > SHIFT_ABOVE * max(first, SHIFT) else 0.0


def run_newton(
    balance: HarmonicBalance, start: RealArray, tolerance: float, linear_solver: LinearSolver, limit: int | None = None
) -> Attempt:
    """One Newton run through PETSc SNES, options under the prefix ``ewr_``."""
    if PETSc.Options("ewr_").hasName("pc_type"):  # a PETSc preconditioner needs the matrix
        linear_solver = "dense"
    comm = PETSc.COMM_SELF
    snes = PETSc.SNES().create(comm)
    snes.setOptionsPrefix("ewr_")
    x, r = PETSc.Vec().createSeq(balance.size, comm=comm), PETSc.Vec().createSeq(balance.size, comm=comm)

    first = float(np.linalg.norm(balance.residual(start)))

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
            step = balance.linearise(x.array_r)
            P.getDenseArray()[:] = step.matrix(choose_shift(step, first))
            P.assemble()

        snes.setJacobian(linearise, matrix)
        pc.setType(PETSc.PC.Type.LU)
    else:
        shell = _Linearised()
        matrix = PETSc.Mat().createPython((balance.size, balance.size), context=shell, comm=comm)
        matrix.setUp()

        def linearise(snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
            shell.step = balance.linearise(x.array_r)
            shell.shift = choose_shift(shell.step, first)

        snes.setJacobian(linearise, matrix)
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(shell)
    snes.setType(PETSc.SNES.Type.PYTHON)
    snes.setPythonContext(_HalvedNewton())
    snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0, max_it=MAX_STEPS)
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
}


class _HalvedNewton:
    """Newton's method with steps halved until the residual norm falls, as a SNES type.

    PETSc's own line searches fit a parabola through the residual, which has kinks, and take more steps. A SNES type chosen
    with ``-ewr_snes_type`` takes this one's place.
    """

    def solve(self, snes: PETSc.SNES, _: PETSc.Vec, x: PETSc.Vec) -> None:
        reason = PETSc.SNES.ConvergedReason
        f = snes.getFunction()[0]
        J, P = snes.getJacobian()[:2]
        ksp = snes.getKSP()
        step, trial, residual = x.duplicate(), x.duplicate(), f.duplicate()
        _, tolerance, _, limit = snes.getTolerances()
        snes.computeFunction(x, f)
        norm = f.norm()
        for taken in range(limit + 1):
            snes.setIterationNumber(taken)
            snes.setFunctionNorm(norm)
            snes.monitor(taken, norm)
            if norm <= tolerance:
                return snes.setConvergedReason(reason.CONVERGED_FNORM_ABS)
            if taken == limit:
                return snes.setConvergedReason(reason.DIVERGED_MAX_IT)
            snes.computeJacobian(x, J, P)
            ksp.setOperators(J, P)
            ksp.solve(f, step)
            if not np.isfinite(step.norm()):
                return snes.setConvergedReason(reason.DIVERGED_LINEAR_SOLVE)
            damping = 1.0
            while True:
                trial.waxpy(-damping, step, x)
                snes.computeFunction(trial, residual)
                found = residual.norm()
                if found <= (1 - 1e-4 * damping) * norm:
                    break
                damping *= 0.5
                if damping < SMALLEST_DAMPING:
                    return snes.setConvergedReason(reason.DIVERGED_LINE_SEARCH)
            trial.copy(x)
            residual.copy(f)
            norm = found


class _Linearised:
    """The current Newton step as a PETSc matrix and as its exact preconditioner."""

    step, shift = None, 0.0

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.array[:] = self.step.multiply(x.array_r)

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        try:
            x.array[:] = self.step.solve(b.array_r, self.shift)
        except np.linalg.LinAlgError:
            x.set(np.nan)  # the step then ends the iteration
