"""``solve`` with an accuracy: the solution of ``solve_to_accuracy``, with its error beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import PROBLEMS

from ewr_fenicsx import newton, solve, solve_to_accuracy
from ewr_fenicsx.errors import ModelError, NotConverged

JOINT = PROBLEMS["lift-off"]


def test_an_accuracy_chooses_the_harmonics_and_tells_the_error():
    found, solution = solve_to_accuracy(JOINT, 0.03), solve(JOINT, accuracy=0.03)
    assert solution.orders == found.solution.orders != JOINT.basis.orders
    np.testing.assert_array_equal(solution.forces, found.solution.forces)
    assert solution.estimated_error == found.estimate.total <= 0.03 and not solution.short
    assert f"estimated error {solution.estimated_error:.1g}" in solution.summary()
    assert "NOT as accurate" not in solution.summary()


def test_without_an_accuracy_the_harmonics_are_those_of_the_problem_and_nothing_is_estimated():
    solution, plain = solve(JOINT, tolerance=1e-10), newton.solve(JOINT, tolerance=1e-10)
    np.testing.assert_array_equal(solution.forces, plain.forces)
    assert np.isnan(solution.estimated_error) and "estimated" not in solution.summary()


def test_what_falls_short_says_why(monkeypatch):
    monkeypatch.setattr("ewr_fenicsx.accuracy.MOST_HARMONICS", 5)
    solution = solve(JOINT, accuracy=1e-6)
    assert solution.converged and solution.estimated_error > 1e-6
    assert solution.short == "harmonic 5 is the highest allowed; allow more, or ask for less"
    assert f"NOT as accurate as asked: {solution.short}" in solution.summary()


def test_a_solve_that_fails_raises_or_returns_the_best_iterate(monkeypatch):
    best = solve(JOINT)

    def fail(*_, **__):
        raise NotConverged("as if", best=replace(best, converged=False))

    monkeypatch.setattr("ewr_fenicsx.accuracy.solve", fail)
    with pytest.raises(NotConverged, match="as if"):
        solve(JOINT, accuracy=0.1)
    assert not solve(JOINT, accuracy=0.1, raise_on_failure=False).converged


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"accuracy": 1.0}, "accuracy = 1.0; give a relative error between 0 and 1"),
        ({"accuracy": 0.1, "linear_solver": "dense"}, "linear_solver and fallbacks: an accuracy, .* leave them out"),
        ({"accuracy": 0.1, "fallbacks": False}, "linear_solver and fallbacks: an accuracy, .* leave them out"),
    ],
)
def test_what_an_accuracy_does_not_take_is_refused(choice, message):
    with pytest.raises(ModelError, match=message):
        solve(JOINT, **choice)
