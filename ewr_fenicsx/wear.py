"""``evolve_wear``: fretting wear over many cycles, on two time scales.

Within a cycle the gap is constant; after it, the gap of each pair has grown by Archard's law. Every cycle is solved, or
the slow time is crossed in jumps: an embedded pair of orders one and two measures the error of a jump and chooses the
next. Explicit jumps are Euler's and Heun's, and stay below the limit of stability that contact stiffness sets. Damped
jumps know that stiffness and have no limit: the pair of Verwer, which is Euler's and Heun's where the stiffness is
zero. A jump of one cycle is the cycle itself, so that jumps tend to the every-cycle run.

Source: Verwer et al. (1999), doi:10.1137/S1064827597326651, for ROS2, of order two with any Jacobian.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from inspect import signature
from pathlib import Path

import numpy as np

from ewr_fenicsx.accuracy import check_accuracy, solve_to_accuracy
from ewr_fenicsx.archard import find_explicit_limit, find_wear_stiffness, measure_wear_rate
from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.contact_problem import ContactProblem, check_problem
from ewr_fenicsx.errors import ModelError, NotConverged, UnheldBody, nearest
from ewr_fenicsx.following import solve_from
from ewr_fenicsx.given import is_positive, is_whole
from ewr_fenicsx.law_kinds import spread_over_pairs
from ewr_fenicsx.newton import solve
from ewr_fenicsx.progress import count_progress
from ewr_fenicsx.reduced_model import ComplexArray, RealArray
from ewr_fenicsx.solution import PeriodicSolution
from ewr_fenicsx.solution_store import fingerprint, gather_output, list_orders
from ewr_fenicsx.wear_accuracy import AccurateWear
from ewr_fenicsx.wear_store import WearFile, WearState, WearStep
from ewr_fenicsx.whole_files import check_place, write_table

SAFETY = 0.9  # of the jump that the error or the limit of stability would allow
GROWTH = 4.0  # of one jump over the one before, at most
CHECK_EVERY = 20  # cycles between checks that a cycle is below the limit, where each is solved
DEPTH_OF_ROUNDING = 1e-6  # of the depth to which the load presses contact in: wear below it is none
GAMMA = 1 - 1 / np.sqrt(2)  # of ROS2: damps the fastest parts of the wear completely


@dataclass(frozen=True)
class Tolerance:
    """Error control of cycle jumps: how far the worn depth may be off at the end.

    A jump over a fraction f of all cycles may be off by sqrt(f) times this, as estimated by the first-order member of
    the pair. Such errors may add up to more than the tolerance, but the second-order member, which is the one kept, is
    off by far less.

    Args:
        depth: Largest error [m]; None: ``share`` says it.
        share: Largest error where ``depth`` is None, over the deepest wear that is expected at the end.
        first: The first jump to try [cycles].
        damped: Whether jumps are damped, and so stable at any length; else they are explicit, and kept below the limit
            of stability.

    Raises:
        ModelError: A tolerance or jump that is not positive.
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
class WearHistory:
    """What a joint wears.

    Attributes:
        problem: The problem at the start: unworn, or worn by its ``wear``.
        coefficient: ``(K_c,)`` wear coefficients [1/Pa].
        steps: What was kept: cycle, worn depth, depth worn by the next cycle, solution.
        solves: Periodic solves that it took.
        stopped: Why wear was not followed to the last cycle; None where it was.
        accuracy: What was asked for of the solutions; None: harmonics and samples were given.
    """

    problem: ContactProblem
    coefficient: RealArray
    steps: tuple[WearStep, ...]
    solves: int
    stopped: str | None
    accuracy: float | None = None

    @cached_property
    def cycles(self) -> np.ndarray:
        """``(steps,)`` cycles done."""
        return np.array([step.cycle for step in self.steps])

    @cached_property
    def depth(self) -> RealArray:
        """``(steps, K_c)`` worn depth, that of a joint worn from the start included [m]."""
        return np.array([step.depth for step in self.steps])

    @property
    def gap(self) -> RealArray:
        """``(steps, K_c)`` initial gap plus worn depth, as the step was solved with it [m]."""
        return np.array([step.solution.problem.clearance for step in self.steps])

    @property
    def rate(self) -> RealArray:
        """``(steps, K_c)`` depth that the next cycle wears [m]."""
        return np.array([step.rate for step in self.steps])

    @property
    def volume(self) -> RealArray:
        """``(steps, K_c)`` worn volume of each pair, depth by tributary area [m^3]."""
        return self.depth * self.problem.model.pair_area

    @property
    def total_volume(self) -> RealArray:
        """``(steps,)`` worn volume of the joint [m^3]."""
        return self.volume.sum(axis=1)

    @property
    def solutions(self) -> tuple[PeriodicSolution, ...]:
        """The periodic solution at every step."""
        return tuple(step.solution for step in self.steps)

    @property
    def estimates(self) -> RealArray:
        """``(steps,)`` estimated errors of the solutions; NaN without an accuracy."""
        return np.array([step.estimate for step in self.steps])

    @cached_property
    def orders(self) -> tuple[int, ...]:
        """Harmonics that any of the solutions has, ``n_h`` of them."""
        return list_orders(self.solutions)

    def output(self, name: str) -> ComplexArray:
        """One-sided complex amplitudes ``(steps, n_h)`` of a named output of the model at ``orders``."""
        return gather_output(self.solutions, name, self.orders)

    def figure(self, name: str) -> RealArray:
        """``(steps,)`` a figure of merit of every solution, such as ``"J_T"``, ``"J_N"`` or ``"rms_tip"``."""
        return np.array([s.merit[name] for s in self.solutions])

    def table(self) -> dict[str, RealArray]:
        """Column -> ``(steps,)``: cycles, worn depth and volume, sliding, separation and outputs."""
        columns = {
            "cycles": self.cycles,
            "deepest [m]": self.depth.max(axis=1),
            "mean depth [m]": self.total_volume / self.problem.model.pair_area.sum(),
            "volume [m^3]": self.total_volume,
        }
        figures = [name for name in self.solutions[0].merit if name.startswith(("J_", "rms_"))]
        columns |= {name: self.figure(name) for name in figures}
        if self.accuracy is not None:
            columns["estimate"] = self.estimates
            columns["highest_harmonic"] = np.array([s.orders[-1] for s in self.solutions])
        return columns

    def write_csv(self, path: str | Path) -> None:
        """Write ``table`` as CSV, a row a step."""
        write_table(path, self.table())


