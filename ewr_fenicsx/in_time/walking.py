"""Bodies that hang on friction alone and walk: a little further every cycle, so that no motion is periodic.

Where pairs stick throughout, friction says nothing of the mean force that each of them carries: springs decide
(``static_displacement_row``), so weak that they take next to nothing from the law. Where the pairs slip and friction
cannot carry the mean load, the springs alone would hold the body, drawn out to no end.

What the springs carry in place of friction passes through zero as harmonics are added, and may be small by chance. How
far a body goes is therefore looked at in time, a few periods from the solution. For ever it goes only along rigid
motions that leave the gaps of all pressed pairs as they are: what pairs move by else has not settled yet.
"""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np
import scipy.linalg

from ewr_fenicsx.balance.balance import HELD_FIRMER, HarmonicBalance
from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.in_time.deviations import STEPS_IN_TIME, THETA, step_from
from ewr_fenicsx.laws.law_kinds import TANGENTS, choose_friction_weight
from ewr_fenicsx.problem.contact_system import ContactSystem
from ewr_fenicsx.problem.law_claims import read_fields

NOTICED = 1e-2  # share of the largest friction force, above which springs hold the body in place of friction
HELD = 1e-5  # share below which friction holds it: what decides its mean force leaves less
DRAWN_OUT = 100.0  # at rest, where nothing is truncated: times the natural length that springs may be drawn out
FIRMER, SHORTER = 10.0, 0.5  # springs so much firmer are drawn out by less than this share where they hold a body
SLOW = 1e-3  # of what its pairs slide in a cycle, above which a walk is worth a word
# Periods in time for which a body is watched; and how many times faster than at their end it may have gone half-way
# where its motion has settled; a third of them apart, ways that fade away are none that last
WATCHED, NO_FASTER = 12, 1.5
FINER, MOST_STEPS = 4, 8192  # how much shorter the steps where they may make it drift, and how many at most
MOST_WORK = 3e8  # steps a period, times rows of contact squared, up to which they are made shorter
FAINT = 1e-2  # share of a slow walk, below which the first third of the periods tells that there is none
PRESSED = 1e-3  # share of the largest mean normal force, from which a pair counts as pressed
SAME = 1e-6  # motion by a rigid mode, over the largest, that is the rounding of meshes
NOTHING = 1e-5  # of the natural length, below which what moves on is the stepping's rounding, as where all pairs stick
UNSOLVED = 10.0  # times the residual: below, what is left over is the solver's, as where friction has nothing to carry
WALKS = (
    "a body that hangs on friction walks: while its pairs slip, friction does not carry the mean load, and no motion "
    "is periodic; add a support or friction, or take from the load"
)


class Walk(NamedTuple):
    """How a body that hangs on friction moves on; its way is right to the order.

    ``share``: of the largest friction force, that friction leaves to springs; 0 where no body hangs on friction, 1
    where the way was seen in time, whatever springs carry.
    ``way``: that it goes in a cycle [m]. ``sliding``: the longest way that its pairs slide to and fro in one [m].
    """

    share: float
    way: float
    sliding: float

    @property
    def slow(self) -> bool:
        """Whether it walks so little that the motion is nearly periodic, and so much that it matters."""
        return self.share > HELD and self.way > SLOW * self.sliding

    def __str__(self) -> str:
        return (
            f"a body that hangs on friction may walk slowly, by the order of {self.way:.0e} m a cycle, where its pairs "
            f"slide {self.sliding:.0e} m: slip and wear of single pairs may be off by as much, and where the body is "
            "on average means nothing; see what more harmonics change, and whether it moves on in integrate(problem)"
        )


def walks(balance: HarmonicBalance, unknowns: RealArray) -> bool:
    """Whether springs carry a mean force that friction cannot, at a solution ``(size,)`` of the balance."""
    left, largest = _leave_over(balance, unknowns)
    if np.any(balance.rate):
        return bool(left.max() > NOTICED * largest)
    share = float(np.max(balance.static_displacement_row * balance.system.flexibility, initial=0.0))
    far = left > min(NOTICED, DRAWN_OUT * share) * largest
    return bool(np.any(far) and np.any(far & _springs_hold(balance, unknowns)))


