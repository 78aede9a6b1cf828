"""A neighbouring problem's solution approached: by operator splitting in large joints, else by Newton steps."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from small_models import PROBLEMS, lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.accuracy import looking_ahead
from ewr_fenicsx.accuracy.estimates import estimate_together, measure_distance
from ewr_fenicsx.accuracy.looking_ahead import approach, raise_harmonics, take_step
from ewr_fenicsx.solver import splitting

RUBBING = ("floating, slip", "lift-off", "prescribed", "plane, floating")


@pytest.fixture
def large(monkeypatch):
    """Every joint counts as large."""
    monkeypatch.setattr(looking_ahead, "LARGE", 1)
    monkeypatch.setattr(splitting, "WORTHWHILE", 1)


def pose(name: str, closure: str = "dashpot") -> ContactProblem:
    return replace(PROBLEMS[name], harmonics=5, samples=256, closure=closure)


@pytest.mark.parametrize("name", RUBBING)
def test_each_look_is_closer_to_the_neighbours_solution(name, large):
    """Closer than the share of the change that an estimate may be off by, down to what a splitting's samples leave."""
    solution = solve(pose(name))
    ahead = raise_harmonics(solution.problem)
    truth = solve(ahead, start=solution, tolerance=1e-11)
    change = measure_distance(solution, truth)
    accuracy = change  # what is asked about
    looks = list(islice(approach(solution, ahead, accuracy), 2))
    assert [look.reason for look in looks] == ["operator splitting"] * 2
    first, second = (measure_distance(look, truth) for look in looks)
    assert first < 0.3 * change and second < max(first, 0.05 * change)


def test_a_splitting_that_does_not_settle_leaves_it_to_newton(large, monkeypatch):
    solution = solve(pose("lift-off"))
    ahead = raise_harmonics(solution.problem)
    monkeypatch.setattr(looking_ahead, "settle", lambda *given: splitting.settle(*given, splitting.Effort(3, 3, 3)))
    looks = list(islice(approach(solution, ahead, 1e-3), 2))
    assert [look.reason for look in looks] == ["one Newton step"] * 2
    step = take_step(solution, ahead)
    np.testing.assert_array_equal(looks[0].forces, step.forces)
    np.testing.assert_array_equal(looks[1].forces, take_step(step, step.problem).forces)


def test_a_splitting_takes_more_samples_where_the_problem_does(large):
    """Or it would not see what too few of them leave."""
    solution = solve(replace(pose("lift-off"), samples=24))
    ahead = replace(raise_harmonics(solution.problem), samples=1024)
    look, truth = next(approach(solution, ahead, 1e-4)), solve(ahead)
    assert look.reason == "operator splitting"
    assert measure_distance(look, truth) < 0.01 * measure_distance(solution, truth)  # with 64 samples 0.07


def test_a_harmonic_that_rings_costs_few_samples_and_a_low_order_none_on_top(large, monkeypatch):
    """Their number is for what the look tells of, not for the harmonic far up that it has besides."""
    solution = solve(replace(pose("lift-off"), samples=64))
    ahead = replace(raise_harmonics(solution.problem), harmonics=(*range(12), 32), samples=284)
    taken, make, errors = [], looking_ahead.Splitting, []
    for many in (False, True):
        monkeypatch.setattr(
            looking_ahead,
            "Splitting",
            lambda b, samples, many=many: taken.append(make(b, 512 if many else samples)) or taken[-1],
        )
        errors.append(measure_distance(next(approach(solution, ahead, 1e-3)), solution))
    assert [splitting.basis.samples for splitting in taken] == [90, 512]
    assert errors[0] == pytest.approx(errors[1], rel=0.02)


def test_newton_goes_on_from_where_a_splitting_stalls(large, monkeypatch):
    """It began again from the solution with fewer harmonics, further off than the splitting had come."""
    settle, settled = looking_ahead.settle, []

    def stall(parts, state, tolerance):
        found = settle(parts, state, tolerance)
        settled.append(found)
        return found if len(settled) <= 2 else found._replace(defect=np.inf)  # what the first defect is; the first look

    solution = solve(pose("lift-off"))
    monkeypatch.setattr(looking_ahead, "settle", stall)
    first, second = islice(approach(solution, raise_harmonics(solution.problem), 1e-3), 2)
    assert (first.reason, second.reason) == ("operator splitting", "one Newton step")
    np.testing.assert_array_equal(second.forces, take_step(first, first.problem).forces)


def test_a_splitting_that_has_no_answer_leaves_it_to_newton(large, monkeypatch):
    def fail(*_):
        raise np.linalg.LinAlgError

    solution = solve(pose("lift-off"))
    monkeypatch.setattr(looking_ahead, "settle", fail)
    assert next(approach(solution, raise_harmonics(solution.problem), 1e-3)).reason == "one Newton step"


@pytest.mark.parametrize("closure", ["spring", "mass"])
def test_what_closes_a_truncation_without_an_impedance_is_approached_by_newton_steps(closure, large):
    """A splitting ends near its solution only."""
    problem = pose("prescribed", closure)
    assert problem.system.closures
    solution = solve(problem)
    assert next(approach(solution, replace(problem, harmonics=9), 1e-3)).reason == "one Newton step"


def test_small_joints_take_newton_steps():
    solution = solve(pose("lift-off"))
    assert next(approach(solution, raise_harmonics(solution.problem), 1e-3)).reason == "one Newton step"


def test_both_ways_estimate_the_same_error(monkeypatch):
    """Within a third: they differ in how far they get."""
    solution = solve(pose("lift-off"))
    by_steps = estimate_together(solution, 1.0, moved=np.inf).error
    monkeypatch.setattr(looking_ahead, "LARGE", 1)
    monkeypatch.setattr(splitting, "WORTHWHILE", 1)
    settled, original = [], looking_ahead._split_towards
    monkeypatch.setattr(
        looking_ahead, "_split_towards", lambda *given: (settled.append(look) or look for look in original(*given))
    )
    by_splitting = estimate_together(solution, by_steps).error
    assert len(settled) == 2
    assert by_splitting == pytest.approx(by_steps, rel=1 / 3)


def test_a_joint_without_contact_rows_is_its_own_neighbour():
    bonded = ContactProblem(lift_off_oscillator(), ContactLaws("bonded", "bonded"), 0.1, 3)
    solution = solve(bonded)
    look = next(approach(solution, replace(bonded, harmonics=7), 1e-3))
    assert look.forces.shape[1] == 0 and measure_distance(look, solution) < 1e-14
