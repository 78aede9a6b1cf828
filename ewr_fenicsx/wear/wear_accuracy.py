"""Wear to an accuracy: harmonics, samples and weights chosen for the fresh joint, and again where it has changed.

What is asked of the outputs is asked of the wear rate as well, which may take far more harmonics: where most pairs
stick, the outputs hardly know of those that slide. Where nothing wears, that may be for want of harmonics: few of them
see pairs stick at once where they land. What the truncated force would wear of what passes by, which more of them take
away, is then judged in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ewr_fenicsx.accuracy.accuracy import AccurateSolution, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import estimate_errors
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.weights import adopt_weights
from ewr_fenicsx.wear.archard import SAMPLES, measure_wear_rate
from ewr_fenicsx.wear.wear_store import WearStep


class AccurateWear:
    """Judges the solutions of a wear calculation, and solves again where one is not as accurate as asked.

    Args:
        problem: The unworn problem; weights that it gives are kept.
        coefficient: ``(K_c,)`` wear coefficients [1/Pa].
        accuracy, tolerance: As in ``solve_to_accuracy``.
        choice: Further arguments of ``solve_to_accuracy``: modes, what limits them, highest harmonic.
    """

    def __init__(
        self,
        problem: ContactProblem,
        coefficient: RealArray,
        accuracy: float,
        tolerance: float,
        choice: Mapping[str, object],
    ):
        self.problem, self.coefficient, self.accuracy, self.tolerance = problem, coefficient, accuracy, tolerance
        self.choice = dict(choice)

    def begin(self, depth: RealArray) -> WearStep:
        """The first step, with as many harmonics as it takes.

        Raises:
            NotConverged: The joint has no solution.
        """
        found, modes = self._solve(replace(self.problem, wear=depth), None, None)
        return self._take(WearStep(0, depth, depth, found.solution), found, modes)

    def look_at(self, step: WearStep) -> WearStep:
        """A step with its estimated error; where that exceeds the accuracy, with the solution of one that does not.

        Where nothing more accurate is found, the step stays as it is, and its estimate says so.
        """
        estimate = estimate_errors(step.solution, self.choice.get("modes", ()), self._judged_rate).total
        if estimate <= self.accuracy:
            return replace(step, estimate=estimate)
        posed = adopt_weights(step.solution.problem, self.problem)
        try:
            found, modes = self._solve(posed, step.solution, step.solution.orders[-1])
        except NotConverged:
            return replace(step, estimate=estimate)
        if found.estimate.total >= estimate:
            return replace(step, estimate=estimate)
        return self._take(step, found, modes)

    def _rate(self, solution: PeriodicSolution) -> RealArray:
        return measure_wear_rate(solution, self.coefficient)

    def _judged_rate(self, solution: PeriodicSolution) -> RealArray:
        """The wear rate; where there is none, that by the truncated force, which presses on what passes by as well."""
        rate = self._rate(solution)
        if np.any(rate):
            return rate
        force, period = np.maximum(0.0, solution.history("normal_force", SAMPLES)), 1 / solution.problem.frequency
        passed = np.mean(force / solution.problem.model.areas * solution.sliding_speed(SAMPLES), axis=0)
        return self.coefficient * period * passed

    def _solve(
        self, problem: ContactProblem, start: PeriodicSolution | None, first: int | None
    ) -> tuple[AccurateSolution, Sequence[int]]:
        """What was found, and which coordinates of its model are modal: on models tried with more there may be none."""
        choice, depth = dict(self.choice), problem.wear
        modes_of = {problem.model: choice.get("modes", ())}
        if more := choice.get("more_modes"):

            def keep_more(count: int) -> tuple[ContactProblem, Sequence[int]]:
                unworn, modes = more(count)
                modes_of[unworn.model] = modes
                return replace(unworn, wear=depth), modes

            choice["more_modes"] = keep_more
        found = solve_to_accuracy(
            problem, self.accuracy, start, self.tolerance, first=first, figure=self._judged_rate, **choice
        )
        return found, modes_of[found.solution.problem.model]

    def _take(self, step: WearStep, found: AccurateSolution, modes: Sequence[int]) -> WearStep:
        self.choice["modes"] = modes
        return replace(step, rate=self._rate(found.solution), solution=found.solution, estimate=found.estimate.total)
