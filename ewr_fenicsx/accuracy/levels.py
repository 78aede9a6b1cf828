"""One level on the way to an accuracy: its knobs, the problem that they pose, and how it is solved.

Masses that rub by themselves close the truncation of Coulomb's law, and above harmonic 3 springs do where joints are
elastic, as long as they find a solution, or dashpots lead to one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ewr_fenicsx.accuracy.estimates import FIRST_ORDER
from ewr_fenicsx.accuracy.looking_ahead import choose_samples
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.dashpots import replace_masses, use_mobility
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solution.symmetry import leave_out_idle
from ewr_fenicsx.solver.newton import solve
from ewr_fenicsx.solver.weights import use_default_weights

SAMPLES, MORE_SAMPLES = 8, 32  # a highest harmonic, to begin with, and where the first level finds nothing
GROWTH = (1.3, 2.5)  # of the highest harmonic from one level to the next
SMALL = 500  # unknowns, up to which some periods of time stepping take no longer than the solves that failed


@dataclass(frozen=True)
class Knobs:
    """What is chosen at a level.

    Attributes:
        top: Highest harmonic.
        density: Samples a highest harmonic.
        dropped: Harmonics that are left out, for their contact forces do not matter.
        springs: Whether springs may close the truncation.
    """

    top: int
    density: float = SAMPLES
    dropped: frozenset[int] = frozenset()
    springs: bool = True

    @property
    def samples(self) -> int:
        """Samples a period."""
        return choose_samples(self.top, self.density)


def pose_level(problem: ContactProblem, knobs: Knobs, start: PeriodicSolution | None) -> ContactProblem:
    """The problem with the knobs' harmonics and samples, weights and closure to match."""
    posed = replace(problem, harmonics=knobs.top, samples=knobs.samples)
    if knobs.dropped:  # a list keeps harmonics that are zero by symmetry
        needed = leave_out_idle(posed, start).basis.orders
        posed = replace(posed, harmonics=tuple(h for h in needed if h not in knobs.dropped))
    if problem.rho_tangential is not None or problem.has_springs or not problem.frequency:
        return posed
    if not knobs.springs:
        return use_mobility(replace_masses(posed))
    few, weighted = knobs.top <= FIRST_ORDER, use_mobility(posed)
    if few and not posed.system.closures:  # no masses
        return weighted
    closed = replace(weighted, closure="spring")
    closures = closed.system.closures
    return weighted if not closures or (few and "springs" in closures) else closed


def solve_first(
    problem: ContactProblem, knobs: Knobs, start: PeriodicSolution | None, tolerance: float
) -> tuple[PeriodicSolution, Knobs]:
    """The first level, as ``solve_level``; where nothing is found with more samples, which may be what it takes."""
    try:
        return solve_level(problem, knobs, start, tolerance, again=False)
    except NotConverged:
        more = replace(knobs, density=MORE_SAMPLES * knobs.samples / (knobs.density * max(1, knobs.top)))
    return solve_level(problem, more, start, tolerance, again=False)


def solve_next(
    problem: ContactProblem, knobs: Knobs, before: PeriodicSolution, tolerance: float, most: int, *, again: bool
) -> tuple[PeriodicSolution, Knobs]:
    """A further level, as ``solve_level``; where nothing is found with a larger set, with harmonics up to ``most``.

    A single set may be in the way, with any closure.
    """
    larger = replace(knobs, top=min(int(np.ceil(GROWTH[0] * knobs.top)), most), springs=True)
    sets = [knobs] if larger.top <= knobs.top else [knobs, larger]
    for tried in sets:
        try:
            return solve_level(problem, tried, before, tolerance, again=again)
        except NotConverged as error:
            lost = error
    named = " or ".join(str(tried.top) for tried in sets)
    raise NotConverged(f"no solution found with harmonics up to {named}: {lost.best.reason}", best=lost.best)


def solve_level(
    problem: ContactProblem, knobs: Knobs, start: PeriodicSolution | None, tolerance: float, *, again: bool
) -> tuple[PeriodicSolution, Knobs]:
    """Solve the problem that the knobs pose.

    Args:
        problem: The problem; a weight ``rho_tangential`` or springs that it gives are kept.
        knobs: The knobs.
        start: The solution of the level before, or one to start the first level from.
        tolerance: Of the residual.
        again: Whether there is a level before, with the same model: the ladder is not taken then.

    Returns:
        The solution, and the knobs without springs where these led to nothing: they are not tried again.

    Raises:
        NotConverged: No solution was found, whatever closes the truncation.
    """

    def run(posed: ContactProblem, *, sturdy: bool) -> PeriodicSolution:
        if again:
            return go_on(posed, start, tolerance, cold=sturdy)
        return solve(posed, start, tolerance, fallbacks=sturdy)

    closed = pose_level(problem, knobs, start)
    if problem.has_springs or not closed.has_springs:
        return run(closed, sturdy=True), knobs
    try:
        return run(closed, sturdy=False), knobs
    except NotConverged:  # dashpots are sturdier, and may lead there
        sturdy = run(pose_level(problem, replace(knobs, springs=False), start), sturdy=True)
    found = leave_dashpots(sturdy, closed, tolerance)
    return found, replace(knobs, springs=found.problem is closed or "springs" not in closed.system.closures)


def leave_dashpots(found: PeriodicSolution, closed: ContactProblem, tolerance: float) -> PeriodicSolution:
    """The solution with springs and masses from that with dashpots, or the latter where nothing leads there."""
    try:
        closer = best = solve(closed, found, tolerance, fallbacks=False)
    except NotConverged as error:
        closer, best = error.best, found
    iterations, seconds = found.iterations + closer.iterations, found.seconds + closer.seconds
    return replace(best, fallbacks=found.fallbacks, iterations=iterations, seconds=seconds)


def go_on(posed: ContactProblem, before: PeriodicSolution, tolerance: float, *, cold: bool) -> PeriodicSolution:
    """A solve from the solution with fewer harmonics; where that fails, from ``cold``, as next to a fold.

    The ladder beyond is long, and hardly ever leads further there; the default weights may, and in small joints the
    first rung from these.

    Raises:
        NotConverged: No solution was found.
    """
    usual = use_default_weights(posed)
    ways = [("given start", posed, before)]
    if cold:
        ways.append(("cold start", posed, None))
    if cold and usual is not posed:
        ways.append(("default weights", usual, None))
    tried, steps, small = [], 0, False
    for name, problem, start in ways:
        try:
            found = solve(problem, start, tolerance, fallbacks=1 if small and problem is usual else False)
        except NotConverged as error:
            lost, small = error, error.best.unknowns <= SMALL
            tried.append(f"{name}: {lost.best.reason}")
            steps += lost.best.iterations
        else:
            tried += [f"{name}: {rung}" for rung in found.fallbacks or [found.reason]]
            told = tuple(tried) if len(tried) > 1 else ()
            return replace(found, fallbacks=told, iterations=steps + found.iterations)
    raise lost
