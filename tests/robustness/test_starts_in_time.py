"""Starts from time stepping: Newton's path from afar, and more harmonics than asked for."""

from __future__ import annotations

from dataclasses import replace

import hard_cases
import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.model.receptance import hit_undamped_mode
from ewr_fenicsx.solver import ladder, newton


@pytest.mark.parametrize(
    "case",
    [
        hard_cases.Case("dovetail", 1 / 3, ("reached", 3.0), 0.05, 3, 0.02, "closed", (1, 1)),  # where Newton stalls
        hard_cases.Case("lap joint", 0.95, ("reached", 1.0), 1.5, 3, 1e-3, "random", (1, 1)),  # from a start itself
    ],
    ids=lambda case: case.model,
)
def test_from_time_stepping_a_path_arrives_where_newton_stalls(case, monkeypatch):
    """Rungs that take hundreds of steps had to find these; a path is longer than next to a solution, but on its way."""
    problem = hard_cases.pose_case(case)
    balance = HarmonicBalance(problem.system)
    begin = (newton.step_coarsely(problem), balance, 1e-8, "elimination", newton.begin_at_full_stick(balance))
    found = newton.start_from_time_stepping(*begin)
    assert found.converged and np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8
    monkeypatch.setattr(newton, "follow_from_afar", lambda *_: None)
    stalled = newton.start_from_time_stepping(*begin)
    assert not stalled.converged and stalled.iterations < found.iterations <= stalled.iterations + 15


def test_a_solution_with_more_harmonics_leads_to_one_with_fewer(monkeypatch):
    """A flank bounces: time stepping leads to no solution with nine harmonics, but in most cases to one with eighteen.

    How it bounces hangs on rounding, and so does whether the motion stepped is one of the fourth that lead nowhere.
    """
    case = hard_cases.Case("blade root", 0.7, ("reached", 1.0), 0.6, 9, 0.02, "half open", (1, 1))
    posed, rung, step = hard_cases.pose_case(case), "more harmonics, then fewer", newton.step_coarsely
    for load in (1.0, 1.0 - 1e-8, 1.0 + 1e-6, 1.0 + 1e-8):
        problem, stepped = replace(posed, model=hard_cases.shake(posed.model, load)), []
        balance = HarmonicBalance(problem.system)
        monkeypatch.setattr(newton, "step_coarsely", lambda posed, into=stepped: into.append(posed) or step(posed))
        begin = ladder.begin_at_full_stick(balance)
        ways = dict(newton.list_rungs(problem, balance, None, 1e-8, "elimination"))
        assert not ways["time stepping"](begin).converged
        found = ways[rung](begin)
        if found.converged:
            break
    assert found.converged and np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8
    assert stepped == [problem], "both rungs go by the same motion"
    monkeypatch.setattr(newton, "LARGEST_FEW", balance.size - 1)
    assert rung not in dict(newton.list_rungs(problem, balance, None, 1e-8, "elimination"))
    monkeypatch.undo()
    many = replace(problem, harmonics=1 + newton.HIGHEST_FEW)
    assert rung not in dict(newton.list_rungs(many, HarmonicBalance(many.system), None, 1e-8, "elimination"))


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({0: 1.0}, "with more harmonics: 200 Hz hits an undamped mode exactly"),
        ({0: 1.0, 150: 0.2}, "steps = 256 cannot resolve harmonic 150"),
    ],
)
def test_where_more_harmonics_make_no_problem_the_ladder_goes_on(given, why, monkeypatch):
    """It raised: of what was not asked for a mode may be hit, and time stepping may refuse what is given."""

    def hit(*_) -> None:
        raise hit_undamped_mode(2 * np.pi * 200.0)

    model = ReducedModel(
        mass=[[1.0]], damping=[[1.0]], stiffness=[[1e6]], tangential=[[1.0]], load={1: [1.0]}, outputs={"mass": [1.0]}
    )
    laws = ContactLaws(normal="prescribed", normal_force=given, friction=0.3)
    problem = ContactProblem(model, laws, 50.0, (0, 1, 2), samples=512, closure="dashpot")
    for way in ("start_cold", "grow_load"):
        monkeypatch.setattr(newton, way, lambda balance, *_, **__: newton.begin_at_full_stick(balance))
    monkeypatch.setattr(newton, "start_from_time_stepping", lambda *given: replace(given[-1], iterations=0))
    monkeypatch.setattr(newton, "add_harmonics", hit)
    solution = solve(problem, raise_on_failure=False)
    rung = next(told for told in solution.fallbacks if told.startswith("more harmonics, then fewer"))
    assert why in rung and solution.converged and solution.fallbacks[-1] != rung


def test_at_rest_there_is_no_period_to_step():
    case = hard_cases.Case("lap joint", 0.95, ("reached", 1.0), 1.5, 3, 1e-3, "closed", (1, 1))
    shaken = hard_cases.pose_case(case)
    still = replace(shaken.model, load={0: shaken.loads[0]})
    for problem in (shaken, replace(shaken, model=still, load=None, frequency=0.0, harmonics=0)):
        rungs = dict(newton.list_rungs(problem, HarmonicBalance(problem.system), None, 1e-8, "elimination"))
        assert ("time stepping" in rungs) == bool(problem.frequency)
