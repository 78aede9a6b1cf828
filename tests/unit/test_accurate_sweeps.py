"""Sweeps whose every point is as accurate as asked: harmonics point by point, folds, files, what cannot be reached."""

from __future__ import annotations

import csv
from dataclasses import replace

import h5py
import numpy as np
import pytest
from checked_solutions import find_turns, measure_residual
from small_models import lift_off_oscillator, stop_oscillator
from test_frequency_response import FREQUENCIES, LAWS, sweep

from ewr_fenicsx import ContactLaws, ContactProblem, frequency_response, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import estimate_errors, measure_distance
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.response import frequency_sweep, refining, sweep_store
from ewr_fenicsx.response.following import LARGEST_SURPRISE, Jump
from ewr_fenicsx.response.refining import CLOSE, join_points, leave_out_close, measure_gap, refine_point
from ewr_fenicsx.response.solution_store import read_records, restore

ACCURACY = 0.02


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Of the results of ``curve``."""
    return tmp_path_factory.mktemp("curve")


@pytest.fixture(scope="module")
def curve(folder):
    return sweep(accuracy=ACCURACY, folder=folder)


def test_every_point_of_an_accurate_sweep_is_as_accurate_as_asked(curve):
    """Against a sweep with many harmonics, and against single solves to the same accuracy, from cold."""
    model = curve.solutions[0].problem.model
    truth = frequency_response(model, LAWS, FREQUENCIES, 60, progress=False)
    for found, true in zip(curve.accurate, truth.solutions, strict=True):
        assert found.reached and found.estimate.total <= ACCURACY
        assert measure_distance(found.solution, true) <= ACCURACY
        single = solve_to_accuracy(ContactProblem(model, LAWS, true.problem.frequency), ACCURACY)
        assert measure_distance(found.solution, single.solution) <= 2 * ACCURACY
    tops = [s.orders[-1] for s in curve.solutions]
    assert len(set(tops)) > 1, "harmonics are chosen at each frequency"
    assert [found.solution for found in curve.accurate] == list(curve.solutions)
    table = curve.table()
    np.testing.assert_array_equal(table["highest_harmonic"], tops)
    np.testing.assert_array_equal(table["estimate"], [found.estimate.total for found in curve.accurate])
    assert f"|tip| harmonic {max(tops)}" in table
    lean = tops.index(min(tops))
    assert curve.output("tip")[lean, curve.orders.index(max(tops))] == 0.0, "a harmonic that this one has not"


def test_an_interrupted_accurate_sweep_goes_on_from_the_points_on_disk(tmp_path, monkeypatch):
    """Of two laws, each with points of its own, in the middle of a group; with another accuracy it begins anew."""
    family = {0.3: LAWS, 0.4: replace(LAWS, friction=0.4)}
    monkeypatch.setattr(refining, "GROUP", 3)
    monkeypatch.setattr(sweep_store, "WORTH", 0.0)
    whole = sweep(laws=family, accuracy=0.02)
    solved, refine = [], refining.refine_point

    def count(problem, *arguments):
        if len(solved) == limit:
            raise KeyboardInterrupt
        solved.append(problem.frequency)
        return refine(problem, *arguments)

    monkeypatch.setattr(refining, "refine_point", count)
    limit = 5
    with pytest.raises(KeyboardInterrupt):
        sweep(laws=family, accuracy=0.02, folder=tmp_path)
    limit = np.inf
    again = sweep(laws=family, accuracy=0.02, folder=tmp_path)
    assert solved == [*FREQUENCIES, *FREQUENCIES], "each once"
    limit = len(solved)
    summarise = lambda curves: [  # noqa: E731
        (f.estimate.total, f.reached, f.limit, [level.orders for level in f.levels])
        for curve in curves.values()
        for f in curve.accurate
    ]
    for curves in (again, sweep(laws=family, accuracy=0.02, folder=tmp_path)):
        assert summarise(curves) == summarise(whole)
        for label, curve in curves.items():
            np.testing.assert_array_equal(curve.output("tip"), whole[label].output("tip"))
    with pytest.raises(KeyboardInterrupt):
        sweep(laws=family, accuracy=0.1, folder=tmp_path)


def test_a_finer_sweep_gives_the_same_curve(curve):
    fine = sweep(np.linspace(0.08, 0.4, 17), accuracy=ACCURACY)
    for here, there in zip(curve.accurate, fine.accurate[::2], strict=True):
        assert measure_distance(here.solution, there.solution) <= 2 * ACCURACY


def test_points_that_are_not_as_accurate_as_asked_say_why():
    curve = sweep(FREQUENCIES[2:4], accuracy=1e-6)
    assert not any(found.reached for found in curve.accurate)
    assert all("harmonic 63 is the highest allowed" in found.limit for found in curve.accurate)
    assert (curve.table()["estimate"] > 1e-6).all()


def test_a_point_without_a_more_accurate_solution_stays_and_says_so(monkeypatch):
    def fail(problem, *_, **__):
        raise NotConverged("lost", best=solve(problem))

    monkeypatch.setattr(refining, "solve_to_accuracy", fail)
    coarse, curve = sweep(), sweep(accuracy=0.02)
    np.testing.assert_array_equal(curve.output("tip"), coarse.output("tip"))
    assert not any(found.reached for found in curve.accurate)
    assert all(found.limit.startswith("no solution found with harmonics up to 5") for found in curve.accurate)
    assert [found.estimate.total for found in curve.accurate] == [estimate_errors(s).total for s in coarse.solutions]


def test_a_point_without_a_more_accurate_solution_is_solved_on_a_model_with_more_modes(monkeypatch):
    """Its forces are not a solution there, though they were one before."""

    def fail(problem, *_, **__):
        raise NotConverged("lost", best=solve(problem))

    monkeypatch.setattr(refining, "solve_to_accuracy", fail)
    curve = sweep()
    model = curve.solutions[0].problem.model
    stiffer = replace(model, stiffness=1.1 * model.stiffness)
    problem = ContactProblem(stiffer, LAWS, FREQUENCIES[0], 5)
    for found in refining.refine_points(problem, curve.solutions, 0.02):
        left = measure_residual(found.solution)
        assert found.solution.problem.model is stiffer and found.solution.converged and left < 1e-8
        assert not found.reached and found.limit


def test_an_accurate_curve_may_begin_with_the_mean_alone():
    at_rest = replace(model := lift_off_oscillator(), load={0: model.load[0]})
    curve = frequency_response(at_rest, LAWS, FREQUENCIES[:2], harmonics=0, accuracy=0.01, progress=False)
    assert all(found.reached for found in curve.accurate)


def test_an_accurate_curve_goes_round_its_folds():
    """With more harmonics the upper fold comes earlier: points that fall off there go, the rest is one curve."""
    model, laws = stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0)
    frequencies = np.linspace(0.15, 0.18, 7)
    curve = frequency_response(model, laws, frequencies, 7, progress=False, accuracy=0.01)
    assert curve.jumps == () and curve.missing == ()
    assert set(frequencies) <= set(curve.frequencies)
    assert all(found.reached for found in curve.accurate)
    turns = find_turns(curve.frequencies)
    assert len(turns) == 2
    # between the folds the response falls all the way but for the accuracy: no point is one of another branch
    heights = np.abs(curve.output("tip")[turns[0] : turns[1] + 1, curve.orders.index(1)])
    assert (np.diff(heights) < 0.01 * heights[:-1]).all()
    assert heights[0] > 1.7 and heights[-1] < 1.01


def test_a_curve_that_falls_off_its_branch_is_broken_there():
    """A point from the lower branch in place of the upper one: told where it is wanted, left out elsewhere."""
    model, laws = stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0)
    upper = frequency_response(model, laws, [0.160, 0.165, 0.166, 0.167], 7, progress=False)
    found = [solve_to_accuracy(s.problem, 0.02, s) for s in upper.solutions]
    lower = None
    for frequency in (0.18, 0.172, 0.169, 0.166):
        lower = solve(replace(upper.solutions[2].problem, frequency=frequency), lower)
    fallen = [*found[:2], replace(found[2], solution=lower), found[3]]
    frequencies = list(upper.frequencies)
    assert join_points(upper.solutions, found, frequencies)[1] == []
    kept, jumps = join_points(upper.solutions, fallen, frequencies)
    assert kept == fallen
    assert [jump.frequency for jump in jumps] == [(0.165, 0.166), (0.166, 0.167)]
    kept, jumps = join_points(upper.solutions, fallen, [0.160, 0.165, 0.167])
    assert kept == [fallen[0], fallen[1], fallen[3]] and jumps == []


def test_far_from_the_point_before_only_what_hangs_together_with_it_stays():
    """As where points between have gone: the first curve's gap is as wide as that to the other branch."""
    model, laws = stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0)
    upper = frequency_response(model, laws, [0.160, 0.166], 7, progress=False).solutions[-1]
    first = last = solve(replace(upper.problem, frequency=0.200))
    for frequency in (0.18, 0.172, 0.169, 0.166):
        last = solve(replace(upper.problem, frequency=frequency), last)
    accurate = {s: solve_to_accuracy(s.problem, 0.02, s) for s in (upper, first, last)}
    assert measure_gap(first, last) > 2 * LARGEST_SURPRISE and measure_gap(upper, last) > LARGEST_SURPRISE
    assert abs(measure_gap(first, upper) - measure_gap(first, last)) < LARGEST_SURPRISE
    for point, end, stays in ((last, upper, False), (upper, last, True)):
        found = [accurate[first], accurate[end]]
        assert join_points([first, point], found, [0.200]) == (found if stays else found[:1], [])


