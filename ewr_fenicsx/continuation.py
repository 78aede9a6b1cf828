"""Branches of periodic solutions along a parameter, past folds: pseudo-arc-length continuation.

The branch is parametrised by its arc length, in which a fold is an ordinary point. One step: a secant predictor, then
Newton on the balance bordered with the condition that the point lies in the plane normal to the secant.

Source: Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.reduced_model import RealArray

BalanceAt = Callable[[float], HarmonicBalance]

_DERIVATIVE_STEP = 1e-6  # relative step in the parameter for the derivative of the residual


@dataclass(frozen=True, eq=False)
class BranchPoint:
    """A converged point of a branch.

    Attributes:
        parameter: Value of the parameter.
        unknowns: ``(size,)`` scaled unknowns; every balance of the branch must use the same units.
        steps: Newton steps that it took.
    """

    parameter: float
    unknowns: RealArray
    steps: int


def trace_branch(
    balance_at: BalanceAt,
    start: BranchPoint,
    span: float,
    *,
    step: float = 0.1,
    smallest_step: float = 1e-4,
    tolerance: float = 1e-8,
    corrector_steps: int = 12,
) -> Iterator[BranchPoint]:
    """Follow a branch from a converged point, until the consumer stops or a step fails at the smallest size.

    Args:
        balance_at: Parameter -> balance, all in the same units.
        start: A converged point.
        span: Parameter range that counts as one unit of length; its sign is the first direction.
        step: First step, in units of arc length.
        smallest_step: Below this the branch ends.
        tolerance: Residual norm of accepted points.
        corrector_steps: Newton steps allowed a point.
    """
    here, tangent = start, np.append(np.zeros(start.unknowns.size), 1.0)
    while step >= smallest_step:
        found = _correct(balance_at, here, tangent, step, span, tolerance, corrector_steps)
        if found is None:
            step *= 0.5
            continue
        secant = np.append(found.unknowns - here.unknowns, (found.parameter - here.parameter) / span)
        tangent = secant / np.linalg.norm(secant)
        yield found
        here = found
        step *= 1.6 if found.steps <= 5 else 1.0 if found.steps <= 8 else 0.7


def _correct(
    balance_at: BalanceAt, here: BranchPoint, tangent: RealArray, step: float, span: float, tolerance: float, limit: int
) -> BranchPoint | None:
    z, s = here.unknowns + step * tangent[:-1], here.parameter + step * tangent[-1] * span
    balance = balance_at(s)
    norm = np.linalg.norm(balance.residual(z))
    for taken in range(limit):
        if norm <= tolerance:
            return BranchPoint(s, z, taken)
        linear = balance.linearise(z)
        nudge = _DERIVATIVE_STEP * span
        slope = (balance_at(s + nudge).residual(z) - linear.residual) / _DERIVATIVE_STEP
        try:
            along, across = linear.solve(linear.residual), linear.solve(slope)
        except np.linalg.LinAlgError:
            return None
        # the point stays in the plane: tangent . (dz, ds) = 0
        ds = tangent[:-1] @ along / (tangent[-1] - tangent[:-1] @ across)
        dz = -along - ds * across
        if not np.isfinite(ds) or not np.all(np.isfinite(dz)):
            return None
        shrink = 1.0
        while True:
            trial = balance_at(s + shrink * ds * span)
            new = np.linalg.norm(trial.residual(z + shrink * dz))
            if new <= (1 - 1e-4 * shrink) * norm:
                break
            shrink *= 0.5
            if shrink < 1e-3:
                return None
        z, s, norm, balance = z + shrink * dz, s + shrink * ds * span, new, trial
    return None
