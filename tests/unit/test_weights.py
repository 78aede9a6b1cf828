"""Weights of one's own, come to from the default ones: by splittings in stages, then along a path or the branch."""

from __future__ import annotations

import hard_cases
import numpy as np
import pytest

from ewr_fenicsx import solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solver import ladder, newton, newton_path, weights
from ewr_fenicsx.solver.continuation import BranchPoint
from ewr_fenicsx.solver.snes import Attempt


@pytest.fixture(scope="module")
def far():
    """A balance with a thousand times the default weight of friction, and the solution with that weight."""
    case = hard_cases.Case("lap joint", 1.0, ("reached", 3.0), 0.6, 9, 0.05, "closed", (1.0, 1e3))
    problem = hard_cases.pose_case(case)
    return HarmonicBalance(problem.system), solve(weights.use_default_weights(problem))


@pytest.fixture
def indirect(monkeypatch):
    """No run of Newton's method that leads there at once."""
    monkeypatch.setattr(weights, "DIRECT_STEPS", 0)


@pytest.fixture
def no_path(monkeypatch):
    """Laws that do not tell their corners."""
    monkeypatch.setattr(newton_path, "can_follow", lambda _: False)


@pytest.fixture
def not_from_afar(monkeypatch):
    """No path that begins at the default weights."""
    monkeypatch.setattr(weights, "follow_from_afar", lambda *_: None)


def approach(far) -> Attempt:
    return weights.approach_weights(*far, 1e-8, "elimination")


def lead_nowhere(monkeypatch) -> None:
    """One stage, whose splitting ends away from any solution; by itself this one arrives or not by chance."""
    monkeypatch.setattr(weights, "STAGES", weights.STAGES[-1:])
    monkeypatch.setattr(weights, "split_at_length", lambda *_: Attempt(np.zeros(0), np.inf, 0, "", False))


def test_stages_lead_where_one_splitting_does_not(far, indirect, no_path, monkeypatch):
    """To a solution of the asked balance; in one stage a walk has to follow, which takes several times the steps."""
    walks, walk = [], weights.walk_weights
    monkeypatch.setattr(weights, "walk_weights", lambda *given: walks.append(given[2]) or walk(*given))
    staged = approach(far)
    assert staged.converged and not walks
    assert np.linalg.norm(far[0].residual(staged.unknowns)) <= 1e-8
    lead_nowhere(monkeypatch)
    at_once = approach(far)
    assert walks and at_once.converged and at_once.iterations > 2 * staged.iterations


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_in_large_joints_what_is_far_off_is_not_tried_at_once(far, monkeypatch, share):
    """Some steps of seconds each hardly ever led anywhere; splittings do."""
    balance, usual = far
    tried, run = [], weights.run_and_follow
    monkeypatch.setattr(weights, "run_and_follow", lambda *given, **more: tried.append(given) or run(*given, **more))
    monkeypatch.setattr(weights, "LARGEST_STAGED", balance.size - 1)
    left = np.linalg.norm(balance.residual(balance.pack(usual.forces, usual.rigid)))
    monkeypatch.setattr(weights, "FAR_OFF", share * left)
    assert approach(far).converged and bool(tried) == (share > 1)


@pytest.mark.parametrize(("shares", "runs"), [((0.5,), 1), ((0.2, 0.5), 2), ((0.2, 0.2, 0.2, 0.9), 4)])
def test_straight_ahead_goes_on_as_long_as_it_closes_in(far, monkeypatch, shares, runs):
    """From where the run before ended; some steps that leave most of the residual are the last."""
    balance, usual = far
    begin, starts = balance.pack(usual.forces, usual.rigid), []
    left = np.linalg.norm(balance.residual(begin)) * np.cumprod(shares)

    def run(balance, start, *_, **__):
        starts.append(start)
        return Attempt(start + 1.0, left[len(starts) - 1], weights.DIRECT_STEPS, "too many Newton steps", False)

    monkeypatch.setattr(weights, "run_and_follow", run)
    last = weights._go_straight(balance, begin, 1e-8, "elimination")
    assert len(starts) == runs and last.iterations == runs * weights.DIRECT_STEPS and last.residual == left[-1]
    np.testing.assert_allclose(starts, begin + np.arange(runs)[:, None], rtol=0, atol=1e-12)


def test_where_little_slips_the_solution_with_default_weights_is_near_enough(far, monkeypatch):
    """No splitting, and no walk: a few Newton steps from there."""
    case = hard_cases.Case("lap joint", 0.5, ("reached", 0.3), 0.6, 5, 0.05, "closed", (1e3, 1e-3))
    problem = hard_cases.pose_case(case)
    monkeypatch.setattr(weights, "split_at_length", lambda *_: pytest.fail("no splitting is needed"))
    monkeypatch.setattr(weights, "LARGEST_STAGED", 0)  # what is near is tried in large joints, too
    usual = solve(weights.use_default_weights(problem))
    found = weights.approach_weights(HarmonicBalance(problem.system), usual, 1e-8, "elimination")
    assert found.converged and 0 < found.iterations <= weights.DIRECT_STEPS


