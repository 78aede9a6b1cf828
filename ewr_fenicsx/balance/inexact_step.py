"""An inexact Newton step: to a few per cent, at a fraction of the time that the exact one's factorisation takes.

GMRES with a preconditioner that leaves out how higher harmonics couple: the lowest ones are solved for as in an exact
step, each higher one by itself, with the laws' derivatives at their mean over the period. Newton's method needs no more
far from a solution (``snes.py``). Nor do the estimates of errors (``looking_ahead.py``): they reach to twice as many
harmonics as the solution, where an exact step takes longer than all the Newton steps to the solution.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.elimination import invert_steady
from ewr_fenicsx.balance.newton_step import Factorisation, NewtonStep
from ewr_fenicsx.balance.petsc_calls import call_petsc
from ewr_fenicsx.given import RealArray

FEW = 1500  # unknowns that no elimination takes out, below which the exact step is cheaper
COUPLED = 5  # lowest harmonics that are solved for together
TOLERANCE = 0.02  # residual of the step over its right side
ITERATIONS = 200  # at most, before the exact step is taken


def solve_inexactly(step: NewtonStep) -> RealArray:
    """The Newton step at a point whose linearised balance is given, ``(size,)``; exact where that is cheap.

    Raises:
        LinAlgError: The Jacobian is singular.
    """
    found = iterate(step, step.residual, TOLERANCE, ITERATIONS) if is_large(step) else None
    return step.solve(step.residual) if found is None else found


def is_large(step: NewtonStep) -> bool:
    """Whether an exact step takes longer than one by GMRES."""
    return step.unknowns_left > FEW and len(step.balance.basis.orders) > COUPLED


def iterate(
    step: NewtonStep, right_side: RealArray, tolerance: float, iterations: int, shift: float = 0.0
) -> RealArray | None:
    """``(J + shift)^-1 b`` by GMRES, ``(size,)``; None where so many iterations do not suffice.

    Args:
        step: The linearised balance.
        right_side: b, ``(size,)``.
        tolerance: Residual over the right side.
        iterations: At most.
        shift: As in ``NewtonStep``.

    Source: Dembo, Eisenstat and Steihaug (1982), Inexact Newton Methods, doi:10.1137/0719025.
    """
    comm, size = PETSc.COMM_SELF, step.balance.size
    try:
        preconditioner = _Uncoupled(step, shift)
    except np.linalg.LinAlgError:  # of a part by itself; the whole need not be singular
        return None
    matrix = PETSc.Mat().createPython((size, size), context=preconditioner, comm=comm)
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix("ewr_inexact_")
    matrix.setUp()
    ksp.setOperators(matrix)
    ksp.setType(PETSc.KSP.Type.GMRES)
    ksp.setGMRESRestart(iterations)
    ksp.setPCSide(PETSc.PC.Side.RIGHT)
    ksp.setTolerances(rtol=tolerance, atol=0.0, max_it=iterations)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.PYTHON)
    pc.setPythonContext(preconditioner)
    ksp.setFromOptions()
    b, x = (PETSc.Vec().createSeq(size, comm=comm) for _ in range(2))
    try:
        b.array[:] = right_side
        call_petsc(ksp.solve, b, x)
        return x.array.copy() if ksp.getConvergedReason() > 0 else None
    finally:
        for item in (pc, ksp, matrix, b, x):  # with pc or ksp left, the preconditioner stays, with its factors
            item.destroy()


class _Uncoupled:
    """The linearised balance as a product, and its inverse where higher harmonics are not coupled."""

    def __init__(self, step: NewtonStep, shift: float = 0.0):
        balance = step.balance
        self.balance, self.step, self.shift = balance, step, shift
        orders = balance.basis.orders
        self.low, self.high = (self._restrict(part) for part in (orders[:COUPLED], orders[COUPLED:]))
        self.count = self.low.basis.coefficients
        right = np.zeros(self.low.size)
        self.factors = Factorisation(NewtonStep(self.low, step.derivatives, right), right, shift)
        # what springs remember is left out: it is held from single instants, and means nothing to a high harmonic
        here = (d for d in step.derivatives if d.since is None)
        mean = [replace(d, values=d.values.mean(axis=0, keepdims=True), kept=None) for d in here]
        self.inverse = invert_steady(self.high, mean, np.arange(balance.rows), step.spread(shift)[COUPLED:])

    def _restrict(self, orders: tuple[int, ...]) -> HarmonicBalance:
        balance = self.balance
        system = balance.system.restrict(orders).sample(balance.basis.samples)
        return HarmonicBalance(system, balance.force_unit)

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.array[:] = self.step.multiply(x.array_r, self.shift)

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        balance, low = self.balance, self.low
        right, rigid = balance.place(b.array_r), b.array_r[balance.size - balance.rigid :]
        solved = self.factors.solve(np.concatenate([right[: self.count][low.unknown], rigid]))
        high = np.matmul(self.inverse, self.high.basis.to_amplitudes(right[self.count :])[:, :, None])[:, :, 0]
        forces = np.concatenate([low.place(solved), self.high.basis.to_coefficients(high)])
        x.array[:] = np.concatenate([forces[balance.unknown], solved[low.size - low.rigid :]])
