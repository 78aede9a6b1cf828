"""Errors by the modes left out of a reduced model, and modes that an accuracy raises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from counted_calls import count_calls
from small_models import lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, evolve_wear, solve, solve_to_accuracy
from ewr_fenicsx.accuracy import levels
from ewr_fenicsx.accuracy.estimates import estimate_errors, estimate_modes, measure_distance
from ewr_fenicsx.accuracy.modes_left_out import ModesBesideResponses, correct_inertia
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.model.restriction import restrict, solve_stuck
from ewr_fenicsx.wear import cycle_jumps
from ewr_fenicsx.wear.wear import WearHistory
from ewr_fenicsx.wear.wear_accuracy import AccurateWear
from ewr_fenicsx.wear.wear_store import TriedModels


def structure_with_modes(*stiffness: float) -> ReducedModel:
    """Six coordinates with two pairs, and one more for each modal stiffness, coupled by their inertia."""
    base, count = random_structure(size=6, pairs=2, seed=4), len(stiffness)
    mass = np.eye(6 + count)
    mass[:6, :6], mass[:6, 6:], mass[6:, :6] = base.mass, 0.1, 0.1
    k = np.diag([*np.ones(6), *stiffness])
    k[:6, :6] = base.stiffness
    grow = lambda rows: np.hstack([rows, np.zeros((rows.shape[0], count))])  # noqa: E731
    load = np.concatenate([np.ones(6), np.zeros(count)])
    return replace(
        base,
        mass=mass,
        stiffness=k,
        damping=0.05 * k,
        normal=grow(base.normal),
        tangential=grow(base.tangential),
        load={0: -20 * grow(base.normal).sum(axis=0), 1: 3 * load},
        outputs={"tip": load},
        pair_area=np.ones(2),
        rigid_modes=None,
    )


def drop_modes(model: ReducedModel, coordinates) -> ReducedModel:
    """The reduced model without some of its modal coordinates."""
    basis = np.delete(np.eye(model.size), list(coordinates), axis=1)
    return restrict(model, basis, basis.T @ model.rigid_modes)


def test_modes_are_raised_from_the_last_solution():
    """Soft modes first, stiff ones last: those that matter are found, and the answer is that of all."""
    full = structure_with_modes(0.5, 1.0, 1.5, 2.0, 1e5, 2e5, 3e5, 4e5)
    laws, asked = ContactLaws(friction=0.2), []

    def keep(count: int) -> tuple[ContactProblem, range]:
        asked.append(count)
        return ContactProblem(drop_modes(full, range(6 + count, 14)), laws, 0.05), range(6, 6 + count)

    problem, modes = keep(1)
    found = solve_to_accuracy(problem, 0.05, modes=modes, more_modes=keep)
    assert found.reached and not found.limit
    assert asked == [1, 2, 4, 8], found.summary()
    assert [level.modes for level in found.levels][-1] == 8
    assert "modes raised from 1 to 8" in found.summary()
    truth = solve(ContactProblem(full, laws, 0.05, 120))
    assert measure_distance(found.solution, truth) < 0.05
    few = solve_to_accuracy(problem, 0.05, modes=modes)
    assert "the 1 modes of the reduced model leave an error of" in few.limit
    assert measure_distance(few.solution, truth) > 0.05, "or there was no need for more"
    raised = [
        level for level, before in zip(found.levels[1:], found.levels, strict=False) if level.modes > before.modes
    ]
    cold = solve(replace(found.solution.problem))
    assert all(level.steps < cold.iterations for level in raised), "contact forces carry over"


def test_the_most_modes_are_a_limit():
    full = structure_with_modes(0.5, 1.0, 1.5, 2.0)
    keep = lambda m: (  # noqa: E731
        ContactProblem(drop_modes(full, range(6 + m, 10)), ContactLaws(friction=0.2), 0.05),
        range(6, 6 + m),
    )
    found = solve_to_accuracy(keep(1)[0], 0.05, modes=range(6, 7), more_modes=keep, most_modes=2)
    assert not found.reached
    assert "the 2 modes of the reduced model leave an error of" in found.limit


@pytest.mark.parametrize("allowed", [{"highest": 3}, {"most_unknowns": 20}])
def test_a_limit_of_the_harmonics_hides_no_other_error(allowed):
    """Weight and modes wait for harmonics to be raised; where a limit ends that, the total has them all the same."""
    problem = ContactProblem(structure_with_modes(0.5, 1.0), ContactLaws(friction=0.2), 0.05)
    found = solve_to_accuracy(problem, 1e-3, modes=[6, 7], **allowed)
    assert found.limit and found.levels[-1].estimate.total > 1e-3, "or there is nothing to wait for"
    alone = estimate_errors(found.solution, [6, 7])
    assert (found.estimate.weight, found.estimate.modes) == (alone.weight, alone.modes)
    assert found.estimate.modes > 1e-3 and "modes" in found.summary()
    assert found.estimate.total > found.levels[-1].estimate.total


def test_dropped_modes_are_seen():
    """Coordinates stiff enough not to matter are dropped unseen, soft ones are not."""
    laws = ContactLaws(friction=0.2)
    for high, limits in ((1e5, (0, 1e-4)), (3.0, (3e-4, 1.0))):
        solution = solve(ContactProblem(structure_with_modes(3.0, high), laws, 0.05, 5))
        estimate = estimate_modes(solution, [6, 7])
        without = solve(replace(solution.problem, model=drop_modes(solution.problem.model, [7])))
        assert limits[0] <= estimate <= limits[1]
        true = measure_distance(without, solution)
        assert true / 5 < estimate < 5 * true


def test_a_third_of_the_modes_are_looked_at():
    """Two of six: the highest by itself is too stiff to say anything."""
    full = structure_with_modes(0.5, 1.0, 1.5, 2.0, 3.0, 1e5)
    solution = solve(ContactProblem(full, ContactLaws(friction=0.2), 0.05, 5))
    true = [
        measure_distance(solve(replace(solution.problem, model=drop_modes(full, modes))), solution)
        for modes in ([11], [10, 11])
    ]
    assert true[0] < 1e-5 < 1e-2 < true[1]
    assert estimate_modes(solution, range(6, 12)) == pytest.approx(true[1], rel=0.2)


def test_modes_are_looked_at_under_the_loads_of_the_problem():
    """Loads given beside the model, in all its coordinates, count as if they were its own."""
    model = structure_with_modes(0.5, 1.0)
    load = {0: model.load[0], 1: model.load[1] * np.linspace(1.0, 3.0, 8)}
    own = ContactProblem(replace(model, load=load), ContactLaws(friction=0.2), 0.05, 5)
    beside = ContactProblem(model, ContactLaws(friction=0.2), 0.05, 5, load=load)
    found, expected = (estimate_modes(solve(problem, tolerance=1e-11), [6, 7]) for problem in (beside, own))
    assert found == pytest.approx(expected, rel=1e-6) and 3e-4 < expected < 1.0


def test_static_responses_beside_the_modes_take_the_place_of_the_highest():
    """Loads on modes so stiff that they follow: left out they are missed, and a model with responses misses nothing."""
    model = structure_with_modes(0.5, 1.0, 1e4, 2e4)
    load = {0: model.load[0], 1: model.load[1] + 5e2 * np.array([*np.zeros(8), 1.0, 2.0])}
    outputs = {"tip": model.outputs["tip"] + np.array([*np.zeros(9), 10.0])}
    solution = solve(ContactProblem(replace(model, load=load, outputs=outputs), ContactLaws(friction=0.2), 0.05, 5))
    missed = estimate_modes(solution, range(6, 10))
    beside = estimate_modes(solution, ModesBesideResponses(range(6, 10), ()))
    assert missed > 0.01 and beside < 1e-4
    assert beside > 0, "what the mode does besides is looked at"


def test_inertia_that_is_lacking_makes_full_stick_as_slow_as_it_is():
    model = structure_with_modes(0.5, 1.0, 1e4)
    squares, shapes = solve_stuck(model, count=3)
    asked = np.sqrt(squares * [0.99, 1.0, 0.9]) / (2 * np.pi)
    corrected = correct_inertia(model, tuple(asked))
    found, turned = solve_stuck(corrected)
    np.testing.assert_allclose(found[:3], squares * [0.99, 1.0, 0.9], rtol=1e-10)
    np.testing.assert_allclose(found[3:], solve_stuck(model)[0][3:], rtol=1e-10)
    aligned = np.abs(np.sum(turned[:, :3] * (model.mass @ shapes), axis=0))
    np.testing.assert_allclose(aligned, np.sqrt([0.99, 1.0, 0.9]), rtol=1e-10, err_msg="the shapes are as before")
    np.testing.assert_array_equal(corrected.stiffness, model.stiffness)
    assert np.linalg.eigvalsh(corrected.mass - model.mass)[0] > -1e-12, "no mode has less inertia"


def test_what_not_even_a_stuck_joint_holds_keeps_its_inertia():
    """A body that turns about its only pair: its frequency is rounding, here 3e-9 Hz and 1e-9 Hz."""
    stiffness = [[4e-16, 0.0, 0.0], [0.0, 1.0, -1.0], [0.0, -1.0, 3.0]]
    model = ReducedModel(np.eye(3), np.zeros((3, 3)), stiffness, normal=[[0.0, 1.0, 0.0]], rigid_modes=np.eye(3)[:, :1])
    corrected = correct_inertia(model, (1e-9, 0.9 * np.sqrt(3) / (2 * np.pi)))
    np.testing.assert_allclose(corrected.mass[0], [1.0, 0.0, 0.0])
    assert corrected.mass[2, 2] == pytest.approx(1 / 0.81)


def test_next_to_a_resonance_the_frequencies_of_full_stick_tell_what_modes_are_lacking():
    """Dropping modes moves the resonance by far less than those do that there never were."""
    full = structure_with_modes(0.5, 1.0, 40.0, 60.0, 2.0, 3.0)
    stuck = np.sqrt(solve_stuck(full, count=3)[0]) / (2 * np.pi)
    few = drop_modes(full, (10, 11))
    posed = (ContactProblem(model, ContactLaws(friction=5.0), 0.999 * stuck[0], 3) for model in (full, few))
    whole, lacking = map(solve, posed)
    true, modes = measure_distance(lacking, whole), range(6, 10)
    without, told = (estimate_modes(lacking, ModesBesideResponses(modes, (), known)) for known in ((), stuck))
    assert 4 * without < true / 3 < told < 3 * true


def test_modes_that_are_too_few_are_the_limit():
    """The lift-off oscillator's first mass as if it were a modal coordinate: without it all is different."""
    found = solve_to_accuracy(
        ContactProblem(lift_off_oscillator(), ContactLaws(friction=0.3), 0.7 / (2 * np.pi)), 0.01, modes=[0]
    )
    assert not found.reached
    assert "the 1 modes of the reduced model leave an error of" in found.limit


