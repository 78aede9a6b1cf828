"""Branches of periodic solutions along a parameter, past folds: pseudo-arc-length continuation.

The branch is parametrised by its arc length, in which a fold is an ordinary point. One step: a secant predictor, then
Newton on the balance bordered with the condition that the point lies in the plane normal to the secant.

Source: Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.newton_step import Factorisation
from ewr_fenicsx.stability import find_side

BalanceAt = Callable[[float], HarmonicBalance]

_DERIVATIVE_STEP = 1e-6  # relative step in the parameter for the derivative of the residual
CORRECTOR_STEPS = 12  # Newton steps allowed a point
_AROUND, _LEAP = 0.2, 5e-3  # a longer step that turns the tangent by an angle of a smaller cosine leapt over a corner
_AGAIN, _ASIDE, _ASKEW = 3, 0.03, 0.97  # points that retrace a branch: how many, how far aside in steps, least cosine


@dataclass(frozen=True, eq=False)
class BranchPoint:
    """A converged point of a branch.

    Attributes:
        parameter: Value of the parameter.
        unknowns: ``(size,)`` scaled unknowns; every balance of the branch must use the same units.
        steps: Newton steps that it took, tries that failed included.
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
    largest_step: float = np.inf,
    tolerance: float = 1e-8,
    before: BranchPoint | None = None,
    stray: float = np.inf,
    oriented: bool = False,
) -> Iterator[BranchPoint]:
    """Follow a branch from a converged point, until the consumer stops or a step fails at the smallest size.

    Args:
        balance_at: Parameter -> balance, all in the same units.
        start: A converged point.
        span: Parameter range that counts as one unit of length; its sign is the first direction.
        step: First step, in units of arc length.
        smallest_step: Below this the branch ends, unless it turns a corner there.
        largest_step: No step is longer than this.
        tolerance: Residual norm of accepted points.
        before: The branch's last point before ``start``, through which the first secant goes; None: the first step
            changes the parameter alone, which misses the branch where it is close to a fold.
        stray: A point further from the last one than so many steps is another branch's. Where it is finite, sharp
            corners are turned: non-smooth laws make branches turn back on themselves in a point. Long steps across
            such a corner are halved.
        oriented: Whether the way on from a corner is told by the Jacobian's determinant, whose sign times that of the
            parameter's change is the same all along a branch, unless others cross it. If not, every corner leads back:
            wrong where a step leapt over the corner and landed beyond it.
    """
    here, tangent, turned, spent = start, np.append(np.zeros(start.unknowns.size), 1.0), False, 0
    if before is not None:
        tangent = _point_to(before, start, span)
    sense = np.sign(tangent[-1]) * find_side(balance_at(start.parameter), start.unknowns) if oriented else 0
    while step >= smallest_step:
        found, onward, taken = _correct(balance_at, here, tangent, step, span, tolerance)
        spent += taken
        if found is not None and measure_arc(here, found, span) > stray * step:
            found = None
        if found is not None and np.isfinite(stray) and step > _LEAP and onward is not None:
            chord = _point_to(here, found, span)
            found = found if np.sign(onward @ chord) * (onward @ tangent) >= _AROUND else None
        if found is None and 0.5 * step < smallest_step and np.isfinite(stray) and not turned:
            corner = _turn_corner(balance_at, here, tangent, 4 * smallest_step, span, sense)
            if corner is not None:
                tangent, step, turned = corner, 200 * smallest_step, True
                continue
        if found is None:
            step *= 0.5
            continue
        tangent, turned = _point_to(here, found, span), False
        yield replace(found, steps=spent)
        here, spent = found, 0
        step = min(largest_step, step * (1.6 if taken <= 5 else 1.0 if taken <= 8 else 0.7))


def measure_arc(a: BranchPoint, b: BranchPoint, span: float) -> float:
    """Distance of two points with the parameter in units of ``span``."""
    return float(np.hypot(np.linalg.norm(b.unknowns - a.unknowns), (b.parameter - a.parameter) / span))


