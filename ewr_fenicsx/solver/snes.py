"""Newton's method on the weighted residual, through PETSc SNES."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from petsc4py import PETSc

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.inexact_step import is_large, iterate
from ewr_fenicsx.balance.newton_step import Factorisation
from ewr_fenicsx.balance.petsc_calls import call_petsc
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.in_time.walking import WALKS, walks

LinearSolver = Literal["elimination", "dense"]

TIGHTEST = 1e-13  # residual below which rounding decides
# Added to the contact rows' diagonal from a start far from any solution, times the residual over the first one, while
# that is above a limit: the steps are then shorter where pairs are about to change status.
SHIFT, SHIFT_ABOVE = 0.1, 1e-3
MAX_STEPS = 150  # -ewr_snes_max_it
# Residual of the firm balance from which the balance itself is a few steps away. From larger ones they are fewer, but
# which mean friction pairs that stick are left with then depends on the way that a solution was found.
TAKE_OVER = 1e-6
# Of the firm balance's residual: below, a start knows where springs hold pairs, from where firmer ones would move them
HELD_NEAR = 0.1
SOFTER = (1e-5, 1e-6, 1e-7)  # shares of the mean force in between, where the firm balance's solution is too far off
NEED_MATRIX = ("newtontr", "newtontrdc", "vinewtonssls")  # its transpose, or scaled rows; as PETSc's preconditioners do
SMALLEST_DAMPING = 1e-6  # of a Newton step
# Above these residuals, it must fall below this share of itself over so many steps: runs that creep from kink to kink
# end at a corner without a solution. Where next to nothing is left, Newton may creep and still arrive, in joints that
# mostly stick: their pairs begin to slip one after the other.
CLOSER = 3e-3
STALLS = ((CLOSER, 7, 0.85), (1e-5, 5, 0.8))
# From so many unknowns on, dense factors are made in single precision, in half the time, and GMRES refines the step to
# this tolerance in so many iterations at most; else they are made anew in double precision.
REFINE_FROM, REFINEMENTS, ROUGH_TOLERANCE = 500, 10, 1e-10
# Such factors precondition later steps as well, for few samples change status in between: how exact these steps are far
# from a solution, and close to it. Where GMRES does not get there, or no length of the step makes the residual fall,
# there are new factors.
FAR_TOLERANCE, CLOSE_TOLERANCE = 0.25, 1e-4
# Above this residual, steps of large joints take no factors of the whole (``inexact_step.py``), in a twentieth of the
# time, and so many iterations at most. Below it, a few exact steps arrive, which share factors.
FAR_FROM, FAR_ITERATIONS = 5e-3, 60


@dataclass(frozen=True, eq=False)
class Attempt:
    """One run from one start: scaled unknowns, residual norm, Newton steps, and why it stopped.

    ``walks``: what it found is no periodic motion, and there is none (``walking.py``).
    ``usual``: what it found holds with default weights and dashpots, in place of what the problem asks for.
    ``detour``: rungs that a solve with these tried on the way to it; none where its first one did.
    """

    unknowns: RealArray
    residual: float
    iterations: int
    reason: str
    converged: bool
    walks: bool = False
    usual: bool = False
    detour: tuple[str, ...] = ()

    @property
    def decides(self) -> bool:
        """Whether no other way is worth trying: it found a solution, or that a body walks."""
        return self.converged or self.walks

    @property
    def told(self) -> str:
        """Why it stopped, and the detour, for people."""
        return self.reason + (f" (with these: {'; '.join(self.detour)})" if self.detour else "")

    def __lt__(self, other: Attempt) -> bool:
        """Whether it left less over; anything is less than no number."""
        return self.residual < other.residual or bool(np.isnan(other.residual))


def run_newton(
    balance: HarmonicBalance,
    start: RealArray,
    tolerance: float,
    linear_solver: LinearSolver,
    limit: int | None = None,
    *,
    near: bool = False,
) -> Attempt:
    """Newton's method through PETSc SNES, options under the prefix ``ewr_``: the firm balance first, then the balance.

    Where springs hold pairs (``static_friction = "held"``), a start near a solution begins with the balance itself.

    Args:
        balance: The balance.
        start: Scaled unknowns.
        tolerance: Residual norm accepted.
        linear_solver: As in ``solve``.
        limit: Newton steps allowed a run, where these are fewer than ``MAX_STEPS`` or an option.
        near: Whether the start is a neighbour's solution: no step is shortened by a shift.
    """
    norm = balance.measure_residual(start)
    with closing(_Newton(balance, linear_solver, limit)) as newton:
        if balance.firm is balance or norm <= tolerance:
            return newton.run(balance, start, tolerance, near)
        attempts = []
        if np.any(balance.held) and norm < HELD_NEAR * balance.firm.measure_residual(start):
            attempts.append(newton.run(balance, start, tolerance, near))
            if attempts[0].decides:
                return attempts[0]
        begun = bool(attempts)
        firm = newton.run(balance.firm, start, max(tolerance, TAKE_OVER), near)
        if firm.converged:  # the factors of its last step serve the balance as well
            attempts.append(newton.run(balance, firm.unknowns, tolerance, near=True, again=True))
            if np.any(balance.held) and not attempts[-1].converged:
                attempts += _soften(newton, balance, firm.unknowns, tolerance)
        # Weights far above the defaults put the two balances far apart, and a joint that mostly sticks is found by one
        # where it is not with the other: then from the start again, unless it was too far off for the steps allowed.
        elsewhere = firm.converged or (norm < CLOSER and firm.iterations != limit)
        if elsewhere and not begun and not any(attempt.converged for attempt in attempts):
            attempts.append(newton.run(balance, start, tolerance, near))
    if not attempts:
        return replace(firm, residual=balance.measure_residual(firm.unknowns))
    steps = firm.iterations + sum(attempt.iterations for attempt in attempts)
    return replace(min(attempts), iterations=steps)


def _soften(newton: _Newton, balance: HarmonicBalance, start: RealArray, tolerance: float) -> list[Attempt]:
    """From a solution of the firm balance to that of the balance through some that are ever less firm.

    Returns:
        The runs, that of the balance itself first, of two that left as much; empty where none is between the two.
    """
    attempts: list[Attempt] = []
    for share in SOFTER:
        between = balance.with_least_share(share)
        if between.is_like(balance):
            break
        attempts.append(newton.run(between, start, max(tolerance, TAKE_OVER), near=True))
        if not attempts[-1].converged:
            break
        start = attempts[-1].unknowns
    left = [replace(a, residual=balance.measure_residual(a.unknowns), converged=False) for a in attempts]
    if attempts and attempts[-1].converged:
        left.insert(0, newton.run(balance, start, tolerance, near=True))
    return left


class _Newton:
    """A SNES for balances with the same unknowns, its linear solver set up by name; to be closed."""

    def __init__(self, balance: HarmonicBalance, linear_solver: LinearSolver, limit: int | None):
        options = PETSc.Options("ewr_")
        if options.hasName("pc_type") or options.getString("snes_type", "") in NEED_MATRIX:
            linear_solver = "dense"
        comm = PETSc.COMM_SELF
        self.limit, self.equations = limit, _Equations()
        self.snes = PETSc.SNES().create(comm)
        self.snes.setOptionsPrefix("ewr_")
        self.x, self.r = (PETSc.Vec().createSeq(balance.size, comm=comm) for _ in range(2))
        self.ksp = self.snes.getKSP()
        self.ksp.setType(PETSc.KSP.Type.PREONLY)
        self.pc = self.ksp.getPC()
        if linear_solver == "dense":
            self.matrix = PETSc.Mat().createDense((balance.size, balance.size), comm=comm)
            self.pc.setType(PETSc.PC.Type.LU)
        else:
            self.matrix = PETSc.Mat().createPython((balance.size, balance.size), context=self.equations, comm=comm)
            self.pc.setType(PETSc.PC.Type.PYTHON)
            self.pc.setPythonContext(self.equations)
        self.matrix.setUp()
        self.snes.setFunction(self.equations.evaluate, self.r)
        self.snes.setJacobian(self.equations.linearise, self.matrix)
        self.halved = _HalvedNewton(self.equations, self.x)
        self.snes.setType(PETSc.SNES.Type.PYTHON)
        self.snes.setPythonContext(self.halved)

    def run(
        self, balance: HarmonicBalance, start: RealArray, tolerance: float, near: bool, *, again: bool = False
    ) -> Attempt:
        """One run from one start; ``again``: where the run before ended, whose factors may serve."""
        self.equations.pose(balance, balance.measure_residual(start), 0.0 if near else SHIFT)
        if not again:
            self.halved.factored, self.halved.single = 0, True
        self.snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0, max_it=MAX_STEPS)
        self.snes.setFromOptions()
        if self.limit is not None:
            self.snes.setTolerances(max_it=min(self.limit, self.snes.getTolerances()[3]))
        self.x.array[:] = start
        call_petsc(self.snes.solve, None, self.x)
        code, steps = self.snes.getConvergedReason(), self.snes.getIterationNumber()
        found = self.x.array.copy()
        residual = balance.measure_residual(found)
        if residual <= tolerance and walks(balance, found):
            return Attempt(found, residual, steps, WALKS, False, walks=True)
        return Attempt(found, residual, steps, _REASONS.get(code, f"SNES reason {code}"), residual <= tolerance)

    def close(self) -> None:
        """Destroys what PETSc holds: with PC or KSP left, the equations stay in memory, with all their factors."""
        for item in (self.pc, self.ksp, self.snes, self.matrix, self.x, self.r, *self.halved.vectors):
            item.destroy()


_REASONS = {
    PETSc.SNES.ConvergedReason.CONVERGED_FNORM_ABS: "residual below the tolerance",
    PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: "the line search found no decrease",
    PETSc.SNES.ConvergedReason.DIVERGED_LOCAL_MIN: "the residual fell no further",
    PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT: "too many Newton steps",
    PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE: "the Newton matrix is singular",
}


class _HalvedNewton:
    """Newton's method with steps halved until the residual norm falls, given up where it stalls, as a SNES type.

    PETSc's own line searches fit a parabola through the residual, which has kinks, and take more steps. A SNES type
    chosen with ``-ewr_snes_type`` takes this one's place.
    """

    def __init__(self, equations: _Equations, like: PETSc.Vec):
        self.equations = equations
        self.vectors = tuple(like.duplicate() for _ in range(3))  # PETSc keeps those that nobody destroys to its end
        self.factored = 0  # unknowns of the factors at hand
        self.single = True  # whether factors in single precision do

    def solve(self, snes: PETSc.SNES, _: PETSc.Vec, x: PETSc.Vec) -> None:
        reason = PETSc.SNES.ConvergedReason
        f = snes.getFunction()[0]
        J, P = snes.getJacobian()[:2]
        ksp = snes.getKSP()
        step, trial, residual = self.vectors
        _, tolerance, _, limit = snes.getTolerances()
        snes.computeFunction(x, f)
        norm = f.norm()
        norms = []
        for taken in range(limit + 1):
            norms.append(norm)
            snes.setIterationNumber(taken)
            snes.setFunctionNorm(norm)
            snes.monitor(taken, norm)
            if norm <= tolerance:
                return snes.setConvergedReason(reason.CONVERGED_FNORM_ABS)
            if taken == limit:
                return snes.setConvergedReason(reason.DIVERGED_MAX_IT)
            if is_stalled(norms):
                return snes.setConvergedReason(reason.DIVERGED_LOCAL_MIN)
            snes.computeJacobian(x, J, P)
            ksp.setOperators(J, P)
            rough = self._iterate(ksp, f, step) or self._reuse_factors(ksp, f, step)
            if not rough:
                self._factor_anew(ksp, f, step)
            damping = 1.0
            while True:
                if not np.isfinite(step.norm()):
                    return snes.setConvergedReason(reason.DIVERGED_LINEAR_SOLVE)
                trial.waxpy(-damping, step, x)
                snes.computeFunction(trial, residual)
                found = residual.norm()
                if found <= (1 - 1e-4 * damping) * norm:
                    break
                damping *= 0.5
                if damping < SMALLEST_DAMPING and rough:  # the step may be to blame
                    self._factor_anew(ksp, f, step)
                    rough, damping = False, 1.0
                elif damping < SMALLEST_DAMPING:
                    return snes.setConvergedReason(reason.DIVERGED_LINE_SEARCH)
            trial.copy(x)
            residual.copy(f)
            norm = found

    def _iterate(self, ksp: PETSc.KSP, right_side: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Whether far from a solution, in a large joint, GMRES gave the step without factors of the whole.

        They would take long there. Without, it makes no difference whether they are eliminated or dense.
        """
        equations = self.equations
        linearised = equations.step
        gross = equations.far and np.linalg.norm(linearised.residual) > FAR_FROM
        if not (gross and is_direct(ksp) and is_large(linearised)):
            return False
        found = iterate(linearised, right_side.array_r, FAR_TOLERANCE, FAR_ITERATIONS, equations.shift)
        if found is not None:
            step.array[:] = found
        return found is not None

    def _reuse_factors(self, ksp: PETSc.KSP, right_side: PETSc.Vec, step: PETSc.Vec) -> bool:
        """Whether the factors of an earlier step gave this one."""
        tolerance = FAR_TOLERANCE if self.equations.far else CLOSE_TOLERANCE
        large = self.factored >= REFINE_FROM and is_direct(ksp)
        return large and refine(ksp, right_side, step, tolerance, old=True)

    def _factor_anew(self, ksp: PETSc.KSP, right_side: PETSc.Vec, step: PETSc.Vec) -> None:
        """A Newton step with factors of its own: in single precision, unless that did not do at an earlier step."""
        equations = self.equations
        self.factored = equations.step.unknowns_left
        own = ksp.getPC().getType() == PETSc.PC.Type.PYTHON
        if own and self.single and self.factored >= REFINE_FROM and is_direct(ksp):
            equations.forget_factors(np.float32)
            self.single = refine(ksp, right_side, step, ROUGH_TOLERANCE, old=False)
            if self.single:
                return
        equations.forget_factors(np.float64)
        ksp.solve(right_side, step)