def evolve_wear(
    problem: ContactProblem,
    cycles: int = 3000,
    coefficient: float | RealArray = 1e-11,
    jump: Tolerance | None = None,
    *,
    keep_every: int = 1,
    deepest: float | None = None,
    file: str | Path | None = None,
    checkpoint_every: int = 100,
    tolerance: float = 1e-8,
    accuracy: float | None = None,
    progress: bool = False,
    **choice: object,
) -> WearHistory:
    """Wear of a joint over many vibration cycles.

    Args:
        problem: The unworn joint (or a worn one: its ``wear`` is where the depth starts).
        cycles: Number of cycles to follow.
        coefficient: Wear coefficient ``k_w`` [1/Pa], scalar or ``(K_c,)``; zero where a pair does not wear.
        jump: Error control of jumps over many cycles at once; None: every cycle is solved.
        keep_every: Steps are kept at least so many cycles apart; the first and last always are.
        deepest: Stop where some pair has worn deeper than this [m].
        file: HDF5 file of the history, from which an interrupted run goes on. The same run unbroken or resumed, however
            often and wherever it was killed, leaves the same file, byte for byte. None: nothing is written.
        checkpoint_every: Solves between two updates of ``file``, which is also written on an interruption.
        tolerance: As in ``solve``.
        accuracy: As in ``solve_to_accuracy``: harmonics, samples and weights are chosen for the unworn joint, looked at
            again at every step that is kept, and raised where they no longer do. None: those of the problem.
        progress: Whether to show how many cycles are done and how long the rest will take.
        choice: Further arguments of ``solve_to_accuracy``, where an accuracy is asked for.

    Returns:
        Cycles, worn depths and solutions at the steps that are kept.

    Raises:
        ModelError: No pair can wear, or a number makes no sense; or more modes in a run that is to be resumed.
        NotConverged, UnheldBody: The unworn joint has no solution. A worn one that has none ends the history.
        OutputError: ``file`` cannot be written, which is looked at first; or holds another run, or none.
    """
    check_problem(problem)
    model = problem.model
    rates = spread_over_pairs(coefficient, np.arange(model.pairs), model.pairs, "wear coefficient")
    if not np.all(rates >= 0) or not np.all(np.isfinite(rates)):
        raise ModelError(
            f"wear coefficient {coefficient}; give one >= 0 in 1/Pa, or one for each of {model.pairs} pairs"
        )
    if not all(is_whole(count, 1) for count in (cycles, keep_every, checkpoint_every)):
        raise ModelError(
            f"cycles = {cycles!r}, keep_every = {keep_every!r}, checkpoint_every = {checkpoint_every!r}; give whole "
            "numbers from 1"
        )
    cycles, keep_every = int(cycles), int(keep_every)
    if not (deepest is None or is_positive(deepest)):
        raise ModelError(f"deepest = {deepest}; give a positive depth [m], or None")
    if not (jump is None or isinstance(jump, Tolerance)):
        raise ModelError(f"jump = {jump!r}; give Tolerance(share=0.01) or the like, or None to solve every cycle")
    if accuracy is not None:
        check_accuracy(accuracy)
    if problem.frequency == 0:
        raise ModelError("no pair can wear: frequency = 0 Hz, so that nothing slides; give the frequency of the cycles")
    rates[~problem.opens] = 0.0  # no gap that could grow
    if not np.any(rates > 0):
        raise ModelError('no pair can wear: it takes normal = "unilateral" and a positive wear coefficient')
    if model.tangents == 0:
        raise ModelError("no pair can wear: the model has no tangential rows, so that nothing slides")
    store = None
    if file is not None:
        if choice.get("more_modes"):
            raise ModelError(
                "file: a resumed run would not know of more_modes; raise the modes before, or give no file"
            )
        stated = fingerprint(problem, cycles, rates, jump, keep_every, deepest, tolerance, accuracy, choice)
        store = WearFile(Path(file), stated, problem)
    state = store.read() if store else None
    if choice and accuracy is None:
        for name in choice.keys() - signature(solve_to_accuracy).parameters.keys():
            raise ModelError(f"{name}: no argument of evolve_wear{nearest(name, signature(evolve_wear).parameters)}")
        raise ModelError(
            f"{', '.join(choice)}: only where an accuracy is asked for; give accuracy=... or leave them out"
        )
    judge = None if accuracy is None else AccurateWear(problem, rates, accuracy, tolerance, choice)
    run = _Run(problem, cycles, rates, jump, keep_every, deepest, tolerance, judge)
    if store and (state is None or not run.is_done(state)):
        check_place(store.path)
    state = state or run.begin()
    saved = state if store else None
    try:
        with count_progress("wear", cycles, progress) as report:
            for state in run.go_on(state):  # noqa: B020
                report(state.latest.cycle)
                if store and state.solves - saved.solves >= checkpoint_every:
                    store.write(state)
                    saved = state
    finally:
        if store and state is not saved:
            store.write(state)
    return WearHistory(problem, rates, state.steps, state.solves, state.stopped, accuracy)


