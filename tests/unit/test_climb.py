"""Cold starts through growing sets of harmonics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solver import ladder


@pytest.fixture
def distance() -> list[float]:
    """Residual that is left with harmonics up to 15."""
    return [0.1]


@pytest.fixture
def visited(monkeypatch, distance) -> list[int]:
    """Highest harmonics of the sets below the last one that are tried; up to 15 there is no solution."""
    tops: list[int] = []
    original = ladder.run_newton

    def run(level, *arguments, **options):
        tops.append(level.basis.orders[-1])
        attempt = original(level, *arguments, **options)
        if tops[-1] != 15:
            return attempt
        return replace(attempt, converged=False, residual=distance[0], reason="none here")

    monkeypatch.setattr(ladder, "run_newton", run)
    return tops


@pytest.fixture(scope="module")
def balance() -> HarmonicBalance:
    return HarmonicBalance(ContactProblem(dovetail(), ContactLaws(friction=0.3), 600.0, 31).system)


def test_in_large_joints_no_larger_set_is_tried_where_there_is_no_solution(balance, visited, monkeypatch):
    """What is found there stands in the whole set, with harmonics that are left at zero, and its residual."""
    monkeypatch.setattr(ladder, "LARGEST_TRACED", balance.size - 1)
    found = ladder.climb(balance, 1e-8, "elimination", ladder.COARSE_LEVELS)
    assert visited == [5, 15] and not found.converged
    assert found.reason == "none here; harmonics up to 5 were solved for"
    forces = balance.unpack(found.unknowns)[0]
    assert np.all(np.any(forces[:16], axis=1)) and not np.any(forces[16:])
    assert found.residual == np.linalg.norm(balance.residual(found.unknowns))


@pytest.mark.parametrize(("left", "large", "rungs"), [(0.1, True, 1), (0.1, False, 0), (1e-3, True, 0)])
def test_all_sets_are_tried_in_small_joints_next_to_a_solution_or_with_rungs(
    balance, visited, distance, monkeypatch, left, large, rungs
):
    distance[0] = left
    monkeypatch.setattr(ladder, "LARGEST_TRACED", balance.size - large)
    vain = lambda level, goal, failed: failed  # noqa: E731
    found = ladder.climb(balance, 1e-8, "elimination", ladder.COARSE_LEVELS, (vain,) * rungs)
    assert visited == [5, 15] and found.converged and found.residual <= 1e-8


@pytest.mark.parametrize("closure", ["mass", "dashpot", "spring"])
@pytest.mark.parametrize("gap", [1e-3, 20.0])
def test_bodies_that_never_touch_take_no_step(gap, closure):
    """A mass that could rub on what it never reaches took 23 steps, and farther away all of the ladder."""
    model = ReducedModel(
        np.eye(2),
        20.0 * np.eye(2),
        [[2e6, -1e6], [-1e6, 2e6]],
        normal=[[0.0, -1.0]],
        tangential=[[1.0, 0.0]],
        load={0: [0.0, 50.0], 1: [30.0, 20.0]},
    )
    laws = ContactLaws(friction=0.3, initial_gap=gap)
    solution = solve(ContactProblem(model, laws, 150.0, closure=closure))
    assert solution.iterations == 0 and not solution.fallbacks and not np.any(solution.forces)
    assert solution.history("gap", 64).min() > 0.5 * gap
