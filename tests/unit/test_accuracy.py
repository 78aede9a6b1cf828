"""Estimated errors against true ones; an accuracy that is asked for against that which comes out."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hard_cases import Case, pose_case
from small_models import dovetail, friction_oscillator, lift_off_oscillator, stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, close_ring, solve, solve_to_accuracy
from ewr_fenicsx.accuracy import estimates
from ewr_fenicsx.accuracy.accuracy import AccurateSolution
from ewr_fenicsx.accuracy.estimates import (
    Look,
    choose_harmonics,
    compare_responses,
    estimate_errors,
    estimate_samples,
    estimate_together,
    estimate_weight,
    find_rate,
    measure_distance,
    step_towards,
)
from ewr_fenicsx.accuracy.looking_ahead import raise_harmonics, take_step
from ewr_fenicsx.errors import ModelError, NotConverged
from ewr_fenicsx.problem.dashpots import match_mobility, read_friction_weight

FREQUENCY = 0.7 / (2 * np.pi)


def rub_and_lift_off(harmonics=5, **settings) -> ContactProblem:
    return ContactProblem(lift_off_oscillator(), ContactLaws(friction=0.3), FREQUENCY, harmonics, **settings)


@pytest.fixture(scope="module")
def truth():
    """Four times the harmonics of any solve here, and another weight: what both agree on is right."""
    return solve(rub_and_lift_off(150, samples=2400))


def test_the_truth_does_not_depend_on_the_weight(truth):
    weight = match_mobility(truth.problem)
    other = solve(replace(truth.problem, rho_tangential=weight), start=truth)
    assert measure_distance(other, truth) < 3e-4


@pytest.mark.parametrize("harmonics", [3, 5, 9, 15, 25])
def test_the_estimate_is_within_a_factor_of_five_of_the_true_error(harmonics, truth):
    solution = solve(rub_and_lift_off(harmonics))
    true = measure_distance(solution, truth)
    assert true / 5 < estimate_errors(solution).total < 5 * true


@pytest.mark.parametrize("harmonics", [3, 5, 9, 15, 25])
def test_two_steps_on_all_knobs_at_once_are_within_a_factor_of_three(harmonics, truth):
    """Asked about an accuracy near the error; what is far above or far below it needs one step."""
    solution = solve(rub_and_lift_off(harmonics))
    true = measure_distance(solution, truth)
    assert true / 3 < estimate_together(solution, true).error < 3 * true
    raised = raise_harmonics(solution.problem)
    ahead = take_step(solution, replace(raised, samples=2 * raised.basis.samples))
    one_step = measure_distance(ahead, solution) / (
        1 - (harmonics / raised.basis.orders[-1]) ** find_rate(solution.problem)
    )
    for accuracy in (1e-3 * true, 1e3 * true):
        assert estimate_together(solution, accuracy).error == one_step
    assert estimate_together(solution, true).error != one_step


@pytest.mark.parametrize("harmonics", [5, 9])
def test_a_harmonic_at_a_resonance_counts_however_far_off_it_is(harmonics):
    """A slider with a light mass on it that resonates at the 17th: errors hardly fall before that one is there."""
    mass, stiffness = np.diag([1.0, 0.02]), np.array([[4.0, -3.0], [-3.0, 3.0]])
    top = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).max())
    model = ReducedModel(
        mass, 5e-4 * stiffness, stiffness, tangential=[[1.0, 0.0]], load={1: [1.0, 0.0]}, outputs={"top": [0.0, 1.0]}
    )
    laws = ContactLaws(normal="prescribed", normal_force=1.0, friction=0.2)
    solution = solve(ContactProblem(model, laws, top / (2 * np.pi * 17), harmonics))
    true = measure_distance(solution, solve(replace(solution.problem, harmonics=151, samples=2048)))
    assert 0.9 * true < estimate_together(solution, true).error < 2 * true


def test_of_a_ring_a_harmonic_resonates_in_its_own_wave():
    """Masses on sliders, joined by springs: of all in phase, as at the 21st harmonic, none is stretched."""
    mass, stiffness, joined = np.diag([1.0, 0.02, 0.0]), np.zeros((3, 3)), np.array([[1.0, -1.0], [-1.0, 1.0]])
    stiffness[:2, :2] += np.diag([1.0, 0.0]) + 3 * joined
    top = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass[:2, :2], stiffness[:2, :2])).max())
    stiffness[1:, 1:] += 2 * joined
    rows = {"tangential": [[1.0, 0.0, 0.0]], "load": {1: [1.0, 0.0, 0.0]}, "outputs": {"top": [0.0, 1.0, 0.0]}}
    model = close_ring(ReducedModel(mass, 5e-4 * stiffness, stiffness, **rows), [1], [2], sectors=7, engine_order=3)
    laws = ContactLaws(normal="prescribed", normal_force=1.0, friction=0.2)
    solution = solve(ContactProblem(model, laws, top / (2 * np.pi * 21), 9))
    true = measure_distance(solution, solve(replace(solution.problem, harmonics=151, samples=2048)))
    assert true > 0.05 and 0.9 * true < estimate_together(solution, true).error < 2 * true


@pytest.mark.parametrize("enough", [200, 10**9])
def test_samples_are_raised_where_they_dominate(monkeypatch, enough):
    """As if all the error came from fewer samples than ``enough``."""
    blame = lambda solution, *_: 1.0 if solution.problem.basis.samples < enough else 0.0  # noqa: E731
    monkeypatch.setattr("ewr_fenicsx.accuracy.accuracy.estimate_samples", blame)
    monkeypatch.setattr("ewr_fenicsx.accuracy.accuracy.estimate_together", lambda *given: Look(blame(*given), 0.0))
    found = solve_to_accuracy(rub_and_lift_off(), 0.003)
    if enough == 200:
        pairs = list(zip(found.levels, found.levels[1:], strict=False))
        raised = [(a.samples, b.samples) for a, b in pairs if a.orders[-1] == b.orders[-1]]
        assert found.reached and raised and raised[-1][1] >= enough
        assert all(few < enough and more > few for few, more in raised)
    else:
        assert "samples a period still leave an error" in found.limit and not found.reached


def test_the_effect_of_the_samples_is_estimated(truth):
    """Coarse sampling: the estimate against a solve with many."""
    coarse = solve(rub_and_lift_off(9, samples=20))
    fine = solve(rub_and_lift_off(9, samples=2400), start=coarse)
    true = measure_distance(coarse, fine)
    assert true > 1e-3
    assert true / 5 < estimate_samples(coarse) < 5 * true


@pytest.mark.parametrize("harmonics", [3, 9])
def test_the_effect_of_the_weight_is_estimated(harmonics):
    """Where a pair slips: the estimate against a solve with twice the weight."""
    solution = solve(rub_and_lift_off(harmonics))
    twice = replace(solution.problem, rho_tangential=2 * read_friction_weight(solution.problem))
    true = measure_distance(solve(twice, start=solution), solution)
    assert true > 5e-3
    assert estimate_weight(solution) == pytest.approx(true, rel=0.2)


def test_a_step_on_the_same_problem_goes_nowhere():
    solution = solve(rub_and_lift_off())
    assert step_towards(solution, replace(solution.problem)) < 1e-7


def test_full_stick_has_no_error():
    problem = ContactProblem(dovetail(excitation=0.5), ContactLaws(friction=0.8), 300.0, 3)
    assert estimate_errors(solve(problem)).total < 1e-9


@lru_cache
def rub_as_accurately_as(accuracy: float) -> AccurateSolution:
    return solve_to_accuracy(rub_and_lift_off(), accuracy)


@pytest.mark.parametrize("accuracy", [0.1, 0.01, 0.003])
def test_the_true_error_is_at_most_the_one_asked_for(accuracy, truth):
    found = rub_as_accurately_as(accuracy)
    assert found.reached and not found.limit
    assert measure_distance(found.solution, truth) <= accuracy
    assert found.estimate.total <= accuracy


def test_less_accuracy_takes_fewer_unknowns():
    taken = [rub_as_accurately_as(accuracy).solution.unknowns for accuracy in (0.1, 0.01, 0.001)]
    assert taken[0] < taken[1] < taken[2]


def test_what_cannot_be_reached_is_said():
    found = solve_to_accuracy(rub_and_lift_off(), 1e-4, highest=9)
    assert not found.reached
    assert "harmonic 9 is the highest allowed" in found.limit
    assert found.estimate.total > 1e-4
    assert found.solution.orders[-1] == 9
    assert "NOT as accurate as asked" in found.summary()


def test_a_fallback_of_the_first_solve_is_not_forgotten(monkeypatch):
    """All later solves start at what it found."""
    rungs = ("cold start: fell no further", "time stepping: residual below the tolerance")

    def solve_late(problem, start, tolerance, **choice):
        return replace(solve(problem, start, tolerance, **choice), fallbacks=rungs if start is None else ())

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", solve_late)
    found = solve_to_accuracy(rub_and_lift_off(), 0.01, first=3)
    assert len(found.levels) > 1
    assert found.solution.fallbacks == tuple(f"harmonics up to 3: {rung}" for rung in rungs)
    assert "there may be other solutions" in found.summary()


def test_where_newton_stalls_on_a_small_joint_time_stepping_leads_on():
    """A springy stop under two harmonics: neither warm nor cold starts find a solution with more than five of them.

    The truth is exact, from matrix exponentials between events.
    """
    load = {0: 23.236, 1: 170.695, 2: 35.768 + 4.2768j}
    model = stop_oscillator(stiffness=1.61142e5, stop_stiffness=8.32193e5, damping=24.024, load=load)
    problem = ContactProblem(model, ContactLaws(tangential="frictionless"), 20.8662)
    with pytest.raises(NotConverged):
        solve(replace(problem, harmonics=13), fallbacks=False)
    found = solve_to_accuracy(problem, 0.01)
    assert found.reached
    assert any("time stepping" in rung for rung in found.solution.fallbacks)
    amplitude = np.abs(found.solution.output("tip")[:3])
    assert amplitude == pytest.approx([2.19183e-4, 5.20870e-4, 1.11615e-4], rel=0.01)


@pytest.mark.parametrize(("accuracy", "order"), [(0.1, 3), (0.02, 3), (0.01, 5)])
def test_a_fine_accuracy_begins_with_more_harmonics(accuracy, order):
    """Three hardly ever meet it: their solve, and the look at its error, are spared."""
    assert rub_as_accurately_as(accuracy).levels[0].orders[-1] == order


def test_unknowns_are_limited():
    found = solve_to_accuracy(rub_and_lift_off(), 1e-4, most_unknowns=40)
    assert "take more than 40 unknowns" in found.limit
    assert found.solution.unknowns <= 40


@pytest.mark.parametrize(
    "choice, told",
    [
        ({"highest": -1}, "highest = -1; give a whole number from 1"),
        ({"highest": "9"}, "highest = '9'; give a whole number from 1"),
        ({"first": 2.5}, "first = 2.5; give a whole number from 1"),
        ({"most_unknowns": np.nan}, "most_unknowns = nan; give a whole number from 1"),
        ({"modes": 5}, "modes = 5; list the modal coordinates, each once, from 0 to 3"),
        ({"modes": None}, "modes = None; give numbers"),
        ({"modes": "ab"}, "modes = 'ab'; give numbers"),
        ({"modes": [0, 4]}, r"modes = \[0, 4\]; list"),
        ({"modes": [0, 0]}, r"modes = \[0, 0\]; list"),
        ({"modes": [-1]}, r"modes = \[-1\]; list"),
    ],
)
def test_choices_that_make_no_sense_are_refused(choice, told):
    with pytest.raises(ModelError, match=told):
        solve_to_accuracy(rub_and_lift_off(), 0.01, **choice)


def test_few_samples_that_lead_nowhere_are_raised(monkeypatch):
    """As at joints where 64 have no solution that any rung finds, and 128 do."""
    tried = []

    def fail_at_few(problem, *arguments, **settings):
        tried.append(problem.basis.samples)
        if problem.basis.samples < 128:
            raise NotConverged("nothing found", best=None)
        return solve(problem, *arguments, **settings)

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", fail_at_few)
    found = solve_to_accuracy(rub_and_lift_off(), 0.03)
    assert found.reached and tried[:2] == [64, 256] and found.levels[0].samples == 256
    monkeypatch.setattr(
        "ewr_fenicsx.accuracy.levels.solve", lambda problem, *_, **__: fail_at_few(replace(problem, samples=64))
    )
    with pytest.raises(NotConverged, match="nothing found"):
        solve_to_accuracy(rub_and_lift_off(), 0.03)


@pytest.mark.parametrize("accuracy", [0.0, 1.0, -0.1, np.nan, None, "x"])
def test_an_accuracy_that_is_none_is_refused(accuracy):
    with pytest.raises(ModelError, match=f"accuracy = {accuracy!r}; give a relative error between 0 and 1"):
        solve_to_accuracy(rub_and_lift_off(), accuracy)


def test_an_accuracy_of_something_else_than_a_problem_is_refused():
    with pytest.raises(ModelError, match=r"problem = ReducedModel\(.*; give ContactProblem\("):
        solve_to_accuracy(rub_and_lift_off().model, 0.1)


def test_weights_that_are_given_are_kept():
    found = solve_to_accuracy(rub_and_lift_off(rho_tangential=0.3), 0.05)
    assert found.solution.problem.rho_tangential == 0.3


def test_a_linear_problem_is_exact():
    laws = ContactLaws(normal="bonded", tangential="bonded")
    found = solve_to_accuracy(ContactProblem(lift_off_oscillator(), laws, FREQUENCY), 0.01)
    assert found.estimate.total < 1e-14 and len(found.levels) == 1


@pytest.mark.parametrize(("outputs", "rounding"), [({"tip": [1.0]}, 0.0), ({}, 1e-12)])
def test_what_sticks_throughout_is_exact(outputs, rounding):
    """Its motion is the rounding of what loads and friction would move: an error of 100 % was seen in that."""
    laws = ContactLaws(normal="prescribed", friction=1.0, normal_force=1.01)
    model = replace(friction_oscillator(load={1: 1.0}), outputs=outputs)
    found = solve_to_accuracy(ContactProblem(model, laws, 0.1), 0.01)
    assert np.abs(found.solution.slip_amplitudes["tangential"]).max() < 1e-12
    assert found.reached and found.estimate.total <= rounding and len(found.levels) == 1


def test_without_outputs_forces_tell_two_joints_apart_that_stick():
    laws = ContactLaws(normal="prescribed", friction=1.0, normal_force=2.0)
    pushed = [
        solve(ContactProblem(replace(friction_oscillator(load={1: load}), outputs={}), laws, 0.1))
        for load in (1.0, 0.8)
    ]
    assert measure_distance(*pushed) == pytest.approx(0.25, rel=1e-9)


@pytest.mark.parametrize("figure", ["J_T", 3])
def test_a_figure_that_is_no_function_is_refused(figure):
    with pytest.raises(ModelError, match=f"figure = {figure!r}; give a function of a solution that returns an array"):
        solve_to_accuracy(rub_and_lift_off(), 0.1, figure=figure)


def test_an_output_that_begins_to_move_is_compared():
    here, there = np.array([[1.0, 0.1]]), np.array([[1.0, 0.0]])
    assert compare_responses(here, there, rest=1e-3) > 1e6
    assert compare_responses(here, there, rest=np.array([0.0, 0.2])) == 0.0
    assert compare_responses(there, here) == 1.0


def test_idle_harmonics_stay_left_out():
    laws = ContactLaws(normal="prescribed", friction=0.3, normal_force=1.0)
    found = solve_to_accuracy(ContactProblem(friction_oscillator(damping=0.02), laws, FREQUENCY), 0.003)
    assert found.reached
    assert set(found.solution.left_out) == {h for h in found.solution.orders if h % 2 == 0}
    slow = ContactProblem(friction_oscillator(damping=0.02), replace(laws, friction=0.5), FREQUENCY, load={3: [1.0]})
    found = solve_to_accuracy(slow, 1e-3)
    assert found.reached and not isinstance(found.solution.problem.harmonics, int), "or none was dropped besides"
    assert all(h % 2 for h in found.solution.orders)


def test_harmonics_without_contact_forces_are_not_chosen():
    """A listed set keeps the even ones, which are zero by symmetry: the choice finds that by itself."""
    laws = ContactLaws(normal="prescribed", friction=0.3, normal_force=1.0)
    solution = solve(ContactProblem(friction_oscillator(damping=0.02), laws, FREQUENCY, tuple(range(12))))
    assert choose_harmonics(solution, 1e-6) == (0, 1, 3, 5, 7, 9, 11)
    assert choose_harmonics(solution, 0.5) == (0, 1)


def test_the_weight_that_closes_the_truncation_is_the_mobility():
    """At one pair: the speed per force at harmonics next to the highest, from the model's own matrices."""
    problem = rub_and_lift_off(12)
    model, omega = problem.model, problem.omega
    row, speeds = model.tangential[0], []
    for h in (13, 16, 19):
        w = h * omega
        x = np.linalg.solve(model.stiffness - w**2 * model.mass + 1j * w * model.damping, row)
        speeds.append(w * abs(row @ x))
    assert match_mobility(problem) == pytest.approx([np.prod(speeds) ** (1 / 3)], rel=1e-9)


