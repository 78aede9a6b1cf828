"""A body in a groove: only along it can it walk, whatever its pairs slide across it while it swings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import pytest
from counted_calls import count_calls

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.in_time import walking
from ewr_fenicsx.runs.study import UNSEEN, _look_at
from ewr_fenicsx.solution import solution as solutions
from ewr_fenicsx.structure.chain import Stopwatch

ALONG, ACROSS = 2, 9  # coordinates: of the block along the groove, and of the mass that swings across it


def lie_in_groove(loads: Mapping[int, Sequence[tuple[int, complex]]], harmonics: int) -> ContactProblem:
    """A block of 1 kg that weighs 10 N, on the two flanks of a V; a mass of 1 kg swings on it.

    Coordinates: x (across), y (up), z (along) of the block, then of the node under each pad; x of the swinging mass.
    """
    half = np.sqrt(0.5)
    frames = half * np.array([[[1, 1, 0], [1, -1, 0]], [[-1, 1, 0], [1, 1, 0]]])
    rows = np.zeros((2, 3, 10))
    for k, flank in enumerate(frames):
        rows[k, :2, :3] = flank
        rows[k, 2, ALONG] = 1.0
        rows[k, :, 3 + 3 * k : 6 + 3 * k] = -rows[k, :, :3]
    stiffness = np.diag([0.0] * 3 + [1e4] * 6 + [0.0])
    stiffness[np.ix_([0, ACROSS], [0, ACROSS])] += 300.0 * np.array([[1, -1], [-1, 1]])
    load = {0: -10.0 * np.eye(10)[1]}
    for h, forces in loads.items():
        load[h] = load.get(h, 0) + sum(force * np.eye(10)[i] for i, force in forces)
    model = ReducedModel(
        np.diag([1.0] * 3 + [0.05] * 6 + [1.0]),
        1e-4 * stiffness,
        stiffness,
        rows[:, 0],
        rows[:, 1:].reshape(4, 10),
        load,
        outputs={"along": np.eye(10)[ALONG]},
    )
    return ContactProblem(model, ContactLaws(friction=0.3), 3.0, harmonics)


@pytest.fixture
def watched(monkeypatch):
    """Steps of every period that is looked at."""
    periods, step_from = [], walking.step_from

    def step(motion, steps, theta):
        for period in step_from(motion, steps, theta):
            periods.append(steps)
            yield period

    monkeypatch.setattr(walking, "step_from", step)
    return periods


def test_what_pairs_slide_across_the_groove_is_no_walk(watched):
    """One harmonic throws the mass off: it swings on for longer than is looked at, and pairs creep across flanks."""
    solution = solve(lie_in_groove({1: [(ACROSS, 2.0)]}, 1))
    assert solution.merit["J_T"] > 1e-3, "they slide"
    assert solution.walks_slowly is None and "walk" not in solution.summary()
    assert watched == [walking.STEPS_IN_TIME] * (walking.WATCHED // 3), "nothing goes along: seen at once"


def test_a_walk_along_the_groove_is_told():
    """Pushed along it by a force and its octave, of which friction leaves a little over."""
    problem = lie_in_groove({1: [(ALONG, 5.0)], 2: [(ALONG, 0.02)]}, 7)
    begun = integrate(problem, steps=4000, periods=40, tolerance=0)
    ends = begun.transient("along")[::4000]
    way = abs(ends[-1] - ends[-2])
    assert way > 1e-6 and abs(ends[-2] - ends[-3]) == pytest.approx(way, rel=1e-2), "it has settled to that"
    assert solve(problem).walks_slowly.way == pytest.approx(way, rel=0.05)


def test_rigid_motions_that_pressed_pairs_leave_free():
    (along,) = walking.find_free_motions(solve(lie_in_groove({1: [(ACROSS, 0.5)]}, 1))).T
    assert along[ALONG] != 0 and np.abs(np.delete(along, ALONG)).max() < 1e-12 * abs(along[ALONG])


def test_long_joints_are_not_looked_at_with_ever_shorter_steps(watched, monkeypatch):
    """The work grows with the square of the rows: a blade root of 360 pairs took hours."""
    problem = lie_in_groove({1: [(ALONG, 5.0)], 2: [(ALONG, 0.02)]}, 7)
    assert solve(problem).walks_slowly
    finest = max(watched)
    watched.clear()
    monkeypatch.setattr(walking, "MOST_WORK", finest * problem.system.rows.shape[0] ** 2 - 1)
    assert solve(problem).walks_slowly
    assert all(b >= a for a, b in pairwise(watched)) and walking.STEPS_IN_TIME < finest > max(watched)


def test_a_look_that_was_interrupted_is_not_taken_again(monkeypatch):
    """What is left to do is to write the solution, which asked again, and went on for as long."""
    solution = solve(lie_in_groove({1: [(ACROSS, 2.0)]}, 1))
    count_calls(monkeypatch, solutions, "watch_walk", 0)
    told, lacking = _look_at(solution.summary, Stopwatch(None), None, solution)
    assert lacking and UNSEEN in told
    assert solution.walks_slowly is None
