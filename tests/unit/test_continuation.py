"""Branches of periodic solutions: their derivative by the parameter, and their tangents."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import takewhile

import numpy as np
import pytest
from small_models import dovetail, friction_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.balance.balance import FIRM, HarmonicBalance
from ewr_fenicsx.balance.newton_step import NewtonStep
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.smoothing import round_corners
from ewr_fenicsx.solver import continuation
from ewr_fenicsx.solver.continuation import BranchPoint
from ewr_fenicsx.solver.snes import run_newton


def begin(problem: ContactProblem) -> tuple[BranchPoint, Callable[[float], HarmonicBalance]]:
    """The solution of a problem, and balances over the frequency in its units."""
    found = solve(problem)
    unit = HarmonicBalance(problem.system).force_unit
    at = lambda f: HarmonicBalance(replace(problem, frequency=float(f)).system, unit)  # noqa: E731
    return BranchPoint(problem.frequency, at(problem.frequency).pack(found.forces, found.rigid), 0), at


def move_in_the_same_states(linear: NewtonStep, there: HarmonicBalance, unknowns: RealArray) -> RealArray:
    """Change of the residual from a linearised balance to another at the same forces, no sample changing status."""
    balance: HarmonicBalance = linear.balance
    seen = []
    for each in (balance, there):
        motion = each.compliance.motion(*each.unpack(unknowns))
        signals = {"displacement": motion, "velocity": each.rate[:, None] * motion}
        seen.append({name: balance.basis.synthesise(signal) for name, signal in signals.items()})
    change = np.zeros((balance.basis.samples, balance.rows))
    for d in linear.derivatives:
        if not d.by_force:
            change[:, d.rows] += d.values * (seen[1][d.variable] - seen[0][d.variable])[:, d.columns]
    return balance.basis.project(change)[balance.unknown] / balance.force_unit


def test_the_derivative_by_the_frequency_keeps_every_sample_in_its_state():
    """At the same forces a resonance moves the mass so far, within a millionth of the frequency, that samples change
    status; along the branch hardly any does. Branches were lost where that was taken for their tangent."""
    laws = ContactLaws(normal="prescribed", normal_force=1.0, friction=0.3)
    problem = ContactProblem(friction_oscillator(damping=1e-3), laws, 0.15915, 9, closure="dashpot")
    here, at = begin(problem)
    linear = at(here.parameter).linearise(here.unknowns)
    found = continuation._differentiate(at, linear, here.unknowns, here.parameter, 1.0)
    step = 1e-9
    moved = move_in_the_same_states(linear, at(here.parameter + step), here.unknowns)
    size = np.linalg.norm(moved / step)
    np.testing.assert_allclose(found, moved / step, atol=1e-4 * size)
    step = 1e-6
    plain = (at(here.parameter + step).residual(here.unknowns) - linear.residual) / step
    assert np.linalg.norm(plain - found) > 0.5 * size, "or the case shows nothing"


def test_the_tangent_points_along_the_branch():
    """Against the next points of the branch, in units in which the frequency's range is one."""
    problem = ContactProblem(dovetail(excitation=600.0), ContactLaws(friction=0.2), 1000.0, 9)
    here, at = begin(problem)
    tangent = continuation._find_tangent(at, here.unknowns, here.parameter, 1000.0)
    for f in (999.99, 1000.01):
        there = solve(replace(problem, frequency=f), tolerance=1e-11)
        chord = np.append(at(f).pack(there.forces, there.rigid) - here.unknowns, (f - 1000.0) / 1000.0)
        assert abs(chord @ tangent) / np.linalg.norm(chord) > 0.999


def test_where_the_sense_is_not_known_no_tangent_is_solved_for(monkeypatch):
    """With too many unknowns to look, two linearisations and a factorisation a point went to waste."""
    laws = ContactLaws(normal="prescribed", normal_force=1.0, friction=0.3)
    here, at = begin(ContactProblem(friction_oscillator(damping=0.1), laws, 0.1, 3))
    monkeypatch.setattr("ewr_fenicsx.in_time.stability.MOST_UNKNOWNS", 0)
    monkeypatch.delattr(HarmonicBalance, "linearise")
    assert continuation._find_tangent(at, here.unknowns, here.parameter, 1.0) is None