def test_a_curve_that_is_refined_again_tells_its_jumps_once(monkeypatch):
    """As with more modes; a jump told twice would break the curve at a second place."""
    curve, jump = sweep(accuracy=0.1), Jump((0.1, 0.2), "with more harmonics")
    monkeypatch.setattr(frequency_sweep, "join_points", lambda points, found, *_: (found, [jump]))
    problem = curve.solutions[0].problem
    for _ in range(2):
        curve = frequency_sweep.refine_response(curve, problem, curve.frequencies, 0.1)
        assert curve.jumps == (jump,)


def test_a_curve_that_is_refined_again_counts_all_its_solves():
    curve = sweep(accuracy=0.1)
    again = frequency_sweep.refine_response(curve, curve.solutions[0].problem, curve.frequencies, 0.1)
    for before, after in zip(curve.accurate, again.accurate, strict=True):
        assert after.levels[: len(before.levels)] == before.levels
        assert len(after.levels) > len(before.levels)


def test_accurate_curves_are_kept_in_files(curve, folder):
    """Forces of solutions with different harmonics in one array; each has its own rows."""
    with h5py.File(folder / "frequency_response.h5") as file:
        records = read_records(file["curve_0"])
        np.testing.assert_array_equal(file["curve_0/table/estimate"][()], curve.table()["estimate"])
    assert len({len(record.forces) for record in records}) > 1
    problem = ContactProblem(curve.solutions[0].problem.model, LAWS, 1.0)
    for record, solution in zip(records, curve.solutions, strict=True):
        back = restore(replace(problem, frequency=record.frequency), record)
        assert back.orders == solution.orders
        np.testing.assert_array_equal(back.output("tip"), solution.output("tip"))
        assert measure_residual(back) < 1e-8
    with (folder / "frequency_response.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["highest_harmonic"]) for row in rows] == [s.orders[-1] for s in curve.solutions]


def test_a_point_without_any_solution_on_the_model_is_missing(curve, monkeypatch):
    """With more modes than the curve that it comes from had, not even its own harmonics may lead to one."""
    refined, lost = dict(zip(curve.frequencies, curve.accurate, strict=True)), FREQUENCIES[3]
    refined[lost] = replace(refined[lost], solution=replace(refined[lost].solution, converged=False))
    monkeypatch.setattr(refining, "refine_point", lambda problem, *_: refined[problem.frequency])
    left = sweep(accuracy=ACCURACY)
    assert left.missing == (lost,) and lost not in left.frequencies
    assert len(left.solutions) == len(FREQUENCIES) - 1 == len(left.accurate)
    assert all(s.converged for s in left.solutions)


def test_a_point_that_crossed_a_fold_is_told_or_left_out():
    """The upper branch's solution in place of the unstable one: near enough to pass for it but for its side."""
    model, laws = stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0)
    curve = frequency_response(model, laws, np.linspace(0.15, 0.18, 7), 7, progress=False)
    points = [s for s in curve.solutions if s.side < 0 and 0.1697 < s.problem.frequency < 0.17055]
    assert len(points) >= 3
    upper = solve(points[1].problem, max(curve.solutions, key=lambda s: abs(s.output("tip")[1])))
    assert upper.side == 1 and 0.04 < measure_gap(points[1], upper) < LARGEST_SURPRISE
    found = [refine_point(s.problem, s, 0.02, 1e-8, 7) for s in points]
    assert join_points(points, found, []) == (found, [])
    found[1] = replace(found[1], solution=upper)
    kept, jumps = join_points(points, found, [])
    assert kept == [found[0], *found[2:]] and jumps == []
    kept, (jump, *_) = join_points(points, found, [points[1].problem.frequency])
    assert kept == found and "this is beyond its fold" in jump.why
    assert jump.frequency == (points[0].problem.frequency, points[1].problem.frequency)


