"""An accuracy that springs reach, and what goes on where they find no solution."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.accuracy import FIRST_ORDER
from ewr_fenicsx.dashpots import use_mobility
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.estimates import measure_distance


def rub_behind_springs(harmonics=5, load=1.0, **settings) -> ContactProblem:
    """Two masses, each with a massless node that rubs behind a spring of its own."""
    stiffness = np.array([[7.0, -1.0, -5.0, 0.0], [-1.0, 6.0, 0.0, -4.0], [-5.0, 0.0, 5.2, 0.0], [0.0, -4.0, 0.0, 4.1]])
    mass = np.diag([1.0, 1.3, 1e-4, 1e-4])
    model = ReducedModel(
        mass=mass,
        damping=0.02 * mass + 0.005 * stiffness,
        stiffness=stiffness,
        tangential=np.eye(4)[2:],
        load={1: load * np.eye(4)[0]},
        outputs={"first": np.eye(4)[0], "second": np.eye(4)[1]},
    )
    laws = ContactLaws(normal="prescribed", normal_force=1.0, friction=[0.5, 0.2])
    return ContactProblem(model, laws, 0.22, harmonics, **settings)


@pytest.fixture(scope="module")
def truth_behind_springs():
    """With dashpots and with springs: both agree, so that either is right."""
    found = [
        solve(rub_behind_springs(highest, samples=20 * highest, closure=closure))
        for highest, closure in ((101, "dashpot"), (201, "spring"))
    ]
    assert measure_distance(*found) < 2e-4
    return found[1]


@pytest.mark.parametrize("accuracy", [0.01, 0.002])
def test_springs_close_the_truncation_where_joints_are_elastic(accuracy, truth_behind_springs):
    """From the second set of harmonics on, fewer of them do than with dashpots; the estimate is on the safe side."""
    found = solve_to_accuracy(rub_behind_springs(), accuracy)
    assert found.reached and found.solution.problem.system.closures == ("springs",)
    assert "closed by springs" in found.summary()
    true = measure_distance(found.solution, truth_behind_springs)
    assert 0 < true <= accuracy and true / 2 < found.estimate.total <= accuracy
    posed = rub_behind_springs()
    damped = solve_to_accuracy(use_mobility(posed), accuracy)
    assert not damped.solution.problem.has_springs
    assert found.solution.unknowns < damped.solution.unknowns


def test_where_springs_find_no_solution_dashpots_go_on(monkeypatch, truth_behind_springs):
    tried = []

    def refuse_springs(problem, start, tolerance, *, fallbacks):
        tried.append((problem.basis.orders[-1], problem.has_springs, fallbacks))
        found = solve(problem, start, tolerance)
        if problem.has_springs:
            raise NotConverged("as if", best=replace(found, reason="as if"))
        return found

    monkeypatch.setattr("ewr_fenicsx.accuracy.solve", refuse_springs)
    found = solve_to_accuracy(rub_behind_springs(), 0.003)
    assert found.reached and not found.solution.problem.has_springs and not found.solution.fallbacks
    assert measure_distance(found.solution, truth_behind_springs) <= 0.003
    (first, *_), (second, *_) = tried[0], tried[1]
    assert tried[:3] == [(first, False, True), (second, True, False), (second, False, False)], "one ladder at most"
    assert not any(springs for _, springs, _ in tried[3:])


def test_where_more_harmonics_find_no_solution_the_one_before_stays(monkeypatch):
    """The ladder from there is long and hardly ever leads further: what came in the way is said, and a remedy."""

    def refuse_many(problem, start, tolerance, *, fallbacks):
        found = solve(problem, start, tolerance)
        if problem.basis.orders[-1] > FIRST_ORDER:
            assert not fallbacks
            raise NotConverged("as if", best=replace(found, reason="as if"))
        return found

    monkeypatch.setattr("ewr_fenicsx.accuracy.solve", refuse_many)
    found = solve_to_accuracy(rub_behind_springs(), 0.003)
    assert not found.reached and found.solution.orders[-1] == FIRST_ORDER and len(found.levels) == 1
    assert re.match(r"no solution found with harmonics up to \d+ or \d+: as if", found.limit), "two sets are tried"
    assert "solve with harmonics of your own" in found.summary()


def test_a_set_of_harmonics_without_a_solution_is_passed_over(monkeypatch, truth_behind_springs):
    """Else a stricter accuracy, which goes by other sets, is reached where a looser one is not."""
    refused = []

    def refuse_one(problem, start, tolerance, *, fallbacks):
        found, top = solve(problem, start, tolerance), problem.basis.orders[-1]
        if top > FIRST_ORDER and refused in ([], [top] * len(refused)):
            refused.append(top)
            raise NotConverged("as if", best=replace(found, reason="as if"))
        return found

    monkeypatch.setattr("ewr_fenicsx.accuracy.solve", refuse_one)
    found = solve_to_accuracy(rub_behind_springs(), 0.003)
    assert found.reached and measure_distance(found.solution, truth_behind_springs) <= 0.003
    assert len(set(refused)) == 1 and found.levels[1].orders[-1] > refused[0]
    assert "springs" in found.solution.problem.system.closures, "springs were not to blame"


def test_where_more_harmonics_are_not_found_from_few_a_cold_start_may_find_them(monkeypatch, truth_behind_springs):
    def refuse_warm(problem, start, tolerance, *, fallbacks):
        found = solve(problem, start, tolerance, fallbacks=fallbacks)
        if start is not None:
            raise NotConverged("as if", best=replace(found, reason="as if"))
        return found

    monkeypatch.setattr("ewr_fenicsx.accuracy.solve", refuse_warm)
    found = solve_to_accuracy(rub_behind_springs(), 0.003)
    assert found.reached and measure_distance(found.solution, truth_behind_springs) <= 0.003
    assert [told.split(": ")[1] for told in found.solution.fallbacks[:2]] == ["given start", "growing harmonics"]
