"""Whether a motion in time is steady, and how far it is from that."""

from __future__ import annotations

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate
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