def _springs_hold(balance: HarmonicBalance, unknowns: RealArray) -> np.ndarray:
    """Rows ``(m,)`` that springs hold at rest: firmer ones would be drawn out by less.

    Where friction is small, elastic bodies slide far before they rest; springs are drawn out by as much, and hold none.
    """
    shares = balance.static_displacement_row * balance.system.flexibility
    firmer = balance.with_least_share(FIRMER * float(np.max(np.where(balance.held, shares / HELD_FIRMER, shares))))
    step = firmer.linearise(unknowns)
    try:
        ends = unknowns, unknowns - step.solve(step.residual)
    except np.linalg.LinAlgError:  # nothing tells
        return np.ones(balance.rows, dtype=bool)
    motions = (balance.compliance.motion(*balance.unpack(end))[0].real for end in ends)
    now, then = (measure_in_plane(balance.system, motion) for motion in motions)
    return then < SHORTER * now


def watch_walk(motion: PeriodicMotion, balance: HarmonicBalance, expected: Walk) -> Walk | None:
    """How a body that hangs on friction goes on in time, some periods after it begins on a solution of a balance.

    Where no rigid motion leaves the gaps as they are, and springs carry no more than they may, there is nothing to see.

    Args:
        motion: The solution.
        balance: The balance.
        expected: How it walks as the solution has it (``measure_walk``).

    Returns:
        None where its motion cannot be stepped, or has not settled to a walk or none.
    """
    free = find_free_motions(motion)
    if not (free.size or expected.slow):
        return Walk(1.0, 0.0, expected.sliding)
    free = free if free.size else motion.problem.layout.model.rigid_modes
    steps, (walk, held) = STEPS_IN_TIME, _watch(motion, balance, free, STEPS_IN_TIME)
    most = min(MOST_STEPS, MOST_WORK / max(1, balance.rows) ** 2)
    # steps hold what drifts, and what ought to, by less than they turn friction
    while walk and (walk.slow or expected.slow) and FINER * steps <= most:
        steps, coarse = FINER * steps, walk
        walk, held = _watch(motion, balance, free, steps)
        if walk and walk.way > max(coarse.way / NO_FASTER, held):
            break
    return walk


def find_free_motions(motion: PeriodicMotion) -> RealArray:
    """Rigid motions ``(n', k)`` that change no pressed pair's gap, in the coordinates of the layout's model."""
    layout = motion.problem.layout
    normal = layout.row_of("normal", np.arange(layout.model.pairs))
    normal, modes = normal[normal >= 0], layout.model.rigid_modes
    force = motion.forces[motion.orders.index(0), normal].real if 0 in motion.orders else np.zeros(normal.size)
    pressed = normal[force > PRESSED * force.max(initial=0.0)]
    units = np.linalg.norm(layout.rows @ modes, axis=0)
    modes = modes[:, units > 0] / units[units > 0]
    _, sizes, ways = np.linalg.svd(layout.rows[pressed] @ modes)
    return modes @ ways[np.count_nonzero(sizes > SAME) :].T