def retraces(points: Sequence[BranchPoint], span: float) -> bool:
    """Whether the last of a branch's points run along earlier ones in their direction: the branch is a closed curve."""
    path = np.array([np.append(point.unknowns, point.parameter / span) for point in points])
    ahead = np.diff(path, axis=0)
    length = np.linalg.norm(ahead, axis=1)
    early = max(0, len(ahead) - 2 * _AGAIN)
    if early == 0 or np.any(length == 0):
        return False
    begin, way, most = path[:early], ahead[:early] / length[:early, None], length[:early]
    for k in range(len(path) - _AGAIN, len(path)):
        off = path[k] - begin
        along = np.einsum("ij,ij->i", off, way)
        aside = np.linalg.norm(off - along[:, None] * way, axis=1)
        there = (along >= 0) & (along <= most) & (aside <= _ASIDE * np.minimum(most, length[k - 1]))
        if not np.any(there & (way @ ahead[k - 1] >= _ASKEW * length[k - 1])):
            return False
    return True


def _point_to(a: BranchPoint, b: BranchPoint, span: float) -> RealArray:
    return np.append(b.unknowns - a.unknowns, (b.parameter - a.parameter) / span) / measure_arc(a, b, span)


def _turn_corner(
    balance_at: BalanceAt, here: BranchPoint, tangent: RealArray, beyond: float, span: float, sense: float
) -> RealArray | None:
    """Where a branch goes from a corner just ahead: the tangent of the smooth piece that begins there.

    ``sense`` is the sign of the determinant times that of the parameter's change; 0: not known, the branch leads back.
    """
    z, s = here.unknowns + beyond * tangent[:-1], here.parameter + beyond * tangent[-1] * span
    linear = balance_at(s).linearise(z)
    slope = (balance_at(s + _DERIVATIVE_STEP * span).residual(z) - linear.residual) / _DERIVATIVE_STEP
    try:
        onward = np.append(-linear.solve(slope), 1.0)
    except np.linalg.LinAlgError:
        return None
    onward *= (sense * find_side(balance_at(s), z) or -np.sign(onward @ tangent)) / np.linalg.norm(onward)
    return None if onward @ tangent < -1 + 1e-6 else onward  # the way that it came


def _correct(
    balance_at: BalanceAt, here: BranchPoint, tangent: RealArray, step: float, span: float, tolerance: float
) -> tuple[BranchPoint | None, RealArray | None, int]:
    """The branch's point a step ahead, or None; its tangent, of either sign, where known; the Newton steps taken."""
    z, s = here.unknowns + step * tangent[:-1], here.parameter + step * tangent[-1] * span
    balance = balance_at(s)
    norm, onward = np.linalg.norm(balance.residual(z)), None
    for taken in range(CORRECTOR_STEPS):
        if norm <= tolerance:
            return BranchPoint(s, z, taken), onward, taken
        linear = balance.linearise(z)
        nudge = _DERIVATIVE_STEP * span
        slope = (balance_at(s + nudge).residual(z) - linear.residual) / _DERIVATIVE_STEP
        try:
            factors = Factorisation(linear, linear.residual)
        except np.linalg.LinAlgError:
            return None, None, taken + 1
        along, across = factors.solution, factors.solve(slope)
        # the point stays in the plane: tangent . (dz, ds) = 0
        onward = np.append(-across, 1.0) / np.hypot(np.linalg.norm(across), 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):  # no such step: the branch is at right angles to the last
            ds = tangent[:-1] @ along / (tangent[-1] - tangent[:-1] @ across)
            dz = -along - ds * across
        if not np.isfinite(ds) or not np.all(np.isfinite(dz)):
            return None, None, taken + 1
        shrink = 1.0
        while True:
            trial = balance_at(s + shrink * ds * span)
            new = np.linalg.norm(trial.residual(z + shrink * dz))
            if new <= (1 - 1e-4 * shrink) * norm:
                break
            shrink *= 0.5
            if shrink < 1e-3:
                return None, None, taken + 1
        z, s, norm, balance = z + shrink * dz, s + shrink * ds * span, new, trial
    return None, None, CORRECTOR_STEPS
