"""``solve`` as users call it: with the harmonics that a problem gives, or with those that an accuracy takes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from reprlib import repr as shorten

import numpy as np

from ewr_fenicsx.accuracy.accuracy import MORE, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import Figure, estimate_at_once
from ewr_fenicsx.errors import EwrError, ModelError, NotConverged
from ewr_fenicsx.given import is_whole
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver import newton
from ewr_fenicsx.solver.snes import LinearSolver

REMEDY = "solve(problem, accuracy=0.01) takes as many harmonics as that needs"


def solve(
    problem: ContactProblem,
    start: PeriodicSolution | None = None,
    tolerance: float = 1e-8,
    *,
    accuracy: float | None = None,
    linear_solver: LinearSolver = "elimination",
    fallbacks: bool | int = True,
    raise_on_failure: bool = True,
) -> PeriodicSolution:
    """Periodic solution of a contact problem.

    Args:
        problem: The problem.
        start: A solution on the same model to start from (another frequency, friction or set of harmonics), or None.
        tolerance: Largest residual norm accepted, relative to the norm of the full-stick contact forces, or of what
            they are where gaps stay open and nothing resonates, times three, if that is less; from 1e-13 to 1e-3.
        accuracy: Largest relative error of the outputs that is asked for: harmonics, samples and weights are then
            chosen, not the problem's own (``solve_to_accuracy`` says how, and returns more). None: the problem's.
        linear_solver: ``"elimination"`` solves for the rows that change status; ``"dense"`` forms the whole Jacobian
            and leaves it to PETSc's KSP. Both take the same steps.
        fallbacks: Whether to go through the ladder where the first attempt fails (``newton.solve`` lists its rungs), or
            how many further rungs to take.
        raise_on_failure: Whether to raise where no solution is found, or return the best iterate.

    Returns:
        The solution: motions, contact forces and figures of merit, and how it was found; its summary estimates its
        error. With an accuracy, its ``estimated_error``, and in ``short`` and its summary why it is not as accurate as
        asked, where it is not.

    Raises:
        ModelError: An argument makes no sense, or is not for an accuracy.
        NotConverged: No solution was found; carries the best iterate and the rungs tried.
    """
    if isinstance(fallbacks, np.bool_):
        fallbacks = bool(fallbacks)
    if not is_whole(fallbacks):
        raise ModelError(
            f"fallbacks = {shorten(fallbacks)}; give True for all further rungs, False for none, or how many, from 0"
        )
    if accuracy is None:
        solution = newton.solve(
            problem,
            start,
            tolerance,
            linear_solver=linear_solver,
            fallbacks=fallbacks if fallbacks is True else int(fallbacks),
            raise_on_failure=raise_on_failure,
        )
        return replace(solution, tell_error=tell_error)
    if linear_solver != "elimination" or fallbacks is not True:
        raise ModelError(
            "linear_solver and fallbacks: an accuracy, which takes several solves, chooses them; leave them out"
        )
    try:
        found = solve_to_accuracy(problem, accuracy, start, tolerance)
    except NotConverged as error:
        if raise_on_failure:
            raise
        return error.best
    remedy = "ask for less, or allow more in solve_to_accuracy" if found.remedy == MORE else found.remedy
    short = f"{found.limit}; {remedy}" if found.limit else ""
    told = partial(recall, found.told_sliding)
    return replace(found.solution, estimated_error=found.estimate.total, short=short, tell_error=told)


def recall(told: str, _: PeriodicSolution) -> str:
    """What was known of a solution's error when it was found."""
    return told


def tell_error(solution: PeriodicSolution, what: str = "", remedy: str = REMEDY, figure: Figure | None = None) -> str:
    """How far off a solution is thought to be that no accuracy was asked of, for people; "" where nothing is left out.

    What its reduced model lacks, modes and mesh, is not in it.

    Args:
        solution: Converged.
        what, remedy: As ``ErrorEstimate.tell`` has them; "": the outputs, or where there are none the pairs.
        figure: What is looked at beside the outputs, as in ``estimate_errors``.
    """
    if not solution.problem.frequency or not solution.unknowns:
        return ""
    try:
        estimate = estimate_at_once(solution, figure=figure)
    except (EwrError, MemoryError) as error:  # the solution is there, and not to be lost for it
        return f"its error is not known: {str(error) or 'out of memory'}"
    seen = "the outputs" if solution.problem.model.outputs else "motions and forces at the pairs"
    return estimate.tell(what or seen, remedy)