def test_wear_that_finds_nothing_with_more_modes_goes_on_with_those_that_it_has(monkeypatch):
    """Their coordinates are those of the model that its solution is on, which the error by modes is estimated with."""
    full, asked = structure_with_modes(0.5, 1.0, 1.5, 2.0, 1e5, 2e5, 3e5, 4e5), []

    def keep(count: int) -> tuple[ContactProblem, range]:
        asked.append(count)
        model = drop_modes(full, range(6 + count, 14))
        return ContactProblem(model, ContactLaws(friction=0.2), 0.05), range(6, 6 + count)

    problem, modes = keep(1)
    judge = AccurateWear(problem, 10, np.full(2, 1e-6), 0.1, 1e-8, {"most_modes": 1}, TriedModels(problem, modes, keep))
    fresh = judge.begin(np.zeros(2))
    assert fresh.estimate > 0.1, "or there is no need for more"
    find = levels.solve

    def fail_with_more(posed, *given, **options):
        if posed.model.size > 7:
            raise NotConverged("no solution", best=fresh.solution)
        return find(posed, *given, **options)

    judge.choice["most_modes"] = 8
    monkeypatch.setattr(levels, "solve", fail_with_more)
    for _ in range(2):
        looked_at = judge.look_at(fresh)
        assert asked.pop() == 2 and looked_at.solution.problem.model.size == 7
        assert looked_at.estimate == estimate_errors(looked_at.solution, modes, judge._rate).total > 0.1
    monkeypatch.undo()
    assert judge.look_at(fresh).estimate <= 0.1 and asked[-1] == 8


