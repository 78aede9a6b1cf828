"""A long splitting: where it leads that neither Newton's method nor a quick one does, and where it gives up."""

from __future__ import annotations

from dataclasses import replace

import hard_cases
import numpy as np
import pytest
from small_models import PROBLEMS

from ewr_fenicsx import solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solver import long_splitting, weights
from ewr_fenicsx.solver.long_splitting import COARSE_GOAL, LONG, split_at_length
from ewr_fenicsx.solver.snes import run_newton
from ewr_fenicsx.solver.splitting import Splitting, settle
from ewr_fenicsx.solver.time_integration import integrate


def pose_bouncing():
    """Bodies that leave each other and bounce."""
    problem = hard_cases.pose_case(hard_cases.Case("dovetail", 0.5, ("reached", 3.0), 1.0, 5, 0.05, "random", (1, 1)))
    return problem, HarmonicBalance(problem.system)


def pose_far():
    """A balance with weights a thousandth of the default ones, and the solution with those."""
    case = hard_cases.Case("dovetail", 1.5, ("reached", 0.3), 0.05, 5, 0.05, "closed", (1e-3, 1e-3))
    problem = hard_cases.pose_case(case)
    usual = solve(replace(problem, rho_normal=None, rho_tangential=None))
    return HarmonicBalance(problem.system), usual, usual.problem.system.compliance.motion(usual.forces, usual.rigid)


def step_in_time(problem):
    """Forces and motions of the steady state that some coarse periods lead to."""
    return integrate(problem, steps=256, periods=40, tolerance=1e-3, theta=0.6, acceleration=True).contact_amplitudes


def test_it_leads_from_time_stepping_where_newton_does_not():
    """Nor does a quick splitting, nor Newton from where time stepping ends."""
    problem, balance = pose_bouncing()
    forces, motion = step_in_time(problem)
    start = balance.pack(forces, np.zeros(balance.rigid))
    assert not run_newton(balance, start, 1e-8, "elimination").converged
    splitting = Splitting(balance)
    assert settle(splitting, splitting.join(forces, motion), COARSE_GOAL).defect > COARSE_GOAL
    found = split_at_length(balance, forces, motion, 1e-8, "elimination")
    assert found.converged and found.iterations <= 5
    assert np.linalg.norm(balance.residual(found.unknowns)) <= 1e-8


def test_it_leads_to_weights_far_off():
    """From the motion of the default ones, in fewer steps than a walk, to the asked problem's own solution."""
    balance, usual, motion = pose_far()
    found = split_at_length(balance, usual.forces, motion, 1e-8, "elimination")
    assert found.converged
    between = weights.blend_weights(usual.problem.system, balance)
    walked = weights.walk_weights(balance, between, [(0.0, balance.pack(usual.forces, usual.rigid))], 1e-8)
    assert 2 * found.iterations < walked.iterations
    change = np.abs(balance.unpack(found.unknowns)[0] - usual.forces).max()
    assert change > 1e-3 * np.abs(usual.forces).max(), "weights change what a truncated series settles on"


def test_in_the_end_it_has_the_samples_of_the_balance():
    """With weights far off their number counts: with a splitting's own, it ends next to the solution, not at it."""
    balance, usual, motion = pose_far()
    left = []
    for samples in (None, balance.basis.samples):
        splitting = Splitting(balance, samples)
        effort = LONG._replace(iterations=12000, window=20)  # how far a look back of 40 leads here is luck
        found = settle(splitting, splitting.join(usual.forces, motion), 1e-6, effort)
        assert found.defect <= 1e-6
        left.append(np.linalg.norm(balance.residual(splitting.unknowns(found.state))))
    assert left[1] < 0.1 * left[0]


@pytest.mark.parametrize("name", ["floating, slip", "lift-off"])
def test_softness_changes_the_way_and_not_where_it_ends(name):
    """Ends are as far apart as what is left of defects has it: rounding may keep these from 1e-9."""
    problem = replace(PROBLEMS[name], harmonics=5, closure="dashpot")
    balance, ends, left = HarmonicBalance(problem.system), [], []
    for softness in long_splitting.SOFTNESSES:
        splitting = Splitting(balance, softness=softness)
        found = settle(splitting, splitting.begin(), 1e-9, long_splitting.LONG)
        left.append(found.defect)
        ends.append(splitting.unknowns(found.state))
    assert max(left) <= 1e-6
    np.testing.assert_allclose(ends[1], ends[0], atol=200 * max(left) * np.abs(ends[0]).max())


def test_where_it_leads_nowhere_it_says_so(monkeypatch):
    _, balance = pose_bouncing()
    nowhere = balance.full_stick[0], np.zeros((len(balance.basis.orders), balance.rows), dtype=complex)
    monkeypatch.setattr(long_splitting, "LONG", LONG._replace(iterations=2))
    monkeypatch.setattr(long_splitting, "HOPELESS", 1e-6)
    assert split_at_length(balance, *nowhere, 1e-8, "elimination") is None
    monkeypatch.setattr(type(balance.system.laws[0]), "opposes", "")
    monkeypatch.setattr(long_splitting, "Splitting", None)  # as laws of one's own, which are no projections
    assert split_at_length(balance, *nowhere, 1e-8, "elimination") is None


def test_large_states_take_fewer_iterations(monkeypatch):
    """They are dear: no more than a fixed work is done on a state, however large."""
    problem, balance = pose_bouncing()
    taken = []
    monkeypatch.setattr(long_splitting, "WORK", 50 * Splitting(balance).begin().size)
    monkeypatch.setattr(
        long_splitting, "settle", lambda *given: taken.append(settle(*given)) or taken[-1]._replace(defect=np.inf)
    )
    assert split_at_length(balance, *step_in_time(problem), 1e-8, "elimination") is None
    assert [split.iterations for split in taken] == [50] * len(long_splitting.SOFTNESSES)
