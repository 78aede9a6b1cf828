"""From a solution to its neighbours: along a parameter step by step, round folds by arc length.

A step is accepted where the solution found lies near the one predicted; a Newton run that lands on another branch does
not, however well it converged. Steps are halved until they are accepted. Where even the smallest is not, the branch
turns back: it is traced by arc length through its folds until it passes the parameter wanted.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.given import ComplexArray
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.continuation import BranchPoint, measure_arc, retraces, trace_branch
from ewr_fenicsx.solver.faint_forces import attend_to_faint_forces
from ewr_fenicsx.solver.newton import solve, wrap
from ewr_fenicsx.solver.snes import Attempt
from ewr_fenicsx.solver.warm_starts import list_predicted, try_starts
from ewr_fenicsx.solver.weights import adopt_weights

NEWTON_STEPS, FEW_STEPS = 15, 8  # of a warm start: what needs more is not near; up to so many, steps may grow
LARGEST_SURPRISE = 0.4  # relative distance of a solution from its prediction, beyond which it may be another branch's
SMALLEST_STEP = 2e-5  # of the frequency
TRACED_POINTS, LOOKS_BACK = 600, 10  # points; how often it is looked whether they go round in a circle
COARSE = 0.2  # change of state between traced points, about, where there is no limit to it
# Distances of a traced point, in steps, from which it is another branch's: a wide one may leap to a branch near by, of
# which a narrow one keeps clear
STRAYS = (3.0, 1.5)
# In which sense a fold is gone round, by the side where steps began, and 0: along the last points. On the odd side they
# may themselves have begun beyond a nose.
SENSES = {1: (1, 0), 0: (0,), -1: (-1, 1)}
# Forces count little in arc length: they are measured by those of the stuck joint, up to so many times the usual. In
# shorter steps through frequency the tracer turns round every corner of a wriggle.
MOST_STUCK = 1e3
CLOSED = "the branch is a closed curve"  # which no other way leads out of
BEYOND, LEAST_SHARE = 0.1, 0.5  # of the range, and of its lowest frequency: how far below it a branch is traced
# Tolerance at folds, at most: at looser ones steps lead on beyond a nose, where no branch is, and traces lose it
FIRM = 1e-6
FARTHEST = 10.0  # times the highest frequency, up to which trials go: far above, masses leave no digit of springs
SAME = 1e-5  # relative distance of two results of the same solve from different starts


@dataclass(frozen=True, eq=False)
class Jump:
    """Where a curve is broken: two frequencies [Hz] between which no branch was found, and what was tried.

    What is found beyond may belong to another branch, which may go on at lower frequencies: a sweep from there down
    (``solve`` with ``start=``) would tell.
    """

    frequency: tuple[float, float]
    why: str


@dataclass(eq=False)
class Curve:
    """Solutions along one branch in its own order, in which frequencies run back between folds."""

    points: list[PeriodicSolution] = field(default_factory=list)
    jumps: list[Jump] = field(default_factory=list)

    def extend(self, other: Curve) -> None:
        """Append another curve."""
        self.points += other.points
        self.jumps += other.jumps


@dataclass(frozen=True, eq=False)
class Stand:
    """From where a branch is followed.

    Attributes:
        here: Its last solution.
        before: The one before it, for a secant, or None.
        reach: Longest step from here [Hz].
    """

    here: PeriodicSolution
    before: PeriodicSolution | None = None
    reach: float = np.inf


def solve_from(
    problem: ContactProblem,
    latest: PeriodicSolution,
    earlier: PeriodicSolution | None = None,
    ratio: float = 1.0,
    tolerance: float = 1e-8,
) -> PeriodicSolution:
    """Solve a problem from one or two neighbours on its branch, with a secant predictor and never from cold.

    Forces *and* motions are extrapolated. A splitting begins there, or else the laws are linearised, and one Newton
    step makes the two fit.

    Args:
        problem: With the model, kinds of laws and harmonics of its neighbours.
        latest: The nearest neighbour.
        earlier: The one before, or None: no secant.
        ratio: Parameter step to the problem over that from ``earlier`` to ``latest``.
        tolerance: As in ``solve``.

    Returns:
        The solution or, not ``converged``, the best iterate.
    """
    begin = time.perf_counter()
    if not problem.system.rows.shape[0]:
        return solve(problem)
    balance = HarmonicBalance(problem.system)
    forces, motion, rigid = latest.forces, latest.row_motion, latest.rigid
    if earlier is not None:
        forces = forces + ratio * (forces - earlier.forces)
        motion = motion + ratio * (motion - earlier.row_motion)
        rigid = rigid + ratio * (rigid - earlier.rigid)
    starts = list_predicted(balance, forces, motion, rigid)
    attempt = try_starts(balance, starts, tolerance, "elimination", NEWTON_STEPS)
    attempt = attend_to_faint_forces(balance, attempt, tolerance, "elimination")
    return wrap(problem, balance, [attempt], (), time.perf_counter() - begin)


def read_state(solution: PeriodicSolution) -> ComplexArray:
    """What oscillates at the contact rows, ``(n_h, m)`` [m]: motion, and force by flexibility, where one may vanish."""
    system = solution.problem.system
    oscillates = np.array(system.basis.orders)[:, None] > 0
    return oscillates * (solution.row_motion + system.flexibility * solution.forces)


def read_whole_motion(solution: PeriodicSolution) -> ComplexArray:
    """What oscillates of all coordinates, ``(n_h, n)``, each by the root of its stiffness: of one unit [J^(1/2)]."""
    oscillates = np.array(solution.orders)[:, None] > 0
    return oscillates * solution.coordinates * np.sqrt(np.abs(solution.problem.model.stiffness.diagonal()))


def compare_states(a: ComplexArray, b: ComplexArray) -> float:
    """Distance of two states over the larger one."""
    size = max(np.linalg.norm(a), np.linalg.norm(b))
    return float(np.linalg.norm(a - b) / size) if size else 0.0


def agree(a: PeriodicSolution, b: PeriodicSolution) -> bool:
    """Whether two solutions of the same problem are one."""
    return compare_states(read_state(a), read_state(b)) <= SAME


@dataclass(frozen=True, eq=False)
class Follower:
    """Follows a branch of solutions along the frequency, with the weights and the closure of the solution it begins at.

    Args:
        problem_at: Frequency [Hz] -> problem.
        lowest, highest: Range of the whole curve [Hz]; its width is the unit of arc length.
        refine: Largest relative change of state between neighbouring points that are kept, of a linear joint that of
            its motion, or None: only the targets are kept.
        tolerance: As in ``solve``.
        tell: What is called now and then where a branch turns back, with a few words on how far it has been traced.
    """

    problem_at: Callable[[float], ContactProblem]
    lowest: float
    highest: float
    refine: float | None = None
    tolerance: float = 1e-8
    tell: Callable[[str], None] = lambda note: None

    def follow(self, start: Sequence[PeriodicSolution], targets: Sequence[float]) -> Curve:
        """The branch from its last point or points to each of the rising ``targets`` in turn; these left out."""
        curve = Curve()
        for piece, _ in self.go_on(Stand(*reversed(start[-2:])), targets):
            curve.extend(piece)
        return curve

    def go_on(self, stand: Stand, targets: Sequence[float]) -> Iterator[tuple[Curve, Stand]]:
        """To each of the rising ``targets`` in turn: the piece of the branch up to it, and where that leaves off.

        Whoever keeps the latter can go on from there later, on the same branch to the last bit.
        """
        here, before, reach = stand.here, stand.before, stand.reach
        for target in targets:
            curve, begun = Curve(), here
            while here.problem.frequency != target:
                f = min(target, here.problem.frequency + reach)
                f = target if target - f < SMALLEST_STEP * target else f
                found, surprise, change = self._step(f, here, before)
                tiny = f - here.problem.frequency <= 2 * SMALLEST_STEP * f  # half of it would be drawn to the target
                lost, far = surprise > LARGEST_SURPRISE, bool(self.refine) and change > self.refine
                turns = tiny and (lost or far) and here.problem.system.rows.shape[0]
                if turns and self.tolerance > FIRM and (firmly := self._go_on_firmly(begun, target)):
                    curve, stand = firmly
                    here, before, reach = stand.here, stand.before, stand.reach
                    break
                traced = self._trace(begun, curve.points, here, before, target) if turns else None
                if traced and (lost or not traced.jumps):
                    curve.extend(traced)
                    reach = np.inf
                    if not traced.points:
                        break  # no solution at this target: on to the next
                    here, before = traced.points[-1], (traced.points[-2:-1] or [here])[0]
                    if traced.jumps:
                        before = None
                    continue
                if lost or (far and not tiny):
                    reach = 0.5 * (f - here.problem.frequency)
                    continue
                if self.refine or f == target:
                    curve.points.append(found)
                easy = surprise < 0.5 * LARGEST_SURPRISE and found.iterations <= FEW_STEPS
                reach = (2.0 if easy else 1.0) * (f - here.problem.frequency)
                here, before = found, here
            yield curve, Stand(here, before, reach)

    def _go_on_firmly(self, begun: PeriodicSolution, target: float) -> tuple[Curve, Stand] | None:
        """One turn of ``go_on`` with a firm tolerance, round a fold; None where it does not hold the beginning."""
        firm = replace(self, tolerance=FIRM)
        found, surprise, _ = firm._step(begun.problem.frequency, begun, None)
        return next(firm.go_on(Stand(found), [target])) if surprise <= LARGEST_SURPRISE else None

    def descend(self, start: PeriodicSolution, targets: Sequence[float]) -> list[PeriodicSolution]:
        """The branch from a point to each of the falling ``targets`` in turn, as far as it leads without a fold."""
        points: list[PeriodicSolution] = []
        here, reach = start, np.inf
        for target in targets:
            while here.problem.frequency != target:
                f = max(target, here.problem.frequency - reach)
                f = target if f - target < SMALLEST_STEP * target else f
                gone = here.problem.frequency - f
                found, surprise, change = self._step(f, here, None)
                if surprise > LARGEST_SURPRISE or (self.refine and change > self.refine):
                    if gone <= 2 * SMALLEST_STEP * f:
                        return points
                    reach = 0.5 * gone
                    continue
                if self.refine or f == target:
                    points.append(found)
                here, reach = found, 2.0 * gone
        return points

    def _pose(self, frequency: float, here: PeriodicSolution) -> ContactProblem:
        """The problem on the branch of ``here``, which may have been found with the default weights only."""
        return adopt_weights(self.problem_at(frequency), here.problem)

    def _step(self, f: float, here: PeriodicSolution, before: PeriodicSolution | None) -> tuple:
        """Solution at a frequency, its distance from its prediction and from the point before it."""
        ratio = 1.0
        if before is not None:
            gone = here.problem.frequency - before.problem.frequency
            ratio = (f - here.problem.frequency) / gone if gone > 0 else 0.0
        found = solve_from(self._pose(f, here), here, before, ratio, self.tolerance)
        if not found.converged:
            return found, np.inf, np.inf
        if not found.problem.system.rows.shape[0]:  # linear: there is no other branch
            return found, 0.0, compare_states(read_whole_motion(found), read_whole_motion(here))
        state, last = read_state(found), read_state(here)
        change = compare_states(state, last)
        if before is None:
            return found, change, change
        return found, min(change, compare_states(state, last + ratio * (last - read_state(before)))), change

    def _trace(
        self,
        begun: PeriodicSolution,
        kept: list[PeriodicSolution],
        here: PeriodicSolution,
        before: PeriodicSolution | None,
        target: float,
    ) -> Curve:
        """The branch from a point next to a fold until it passes ``target``, its last point; or a cold solve there.

        Steps through frequency may leap over the nose of a fold, and then follow what lies beyond back up to it: from
        there the branch leads on the other way. Its sense, which the side tells where they ``begun``, is that of the
        branch all along. Points ``kept`` on another side are taken out: it passes them again, in its own order.
        """
        for sense, stray in product(SENSES[begun.side], STRAYS):
            points, why = self._trace_arc(here, before, target, stray, sense)
            self.tell("")
            if not why:
                if sense:
                    kept[:] = [point for point in kept if point is here or point.side * sense > 0]
                return Curve(points)
            if CLOSED in why:
                break
        # what was traced so far is on no way to the target
        try:
            cold = solve(self.problem_at(target), tolerance=self.tolerance)
        except NotConverged as error:
            return Curve([], [Jump((here.problem.frequency, target), f"{why}; {error}")])
        why += "; solved from cold, maybe on another branch"
        return Curve([cold], [Jump((here.problem.frequency, target), why)])

    def _trace_arc(
        self, here: PeriodicSolution, before: PeriodicSolution | None, target: float, stray: float, sense: int
    ) -> tuple[list[PeriodicSolution], str]:
        """Arc-length continuation until the branch passes ``target``: its points, and why it did not get there."""
        unit = HarmonicBalance(here.problem.system).measure_stick(MOST_STUCK)
        span = self.highest - self.lowest
        least = max(self.lowest - BEYOND * span, LEAST_SHARE * self.lowest)

        def balance_at(frequency: float) -> HarmonicBalance:
            possible = min(max(frequency, 0.9 * least), FARTHEST * self.highest)  # a trial may go anywhere
            return HarmonicBalance(self._pose(possible, here).system, unit)

        def as_branch_point(solution: PeriodicSolution) -> BranchPoint:
            balance = balance_at(solution.problem.frequency)
            return BranchPoint(solution.problem.frequency, balance.pack(solution.forces, solution.rigid), 0)

        @cache
        def solution_at(point: BranchPoint) -> PeriodicSolution:
            balance = balance_at(point.parameter)
            residual = balance.measure_residual(point.unknowns)
            attempt = Attempt(point.unknowns, residual, point.steps, "traced by arc length", residual <= self.tolerance)
            return wrap(self._pose(point.parameter, here), balance, [attempt], (), 0.0)

        state_at = cache(lambda point: read_state(solution_at(point)))

        meet = cache(lambda a, b: self._step(target, solution_at(b), solution_at(a)))  # at the target, from both

        def measure_room(a: BranchPoint, b: BranchPoint) -> float:
            change = compare_states(state_at(a), state_at(b)) if self.refine else 0.0
            far = b.parameter >= target and meet(a, b)[1] > LARGEST_SURPRISE
            return min(self.refine / change if change else np.inf, 0.5 if far else np.inf)

        points: list[PeriodicSolution] = []
        last = None if before is None else as_branch_point(before)
        point = as_branch_point(here)
        times = math.ceil(COARSE / self.refine) if self.refine else 1  # as many points
        first = 0.05 if last is None else max(1e-6, measure_arc(last, point, span))
        branch = trace_branch(
            balance_at,
            point,
            span,
            step=first,
            smallest_step=1e-7,
            largest_step=0.1,
            tolerance=self.tolerance,
            before=last,
            sense=sense,
            stray=stray,
            measure_room=measure_room,
        )
        path = [point]
        for point in branch:
            path.append(point)
            if len(path) % (times * LOOKS_BACK) == 0:
                self.tell(f"fold at {point.parameter:.4g} Hz, {len(path)} points")
                if retraces(path, span):
                    frequencies = [p.parameter for p in path]
                    return points, f"{CLOSED} between {min(frequencies):g} and {max(frequencies):g} Hz"
            if point.parameter >= target:
                found, surprise, _ = meet(*path[-2:])
                if surprise <= LARGEST_SURPRISE:
                    return [*points, found], ""
                return points, f"past its folds, the branch was lost before {target:g} Hz"
            if point.parameter < least:
                return points, f"the branch left the range of frequencies at {point.parameter:g} Hz"
            if len(points) >= times * TRACED_POINTS:
                return points, f"{len(points)} points of arc-length continuation did not reach it"
            points.append(solution_at(point))
        return points, "the branch was lost by arc-length continuation"
