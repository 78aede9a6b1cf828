"""Wear to an accuracy: harmonics, samples and weights chosen for the fresh joint, and again where it has changed.

What is asked of the outputs is asked of the wear rate as well, which may take far more harmonics: where most pairs
stick, the outputs hardly know of those that slide. Where it has all but died out, its error counts by what it adds to
the depth over all cycles. Where nothing wears, that may be for want of harmonics: few of them see pairs stick at
once where they land. What the truncated force would wear of what passes by, which more of them take away, is then
judged in its place.
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
from ewr_fenicsx.wear.archard import SAMPLES, measure_wear_rate, weigh_wear_rate
from ewr_fenicsx.wear.wear_store import TriedModels, WearStep


class AccurateWear:
    """Judges the solutions of a wear calculation, and solves again where one is not as accurate as asked.

    Args:
        problem: The unworn problem; weights that it gives are kept.
        cycles: Number of cycles to follow.
        coefficient: ``(K_c,)`` wear coefficients [1/Pa].
        accuracy, tolerance: As in ``solve_to_accuracy``.
        choice: Further arguments of ``solve_to_accuracy``: what limits modes, highest harmonic.
        models: The joint's models with their modes.
    """

    def __init__(
        self,
        problem: ContactProblem,
        cycles: int,
        coefficient: RealArray,
        accuracy: float,
        tolerance: float,
        choice: Mapping[str, object],
        models: TriedModels,
    ):
        self.problem, self.coefficient, self.accuracy, self.tolerance = problem, coefficient, accuracy, tolerance
        self.cycles, self.choice, self.models = cycles, choice, models

    def begin(self, depth: RealArray) -> WearStep:
        """The first step, with as many harmonics as it takes.

        Raises:
            NotConverged: The joint has no solution.
        """
        found = self._solve(replace(self.problem, wear=depth), None, None)
        return self._take(WearStep(0, depth, depth, found.solution), found)

    def look_at(self, step: WearStep) -> WearStep:
        """A step with its estimated error; where that exceeds the accuracy, with the solution of one that does not.

        Where nothing more accurate is found, the step stays as it is, and its estimate says so.
        """
        modes = self.models.modes_of(step.solution.problem.model)
        estimate = estimate_errors(step.solution, modes, self._judged_rate).total
        if estimate <= self.accuracy:
            return replace(step, estimate=estimate)
        posed = adopt_weights(step.solution.problem, self.problem)
        try:
            found = self._solve(posed, step.solution, step.solution.orders[-1])
        except NotConverged:
            return replace(step, estimate=estimate)
        if found.estimate.total >= estimate:
            return replace(step, estimate=estimate)
        return self._take(step, found)

    def _rate(self, solution: PeriodicSolution) -> RealArray:
        return measure_wear_rate(solution, self.coefficient)

    def _judged_rate(self, solution: PeriodicSolution) -> RealArray:
        """The wear rate; where there is none, that by the truncated force, which presses on what passes by as well."""
        pace = float((solution.problem.clearance - self.problem.clearance).max()) / self.cycles
        judged = weigh_wear_rate(solution, self.coefficient, pace)
        if np.any(judged[:-1]):
            return judged
        force, period = np.maximum(0.0, solution.history("normal_force", SAMPLES)), 1 / solution.problem.frequency
        passed = np.mean(force / solution.problem.model.areas * solution.sliding_speed(SAMPLES), axis=0)
        judged[:-1] = self.coefficient * period * passed
        return judged

    def _solve(self, problem: ContactProblem, start: PeriodicSolution | None, first: int | None) -> AccurateSolution:
        models, depth = self.models, problem.wear

        def keep_more(count: int) -> tuple[ContactProblem, Sequence[int]]:
            unworn, modes = models.keep_more(count)
            return replace(unworn, wear=depth), modes

        return solve_to_accuracy(
            problem,
            self.accuracy,
            start,
            self.tolerance,
            first=first,
            figure=self._judged_rate,
            modes=models.modes_of(problem.model),
            more_modes=keep_more if models.more else None,
            **self.choice,
        )

    def _take(self, step: WearStep, found: AccurateSolution) -> WearStep:
        return replace(step, rate=self._rate(found.solution), solution=found.solution, estimate=found.estimate.total)