def test_points_of_a_fold_that_lie_close_are_not_solved_again():
    """Where a solution is wanted it stays, and so do enough of the others for the folds to be seen."""
    model = stop_oscillator(excitation=0.08, damping=0.04, stop_stiffness=1.0)
    wanted = list(np.linspace(0.12, 0.22, 21))
    curve = frequency_response(
        model, ContactLaws(tangential="frictionless", initial_gap=1.0), wanted, harmonics=9, progress=False
    )
    kept = leave_out_close(curve.solutions, wanted)
    frequencies = [point.problem.frequency for point in kept]
    assert set(wanted) <= set(frequencies) and len(wanted) < len(kept) < len(curve.solutions)
    assert len(find_turns(frequencies)) == 2
    left_out = [point for point in curve.solutions if point not in kept]
    for point in left_out:
        assert min(measure_gap(point, other) for other in kept) <= CLOSE


def test_points_that_were_asked_for_between_the_frequencies_are_kept():
    """``refine`` promises how far neighbours may be apart."""
    coarse, curve = (sweep(FREQUENCIES[:4], refine=0.05, **settings) for settings in ({}, {"accuracy": 0.05}))
    np.testing.assert_array_equal(curve.frequencies, coarse.frequencies)
    assert len(leave_out_close(coarse.solutions, FREQUENCIES[:4])) < len(coarse.solutions), "or it proves nothing"