def _watch(motion: PeriodicMotion, balance: HarmonicBalance, free: RealArray, steps: int) -> tuple[Walk | None, float]:
    """The same with so many steps a period; and the way that these may hold: friction turns in the same step still.

    ``free``: ``(n', k)`` along which it may go on.
    """
    from ewr_fenicsx.in_time.periodicity import fades  # only for those that are stepped, as time stepping itself

    rubs, ways, third, way = balance.static_displacement_row > 0, [], WATCHED // 3, 0.0
    try:
        for scheme, period in islice(step_from(motion, steps, THETA), WATCHED):
            if not ways:
                along = scipy.linalg.orth(scheme.contraction @ (motion.problem.layout.expansion @ free))
            drift = scheme.rows @ along @ (along.T @ (period.positions[-1] - period.positions[0]))
            ways.append(float(measure_in_plane(balance.system, drift)[rubs].max()))
            slip = measure_in_plane(balance.system, np.diff(period.positions @ scheme.rows.T, axis=0)).sum(axis=0)
            slid = float(slip[rubs].max())
            if len(ways) == third and max(ways[1:]) < FAINT * SLOW * slid:
                break
    except (ModelError, ImportError):
        return None, 0.0
    if len(ways) > third:
        if len(ways) < WATCHED or ways[WATCHED // 2] > NO_FASTER * ways[-1] or fades(ways[third - 1 :: third]):
            return None, 0.0
        way = ways[-1] if ways[-1] > NOTHING * balance.length_unit else 0.0
    turned = measure_in_plane(balance.system, np.diff(period.velocities @ scheme.rows.T, axis=0)).max(axis=0)
    return Walk(1.0, way, slid), 0.5 * float(turned[rubs].max()) / motion.problem.frequency


def measure_walk(balance: HarmonicBalance, unknowns: RealArray) -> Walk:
    """How a body that hangs on friction moves on, at a solution ``(size,)`` of the balance.

    What the mean equation of a law leaves over, the body's moving on would add to friction's mean: while a pair sticks,
    a velocity over the weight of its dashpot. Where springs close the truncation the default weight stands in, and
    tells the order of the walk.
    """
    left, largest = _leave_over(balance, unknowns)
    if not np.any(left):
        return Walk(0.0, 0.0, 0.0)
    held, omega = left > 0, balance.compliance.omega or 1.0
    forces, rigid = balance.unpack(unknowns)
    motion = balance.compliance.motion(forces, rigid)
    weight, sticks = choose_friction_weight(omega, balance.system.flexibility), np.ones(balance.rows)
    seen = balance.sample(forces, motion)
    for law, rows, at in zip(balance.system.laws, balance.law_rows, seen, strict=True):
        if np.any(held[rows]):
            weight[rows] = getattr(law, "rho", weight[rows])
            sticks[rows] = 1 - np.mean(read_fields(law, at).get("slipping", np.zeros((1, rows.size))), axis=0)
    share_of_stick = max(left @ sticks / left.sum(), 1 / balance.basis.samples)
    period, speed = 2 * np.pi / omega, balance.basis.synthesise(balance.rate[:, None] * motion)
    way = period * weight * left / share_of_stick
    slid = period * np.mean(measure_in_plane(balance.system, speed), axis=0)
    return Walk(float(left.max() / largest), float(way.max()), float(slid[balance.static_displacement_row > 0].max()))


def _leave_over(balance: HarmonicBalance, unknowns: RealArray) -> tuple[RealArray, float]:
    """Mean force that friction leaves to springs, zero where it is the solver's, and the largest friction force [N].

    The first is ``(m,)``; where a pair has two tangents, its size is at the rows of both.
    """
    held, springs = balance.static_displacement_row > 0, balance.static_displacement_row.copy()
    at_rest = not (np.any(balance.rate) or np.any(balance.compliance.rigid_load))  # by interference alone
    if at_rest or not balance.hangs_on_friction:
        return np.zeros(balance.rows), 1.0
    for law, rows in zip(balance.system.laws, balance.law_rows, strict=True):
        # stronger springs than the law's are but for the start of a run
        springs[rows] = np.where(balance.held[rows], law.static_displacement_row, springs[rows])
    forces, rigid = balance.unpack(unknowns)
    drawn = balance.compliance.motion(forces, rigid)[0].real
    left = measure_in_plane(balance.system, (balance.static_force_row * forces[0].real + springs * drawn) * held)
    unsolved = UNSOLVED * balance.measure_residual(unknowns) * balance.force_unit
    rubbing = measure_in_plane(balance.system, balance.basis.synthesise(forces))[:, held]
    return np.where(left > unsolved, left, 0.0), float(rubbing.max()) or 1.0


def measure_in_plane(system: ContactSystem, values: RealArray) -> RealArray:
    """Sizes of values at the rows, ``(..., m)``; along the two tangents of a pair both are that of the whole."""
    sizes, (first, second) = np.abs(values), (system.row_of(d, np.arange(system.model.pairs)) for d in TANGENTS)
    both = (first >= 0) & (second >= 0)
    first, second = first[both], second[both]
    sizes[..., first] = sizes[..., second] = np.hypot(values[..., first], values[..., second])
    return sizes
