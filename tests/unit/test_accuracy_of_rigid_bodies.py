"""An accuracy that is asked of bodies that nothing elastic parts from the wall on which they rub."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import measure_distance


def slide_under_a_moving_load(rng: np.random.Generator) -> ContactProblem:
    """A chain of masses with any of its values, whose last one rubs under a normal force that moves."""
    n = int(rng.integers(1, 4))
    springs, w = rng.uniform(0.5, 2.0, n + 1), rng.uniform(0.3, 2.5)
    stiffness = np.diag(springs[:-1] + springs[1:]) - np.diag(springs[1:-1], 1) - np.diag(springs[1:-1], -1)
    load = {1: np.eye(n)[0], 3: rng.uniform(0.0, 0.5) * np.exp(1j * rng.uniform(0, 6)) * np.eye(n)[0]}
    outputs, rubs = {"x": np.eye(n)[0]}, np.eye(n)[-1:]
    model = ReducedModel(np.eye(n), 0.05 * stiffness, stiffness, tangential=rubs, load=load, outputs=outputs)
    receptance = np.linalg.inv(stiffness + 0.05j * w * stiffness - w**2 * np.eye(n))
    stuck = abs(receptance[-1, 0] / receptance[-1, -1])
    moving = {0: [stuck], int(rng.integers(1, 3)): [0.6 * stuck * np.exp(1j * rng.uniform(0, 6))]}
    laws = ContactLaws("prescribed", friction=rng.uniform(0.2, 0.9), normal_force=moving)
    return ContactProblem(model, laws, w / (2 * np.pi))


def test_sliders_under_moving_loads_are_nearly_always_as_accurate_as_asked():
    """Their masses close the truncation; the truth is that of as many harmonics as leave dashpots off by up to 1 %."""
    rng, missed, near, orders = np.random.default_rng(4), [], [], []
    for _ in range(24):
        problem = slide_under_a_moving_load(rng)
        truth = solve(replace(problem, harmonics=127, samples=2048, closure="spring"))
        assert truth.problem.system.closures == ("masses",)
        for accuracy in (0.1, 0.01):
            found = solve_to_accuracy(problem, accuracy)
            assert found.reached
            true = measure_distance(found.solution, truth)
            missed.append(true > accuracy)
            near.append(true / 5 < found.estimate.total < 5 * true)
            orders.append(found.solution.orders[-1])
    assert not any(missed) and np.mean(near) >= 0.95 and np.median(orders) <= 8


def turn_on_a_wall(pairs: int) -> ContactProblem:
    """A block on springs that slides and turns on a wall: its pairs move each other, so that no mass is that of one."""
    arms = np.linspace(-0.1, 0.1, pairs)
    model = ReducedModel(
        mass=np.diag([1.0, 4e-3]),
        damping=np.diag([0.02, 8e-5]),
        stiffness=np.diag([1.0, 6e-3]),
        tangential=np.column_stack([np.ones(pairs), arms]),
        load={1: [1.0, 0.04]},
        outputs={"x": [1.0, 0.0], "edge": [0.0, 0.1]},
    )
    return ContactProblem(model, ContactLaws("prescribed", normal_force=1.0 / pairs, friction=0.5), 0.17)


def test_pairs_that_move_each_other_are_nearly_always_as_accurate_as_asked():
    """Dashpots close their truncation, and errors fall slowly: as if like the inverse square they would be missed."""
    missed, usual = [], turn_on_a_wall(4)
    for frequency in np.linspace(0.08, 0.3, 8):
        problem = replace(usual, frequency=frequency)
        truth = solve(replace(problem, harmonics=127, samples=2048))
        for accuracy in (0.1, 0.03):
            found = solve_to_accuracy(problem, accuracy)
            assert found.reached and not found.solution.problem.system.closures
            true = measure_distance(found.solution, truth)
            missed.append(true > accuracy)
            assert true / 2 < found.estimate.total
    assert np.mean(missed) < 0.1


def test_a_last_set_cut_short_by_a_limit_is_not_thought_worse_than_the_one_before():
    """What the last two harmonics change tells little of those above."""
    problem = turn_on_a_wall(4)
    higher = [level.orders[-1] for level in solve_to_accuracy(problem, 0.003).levels]
    found = solve_to_accuracy(problem, 0.003, highest=higher[-2] + 2)
    before, last = found.levels[-2:]
    assert before.orders[-1] < last.orders[-1] < 1.1 * before.orders[-1]
    assert last.estimate.total < 1.5 * before.estimate.total
