"""The slow time of wear: cycle by cycle, or in jumps over many cycles whose error is measured.

Every cycle is solved, or the slow time is crossed in jumps: an embedded pair of orders one and two measures the error
of a jump and chooses the next. Explicit jumps are Euler's and Heun's, and stay below the limit of stability that
contact stiffness sets. Damped jumps know that stiffness and have no limit: the pair of Verwer, which is Euler's and
Heun's where the stiffness is zero. They take of it what the jump before has shown, for pairs that are seldom closed
together give way more easily. A jump of one cycle is the cycle itself, so that jumps tend to the every-cycle run.

Source: Verwer et al. (1999), doi:10.1137/S1064827597326651, for ROS2, of order two with any Jacobian.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ewr_fenicsx.errors import ModelError, NotConverged, UnheldBody
from ewr_fenicsx.given import RealArray, is_positive, is_whole
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.response.following import solve_from
from ewr_fenicsx.response.refining import measure_gap
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.newton import solve
from ewr_fenicsx.wear.archard import find_explicit_limit, find_wear_stiffness, measure_wear_rate
from ewr_fenicsx.wear.same_place import PairsAtOnePlace
from ewr_fenicsx.wear.wear_accuracy import AccurateWear
from ewr_fenicsx.wear.wear_store import Leap, WearState, WearStep

SAFETY = 0.9  # of the jump that the error or the limit of stability would allow
GROWTH = 4.0  # of one jump over the one before, at most; none after one that led to no solution
CHECK_EVERY = 20  # cycles between checks that a cycle is below the limit, where each is solved
LOWER = "lower the wear coefficient (in 1/Pa, mostly below 1e-9)"  # where a cycle wears too much
REMEDY = f"{LOWER}, or let wear pass as a flow: Tolerance(damped=True)"
GAMMA = 1 - 1 / np.sqrt(2)  # of ROS2: damps the fastest parts of the wear completely
AMPLE = 2.0  # of the stiffness that a jump has shown: the next one may meet more of it


@dataclass(frozen=True, kw_only=True)  # a bare 0.01 would be read as a hundredth, and mean a depth of 10 mm
class Tolerance:
    """Error control of cycle jumps: how far the worn depth may be off at the end; its numbers are given by name.

    A jump over a fraction f of all cycles may be off by sqrt(f) times this, as estimated by the first-order member of
    the pair. Such errors may add up to more than the tolerance, but the second-order member, which is the one kept, is
    off by far less.

    Args:
        depth: Largest error [m]; None: ``share`` says it.
        share: Largest error where ``depth`` is None, over the deepest wear that is expected at the end:
            before a jump or after it, whichever is less.
        first: The first jump to try [cycles].
        damped: Whether jumps are damped, and so stable at any length; else they are explicit, and kept below the limit
            of stability.

    Raises:
        ModelError: A tolerance or jump that is not positive.
        TypeError: A number without its name.
    """

    depth: float | None = None
    share: float = 0.01
    first: int = 2
    damped: bool = True

    def __post_init__(self) -> None:
        fits = is_positive(self.share) and self.share < 1 and (self.depth is None or is_positive(self.depth))
        if not (fits and is_whole(self.first, 1)):
            raise ModelError(
                f"{self}; depth and share must be positive, share below 1, first a whole number of at least 1 cycle"
            )


@dataclass(frozen=True, eq=False)
class WearRun:
    """One wear calculation, from any of its states to the next.

    Args:
        problem: The joint at the start.
        cycles: Number of cycles to follow.
        coefficient: ``(K_c,)`` wear coefficients [1/Pa].
        jump: Error control of jumps; None: every cycle is solved.
        keep_every: Steps are kept at least so many cycles apart.
        deepest: Stop where some pair has worn deeper than this [m]; None: nowhere.
        tolerance: As in ``solve``.
        judge: Where an accuracy is asked for: what solves the first step, and looks at each that is kept.
    """

    problem: ContactProblem
    cycles: int
    coefficient: RealArray
    jump: Tolerance | None
    keep_every: int
    deepest: float | None
    tolerance: float
    judge: AccurateWear | None

    @cached_property
    def places(self) -> PairsAtOnePlace:
        """Pairs that wear level because they are at one place."""
        return PairsAtOnePlace(self.problem, self.coefficient)

    def begin(self) -> WearState:
        """The first state: the joint as it is given.

        Raises:
            NotConverged, UnheldBody: It has no solution.
        """
        depth = np.zeros(self.problem.model.pairs) if self.problem.wear is None else np.array(self.problem.wear)
        if self.judge:
            first = self._level(self.judge.begin(depth))
        else:
            solution = solve(replace(self.problem, wear=depth), tolerance=self.tolerance)
            first = self._take(0, depth, solution)
        return WearState(first, None, self.jump.first if self.jump else 1, 1, 0, (first,), None)

    def go_on(self, state: WearState) -> Iterator[WearState]:
        """The states after a state, one a step, to the end."""
        while not self.is_done(state):
            state = self.advance(state)
            yield state

    def is_done(self, state: WearState) -> bool:
        """Whether no step follows on a state."""
        return state.stopped is not None or state.latest.cycle >= self.cycles

    def advance(self, state: WearState) -> WearState:
        """The state one cycle or jump later, or why there is none."""
        here, limit, decay = state.latest, np.inf, None
        if not np.any(here.rate):  # nor will it wear later on
            return self._keep(state, replace(here, cycle=self.cycles))
        if self.jump or here.cycle % CHECK_EVERY == 0:
            decay = find_wear_stiffness(here.solution, self.coefficient)
            limit = find_explicit_limit(decay)
        if limit < 1 and not (self.jump and self.jump.damped):
            return self._stop(
                state,
                f"one cycle wears more than contact can follow (stable up to {limit:.2g} cycles): the two time scales "
                f"are one here; {REMEDY}",
            )
        solves, length, growth = 0, 1, GROWTH
        if self.jump:
            cap = np.inf if self.jump.damped else SAFETY * limit
            length = int(max(1, min(state.jump, cap, self.cycles - here.cycle, self._reach(here))))
        while True:
            solves += 1
            try:
                if length == 1 and limit >= 1:
                    found, room = [self._solve(here, state.earlier, here.depth + here.rate, 1, fallbacks=True)], np.inf
                    break
                trial, worn, room = self._try_jump(state, length, decay)
                if room >= 1 or length == 1:
                    solves += 1
                    found = [trial, self._solve(trial, None, np.maximum(worn, here.depth), 0, fallbacks=length == 1)]
                    break
                length = max(1, int(min(0.5, SAFETY * np.sqrt(room)) * length))
            except (NotConverged, UnheldBody) as failure:
                if length == 1:
                    unheld = isinstance(failure, UnheldBody)
                    why = f"the joint no longer carries its load: {failure}" if unheld else str(failure)
                    return self._stop(replace(state, solves=state.solves + solves), why)
                length, growth = max(1, length // 4), 1.0
        following = 1
        if self.jump:
            free = min(growth, SAFETY * np.sqrt(room))
            following = max(1, int(free * length), length + 1 if free > 1 else 1)
        rough = state.rough + int(room < 1)
        state = replace(state, jump=following, solves=state.solves + solves, rough=rough)
        return self._keep(_add_leap(state, found), found[-1])

    def _try_jump(self, state: WearState, length: int, decay: RealArray) -> tuple[WearStep, RealArray, float]:
        """The step after a jump of first order, the depth of second order ``(K_c,)`` [m], and the room there is.

        Room is the error that is allowed over the one that was made. Where it is less than one, the depth is that of
        the linearly implicit Euler rule, for a single cycle: what the pair wears too deep would stay so.
        """
        here, one = state.latest, np.eye(len(decay))
        taken = (_find_share_shown(state, decay) if self.jump.damped else 0.0) * length * decay
        damping = one + GAMMA * taken
        first = np.linalg.solve(damping, here.rate)
        depth = np.maximum(here.depth + length * first, 0.0)
        trial = self._solve(here, state.earlier, depth, length, fallbacks=length == 1)
        second = np.linalg.solve(damping, trial.rate - 2 * first)
        # what a wrong stiffness does to the second order, which the pair does not see once damping is strong
        missed = np.linalg.solve(damping, GAMMA**2 * taken @ (trial.rate - here.rate + taken @ first))
        error = length * float(max(0.5 * np.abs(first + second).max(), np.abs(missed).max()))
        allowed = self._allowed(here, trial, decay)
        if error > allowed:
            return trial, here.depth + np.linalg.solve(one + decay, here.rate), allowed / error
        # the sum over so many cycles, which is half a cycle's change less than the integral
        change = np.linalg.solve(damping, np.linalg.solve(damping, trial.rate - here.rate))
        worn = here.depth + length * (1.5 * first + 0.5 * second) - 0.5 * change
        return trial, worn, allowed / error if error else np.inf

    def _keep(self, state: WearState, ahead: WearStep) -> WearState:
        """The state with one more step, which is among those kept where it is its turn."""
        here = state.latest
        deep = self.deepest is not None and ahead.depth.max() > self.deepest
        kept = deep or ahead.cycle - state.steps[-1].cycle >= self.keep_every or ahead.cycle == self.cycles
        if kept and self.judge:
            state, ahead = self._look_at(state, ahead)
        earlier = here if ahead.solution.orders == here.solution.orders else None  # nothing to extrapolate from
        state = replace(state, latest=ahead, earlier=earlier, steps=(*state.steps, ahead) if kept else state.steps)
        if not deep:
            return state
        pair = int(ahead.depth.argmax())
        return self._stop(state, f"pair {pair} has worn {ahead.depth[pair]:.3g} m deep, more than {self.deepest:g} m")

    def _look_at(self, state: WearState, step: WearStep) -> tuple[WearState, WearStep]:
        looked = self._level(self.judge.look_at(step))
        return state if looked.solution is step.solution else _add_leap(state, [looked]), looked

    def _stop(self, state: WearState, why: str) -> WearState:
        if state.steps[-1].cycle != state.latest.cycle:  # it was not its turn
            state, last = self._look_at(state, state.latest) if self.judge else (state, state.latest)
            state = replace(state, latest=last, steps=(*state.steps, last))
        return replace(state, stopped=f"after {state.latest.cycle} cycles: {why}")

    def _reach(self, here: WearStep) -> float:
        """Cycles after which the first pair is deeper than allowed, at the rate of this one."""
        if self.deepest is None:
            return np.inf
        wears = here.rate > 0
        left = (self.deepest - here.depth[wears]) / here.rate[wears]
        return np.floor(left.min(initial=np.inf)) + 1

    def _allowed(self, here: WearStep, trial: WearStep, decay: RealArray) -> float:
        part = np.sqrt((trial.cycle - here.cycle) / self.cycles)
        if self.jump.depth is not None:
            return part * self.jump.depth
        # where neighbours that do not wear take over the load, far less than the step before the jump foresees
        return part * self.jump.share * min(self._foresee_deepest(step, decay) for step in (here, trial))

    def _foresee_deepest(self, step: WearStep, decay: RealArray) -> float:
        left = self.cycles - step.cycle
        further = np.linalg.solve(np.eye(len(decay)) + left * decay, left * step.rate)  # it evens out on the way
        return float((step.depth + further).max())

    def _solve(
        self, latest: WearStep, earlier: WearStep | None, depth: RealArray, length: int, *, fallbacks: bool
    ) -> WearStep:
        """The step so many cycles later with a worn depth; without ``fallbacks`` a shorter jump is the remedy."""
        depth = self.places.level(depth)
        problem = replace(latest.solution.problem, wear=depth)
        ratio = length / (latest.cycle - earlier.cycle) if earlier else 0.0
        before = earlier.solution if earlier else None
        solution = solve_from(problem, latest.solution, before, ratio, self.tolerance)
        if not solution.converged:
            if not fallbacks:
                raise NotConverged(f"no solution near that before the jump: {solution.reason}", best=solution)
            solution = solve(problem, latest.solution, self.tolerance)
        return self._take(latest.cycle + length, depth, solution)

    def _take(self, cycle: int, depth: RealArray, solution: PeriodicSolution) -> WearStep:
        return self._level(WearStep(cycle, depth, measure_wear_rate(solution, self.coefficient), solution))

    def _level(self, step: WearStep) -> WearStep:
        """The step with a rate that keeps pairs at one place level."""
        return replace(step, rate=self.places.level_rate(step.depth, step.rate))


def _find_share_shown(state: WearState, decay: RealArray) -> float:
    """The part of the wear stiffness to damp the next jump with: as much as the change of rate over the last one shows.

    Where pairs flap, those that are ever closed are far stiffer together than those that are closed at a time.
    """
    here, before = state.latest, state.earlier
    foreseen = np.abs(decay @ (here.depth - before.depth)).max() if before else 0.0
    return min(1.0, AMPLE * float(np.abs(here.rate - before.rate).max() / foreseen)) if foreseen > 0 else 1.0


def _add_leap(state: WearState, found: list[WearStep]) -> WearState:
    """The state, that knows where a fallback found the next steps."""
    fallbacks = [way for step in found for way in step.solution.fallbacks[-1:]]
    if not fallbacks:
        return state
    here, change = state.latest, measure_gap(state.latest.solution, found[-1].solution)
    return replace(state, leaps=(*state.leaps, Leap(here.cycle, fallbacks[0].partition(":")[0], change)))