def test_where_single_steps_tell_of_a_large_error_the_neighbouring_problem_is_solved(monkeypatch):
    """They told of 65 % where harmonics are off by 3 %; where nothing is found there, they have to do."""
    problem = ContactProblem(dovetail(excitation=800.0), ContactLaws(friction=0.3), 400.0, 5)
    solution, reference = solve(problem), solve(replace(problem, harmonics=31))
    true, stepped = measure_distance(reference, solution), estimates.estimate_together(solution, estimates.USUAL).error
    assert stepped > 5 * true
    assert true < estimates.estimate_at_once(solution).total < 3 * true
    with monkeypatch.context() as small:
        small.setattr(estimates, "LARGEST_AHEAD", solution.unknowns - 1)
        assert estimates.estimate_at_once(solution).total == stepped, "it would take long"
    failed = replace(solution, converged=False)
    monkeypatch.setattr(estimates, "solve", lambda *given, **options: failed)
    assert estimates.estimate_at_once(solution).total == stepped


def test_a_neighbouring_problem_is_solved_closely_where_forces_are_small():
    """Beside the forces that would close all gaps. With 1e-5 of these left, nothing moved: an error of 0 was told."""
    posed = pose_case(Case("lap joint", 0.95, ("applied", 0.1), 0.6, 8, 0.005, "random", (1, 1)))
    assert 0.1 < estimates.estimate_at_once(solve(posed)).total < 1.0, "11 %, by time stepping"


@pytest.mark.parametrize(
    "figure, message",
    [
        (lambda s: np.array([np.nan]), "figure returns .*nan.*; give finite numbers"),
        (lambda s: [np.inf], "give finite numbers"),
        (lambda s: None, "what figure returns = None; give numbers"),
        (lambda s: np.abs(s.output("tip")), "as many for every solution, whatever its harmonics"),
    ],
)
def test_a_figure_that_says_nothing_is_refused(figure, message):
    """NaN passed for accurate, and other lengths ended in numpy's words."""
    laws = ContactLaws("prescribed", normal_force=0.7, friction=1.0)
    with pytest.raises(ModelError, match=message):
        solve_to_accuracy(ContactProblem(friction_oscillator(), laws, 0.12), 1e-3, figure=figure)