@pytest.mark.parametrize(("factor", "at_once"), [(1e3, True), (1e-3, True), (3.0, False)])
def test_weights_far_off_begin_with_the_default_ones(factor, at_once, monkeypatch):
    """A cold start with weights a thousandfold off fails in a third of the cases, after forty steps.

    It is the first way then, and no fallback: that there may be other solutions need not be told.
    """
    case = hard_cases.Case("lap joint", 1.0, ("reached", 0.3), 0.6, 5, 0.05, "closed", (1.0, factor))
    problem = hard_cases.pose_case(case)
    assert weights.has_far_weights(problem) == at_once
    left, leave = [], newton.leave_default_weights
    monkeypatch.setattr(newton, "leave_default_weights", lambda *given: left.append(1) or leave(*given))
    solution = solve(problem)
    assert hard_cases.judge(solution)[0] == "converged" and solution.problem.rho_tangential is not None
    assert len(left) == at_once and solution.fallbacks == ()
    solve(problem, fallbacks=False, raise_on_failure=False)
    assert len(left) == at_once, "by itself it takes no ladder"


def test_a_walk_that_takes_long_is_given_up(far, indirect, no_path, monkeypatch):
    lead_nowhere(monkeypatch)
    monkeypatch.setattr(weights, "WALK_STEPS", 5)
    found = approach(far)
    assert not found.converged and "the branch was lost or too long" in found.reason


def test_large_joints_take_one_stage(far, indirect, monkeypatch):
    tried, split = [], weights.split_at_length
    monkeypatch.setattr(weights, "split_at_length", lambda level, *given: tried.append(level) or split(level, *given))
    monkeypatch.setattr(weights, "LARGEST_STAGED", far[0].size - 1)
    approach(far)
    assert tried == [far[0]]


@pytest.mark.parametrize(("lost", "begins"), [(False, 2 / 3), (True, 0.0)])
def test_a_walk_begins_where_splittings_end_and_else_at_the_default_weights(
    far, indirect, not_from_afar, monkeypatch, lost, begins
):
    balance, begun = far[0], []
    split, follow, run = weights.split_at_length, weights.follow, weights.run_newton
    monkeypatch.setattr(
        weights, "split_at_length", lambda level, *given: None if level is balance else split(level, *given)
    )
    monkeypatch.setattr(weights, "follow", lambda *given, **most: begun.append(given[-1]) or follow(*given, **most))
    if lost:  # as where what a splitting ends at is no solution

        def run_except_first(*given, **options):
            if given[4] == 0:
                return run(*given, **options)
            monkeypatch.setattr(weights, "run_newton", run)
            return Attempt(given[1], np.inf, 1, "", False)

        monkeypatch.setattr(weights, "run_newton", run_except_first)
    found = approach(far)
    assert begun == [f"of the way from {begins:.0%} to the asked weights"]
    assert found.converged and np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8


def test_a_path_arrives_where_splittings_end_and_a_walk_is_lost(monkeypatch):
    """It took 210 steps, which ended with the default weights as the answer; a thousand corners lead to those asked."""
    case = hard_cases.Case("lap joint", 1.05, ("applied", 0.3), 1.5, 9, 0.02, "random", (1e-3, 1e-3))
    problem = hard_cases.pose_case(case)
    monkeypatch.setattr(weights, "walk_weights", lambda *_: pytest.fail("no walk is needed"))
    solution = solve(problem)
    assert solution.problem is problem and hard_cases.judge(solution)[0] == "converged"
    assert solution.iterations <= 60


def test_weights_on_the_way_are_even_in_their_logarithms(far):
    balance, usual = far
    at = weights.blend_weights(usual.problem.system, balance)
    friction = [at(share).system.laws[-1].rho for share in (0, 0.5, 1)]
    np.testing.assert_allclose(friction[1] / friction[0], np.sqrt(1e3))
    np.testing.assert_allclose(friction[2] / friction[1], np.sqrt(1e3))


def test_a_branch_that_leads_away_is_left(far, monkeypatch):
    """It went on for hundreds of points, and the failure told where it was in percents of sixty digits."""
    balance, usual = far
    unknowns, yielded = balance.pack(usual.forces, usual.rigid), []

    def run_away(at, here, *given, **options):
        for k in range(1, 100):
            yielded.append(BranchPoint(-(10.0**k), here.unknowns, 1))
            yield yielded[-1]

    monkeypatch.setattr(ladder, "trace_branch", run_away)
    failed = Attempt(unknowns, np.inf, 0, "", False)
    last = ladder.follow(balance, lambda share: balance, 0.0, unknowns, 1e-8, failed, "of the way")
    assert len(yielded) == 1 and "lost or too long at 0% of the way" in last.reason


@pytest.mark.parametrize(("ahead", "arrives"), [(0.05, True), (0.03, False), (-0.05, False)])
def test_a_walk_is_left_as_soon_as_it_is_too_slow(far, monkeypatch, ahead, arrives):
    """One of ten steps a point has 220 for the whole way: not when these are spent, but when they would not do."""
    balance, usual = far
    unknowns, yielded = balance.pack(usual.forces, usual.rigid), []

    def walk(at, here, *given, **options):
        while True:
            yielded.append(BranchPoint(ahead * (len(yielded) + 1), here.unknowns, 10))
            yield yielded[-1]

    monkeypatch.setattr(ladder, "trace_branch", walk)
    failed = Attempt(unknowns, np.inf, 7, "", False)  # its own steps count for nothing here
    ladder.follow(balance, lambda share: balance, 0.0, unknowns, 1e-8, failed, "of the way", pace=220)
    assert (yielded[-1].parameter >= 1.0) == arrives
    assert arrives or len(yielded) == 4