@dataclass(frozen=True, eq=False)
class _Run:
    """One wear calculation; ``go_on`` yields its state after every step, from which it can go on."""

    problem: ContactProblem
    cycles: int
    coefficient: RealArray
    jump: Tolerance | None
    keep_every: int
    deepest: float | None
    tolerance: float
    judge: AccurateWear | None = None

    def begin(self) -> WearState:
        depth = np.zeros(self.problem.model.pairs) if self.problem.wear is None else np.array(self.problem.wear)
        if self.judge:
            first = self.judge.begin(depth)
        else:
            solution = solve(replace(self.problem, wear=depth), tolerance=self.tolerance)
            first = WearStep(0, depth, measure_wear_rate(solution, self.coefficient), solution)
        return WearState(first, None, self.jump.first if self.jump else 1, 1, (first,), None)

    def go_on(self, state: WearState) -> Iterator[WearState]:
        while not self.is_done(state):
            state = self.advance(state)
            yield state

    def is_done(self, state: WearState) -> bool:
        return state.stopped is not None or state.latest.cycle >= self.cycles

    def advance(self, state: WearState) -> WearState:
        """The state one cycle or jump later, or why there is none."""
        here = state.latest
        limit = np.inf
        if self.jump or here.cycle % CHECK_EVERY == 0:
            decay = find_wear_stiffness(here.solution, self.coefficient)
            limit = find_explicit_limit(decay)
        if limit < 1 and not (self.jump and self.jump.damped):
            return self._stop(
                state,
                f"one cycle wears more than contact can follow (stable up to {limit:.2g} cycles): the two time scales "
                "are one here; lower the wear coefficient, or let wear pass as a flow: Tolerance(damped=True)",
            )
        solves, error, allowed, length = 0, 0.0, np.inf, 1
        if self.jump:
            cap = np.inf if self.jump.damped else SAFETY * limit
            length = int(max(1, min(state.jump, cap, self.cycles - here.cycle)))
        while True:
            try:
                if length == 1 and limit >= 1:
                    ahead, error = self._solve(here, state.earlier, here.depth + here.rate, 1), 0.0
                    solves += 1
                    break
                damping = np.eye(len(decay)) + (GAMMA if self.jump.damped else 0.0) * length * decay
                first = np.linalg.solve(damping, here.rate)
                trial = self._solve(here, state.earlier, np.maximum(here.depth + length * first, 0.0), length)
                solves += 1
                second = np.linalg.solve(damping, trial.rate - 2 * first)
                error = 0.5 * length * float(np.abs(first + second).max())
                allowed = self._allowed(here, length, decay)
                if error <= allowed:
                    # the sum over so many cycles, which is half a cycle's change less than the integral
                    change = np.linalg.solve(damping, np.linalg.solve(damping, trial.rate - here.rate))
                    worn = here.depth + length * (1.5 * first + 0.5 * second) - 0.5 * change
                elif length > 1:
                    length = max(1, int(min(0.5, SAFETY * np.sqrt(allowed / error)) * length))
                    continue
                else:  # a cycle that is too long for the pair of orders: what is worn too deep would stay so
                    worn = here.depth + np.linalg.solve(np.eye(len(decay)) + decay, here.rate)
                ahead = self._solve(trial, None, np.maximum(worn, here.depth), 0)
                ahead = replace(ahead, cycle=here.cycle + length)
                solves += 1
                break
            except (NotConverged, UnheldBody) as failure:
                solves += 1
                if length == 1:
                    state = replace(state, solves=state.solves + solves)
                    unheld = isinstance(failure, UnheldBody)
                    why = f"the joint no longer carries its load: {failure}" if unheld else str(failure)
                    return self._stop(state, why)
                length = max(1, length // 4)
        following = 1
        if self.jump:
            free = GROWTH if error == 0 else min(GROWTH, SAFETY * np.sqrt(allowed / error))
            following = max(1, int(free * length), length + 1 if free > 1 else 1)
        kept = ahead.cycle - state.steps[-1].cycle >= self.keep_every or ahead.cycle == self.cycles
        if kept and self.judge:
            ahead = self.judge.look_at(ahead)
        earlier = here if ahead.solution.orders == here.solution.orders else None  # nothing to extrapolate from
        done = replace(state, latest=ahead, earlier=earlier, jump=following, solves=state.solves + solves)
        if self.deepest is not None and ahead.depth.max() > self.deepest:
            pair = int(ahead.depth.argmax())
            return self._stop(
                done, f"pair {pair} has worn {ahead.depth[pair]:.3g} m deep, more than {self.deepest:g} m"
            )
        if kept:
            done = replace(done, steps=(*state.steps, ahead))
        return done

    def _stop(self, state: WearState, why: str) -> WearState:
        steps = state.steps if state.steps[-1].cycle == state.latest.cycle else (*state.steps, state.latest)
        return replace(state, steps=steps, stopped=f"after {state.latest.cycle} cycles: {why}")

    def _allowed(self, here: WearStep, length: int, decay: RealArray) -> float:
        part = np.sqrt(length / self.cycles)
        if self.jump.depth is not None:
            return part * self.jump.depth
        left = self.cycles - here.cycle
        further = np.linalg.solve(np.eye(len(decay)) + left * decay, left * here.rate)  # it evens out on the way
        expected = float((here.depth + further).max())
        return part * self.jump.share * max(expected, DEPTH_OF_ROUNDING * self._press_in())

    def _press_in(self) -> float:
        """How far the mean load presses contact in, about: the depth by which wear makes a difference [m]."""
        system = self.problem.system
        rows = system.row_of("normal", np.flatnonzero(self.problem.opens))
        mean = np.abs(HarmonicBalance(system).full_stick[0][0, rows].real) if system.basis.has_mean else 0.0
        return float(np.max(mean * system.flexibility[rows]))

    def _solve(self, latest: WearStep, earlier: WearStep | None, depth: RealArray, length: int) -> WearStep:
        problem = replace(latest.solution.problem, wear=depth)
        ratio = length / (latest.cycle - earlier.cycle) if earlier else 0.0
        before = earlier.solution if earlier else None
        solution = solve_from(problem, latest.solution, before, ratio, self.tolerance)
        if not solution.converged:
            solution = solve(problem, start=latest.solution, tolerance=self.tolerance)
        return WearStep(latest.cycle + length, depth, measure_wear_rate(solution, self.coefficient), solution)
