"""Branches of periodic solutions along a parameter, past folds: pseudo-arc-length continuation.

The branch is parametrised by its arc length, in which a fold is an ordinary point. One step: along the tangent that the
last correction ended with, or a secant, then Newton on the balance bordered with the condition that the point lies in
the plane normal to that. What costs is factorisations: each serves as long as steps with it take much of the residual
away, and with rounded corners a point far off or hardly found is given up for a nearer one.

Source: Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, repeat

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.newton_step import Factorisation, NewtonStep
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.in_time.stability import find_side

BalanceAt = Callable[[float], HarmonicBalance]

_DERIVATIVE_STEP = 1e-8  # step in the parameter for the derivative of the residual, over its span
CORRECTOR_STEPS = 12  # Newton steps allowed a point
# With rounded corners (at sharp ones residuals leap, and steps are short by nature): the residual of a prediction, over
# the natural force, above which it leads nowhere; and the share of a residual that so many steps must go below.
_MOST_LEFT, _SLOW, _PATIENCE = 1.0, 0.3, 3
# Share of the residual that a step must take away, and its least length: the first with its factors, and further ones.
_FIRST, _FURTHER = (1e-4, 1e-3), (0.7, 1.0)
_AROUND, _LEAP = 0.2, 5e-3  # a longer step that turns the tangent by an angle of a smaller cosine leapt over a corner
_NEAREST, _ROOMY = 1e-6, 0.9  # step that is short enough for any room; share of the room that the next step goes for
_LARGE = 0.3  # share of the norm of the unknowns by which steps may be longer, where that is above one: rarely it is
_STRAIGHT, _ALONG = 0.9, 0.5  # cosine above which a branch goes straight on; and above which two tangents are one
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
    step: float,
    smallest_step: float = 1e-4,
    largest_step: float = np.inf,
    tolerance: float = 1e-8,
    before: BranchPoint | None = None,
    sense: int = 0,
    stray: float = np.inf,
    measure_room: Callable[[BranchPoint, BranchPoint], float] = lambda here, found: np.inf,
) -> Iterator[BranchPoint]:
    """Follow a branch from a converged point, until the consumer stops or a step fails at the smallest size.

    Args:
        balance_at: Parameter -> balance, all in the same units.
        start: A converged point.
        span: Parameter range that counts as one unit of length; its sign is the first direction.
        step: First step, in units of arc length.
        smallest_step: Below this the branch ends.
        largest_step: No step is longer than this, or than a like share of large unknowns.
        tolerance: Residual norm of accepted points.
        before: The branch's last point before ``start``, through which the first secant goes; None: the first step
            changes the parameter alone, which misses the branch where it is close to a fold.
        sense: Which way to go from ``start``: 1 or -1 times the one in which the bordered determinant is positive,
            wherever ``before`` is; 0, or where that is not known: along the secant.
        stray: A point further from the last one than so many steps is another branch's. Where it is finite, long steps
            across a sharp corner are halved, and go along secants: they come closer to a corner, in more steps. Else a
            step that follows a halved one is no longer than that.
        measure_room: How many times as far apart two points in turn may be at most; where it is less than one, the
            second is looked for nearer by.
    """
    here, tangent, spent, halved = start, np.append(np.zeros(start.unknowns.size), 1.0), 0, False
    if before is not None:
        tangent = _point_to(before, start, span)
    tangent_at = cache(lambda point: _find_tangent(balance_at, point.unknowns, point.parameter, span))
    if sense and (there := tangent_at(start)) is not None:
        tangent = sense * there
    ways = [(here, tangent)]  # the last points, and along what the branch came there
    while step >= smallest_step:
        found, onward, taken = _correct(balance_at, here, step * tangent, tangent, span, tolerance)
        spent += taken
        if found is not None and measure_arc(here, found, span) > stray * step:
            found = None
        if found is not None and np.isfinite(stray) and step > _LEAP and onward is not None:
            chord = _point_to(here, found, span)
            around = np.sign(onward @ chord) * (onward @ tangent) < _AROUND
            if around or _turns_back(tangent_at, ways[0], (found, chord)):
                found = None
        ahead = None
        if found is None and step <= _LEAP:
            found, ahead, taken = _turn_corner(balance_at, ways, step, span, tolerance)
            spent += taken
        if found is None:
            step, halved = 0.5 * step, True
            continue
        found = replace(found, steps=spent)
        room = measure_room(here, found)
        if room < 1 and step > _NEAREST:
            step = max(0.5, _ROOMY * room) * step
            continue
        if ahead is None:
            secant = _point_to(here, found, span)
            ahead = secant if np.isfinite(stray) else _find_way(secant, onward)
        tangent = ahead
        yield found
        here, spent = found, 0
        ways = [(here, tangent), *ways[:1]]
        most = largest_step * max(1.0, _LARGE * float(np.linalg.norm(here.unknowns)))
        growth = 0.7 if taken > 8 else 1.0 if taken > 5 or (halved and not np.isfinite(stray)) else 1.6
        step, halved = min(most, growth * step, max(_NEAREST, _ROOMY * room * step)), False


def _find_way(secant: RealArray, tangent: RealArray | None) -> RealArray:
    """Where a branch goes on: along a tangent of either sign, unless that has turned away from the secant."""
    if tangent is None or abs(tangent @ secant) < _ALONG:
        return secant
    return np.sign(tangent @ secant) * tangent


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
    balance_at: BalanceAt, ways: Sequence[tuple[BranchPoint, RealArray]], step: float, span: float, tolerance: float
) -> tuple[BranchPoint | None, RealArray | None, int]:
    """A branch's point beyond a sharp corner, over which a step leaps or the last one leapt.

    Non-smooth laws make branches piecewise smooth: they turn in a point, often back on themselves, so that no plane
    across the way they came meets the piece beyond. It is looked for in a plane across that piece's own tangent.

    Args:
        ways: The last points, the latest first, with the direction in which the branch came to each.
        balance_at, step, span, tolerance: As in ``trace_branch``.

    Returns:
        The point and the tangent there, or None; and the Newton steps taken.
    """
    sense, taken = 0, 0
    for point, tangent in ways:  # the latest may lie beyond a corner, aside of the way that led there
        there = _find_tangent(balance_at, point.unknowns, point.parameter, span)
        taken += 1
        if there is not None and abs(there @ tangent) > _ALONG:
            sense = np.sign(there @ tangent)
            break
    here, tangent = ways[0]
    ahead = step * tangent
    beyond = _find_tangent(balance_at, here.unknowns + ahead[:-1], here.parameter + ahead[-1] * span, span)
    if not sense or beyond is None or sense * beyond @ tangent > _STRAIGHT:
        return None, None, taken + 1
    beyond = sense * beyond
    found, _, steps = _correct(balance_at, here, ahead + step * beyond, beyond, span, tolerance)
    if found is None:
        return None, None, taken + 1 + steps
    there = _find_tangent(balance_at, found.unknowns, found.parameter, span)
    if there is None or sense * there @ beyond < _ALONG:
        found = there = None
    return found, sense * there if found else None, taken + 2 + steps


def _turns_back(
    tangent_at: Callable[[BranchPoint], RealArray | None],
    a: tuple[BranchPoint, RealArray],
    b: tuple[BranchPoint, RealArray],
) -> bool:
    """Whether a branch that comes to one point along a direction goes on otherwise at another, by its sense in both.

    As where a step leapt over the corner in which the branch turns back, to where that piece came from. The step may
    look straight, for forces are small where contact is only just grazed. Where a sense is not known it does not.

    Args:
        tangent_at: As ``_find_tangent``.
        a, b: The points, with directions along which to come there.
    """
    (begin, way), (end, onward) = ((tangent_at(point), direction) for point, direction in (a, b))
    if begin is None or end is None or abs(begin @ way) < _ALONG:
        return False
    return np.sign(begin @ way) * (end @ onward) < _ALONG


def _find_tangent(balance_at: BalanceAt, unknowns: RealArray, parameter: float, span: float) -> RealArray | None:
    """Tangent of the branch through a point, in the direction in which the bordered determinant is positive.

    All along a branch that is the same direction, also round corners, unless another branch crosses it.
    """
    try:
        balance = balance_at(parameter)
        side = find_side(balance, unknowns)
        if not side:  # as where there are too many unknowns to look: the rest would take long as well
            return None
        linear = balance.linearise(unknowns)
        across = linear.solve(_differentiate(balance_at, linear, unknowns, parameter, span))
    except (np.linalg.LinAlgError, ModelError):  # the latter as in ``_correct``
        return None
    tangent = np.append(-across, 1.0) * side
    norm = np.linalg.norm(tangent)
    return tangent / norm if norm < np.inf else None


def _differentiate(
    balance_at: BalanceAt, linear: NewtonStep, unknowns: RealArray, parameter: float, span: float
) -> RealArray:
    """Derivative of the residual by the parameter in units of ``span``, with the laws linear in the motion.

    At the same forces a resonance moves pairs so far that many change status, however short the step; along the branch
    forces change as well, and hardly any does.
    """
    motion = linear.balance.compliance.motion(*linear.balance.unpack(unknowns))
    nudged = balance_at(parameter + _DERIVATIVE_STEP * span).linearise(unknowns, motion)
    return (nudged.residual - linear.residual) / _DERIVATIVE_STEP


def _correct(
    balance_at: BalanceAt, here: BranchPoint, ahead: RealArray, tangent: RealArray, span: float, tolerance: float
) -> tuple[BranchPoint | None, RealArray | None, int]:
    """The branch's point in the plane across a tangent, through ``ahead`` of here; or None.

    With its own tangent, of either sign, where known, and the Newton steps taken: factorisations, each of which serves
    for further steps as well.
    """
    try:
        return _iterate(balance_at, here, ahead, tangent, span, tolerance)
    except ModelError:  # a trial hit a mode without damping exactly
        return None, None, 1


def _iterate(
    balance_at: BalanceAt, here: BranchPoint, ahead: RealArray, tangent: RealArray, span: float, tolerance: float
) -> tuple[BranchPoint | None, RealArray | None, int]:
    """``_correct``, where every trial has a balance."""
    z, s = here.unknowns + ahead[:-1], here.parameter + ahead[-1] * span
    balance, onward = balance_at(s), None
    left = [balance.measure_residual(z)]  # by the steps of each factorisation
    rounded = not any(law.has_corners for law in balance.system.laws)
    while not left[-1] <= tolerance:  # no number is none either
        taken = len(left) - 1
        slow = taken >= _PATIENCE and left[-1] > _SLOW * left[-1 - _PATIENCE]
        if taken == CORRECTOR_STEPS or np.isnan(left[-1]) or (rounded and (slow or left[0] > _MOST_LEFT)):
            return None, None, taken
        linear = balance.linearise(z)
        slope = _differentiate(balance_at, linear, z, s, span)
        try:
            factors = Factorisation(linear, linear.residual)
        except np.linalg.LinAlgError:
            return None, None, taken + 1
        along, across, norm = factors.solution, factors.solve(slope), left[-1]
        onward = np.append(-across, 1.0) / np.hypot(np.linalg.norm(across), 1.0)
        for share, least in chain([_FIRST], repeat(_FURTHER)):
            # the point stays in the plane: tangent . (dz, ds) = 0
            with np.errstate(divide="ignore", invalid="ignore"):  # none: the branch is at right angles to the last
                ds = tangent[:-1] @ along / (tangent[-1] - tangent[:-1] @ across)
                dz = -along - ds * across
            if not np.isfinite(ds) or not np.all(np.isfinite(dz)):
                return None, None, taken + 1
            moved = _descend(balance_at, (z, s), (dz, ds * span), norm, share, least)
            if moved is None:
                break
            z, s, balance, norm, residual = moved
            if norm <= tolerance:
                break
            along = factors.solve(residual)
        if not norm < left[-1]:
            return None, None, taken + 1
        left.append(norm)
    return BranchPoint(s, z, len(left) - 1), onward, len(left) - 1


def _descend(
    balance_at: BalanceAt,
    here: tuple[RealArray, float],
    step: tuple[RealArray, float],
    norm: float,
    share: float,
    least: float,
) -> tuple[RealArray, float, HarmonicBalance, float, RealArray] | None:
    """Where a step leads, halved until it takes away a ``share`` of the residual's ``norm``, or as much less as it is.

    Returns:
        Unknowns, parameter, balance, and the residual after its norm; None where less than the ``least`` part of the
        step would do.
    """
    shrink = 1.0
    while shrink >= least:
        z, s = here[0] + shrink * step[0], here[1] + shrink * step[1]
        balance = balance_at(s)
        residual = balance.residual(z)
        left = float(np.linalg.norm(residual))
        if left <= (1 - share * shrink) * norm:
            return z, s, balance, left, residual
        shrink *= 0.5
    return None