def is_stalled(norms: Sequence[float]) -> bool:
    """Whether residuals, step by step, creep rather than fall."""
    for above, steps, share in STALLS:
        if norms[-1] > above:
            return len(norms) > steps and norms[-1] > share * norms[-1 - steps]
    return False


def is_direct(ksp: PETSc.KSP) -> bool:
    """Whether a linear solve is one with factors, and nothing that a user has asked for in place of it."""
    return ksp.getType() == PETSc.KSP.Type.PREONLY


def refine(ksp: PETSc.KSP, right_side: PETSc.Vec, x: PETSc.Vec, tolerance: float, *, old: bool) -> bool:
    """Whether GMRES solves the system in few iterations with factors that are rough, or ``old``: of an earlier step."""
    ksp.setTolerances(rtol=tolerance, max_it=REFINEMENTS)
    ksp.setType(PETSc.KSP.Type.FGMRES)  # flexible: factors in single precision round every vector anew
    ksp.getPC().setReusePreconditioner(old)
    ksp.solve(right_side, x)
    solved = ksp.getConvergedReason() > 0
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setReusePreconditioner(False)
    return solved


class _Equations:
    """The balance as PETSc sees it: residual, Jacobian as a matrix or an operator, and its inverse by factors."""

    def __init__(self):
        self.forget_factors(np.float64)

    def forget_factors(self, precision: type) -> None:
        """The next factors are new ones, of this precision."""
        self.factors: Factorisation | None = None
        self.precision = precision

    def pose(self, balance: HarmonicBalance, first: float, most_shift: float) -> None:
        """The balance of a run, its first residual norm, and the most that is added to contact rows."""
        self.balance, self.first, self.most_shift = balance, first, most_shift
        self.step, self.shift, self.far = None, 0.0, True

    def evaluate(self, snes: PETSc.SNES, x: PETSc.Vec, r: PETSc.Vec) -> None:
        r.array[:] = self.balance.residual(x.array_r)

    def linearise(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self.step = self.balance.linearise(x.array_r)
        norm = float(np.linalg.norm(self.step.residual))
        self.far = norm > SHIFT_ABOVE * max(self.first, SHIFT)
        self.shift = self.most_shift * norm / self.first if self.far else 0.0
        if P.getType() != PETSc.Mat.Type.PYTHON:
            P.getDenseArray()[:] = self.step.matrix(self.shift)
        P.assemble()  # says that it has changed

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.array[:] = self.step.multiply(x.array_r, self.shift)

    def setUp(self, pc: PETSc.PC) -> None:
        self.factors = None  # of an earlier step, and not to be kept

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        if self.factors is not None:
            x.array[:] = self.factors.solve(b.array_r)
            return
        try:
            self.factors = Factorisation(self.step, b.array_r, self.shift, self.precision)
            x.array[:] = self.factors.solution
        except np.linalg.LinAlgError:
            x.set(np.nan)  # the step then ends the iteration
