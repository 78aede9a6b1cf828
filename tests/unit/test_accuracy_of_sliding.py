"""What is told of the sliding, which converges more slowly than the response does, beside an accuracy."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail, friction_oscillator, lift_off_oscillator, one_pressed_of_two

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import ErrorEstimate, compare_sliding, estimate_at_once, estimate_together
from ewr_fenicsx.runs.findings import list_causes, tell_estimate


def pose_slipping() -> list[ContactProblem]:
    """Joints that slip by far, some of which lift off."""
    rubs = ContactLaws("prescribed", normal_force=1.0, friction=0.3)
    return [
        *(
            ContactProblem(lift_off_oscillator(), ContactLaws(friction=mu), f)
            for mu in (0.2, 0.5)
            for f in (0.12, 0.16)
        ),
        *(ContactProblem(friction_oscillator(damping=0.02), rubs, f) for f in (0.08, 0.12)),
        *(ContactProblem(dovetail(excitation=x), ContactLaws(friction=0.1), 900.0) for x in (100.0, 150.0)),
    ]


def test_the_estimated_error_of_the_sliding_tells_its_order():
    """Of the way that pairs slide, of what presses as it slides, and of what friction dissipates: the furthest off."""
    ratios = []
    for problem in pose_slipping():
        coarse = solve(replace(problem, harmonics=5))
        fine = solve(replace(problem, harmonics=47), start=coarse)
        seen = np.array([s.press_and_slide() for s in (coarse, fine)])
        sliding = np.array([seen[:, 1].mean(axis=(1, 2)), np.prod(seen, axis=1).mean(axis=(1, 2))])
        sliding = np.vstack([sliding, [s.merit["friction_dissipation"] for s in (coarse, fine)]])
        true = np.max(np.abs(np.diff(sliding)[:, 0]) / sliding.max(axis=1))
        assert fine.merit["J_T"] > 0
        ratios.append(estimate_together(coarse, 1e-9).sliding / true)
    assert all(0.2 < ratio < 5 for ratio in ratios)
    assert 0.5 < np.median(ratios) < 2.5


def test_a_pair_that_is_open_throughout_does_not_hide_what_rubs():
    """It slid thirty times as far, and a tenth of the error was told."""
    alone = replace(pose_slipping()[2], harmonics=5)
    model, each = alone.model, np.eye(4)
    normal, tangential = np.vstack([model.normal, each[1]]), np.vstack([model.tangential, 5 * each[0]])
    model = replace(model, normal=normal, tangential=tangential, pair_area=None)
    beside = replace(alone, model=model, laws=ContactLaws(friction=0.5, initial_gap=[0.0, 1e3]))
    coarse, by_itself = (solve(problem) for problem in (beside, alone))
    assert coarse.merit["J_T"] > 15 * by_itself.merit["J_T"], "the mean over both"
    assert coarse.merit["friction_dissipation"] == pytest.approx(by_itself.merit["friction_dissipation"], rel=1e-3)
    expected = estimate_together(by_itself, 1e-9).sliding
    assert expected > 0.1 and estimate_together(coarse, 1e-9).sliding == pytest.approx(expected, rel=0.1)


def test_what_dashpots_take_is_in_the_error_of_what_friction_dissipates():
    """A joint that is open for most of the period: 0.8 % was told, of what surfaces slide, where it was off by 5 %."""
    coupling = np.array([[-5.5, 0.5], [-3.7, -6.0]])
    stiffness = np.block([[np.array([[7.0, 3.9], [3.9, 10.6]]), coupling], [coupling.T, np.diag([4.9, 6.0])]])
    model = ReducedModel(
        mass=np.diag([1.75, 1.8, 0.0, 0.0]),
        damping=np.diag([0.09, 0.1, 0.0, 0.0]),
        stiffness=stiffness,
        normal=[[0.0, 0.0, 1.0, 0.0]],
        tangential=[[0.0, 0.0, 0.0, 1.0]],
        load={0: [-1.0, 0.0, 0.0, 0.0], 1: [-0.15 + 0.5j, -2.4 + 0.6j, 0.0, 0.0]},
        outputs={"x": [1.0, 0.0, 0.0, 0.0]},
    )
    coarse = solve(ContactProblem(model, ContactLaws(friction=0.35), 0.153, 5))
    fine = solve(replace(coarse.problem, harmonics=47, closure="spring"), start=coarse)
    true = 1 - fine.merit["friction_dissipation"] / coarse.merit["friction_dissipation"]
    assert true > 0.03 and true / 2 < estimate_at_once(coarse).sliding < 3 * true
    assert coarse.merit["J_T"] == pytest.approx(fine.merit["J_T"], rel=0.01)


def test_what_sticks_is_not_said_to_slide():
    problem = ContactProblem(dovetail(excitation=1.0), ContactLaws(friction=1.0), 900.0)
    assert estimate_together(solve(problem), 1e-9).sliding == 0.0


def test_what_slides_while_it_is_open_has_no_work_that_could_be_off():
    """Beside a pair that sticks: works of friction that are rounding were said to be off by up to 1e14 %."""
    problem = ContactProblem(
        one_pressed_of_two(), ContactLaws(friction=1.0, initial_gap=[0.0, 10.0]), 0.19, closure="dashpot"
    )
    solution = solve(problem)
    assert solution.merit["J_T"] > 1 and abs(solution.merit["friction_dissipation"]) < 1e-12
    for found in (solution, solve(problem, accuracy=0.01), solve(replace(problem, closure="mass"), accuracy=0.01)):
        assert estimate_together(found, 1e-9).sliding < 0.01 and "sliding" not in found.summary()


def test_works_of_friction_of_opposite_signs_differ_by_twice_the_larger_one_at_most():
    """A step ahead may end where friction gives energy: it was compared with the smaller work, and 2400 % was told."""
    solution = solve(pose_slipping()[2])
    rub = solution.problem.system.row_of("tangential", np.arange(1))
    ahead = replace(solution, forces=solution.forces.copy())
    ahead.forces[1:, rub] *= -50.0
    assert ahead.merit["J_T"] > 0 and 1.0 < compare_sliding(ahead, solution) <= 2.0


def test_sliding_is_in_no_total_and_reaches_the_results():
    found = solve_to_accuracy(pose_slipping()[0], 0.02)
    assert found.estimate.sliding > 0
    assert found.estimate.total == pytest.approx(replace(found.estimate, sliding=np.nan).total)
    assert list_causes(found.estimate)["sliding"] == found.estimate.sliding
    assert estimate_at_once(solve(pose_slipping()[0])).sliding > 0


@pytest.mark.parametrize(
    "total, sliding, told",
    [(0.01, 0.3, "may be off by 30%"), (0.2, 0.3, ""), (0.01, 0.04, ""), (0.01, np.nan, ""), (0.01, 1.2, "by 120%")],
)
def test_sliding_that_is_much_further_off_than_the_response_is_told(total, sliding, told):
    estimate = ErrorEstimate(total, np.nan, sliding=sliding)
    found = replace(solve_to_accuracy(pose_slipping()[0], 0.1), estimate=estimate)
    for text in (found.summary(), tell_estimate(estimate, "the response")):
        assert ("sliding (J_T, dissipation)" in text) == bool(told) and told in text


@pytest.mark.parametrize("which, told", [(2, True), (3, False)])
def test_the_summary_of_a_solution_to_an_accuracy_tells_it_as_well(which, told):
    """Nobody was told where ``solve`` was asked for ten per cent, and the sliding was off by half."""
    problem = pose_slipping()[which]
    found, solution = solve_to_accuracy(problem, 0.1), solve(problem, accuracy=0.1)
    exact = solve(replace(problem, harmonics=63), start=solution).merit["J_T"]
    assert (abs(solution.merit["J_T"] / exact - 1) > 0.2) == told
    for text in (found.summary(), solution.summary(), pickle.loads(pickle.dumps(solution)).summary()):
        assert ("sliding (J_T, dissipation) may be off by" in text) == told
