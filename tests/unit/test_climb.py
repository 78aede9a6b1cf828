"""Cold starts through growing sets of harmonics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solution.symmetry import leave_out_idle
from ewr_fenicsx.solver import ladder
from ewr_fenicsx.solver.growing_sets import add_harmonics
from ewr_fenicsx.solver.snes import Attempt, run_newton


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


def test_corners_are_rounded_in_somewhat_larger_joints_than_others_are_traced(monkeypatch):
    balance = HarmonicBalance(ContactProblem(dovetail(), ContactLaws(friction=0.3), 600.0, 5).system)
    lost = ladder.begin_at_full_stick(balance)
    monkeypatch.setattr(ladder, "LARGEST_TRACED", balance.size - 1)
    found = ladder.sharpen_corners(balance, 1e-8, lost)
    assert found.converged and np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8
    monkeypatch.setattr(ladder, "LARGEST_ROUNDED", balance.size - 1)
    assert ladder.sharpen_corners(balance, 1e-8, lost) is lost


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


def rub(stiffness: float, harmonics, normal_force=1.0, **given) -> ContactProblem:
    """A mass that rubs."""
    mass = ReducedModel(
        mass=[[1.0]], damping=[[1.0]], stiffness=[[stiffness]], tangential=[[1.0]], load={1: [1.0]},
        outputs={"mass": [1.0]},
    )  # fmt: skip
    laws = ContactLaws(normal="prescribed", normal_force=normal_force, friction=0.3)
    return ContactProblem(mass, laws, 30.0, harmonics, **given)


@pytest.mark.parametrize(
    ("kept", "more"),
    [
        (3, (0, 1, 2, 3, 4, 5, 6)),
        (1, (0, 1, 2)),
        ((1, 3, 5), (1, 3, 5, 7, 9)),  # as symmetry leaves them
        ((1,), (1, 3)),
        ((0, 1), (0, 1, 3)),
        ((0, 1, 4), (0, 1, 4, 7)),
    ],
)
def test_harmonics_are_added_as_far_apart_as_the_last_two(kept, more):
    few = rub(1e4, kept, samples=64, closure="dashpot")
    many = add_harmonics(few, 2)
    assert many.basis.orders == more and few.system.laws[-1].rho == pytest.approx(many.system.laws[-1].rho)


def test_what_is_added_by_symmetry_does_not_stay_zero():
    assert add_harmonics(leave_out_idle(rub(1e4, 1)), 2).basis.orders == (1, 3)


def test_with_more_harmonics_the_laws_are_the_same():
    """Beyond them the mass would move by itself, and its law would remember; samples still tell what is given."""
    few = rub(1e6, 4, {0: 1.0, 150: 0.2}, samples=512)
    assert few.system.closures == () and replace(few, harmonics=8).system.closures == ("masses",)
    assert add_harmonics(few, 2).system.closures == () and add_harmonics(few, 2).basis.samples == 512


@pytest.fixture(scope="module")
def sets():
    """A balance, the same with more harmonics, and the solution with these."""
    problem = ContactProblem(dovetail(), ContactLaws(friction=0.3), 30.0, 3)
    above = HarmonicBalance(add_harmonics(problem, 2).system)
    found = run_newton(above, above.pack(*above.full_stick), 1e-9, "elimination")
    assert found.converged
    return HarmonicBalance(problem.system), above, found


@pytest.mark.parametrize("at_once", [True, False])
def test_it_comes_down_to_fewer_harmonics(sets, at_once, monkeypatch):
    balance, above, found = sets
    seen, run = [], ladder.run_and_follow
    monkeypatch.setattr(ladder, "run_and_follow", lambda b, *a, **k: seen.append(b.basis.orders[-1]) or run(b, *a, **k))
    if not at_once:
        monkeypatch.setattr(ladder, "split_at_length", lambda *_: None)
    down = ladder.come_down(balance, above, found, 1e-9, "elimination")
    assert down.converged and np.linalg.norm(balance.residual(down.unknowns)) <= 1e-9
    assert seen == ([] if at_once else [5, 4, 3])
    cold = run_newton(balance, balance.pack(*balance.full_stick), 1e-9, "elimination")
    np.testing.assert_allclose(down.unknowns, cold.unknowns, rtol=0, atol=1e-6)


def test_it_says_down_to_where_it_came(sets, monkeypatch):
    balance, above, found = sets
    run = ladder.run_and_follow
    lost = lambda b, start, *_, **__: Attempt(start, 0.1, 7, "as if", False)  # noqa: E731
    monkeypatch.setattr(ladder, "split_at_length", lambda *_: None)
    monkeypatch.setattr(
        ladder, "run_and_follow", lambda b, *a, **k: (run if b.basis.orders[-1] > 4 else lost)(b, *a, **k)
    )
    down = ladder.come_down(balance, above, found, 1e-9, "elimination")
    assert not down.converged and down.iterations >= 7
    assert down.reason == "what solves harmonics up to 5 led to nothing up to 4"
    assert down.residual == pytest.approx(np.linalg.norm(balance.residual(down.unknowns)))


@pytest.mark.parametrize("walks", [True, False])
def test_a_splitting_that_ends_nearest_is_what_is_left(sets, walks, monkeypatch):
    balance, above, found = sets
    near = Attempt(np.zeros(balance.size), 1e-3, 3, "near", False, walks=walks)
    lost = lambda b, start, *_, **__: Attempt(start, 0.1, 7, "as if", False)  # noqa: E731
    monkeypatch.setattr(ladder, "split_at_length", lambda b, *_: near if b is balance else None)
    monkeypatch.setattr(ladder, "run_and_follow", lost)
    down = ladder.come_down(balance, above, found, 1e-9, "elimination")
    assert down.unknowns is near.unknowns and down.walks == walks and down.iterations == (3 if walks else 10)
