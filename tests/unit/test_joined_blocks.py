"""Blocks of a sweep, which ranks solve apart, are one curve when they are joined."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from checked_solutions import find_turns
from small_models import lift_off_oscillator, stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, frequency_response, solve
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.response import following, frequency_sweep
from ewr_fenicsx.response.following import Curve, Jump
from ewr_fenicsx.response.sweep_store import BlockState

LAWS = ContactLaws(friction=0.3)
FREQUENCIES = np.linspace(0.08, 0.4, 9)


def sweep(**settings):
    model = lift_off_oscillator(excitation=0.6, damping=0.1)
    return frequency_response(model, LAWS, FREQUENCIES, harmonics=5, progress=False, **settings)


def start_late(problem, **settings):
    """``solve``, that finds nothing at the first frequencies."""
    found = solve(problem, **settings)
    if problem.frequency < 0.25:
        raise NotConverged("as if", best=found)
    return found


def test_blocks_of_another_size_give_the_same_curve(monkeypatch):
    one = sweep().output("tip")
    monkeypatch.setattr(frequency_sweep, "BLOCK", 2)
    np.testing.assert_allclose(sweep().output("tip"), one, atol=1e-7 * np.abs(one).max())


def test_a_block_without_a_cold_solution_is_followed_from_the_one_before(monkeypatch):
    usual, cold = sweep(), frequency_sweep._solve_block
    monkeypatch.setattr(frequency_sweep, "BLOCK", 2)
    nothing = [BlockState(passed=3)]
    monkeypatch.setattr(frequency_sweep, "_solve_block", lambda f, b, s: nothing if b.number == 2 else cold(f, b, s))
    curve = sweep()
    assert curve.missing == () and curve.jumps == ()
    np.testing.assert_allclose(curve.output("tip"), usual.output("tip"), atol=1e-7 * np.abs(usual.output("tip")).max())


def test_blocks_meet_where_a_fold_lies_between_them(monkeypatch):
    """Cold starts find either branch where there are three; joined, the blocks are the curve of one sweep."""
    model, laws = stop_oscillator(), ContactLaws(tangential="frictionless", initial_gap=1.0)
    frequencies = np.linspace(0.16, 0.18, 11)
    shapes = []
    for size in (2, 3, 20):
        monkeypatch.setattr(frequency_sweep, "BLOCK", size)
        curve = frequency_response(model, laws, frequencies, harmonics=7, progress=False)
        assert curve.jumps == ()
        turns = find_turns(curve.frequencies)
        shapes.append((len(turns), curve.frequencies[turns], np.abs(curve.output("tip")[[0, -1], 1])))
    for turns, folds, ends in shapes:
        assert turns == 2
        np.testing.assert_allclose(folds, shapes[0][1], rtol=1e-3)
        np.testing.assert_allclose(ends, shapes[0][2], rtol=1e-7)


@pytest.mark.parametrize("refine", [None, 0.3])
@pytest.mark.parametrize("block", [20, 2])
def test_the_branch_is_followed_down_to_where_no_cold_start_found_it(monkeypatch, block, refine):
    """At the first frequencies, in one block or in several."""
    usual = sweep(refine=refine)
    monkeypatch.setattr(frequency_sweep, "solve", start_late)
    monkeypatch.setattr(frequency_sweep, "BLOCK", block)
    curve = sweep(refine=refine)
    assert curve.missing == () and curve.jumps == () and np.all(np.diff(curve.frequencies) > 0)
    same, at = np.isin(usual.frequencies, FREQUENCIES), np.isin(curve.frequencies, FREQUENCIES)
    tip = usual.output("tip")[same]
    np.testing.assert_allclose(curve.output("tip")[at], tip, atol=1e-7 * np.abs(tip).max())


def test_frequencies_that_the_branch_does_not_lead_down_to_stay_missing(monkeypatch):
    monkeypatch.setattr(frequency_sweep, "solve", start_late)
    monkeypatch.setattr(frequency_sweep, "BLOCK", 2)
    monkeypatch.setattr(following, "LARGEST_SURPRISE", 0.0)  # nothing is near enough
    assert sweep().missing == tuple(f for f in FREQUENCIES if f < 0.25)


def test_a_jump_before_blocks_meet_is_no_jump_of_their_curve(monkeypatch):
    """The second block began on another branch, which it lost; the first one's leads on to where it went."""
    point = lambda f: SimpleNamespace(problem=ContactProblem(lift_off_oscillator(), LAWS, f))  # noqa: E731
    first = Curve([point(1.0), point(2.0)])
    second = Curve([point(2.0), point(3.0), point(4.0)], [Jump((2.5, 3.0), ""), Jump((3.5, 4.0), "")])
    follower = SimpleNamespace(follow=lambda start, targets: Curve([point(f) for f in targets]))
    monkeypatch.setattr(frequency_sweep, "agree", lambda a, b: a.problem.frequency > 2)
    curve = frequency_sweep._join([first, second], [(1.0, 2.0), (2.0, 3.0, 4.0)], follower)
    assert [p.problem.frequency for p in curve.points] == [1, 2, 3, 4]
    assert [jump.frequency for jump in curve.jumps] == [(3.5, 4.0)]