def test_wear_to_an_accuracy_goes_on_with_the_modes_that_it_raised(tmp_path, monkeypatch):
    """Its file, of models that are made again, is that of an unbroken run to the last byte."""
    full, asked = structure_with_modes(0.5, 1.0, 1.5, 2.0, 1e5, 2e5, 3e5, 4e5), []

    def keep(count: int) -> tuple[ContactProblem, range]:
        asked.append(count)
        model = drop_modes(full, range(6 + count, 14))
        return ContactProblem(model, ContactLaws(friction=0.2), 0.05), range(6, 6 + count)

    def run(name: str) -> WearHistory:
        problem, modes = keep(1)
        asked.clear()
        choice = {"accuracy": 0.05, "modes": modes, "more_modes": keep, "most_modes": 8}
        return evolve_wear(problem, 6, 1e-4, file=tmp_path / name, progress=False, **choice)

    whole = run("whole.h5")
    assert asked == [2, 4, 8] and len({step.problem.model for step in whole.solutions}) == 1
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        count_calls(patch, cycle_jumps, "solve_from", 3)
        run("broken.h5")
    with monkeypatch.context() as patch:
        calls = count_calls(patch, cycle_jumps, "solve_from")
        history = run("broken.h5")
    assert asked == [2, 4, 8] and len(calls) == 3, "the models, and what was left to solve"
    assert history.solutions[-1].problem.model.size == 14
    np.testing.assert_array_equal(history.depth, whole.depth)
    assert (tmp_path / "broken.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()