def test_the_last_step_of_the_corrector_counts(monkeypatch):
    """Where as many are allowed as a point takes, it is found, and with one less it is not."""
    problem = ContactProblem(dovetail(excitation=600.0), ContactLaws(friction=0.2), 1000.0, 9)
    here, at = begin(problem)

    def step() -> BranchPoint:
        return next(continuation.trace_branch(at, here, 1000.0, step=1e-3, smallest_step=1e-3), None)

    usual = step()
    assert usual.steps > 1
    monkeypatch.setattr(continuation, "CORRECTOR_STEPS", usual.steps)
    assert step().parameter == usual.parameter
    monkeypatch.setattr(continuation, "CORRECTOR_STEPS", usual.steps - 1)
    assert step() is None


def sharpen(excitation: float = 600.0, friction: float = 0.2, step: float = 0.1) -> tuple[RealArray, int]:
    """Laws with rounded corners traced from blunt ones to sharp ones: the exact laws' unknowns, and the steps."""
    problem = ContactProblem(dovetail(excitation=excitation), ContactLaws(friction=friction), 1000.0, 9)
    balance = HarmonicBalance(problem.system)
    unit = balance.force_unit / np.sqrt(balance.rows)

    def at(logarithm: float) -> HarmonicBalance:
        return HarmonicBalance(round_corners(balance.system, np.exp(logarithm) * unit), balance.force_unit, FIRM)

    blunt = run_newton(at(0.0), balance.pack(*balance.full_stick), 1e-9, "elimination")
    assert blunt.converged
    branch = continuation.trace_branch(at, BranchPoint(0.0, blunt.unknowns, 0), -2.0, step=step, tolerance=1e-9)
    points = list(takewhile(lambda point: point.parameter > -12.0, branch))
    end = run_newton(balance, points[-1].unknowns, 1e-9, "elimination", near=True).unknowns
    return end, sum(point.steps for point in points)


def test_along_tangents_a_branch_takes_fewer_steps(monkeypatch):
    """Beside the same along secants, each step with factors of its own."""
    monkeypatch.setattr(continuation, "_FURTHER", (1.0, 1.0))
    end, steps = sharpen()
    monkeypatch.setattr(continuation, "_find_way", lambda secant, _: secant)
    same, more = sharpen()
    np.testing.assert_allclose(end, same, atol=1e-6 * np.linalg.norm(same))
    assert steps < 0.9 * more


def test_a_factorisation_serves_for_several_steps(monkeypatch):
    """It leads to the same end, with fewer of them."""
    end, steps = sharpen()
    monkeypatch.setattr(continuation, "_FURTHER", (1.0, 1.0))
    same, more = sharpen()
    np.testing.assert_allclose(end, same, atol=1e-6 * np.linalg.norm(same))
    assert steps < 0.75 * more


def test_a_point_that_is_hardly_found_is_given_up(monkeypatch):
    """A nearer one takes fewer steps."""
    given = {"excitation": 1500.0, "friction": 0.6, "step": 1.0}
    end, steps = sharpen(**given)
    monkeypatch.setattr(continuation, "_SLOW", np.inf)
    same, more = sharpen(**given)
    np.testing.assert_allclose(end, same, atol=1e-6 * np.linalg.norm(same))
    assert steps < 0.8 * more


def test_what_is_no_number_is_no_point(monkeypatch):
    """Forces that overflow on the way leave a residual that is none, which is below no tolerance."""
    here, at = begin(ContactProblem(dovetail(excitation=600.0), ContactLaws(friction=0.2), 1000.0, 9))
    residual = HarmonicBalance.residual
    monkeypatch.setattr(HarmonicBalance, "residual", lambda balance, z: np.nan * residual(balance, z))
    assert next(continuation.trace_branch(at, here, 1000.0, step=1e-3), None) is None


def test_a_prediction_far_off_costs_no_factorisation(monkeypatch):
    """A shorter one follows: with a limit that no prediction meets, none of them is corrected."""
    factorised, make = [], continuation.Factorisation
    monkeypatch.setattr(continuation, "Factorisation", lambda *given: factorised.append(1) or make(*given))
    monkeypatch.setattr(continuation, "_MOST_LEFT", 0.0)
    with pytest.raises(IndexError):  # no point
        sharpen()
    assert not factorised


def test_a_tangent_that_has_turned_away_is_none():
    along, across = np.array([1.0, 0.0]), np.array([0.1, np.sqrt(0.99)])
    np.testing.assert_array_equal(continuation._find_way(along, None), along)
    np.testing.assert_array_equal(continuation._find_way(along, across), along)
    np.testing.assert_array_equal(continuation._find_way(along, -along), along)
