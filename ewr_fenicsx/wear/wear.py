"""``evolve_wear``: fretting wear over many cycles, on two time scales.

Within a cycle the gap is constant; after it, the gap of each pair has grown by Archard's law (``archard.py``). How the
slow time is crossed, cycle by cycle or in jumps, says ``cycle_jumps.py``.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from inspect import signature
from pathlib import Path

import numpy as np

from ewr_fenicsx.accuracy.accuracy import check_accuracy, solve_to_accuracy
from ewr_fenicsx.accuracy.solving import tell_error
from ewr_fenicsx.errors import ModelError, list_few, nearest
from ewr_fenicsx.given import RealArray, is_positive, is_whole
from ewr_fenicsx.laws.law_kinds import spread_over_pairs
from ewr_fenicsx.problem.contact_problem import ContactProblem, check_problem
from ewr_fenicsx.progress import count_progress
from ewr_fenicsx.response.solution_store import fingerprint
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solution.solution_series import SolutionSeries
from ewr_fenicsx.wear.archard import weigh_wear_rate
from ewr_fenicsx.wear.cycle_jumps import LOWER, Tolerance, WearRun
from ewr_fenicsx.wear.wear_accuracy import AccurateWear
from ewr_fenicsx.wear.wear_store import Leap, TriedModels, WearFile, WearStep
from ewr_fenicsx.whole_files import check_place, write_table

MOST = 10**12  # cycles, as in a scene: more do not fit where they are counted
WORTH = 10.0  # seconds of work that are worth a new version of the file


@dataclass(frozen=True, eq=False, repr=False)
class WearHistory(SolutionSeries):
    """What a joint wears.

    Attributes:
        problem: The problem at the start: unworn, or worn by its ``wear``.
        coefficient: ``(K_c,)`` wear coefficients [1/Pa].
        steps: What was kept: cycle, worn depth, depth worn by the next cycle, solution.
        solves: Periodic solves that it took.
        stopped: Why wear was not followed to the last cycle; None where it was.
        accuracy: What was asked for of the solutions; None: harmonics and samples were given.
        rough: Cycles that each wore more than contact can follow, and so are further off than ``jump`` allows.
        leaps: Where no solution was found near the last one but by a fallback, which may be another motion.
    """

    problem: ContactProblem
    coefficient: RealArray
    steps: tuple[WearStep, ...]
    solves: int
    stopped: str | None
    accuracy: float | None = None
    rough: int = 0
    leaps: tuple[Leap, ...] = ()

    def __repr__(self) -> str:
        told = f"stopped {self.stopped}" if self.stopped else "to the last one"
        told += f"; NOT within the tolerance at {self.rough} cycles" if self.rough else ""
        told += f"; NOT as accurate as asked at {len(self.short)} of the steps" if len(self.short) else ""
        return f"WearHistory({len(self.steps)} steps to cycle {self.cycles[-1]} in {self.solves} solves, {told})"

    def summary(self) -> str:
        """A few lines for people: how deep it wore, and how far off what the last cycle wears is thought to be."""
        last, what = self.solutions[-1], "the outputs and the wear rate"
        lines = self.list_outcome()
        if self.accuracy is not None:
            lines.append(f"  estimated errors up to {np.nanmax(self.estimates):.1g} of {self.accuracy:g} asked")
        elif np.any(self.rate[-1]):
            remedy = "evolve_wear(..., accuracy=0.01) takes as many harmonics as that needs"
            pace = float((self.depth[-1] - self.depth[0]).max()) / max(1, self.cycles[-1])
            told = tell_error(last, what, remedy, lambda there: weigh_wear_rate(there, self.coefficient, pace))
            lines.append(f"  in the end {told}")
        return "\n".join(lines + [f"  in the end {line}" for line in last.list_reservations()])

    def list_outcome(self) -> list[str]:
        """How deep it wore, and what is to be said against that: a line each, for people."""
        lines = [
            f"{self.cycles[-1]} cycles in {self.solves} solves: deepest {1e6 * self.depth[-1].max():.3g} µm, "
            f"volume {1e9 * self.total_volume[-1]:.3g} mm^3"
        ]
        if self.short.size:
            lines.append(f"  NOT as accurate as asked at {list_few(self.short, 'steps')} cycles")
        if self.rough:
            lines.append(
                f"  NOT within the tolerance: each of {self.rough} cycles wore more than contact can follow, and their "
                f"depth is rough; {LOWER}"
            )
        if self.leaps:
            at, most = list_few([leap.cycle for leap in self.leaps], "steps"), max(leap.change for leap in self.leaps)
            ways = ", ".join(dict.fromkeys(leap.found_by for leap in self.leaps))
            lines.append(
                f"  after {at} cycles the motion led nowhere: wear goes on from a solution found otherwise ({ways}), "
                f"whose outputs differ by {'up to ' if len(self.leaps) > 1 else ''}{100 * most:.3g}%"
            )
        if self.loss_of_stability:
            stable, lost = self.loss_of_stability
            since = "from the first cycle on" if stable is None else f"after {lost} cycles, and not yet after {stable}"
            lines.append(f"  its motion is unstable {since}: depths from there on are by a motion that does not last")
        lines += [f"  stopped {self.stopped}"] if self.stopped else []
        if not np.any(self.rate[-1]):
            began = self.cycles[np.flatnonzero(~np.any(self.rate, axis=1))[0]]
            lines.append(f"  nothing wears from cycle {began} on: no pair that may wear slides while it is pressed")
            if self._passes_by:
                lines.append("  pairs slide while they are open; more harmonics may show that they rub as they land")
        return lines

    @property
    def _passes_by(self) -> bool:
        """Whether in the end pairs that may wear are pressed now, and slide then."""
        pressed, slides = (values.any(axis=0) for values in self.solutions[-1].press_and_slide())
        return bool(np.any(pressed & slides & (self.coefficient > 0)))

    @cached_property
    def loss_of_stability(self) -> tuple[int | None, int] | None:
        """Cycles of two steps in turn, the first of a stable and the second of an unstable solution.

        Looked for by halving, where the last solution is unstable; None: it is not. The first is None where the joint
        is unstable from the start.
        """
        solutions, stable, lost = self.solutions, -1, len(self.steps) - 1
        if not solutions[lost].unstable:
            return None
        while lost - stable > 1:
            middle = (stable + lost) // 2
            stable, lost = (stable, middle) if solutions[middle].unstable else (middle, lost)
        return None if stable < 0 else int(self.cycles[stable]), int(self.cycles[lost])

    @property
    def cycles(self) -> np.ndarray:
        """``(steps,)`` cycles done."""
        return np.array([step.cycle for step in self.steps])

    @property
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
        return self.depth * self.problem.model.areas

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

    @property
    def short(self) -> np.ndarray:
        """Cycles after which the solution is thought less accurate than asked, in turn; none without an accuracy."""
        return self.cycles[:0] if self.accuracy is None else self.cycles[self.estimates > self.accuracy]

    def table(self) -> dict[str, RealArray]:
        """Column -> ``(steps,)``: cycles, worn depth and volume, sliding, separation and outputs."""
        columns = {
            "cycles": self.cycles,
            "deepest [m]": self.depth.max(axis=1),
            "mean depth [m]": self.total_volume / self.problem.model.areas.sum(),
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
    progress: bool = True,
    **choice: object,
) -> WearHistory:
    """Wear of a joint over many vibration cycles; warns where the model has no ``pair_area``, for which ones stand in.

    Args:
        problem: The unworn joint (or a worn one: its ``wear`` is where the depth starts).
        cycles: Number of cycles to follow.
        coefficient: Wear coefficient ``k_w`` [1/Pa], scalar or ``(K_c,)``; zero where a pair does not wear. It counts
            for nothing at pairs that cannot part (bonded, or under a given normal force) or whose tangents are bonded.
        jump: Error control of jumps over many cycles at once, ``Tolerance()`` as a scene has it; None: every cycle is
            solved.
        keep_every: Steps are kept at least so many cycles apart; the first and last always are.
        deepest: Stop where some pair has worn deeper than this [m]; a jump goes no farther than about there.
        file: HDF5 file of the history, from which an interrupted run goes on. The same run unbroken or resumed, however
            often and wherever it was killed, leaves the same file, byte for byte. None: nothing is written.
        checkpoint_every: Solves between two updates of ``file`` at most, which is also written after some seconds of
            work, and on an interruption.
        tolerance: As in ``solve``.
        accuracy: As in ``solve_to_accuracy``: harmonics, samples and weights are chosen for the unworn joint, looked at
            again at every step that is kept, and raised where they no longer do. None: those of the problem.
        progress: Whether to show how many cycles are done and how long the rest will take.
        choice: Further arguments of ``solve_to_accuracy``, where an accuracy is asked for. Of a run that goes on from
            its ``file``, ``more_modes`` makes the same models again.

    Returns:
        Cycles, worn depths and solutions at the steps that are kept.

    Raises:
        ModelError: No pair can wear; or a number makes no sense.
        NotConverged, UnheldBody: The unworn joint has no solution. A worn one that has none ends the history.
        OutputError: ``file`` cannot be written, which is looked at first; or holds another run, or none.
    """
    check_problem(problem)
    if not (all(is_whole(count, 1) for count in (cycles, keep_every, checkpoint_every)) and cycles <= MOST):
        raise ModelError(
            f"cycles = {cycles!r}, keep_every = {keep_every!r}, checkpoint_every = {checkpoint_every!r}; give whole "
            f"numbers from 1, and up to {MOST:.0e} cycles"
        )
    cycles, keep_every = int(cycles), int(keep_every)
    rates = read_coefficient(problem, coefficient)
    if problem.model.pair_area is None:
        warnings.warn(
            "pair_area was not given: each pair is taken to have an area of 1 m^2, by which its pressure and its depth "
            "may be orders of magnitude too small; give ReducedModel(..., pair_area=...)",
            stacklevel=2,
        )
    if not (deepest is None or is_positive(deepest)):
        raise ModelError(f"deepest = {deepest}; give a positive depth [m], or None")
    if not (jump is None or isinstance(jump, Tolerance)):
        raise ModelError(f"jump = {jump!r}; give Tolerance(share=0.01) or the like, or None to solve every cycle")
    _check_choice(choice, accuracy)
    store, modes = None, choice.pop("modes", ())
    models = TriedModels(problem, modes, choice.pop("more_modes", None))
    if file is not None:
        stated = fingerprint(problem, cycles, rates, jump, keep_every, deepest, tolerance, accuracy, modes, choice)
        store = WearFile(Path(file), stated, models)
    state = store.read() if store else None
    judge = None if accuracy is None else AccurateWear(problem, cycles, rates, accuracy, tolerance, choice, models)
    run = WearRun(problem, cycles, rates, jump, keep_every, deepest, tolerance, judge)
    if store and (state is None or not run.is_done(state)):
        check_place(store.path)
    saved, since = state, time.monotonic()  # what the file holds, and since when
    state = state or run.begin()
    solves = state.solves
    try:
        with count_progress("wear", cycles, progress) as report:
            report(state.latest.cycle)
            for state in run.go_on(state):  # noqa: B020
                report(state.latest.cycle)
                due = time.monotonic() - since >= WORTH  # where solves are slow, fewer of them
                if store and (due or state.solves - solves >= checkpoint_every):
                    store.write(state)
                    saved, solves, since = state, state.solves, time.monotonic()
    finally:
        if store and state is not saved:
            store.write(state)
    return WearHistory(problem, rates, state.steps, state.solves, state.stopped, accuracy, state.rough, state.leaps)


def _check_choice(choice: Mapping[str, object], accuracy: float | None) -> None:
    """Checks the accuracy, and that further arguments are those of ``solve_to_accuracy`` that wear leaves open."""
    if accuracy is not None:
        check_accuracy(accuracy)
    keywords = [name for name, at in signature(solve_to_accuracy).parameters.items() if at.kind is at.KEYWORD_ONLY]
    free = set(keywords) - {"first", "figure"}  # wear chooses these by itself
    for name in choice.keys() - free:
        known = free | signature(evolve_wear).parameters.keys() - {"choice"}
        raise ModelError(f"{name}: no argument of evolve_wear{nearest(name, sorted(known))}")
    if choice and accuracy is None:
        raise ModelError(
            f"{', '.join(choice)}: only where an accuracy is asked for; give accuracy=... or leave them out"
        )


def read_coefficient(problem: ContactProblem, coefficient: float | RealArray) -> RealArray:
    """Wear coefficient of each pair, ``(K_c,)`` [1/Pa]; zero where no gap could grow, or bonds let nothing slide.

    Raises:
        ModelError: It is negative, above 1e100 or NaN, there are not as many as pairs, or no pair can wear.
    """
    model = problem.model
    rates = spread_over_pairs(coefficient, np.arange(model.pairs), model.pairs, "wear coefficient")
    if not np.all((rates >= 0) & (rates <= 1e100)):  # neither of which holds of NaN
        raise ModelError(
            f"wear coefficient {coefficient}; give one from 0 to 1e100 in 1/Pa, or one for each of {model.pairs} pairs"
        )
    if problem.frequency == 0:
        raise ModelError("no pair can wear: frequency = 0 Hz, so that nothing slides; give the frequency of the cycles")
    if model.tangents == 0:
        raise ModelError("no pair can wear: the model has no tangential rows, so that nothing slides")
    rates[~problem.opens] = 0.0
    for pairs, laws in problem.groups:
        if set(model.tangent_directions) <= set(laws.kinds[1].holds(model.tangents)):
            rates[pairs] = 0.0
    if not np.any(rates > 0):
        raise ModelError(
            'no pair can wear: it takes pairs that may part (normal = "unilateral") and slide (tangential = "coulomb" '
            'or "frictionless"), and a positive wear coefficient'
        )
    return rates
