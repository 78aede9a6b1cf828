"""The cheapest solve that is accurate enough: starts cheap, raises the knob whose error dominates, and goes on."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np

from ewr_fenicsx.accuracy.estimates import (
    CLEAR,
    FIRST_ORDER,
    ErrorEstimate,
    Figure,
    choose_harmonics,
    estimate_modes,
    estimate_samples,
    estimate_together,
    estimate_weight,
    find_rate,
    measure_distance,
)
from ewr_fenicsx.accuracy.levels import GROWTH, Knobs, solve_first, solve_next
from ewr_fenicsx.accuracy.modes_left_out import ModesBesideResponses
from ewr_fenicsx.errors import ModelError, NotConverged
from ewr_fenicsx.given import is_whole, read_numbers
from ewr_fenicsx.problem.contact_problem import ContactProblem, check_problem
from ewr_fenicsx.solution.loading_history import find_missed_mean
from ewr_fenicsx.solution.solution import PeriodicSolution

LOG = logging.getLogger(__name__)  # INFO: each level, as it is done

# Accuracy that the first few harmonics hardly ever meet, and what a solve begins with there: the level is spared.
FINE, FINE_ORDER = 0.02, 5
GROWTH_OF_MANY, MANY = (1.3, 1.6), 1000  # from so many unknowns on: a far start costs more steps than it saves
MOST_HARMONICS = 63  # of the lowest harmonic with a load
MOST_SAMPLES = 512  # a highest harmonic
MODES_GROWTH = 2  # of their number, where the modes left out matter most
MOST_MODES = 240
IDLE = 0.02  # share of the accuracy asked for that does not matter, in forces of harmonics and in errors by samples

# Remedies: for limits that the caller sets, and where no solution is found
MORE = "allow more, or ask for less"
OWN = "ask for less, or solve with harmonics of your own, which takes every fallback"
MoreModes = Callable[[int], tuple[ContactProblem, Sequence[int]]]


@dataclass(frozen=True)
class Level:
    """One solve on the way to an accuracy: what was chosen, what came out, and what it took."""

    orders: tuple[int, ...]
    samples: int
    unknowns: int
    estimate: ErrorEstimate
    steps: int
    seconds: float
    modes: int = 0

    @classmethod
    def of(cls, found: PeriodicSolution, estimate: ErrorEstimate, modes: int) -> Level:
        """The level at which a solution was found, with so many modes."""
        basis = found.problem.basis
        return cls(basis.orders, basis.samples, found.unknowns, estimate, found.iterations, found.seconds, modes)


@dataclass(frozen=True, eq=False)
class AccurateSolution:
    """A periodic solution and how accurate it is thought to be.

    Attributes:
        solution: The solution.
        estimate: Its estimated errors.
        accuracy: What was asked for.
        reached: Whether the estimate meets it.
        limit: What kept it from that; "" where nothing did.
        levels: The solves that led there.
        seconds: Wall time of everything.
        remedy: What can be done where there is a limit.
    """

    solution: PeriodicSolution
    estimate: ErrorEstimate
    accuracy: float
    reached: bool
    limit: str
    levels: tuple[Level, ...] = field(repr=False)
    seconds: float
    remedy: str = MORE

    @property
    def told_sliding(self) -> str:
        """What is to be said of the sliding, and what to do; "" where it is no further off than all else."""
        told = self.estimate.told_sliding
        return f"{told}: ask for a smaller accuracy where that matters" if told else ""

    def summary(self) -> str:
        """A few lines for people."""
        found, orders = self.estimate, self.solution.orders
        closures, count = " and ".join(self.solution.problem.system.closures), len(self.levels)
        closed = f" closed by {closures}" if closures else ""
        lines = [
            f"estimated error {found.total:.1g} of {self.accuracy:g} asked ({found.shares}), {len(orders)} harmonics "
            f"up to {orders[-1]}{closed}, {self.solution.problem.basis.samples} samples, "
            f"{count} solve{'s' * (count != 1)}, {self.seconds:.2f} s"
        ]
        modes = [level.modes for level in self.levels]
        if modes and modes[-1] > modes[0]:
            lines.append(f"  modes raised from {modes[0]} to {modes[-1]}")
        if self.limit:
            lines.append(f"  NOT as accurate as asked: {self.limit}; {self.remedy}")
        if self.told_sliding:
            lines.append(f"  {self.told_sliding}")
        return "\n".join([*lines, self.solution.summary()])


def solve_to_accuracy(
    problem: ContactProblem,
    accuracy: float,
    start: PeriodicSolution | None = None,
    tolerance: float = 1e-8,
    *,
    first: int | None = None,
    highest: int | None = None,
    most_unknowns: int = 8000,
    modes: Sequence[int] = (),
    more_modes: MoreModes | None = None,
    most_modes: int = MOST_MODES,
    figure: Figure | None = None,
) -> AccurateSolution:
    """Periodic solution whose outputs are as accurate as asked, with an estimate of their error.

    Starts with few harmonics and samples, estimates the error and raises what dominates it (harmonics, samples or
    modes), each solve started at the one before. Harmonics whose contact forces do not matter are left out on the way.
    Masses that rub by themselves close the truncation of Coulomb's law, and above harmonic 3 springs do where joints
    are elastic, as long as they find a solution, or dashpots lead to one.
    Only the first solve, and the first with more modes, take the whole ladder: where more harmonics lead nowhere
    without (in small joints time stepping is tried), a larger set is tried once, and where it fails as well, what was
    found before stays.

    Args:
        problem: The problem; its own harmonics (which must hold its loads) and samples are not used; a weight
            ``rho_tangential`` or springs that it gives are kept.
        accuracy: Largest relative error of the outputs' oscillation over a period.
        start: A solution on the same model, of a neighbouring problem, or None.
        tolerance: Largest residual norm of each solve.
        first: Highest harmonic of the first solve, unless loads need more; None: 3, or 5 for accuracies below 2 %.
        highest: Highest harmonic that may be used; None: 63 times the lowest that is loaded, or twice the highest.
        most_unknowns: Unknowns a solve may have.
        modes: Which coordinates of the model are modal, by rising frequency, so that the error by the modes left out
            can be estimated; as ``ModesBesideResponses`` where it has the static responses to its loads besides, which
            make that error small. Empty: it is not looked at.
        more_modes: Number of modes -> the problem on a model that keeps so many, with the same pairs, and which of its
            coordinates they are. None: modes that are too few are a limit.
        most_modes: Modes that ``more_modes`` may be asked for.
        figure: Function of a solution whose values are to be as accurate as the outputs, by the largest error over the
            largest value; None: nothing besides the outputs.

    Returns:
        The last solution. ``reached`` and ``limit`` say whether the accuracy was reached, and if not, why.

    Raises:
        ModelError: The accuracy is not between 0 and 1; a limit is no whole number from 1, or below a load's harmonic;
            ``modes`` are no coordinates of the model; ``figure`` is no function.
        NotConverged: Not even the first solve found a solution.
    """
    check_accuracy(accuracy)
    check_problem(problem)
    modes = read_modes(modes, problem.model.size)
    driven = [h for h in problem.driven if h]
    if highest is None:
        highest = max(MOST_HARMONICS * min(driven, default=1), 2 * max(driven, default=1))
    if first is None:
        first = FIRST_ORDER if accuracy >= FINE else FINE_ORDER
    for name, count in (("first", first), ("highest", highest), ("most_unknowns", most_unknowns)):
        if not is_whole(count, 1):
            raise ModelError(f"{name} = {count!r}; give a whole number from 1")
    if not (figure is None or callable(figure)):
        raise ModelError(f"figure = {figure!r}; give a function of a solution that returns an array, or None")
    begin = time.perf_counter()
    if max(driven, default=0) > highest:
        raise ModelError(f"highest = {highest}; loads act at harmonic {max(driven)}: allow at least that")
    top = min(int(highest), max([int(first), *(2 * h for h in driven if h > 1)]))
    knobs, levels = Knobs(top), []
    tried: tuple[str, ...] = ()  # fallbacks of the solves before: what was found by them starts all that follow
    solution, estimate, limit, remedy = start, None, "", MORE
    while not limit:
        if not levels:
            found, knobs = solve_first(problem, knobs, solution, tolerance)
        else:
            again = len(modes) == levels[-1].modes
            most = bound_order(levels[-1], int(highest), most_unknowns)
            try:
                found, knobs = solve_next(problem, knobs, solution, tolerance, most, again=again)
            except NotConverged as error:
                limit, remedy = str(error), OWN
        if not limit:
            tried += tuple(f"harmonics up to {knobs.top}: {rung}" for rung in found.fallbacks)
            before, solution = solution if levels else None, replace(found, fallbacks=tried)
            estimate = judge(solution, before, levels, modes, accuracy, figure)
            levels.append(Level.of(solution, estimate, len(modes)))
            LOG.info("harmonics up to %d: estimated error %.1g of %g asked", knobs.top, estimate.total, accuracy)
            if estimate.total <= accuracy:
                break
            if estimate.dominating != "modes":
                knobs, limit = raise_knobs(knobs, solution, levels, accuracy, int(highest), most_unknowns)
        known = levels[-1].modes == len(modes)  # else what was found knows less than more modes did, that led nowhere
        if limit and known and estimate.harmonics + np.nan_to_num(estimate.samples) > accuracy:  # others need not wait
            others = estimate_weight(solution, figure), estimate_modes(solution, modes, figure)
            estimate = ErrorEstimate(estimate.harmonics, estimate.samples, *others, estimate.sliding)
        if known and estimate.dominating == "modes":
            limit, remedy = f"the {len(modes)} modes of the reduced model leave an error of {estimate.modes:.1g}", MORE
            if more_modes and len(modes) < most_modes:
                (problem, modes), limit = more_modes(raise_modes(len(modes), most_modes)), ""
    broken = solution.list_broken_symmetry()  # what it left out is in no estimate
    if broken:
        limit, remedy = broken[0], "give the law odd = False"
    seconds, reached = time.perf_counter() - begin, estimate.total <= accuracy and not broken
    return AccurateSolution(solution, estimate, accuracy, reached, limit, tuple(levels), seconds, remedy)


def check_accuracy(accuracy: float) -> None:
    """Refuses what is no accuracy.

    Raises:
        ModelError: Not a number between 0 and 1.
    """
    if not (isinstance(accuracy, Real) and 0 < accuracy < 1):
        raise ModelError(f"accuracy = {accuracy!r}; give a relative error between 0 and 1, such as 0.01")


def read_modes(modes: Sequence[int], size: int) -> tuple[int, ...]:
    """Which of a model's ``size`` coordinates are modal.

    Raises:
        ModelError: Something else than a list of its coordinates, each once.
    """
    listed = read_numbers("modes", modes)
    if listed.ndim != 1 or len(set(listed)) < listed.size or not all(is_whole(m) and m < size for m in listed):
        raise ModelError(f"modes = {modes!r}; list the modal coordinates, each once, from 0 to {size - 1}")
    if isinstance(modes, ModesBesideResponses):
        return modes
    return tuple(int(m) for m in listed)


def judge(
    solution: PeriodicSolution,
    before: PeriodicSolution | None,
    levels: Sequence[Level],
    modes: Sequence[int],
    accuracy: float,
    figure: Figure | None,
) -> ErrorEstimate:
    """Estimated errors of a solution; the change from the one before counts as well where it tells of larger ones.

    Where that change tells of more than the accuracy, no Newton step with more harmonics is needed to know. (Springs
    leave far less than the change that they brought, which tells nothing of their error.) A last set cut short by a
    limit has few new harmonics, which tell little of those to come: its change counts as after the least growth.
    Harmonics and samples are looked at together. Where they are above the accuracy they are raised whatever the other
    errors are: those wait. Where they are far below it, the weight need not be looked at, unless mean friction is set
    to zero that would not be: it then shows whatever the harmonics. Where more harmonics than at the level before have
    not halved them, the samples are looked at by themselves, unless they did not matter at a level before: there are as
    many a harmonic.
    """
    error, samples, sliding = 0.0, np.nan, np.nan
    moved = 0.0 if before is None else measure_distance(before, solution, figure)
    closures = {s.problem.system.closures for s in (before, solution) if s is not None}
    closed_alike = before is not None and closures in ({()}, {("masses",)})
    if closed_alike and (growth := solution.orders[-1] / max(1, before.orders[-1])) > 1:
        error = moved / (max(growth, GROWTH[0]) ** find_rate(solution.problem) - 1)
    if error <= accuracy:
        seen, sliding = estimate_together(solution, accuracy, figure, moved)
        error = max(error, seen)
    known = [level.estimate.samples for level in levels if level.estimate.samples < IDLE * accuracy]
    if before is not None and not known and max(accuracy, levels[-1].estimate.total / 2) < error < np.inf:
        samples = min(estimate_samples(solution, figure), error)
    if error > accuracy:
        return ErrorEstimate(error - np.nan_to_num(samples), samples, sliding=sliding)
    shows = CLEAR * error >= accuracy or find_missed_mean(solution)
    weight = estimate_weight(solution, figure) if shows else np.nan
    error_of_modes = estimate_modes(solution, modes, figure)
    return ErrorEstimate(error, np.nan, weight, error_of_modes, sliding)


def raise_modes(count: int, most: int) -> int:
    """Number of modes to keep where ``count`` leave out too much."""
    return min(MODES_GROWTH * count, most)


def raise_knobs(
    knobs: Knobs,
    solution: PeriodicSolution,
    levels: Sequence[Level],
    accuracy: float,
    highest: int,
    most_unknowns: int,
) -> tuple[Knobs, str]:
    """Samples or harmonics raised after a solution, whichever dominate its error; and what limit they hit, if any."""
    estimate = levels[-1].estimate
    if estimate.dominating == "samples":
        still = f"{levels[-1].samples} samples a period still leave an error of {estimate.samples:.1g}"
        density = 2 * knobs.density
        return replace(knobs, density=density), still if density > MOST_SAMPLES else ""
    wanted = next_order(levels, accuracy, find_rate(solution.problem))
    most = bound_order(levels[-1], highest, most_unknowns)
    top = min(max(wanted, knobs.top + 2), most)  # symmetry may make the next one zero
    if top <= knobs.top:
        hit = f"harmonic {highest} is the highest allowed"
        full = f"more harmonics than {knobs.top} take more than {most_unknowns} unknowns"
        return knobs, hit if knobs.top >= highest else full
    needed = {*choose_harmonics(solution, IDLE * accuracy), *solution.left_out}
    return replace(knobs, top=top, dropped=knobs.dropped | set(solution.orders) - needed), ""


def bound_order(level: Level, highest: int, most_unknowns: int) -> int:
    """Highest harmonic of a solve after this one that has ``most_unknowns`` at most, as far as ``highest``."""
    room = (most_unknowns - level.unknowns) * (len(level.orders) - 0.5) / max(1, level.unknowns)
    return min(highest, level.orders[-1] + int(room))


def next_order(levels: Sequence[Level], accuracy: float, rate: float) -> int:
    """Highest harmonic of the next solve, by the ``rate`` at which errors fall."""
    here = levels[-1]
    goal = max(0.8 * accuracy - np.nan_to_num(here.estimate.samples), 0.3 * accuracy)
    wanted = (here.estimate.truncation / goal) ** (1 / rate)
    low, high = GROWTH if here.unknowns < MANY else GROWTH_OF_MANY
    return int(np.ceil(max(1, here.orders[-1]) * min(max(wanted, low), high)))
