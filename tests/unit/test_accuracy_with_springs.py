"""An accuracy that springs reach, and what goes on where they find no solution."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import FIRST_ORDER, estimate_together, measure_distance
from ewr_fenicsx.accuracy.levels import Knobs, go_on, pose_level
from ewr_fenicsx.balance.inexact_step import solve_inexactly
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.problem.dashpots import match_mobility, read_friction_weight, use_mobility


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

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", refuse_springs)
    found = solve_to_accuracy(rub_behind_springs(), 0.003, first=FIRST_ORDER)
    assert found.reached and not found.solution.problem.has_springs and not found.solution.fallbacks
    assert measure_distance(found.solution, truth_behind_springs) <= 0.003
    (first, *_), (second, *_) = tried[0], tried[1]
    assert tried[:2] == [(first, False, True), (second, True, False)], "one ladder at most"
    assert tried[2:4] == [(second, False, False), (second, True, False)], "dashpots may lead to springs"
    assert not any(springs for _, springs, _ in tried[4:])


def test_dashpots_lead_to_springs_that_are_not_found_by_themselves(monkeypatch, truth_behind_springs):
    """As at rubbing pads behind stiff springs: from cold hardly a set of harmonics was solved, from dashpots all."""

    def refuse_cold(problem, start, tolerance, *, fallbacks):
        found = solve(problem, start, tolerance)
        if problem.has_springs and (start is None or start.orders != found.orders):
            raise NotConverged("as if", best=replace(found, reason="as if"))
        return found

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", refuse_cold)
    found = solve_to_accuracy(rub_behind_springs(), 0.002)
    assert found.reached and found.solution.problem.has_springs
    assert measure_distance(found.solution, truth_behind_springs) <= 0.002


def test_where_more_harmonics_find_no_solution_the_one_before_stays(monkeypatch):
    """The ladder from there is long and hardly ever leads further: what came in the way is said, and a remedy."""

    def refuse_many(problem, start, tolerance, *, fallbacks):
        found = solve(problem, start, tolerance)
        if problem.basis.orders[-1] > FIRST_ORDER:
            assert fallbacks is False or (fallbacks == 1 and fallbacks is not True), "the ladder is long"
            raise NotConverged("as if", best=replace(found, reason="as if"))
        return found

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", refuse_many)
    found = solve_to_accuracy(rub_behind_springs(), 0.003, first=FIRST_ORDER)
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

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", refuse_one)
    found = solve_to_accuracy(rub_behind_springs(), 0.003, first=FIRST_ORDER)
    assert found.reached and measure_distance(found.solution, truth_behind_springs) <= 0.003
    assert len(set(refused)) == 1 and found.levels[1].orders[-1] > refused[0]
    assert "springs" in found.solution.problem.system.closures, "springs were not to blame"


def test_where_more_harmonics_are_not_found_from_few_a_cold_start_may_find_them(monkeypatch, truth_behind_springs):
    def refuse_warm(problem, start, tolerance, *, fallbacks):
        found = solve(problem, start, tolerance, fallbacks=fallbacks)
        if start is not None:
            raise NotConverged("as if", best=replace(found, reason="as if"))
        return found

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", refuse_warm)
    found = solve_to_accuracy(rub_behind_springs(), 0.003)
    assert found.reached and measure_distance(found.solution, truth_behind_springs) <= 0.003
    assert [told.split(": ")[1] for told in found.solution.fallbacks[:2]] == ["given start", "cold start"]


def test_where_no_weight_of_its_own_leads_on_the_default_ones_may(monkeypatch, truth_behind_springs):
    def refuse_own(problem, start, tolerance, *, fallbacks):
        found = solve(problem, start, tolerance, fallbacks=fallbacks)
        if start is not None or problem.rho_tangential is not None:
            raise NotConverged("as if", best=replace(found, reason="as if"))
        return found

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", refuse_own)
    posed = pose_level(rub_behind_springs(), Knobs(9, springs=False), None)
    found = go_on(posed, solve(rub_behind_springs()), 1e-8, cold=True)
    assert found.problem.rho_tangential is None
    assert [told.split(": ")[0] for told in found.fallbacks] == ["given start", "cold start", "default weights"]
    assert measure_distance(found, truth_behind_springs) < 0.02


def test_dashpots_stand_for_masses_where_these_find_no_solution():
    """Also where no pair has a weight of its own: it was masses again that were tried in place of masses."""
    model = ReducedModel(
        np.diag([1.0, 2.0]), 0.1 * np.eye(2), np.diag([3.0, 1.0]), tangential=np.eye(2), load={1: [1.0, 1.0]}
    )
    problem = ContactProblem(model, ContactLaws("prescribed", normal_force=1.0, friction=0.3), 0.1)
    closures = [pose_level(problem, Knobs(9, springs=springs), None).system.closures for springs in (True, False)]
    assert closures == [("masses",), ()]


@pytest.mark.parametrize(("length", "mass", "time"), [(1e3, 1e-3, 1.0), (1e-6, 1e3, 1e2)])
def test_weights_do_not_depend_on_units_where_masses_stand_beside_dashpots(length, mass, time):
    """Masses beside dashpots had a weight of one, in any units."""
    stiffness = np.array([[3.0, 0.0, 0.0], [0.0, 7.0, -5.0], [0.0, -5.0, 5.2]])

    def pose(length: float, mass: float, time: float) -> ContactProblem:
        force = mass * length / time**2
        model = ReducedModel(
            mass * np.diag([2.0, 1.0, 1e-4]),
            0.05 * mass / time * stiffness,
            mass / time**2 * stiffness,
            tangential=np.eye(3)[[0, 2]],
            load={1: force * np.array([1.0, 1.0, 0.0])},
        )
        laws = ContactLaws("prescribed", normal_force=force, friction=0.3)
        return ContactProblem(model, laws, 0.1 / time, 9)

    usual, other = pose(1.0, 1.0, 1.0), pose(length, mass, time)
    assert "masses" in usual.system.closures and match_mobility(usual) is not None
    np.testing.assert_allclose(match_mobility(other) * mass / time, match_mobility(usual), rtol=1e-9)
    np.testing.assert_allclose(read_friction_weight(other) * mass / time, read_friction_weight(usual), rtol=1e-9)


def test_a_small_estimate_after_a_large_change_takes_a_second_look(monkeypatch):
    """One Newton step may tell of nothing by chance: at an under-platform damper it did, twenty times too little."""
    solution, taken = solve(rub_behind_springs()), []

    def count(step):
        taken.append(step)
        return solve_inexactly(step)

    monkeypatch.setattr("ewr_fenicsx.accuracy.looking_ahead.solve_inexactly", count)
    first = estimate_together(solution, 0.9).error
    assert first < 0.9 / 4 and len(taken) == 1
    assert estimate_together(solution, 0.9, moved=4.9 * first).error == first and len(taken) == 2
    assert estimate_together(solution, 0.9, moved=5.1 * first).error != first and len(taken) == 4
