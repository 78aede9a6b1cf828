"""Where a motion in time starts: from rest, from full stick, from a periodic solution or from a state."""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.errors import ModelError, UnheldBody
from ewr_fenicsx.given import read_numbers
from ewr_fenicsx.in_time.time_stepping import State
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.at_rest import find_rest

_STARTS = 'give "rest", None (full stick), a PeriodicSolution or a State'


def choose_start(problem: ContactProblem, start: PeriodicSolution | State | str | None) -> State:
    """State at ``tau = 0`` that ``start`` stands for; see ``integrate``.

    Raises:
        ModelError: An unknown word, no rest was found, or a state of another size than the model's; or contact forces
            do not see a motion of a floating body, and the start is no state.
        UnheldBody: The start is no state, and contact cannot hold a floating body under its mean load.
    """
    if isinstance(start, State):
        state = start
    elif start is None or isinstance(start, str):
        if start not in (None, "rest"):
            raise ModelError(f'start = "{start}"; {_STARTS}')
        try:
            problem.system  # noqa: B018
        except (ModelError, UnheldBody) as error:
            error.args = (f"{error}; integrate steps it all the same from a State",)
            raise
        moves = bool(np.any(problem.clearance)) or is_held_by_friction(problem)
        at_rest = find_rest(problem)[0] if moves else None
        if start == "rest" and moves and not at_rest:
            raise ModelError(f'start = "rest": no static solution of the laws was found; {_STARTS}')
        found = at_rest or find_full_stick(problem)
        if at_rest or start == "rest":
            has_mean = found.problem.basis.has_mean  # without it nothing acts on average
            position = found.coordinates[0].real if has_mean else np.zeros(problem.model.size)
            state = State(position, np.zeros(problem.model.size))
        else:
            state = State.of(problem, found.coordinates)
    elif isinstance(start, PeriodicSolution):
        state = State.of(start.problem, start.coordinates)
    else:
        raise ModelError(f"start is of type {type(start).__name__}; {_STARTS}")
    read = {name: read_numbers(f"start: {name}", getattr(state, name)) for name in ("position", "velocity")}
    for name, value in read.items():
        if value.shape != (problem.model.size,) or not np.isfinite(value).all():
            raise ModelError(f"start: {name} has shape {value.shape}; expected {problem.model.size} finite coordinates")
    return State(**read)


def is_held_by_friction(problem: ContactProblem) -> bool:
    """Whether friction holds pairs against the mean load from the start: no more of it than its limits allow."""
    return any(law.static_target is not None and law.opposes == "velocity" for law in problem.system.laws)


def find_full_stick(problem: ContactProblem) -> PeriodicMotion:
    """The linear periodic motion in which no pair opens or slips."""
    forces, rigid = np.zeros((len(problem.basis.orders), 0), dtype=complex), np.zeros(0)
    if problem.system.rows.shape[0]:
        forces, rigid = HarmonicBalance(problem.system).full_stick
    return PeriodicMotion(problem, forces, rigid)
