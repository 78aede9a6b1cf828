"""Whether a motion in time is steady, and how far it is from that."""

from __future__ import annotations

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.in_time.time_stepping import State


@pytest.mark.parametrize("acceleration", [False, True])
@pytest.mark.parametrize("start", ["rest", State(np.array([0.01, 0.01]), np.zeros(2))])
def test_what_comes_to_rest_is_steady_and_nowhere_else(start, acceleration):
    """Relative to the rounding that alone still moved, it was some way off, and for ever where it was accelerated."""
    springs, pulled = [[2e3, -1e3], [-1e3, 1e3]], {0: [5.0, 0.0]}
    model = ReducedModel(np.diag([1.0, 0.0]), np.diag([3.0, 0.0]), springs, [[0.0, 1.0]], load=pulled)
    problem = ContactProblem(model, ContactLaws(tangential="frictionless", initial_gap=-1e-3), 5.0, 0)
    resting = integrate(problem, start, steps=400, periods=100, acceleration=acceleration)
    assert resting.converged and resting.distance < 1e-3
    assert resting.end.position[0] == pytest.approx(5e-3, rel=1e-6)


@pytest.mark.parametrize("outputs", [{}, {"contact": [0.0, 1.0]}])
def test_masses_behind_pairs_that_hold_are_followed_without_an_output(outputs):
    """Steady after two periods they were, for no pair moves; the force on it was to grow by a factor of sixteen."""
    springs, loads = [[2e3, -1e3], [-1e3, 2e3]], {0: [0.0, -40.0], 1: [1.0, 0.0]}
    model = ReducedModel(np.diag([1.0, 0.1]), 0.6 * np.eye(2), springs, [[0.0, 1.0]], load=loads, outputs=outputs)
    problem = ContactProblem(model, ContactLaws(tangential="frictionless"), np.sqrt(2e3) / (2 * np.pi), 3)
    begun = integrate(problem, "rest", steps=400, periods=20)
    assert not begun.converged and "falls steadily" in begun.reason
    settled = integrate(problem, "rest", steps=400, periods=300)
    swing = np.ptp(solve(problem).history("normal_force", 400))
    assert settled.converged and np.ptp(settled.history("normal_force")) == pytest.approx(swing, rel=2e-3)
