"""Factors of Newton's matrices: eliminated or dense, in single precision or double, new or of an earlier step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import PROBLEMS, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.balance import inexact_step
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solver import snes


def record_steps(problem: ContactProblem, **arguments) -> tuple:
    """The solution, and the unknowns at which each Newton step was taken."""
    visited = []
    original = HarmonicBalance.linearise

    def spy(self, unknowns):
        visited.append(unknowns.copy())
        return original(self, unknowns)

    HarmonicBalance.linearise = spy
    try:
        return solve(problem, tolerance=1e-10, **arguments), visited
    finally:
        HarmonicBalance.linearise = original


@pytest.mark.parametrize("factors", ["double", "single", "reused"])
@pytest.mark.parametrize("name", PROBLEMS)
def test_both_linear_solvers_take_the_same_steps(name, factors, monkeypatch):
    """With double factors at each step, or single ones refined; those of earlier steps leave them a few digits less."""
    if factors != "double":
        monkeypatch.setattr(snes, "REFINE_FROM", 1)
    if factors == "single":  # those of earlier steps serve only where they do as well
        monkeypatch.setattr(snes, "FAR_TOLERANCE", snes.ROUGH_TOLERANCE)
        monkeypatch.setattr(snes, "CLOSE_TOLERANCE", snes.ROUGH_TOLERANCE)
    first, eliminated = record_steps(PROBLEMS[name], linear_solver="elimination")
    second, dense = record_steps(PROBLEMS[name], linear_solver="dense")
    assert first.iterations == second.iterations
    assert len(eliminated) == len(dense) and (len(dense) > 1 or name == "stuck")
    bound = 1e-5 if factors == "reused" else 1e-8
    for a, b in zip(eliminated, dense, strict=True):
        np.testing.assert_allclose(a, b, atol=bound * np.abs(b).max())
    np.testing.assert_allclose(first.forces, second.forces, atol=1e-9 * np.abs(second.forces).max())


def test_factors_in_single_precision_are_refined_or_made_again(monkeypatch):
    """GMRES on them finds the step to ten digits; where it does not, double ones are made."""
    made = []
    original = snes.Factorisation

    def record(step, right_side, shift, precision):
        made.append(precision)
        return original(step, right_side, shift, precision)

    problem = replace(PROBLEMS["floating, slip"], harmonics=15)
    monkeypatch.setattr(snes, "Factorisation", record)
    double = solve(problem, tolerance=1e-11)
    assert set(made) == {np.float64}
    monkeypatch.setattr(snes, "REFINE_FROM", 1)
    made.clear()
    single = solve(problem, tolerance=1e-11)
    assert set(made) == {np.float32}
    np.testing.assert_allclose(single.forces, double.forces, atol=1e-9 * np.abs(double.forces).max())
    monkeypatch.setattr(snes, "REFINEMENTS", 1)  # too few for ten digits
    made.clear()
    again = solve(problem, tolerance=1e-11)
    assert again.converged and 1 <= made.count(np.float32) <= 2  # once a run: of the firm balance, of the balance
    assert set(made[-2:]) == {np.float64}
    np.testing.assert_allclose(again.forces, double.forces, atol=1e-9 * np.abs(double.forces).max())


@pytest.mark.parametrize("frequency", [450.0, 481.0, 520.0])
def test_factors_of_earlier_steps_serve_later_ones(frequency, monkeypatch):
    """The same solution to the tolerance, with fewer factorisations than steps."""
    made = []
    original = snes.Factorisation

    def count(*arguments):
        made.append(arguments)
        return original(*arguments)

    problem = replace(PROBLEMS["floating, slip"], frequency=frequency, harmonics=15)
    monkeypatch.setattr(snes, "Factorisation", count)
    monkeypatch.setattr(snes, "REFINE_FROM", 10**9)
    anew = solve(problem, tolerance=1e-11)
    assert len(made) == anew.iterations > 3
    made.clear()
    monkeypatch.setattr(snes, "REFINE_FROM", 1)
    again = solve(problem, tolerance=1e-11)
    assert len(made) < again.iterations <= anew.iterations + 5
    np.testing.assert_allclose(again.forces, anew.forces, atol=1e-9 * np.abs(anew.forces).max())


def test_no_run_ends_for_a_step_that_old_factors_gave(monkeypatch):
    """Where no length of it makes the residual fall, the step is taken again with new ones."""
    problem, original = PROBLEMS["floating, slip"], snes.refine
    monkeypatch.setattr(snes, "REFINE_FROM", 10**9)
    exact = solve(problem)
    monkeypatch.setattr(snes, "REFINE_FROM", 1)
    useless = []

    def refine(ksp, right_side, x, tolerance, *, old):
        if not old:
            return original(ksp, right_side, x, tolerance, old=old)
        useless.append(tolerance)
        x.set(0.0)
        return True

    monkeypatch.setattr(snes, "refine", refine)
    found = solve(problem)
    assert len(useless) > 1 and found.converged and found.iterations == exact.iterations and found.fallbacks == ()


@pytest.mark.parametrize("linear_solver", ["elimination", "dense"])
def test_far_from_a_solution_large_joints_take_steps_without_factors_of_the_whole(linear_solver, monkeypatch):
    """The same solution from fewer factorisations; exact steps take over where GMRES does not get there."""
    made, gone_far, original = [], [], snes._HalvedNewton._factor_anew

    def record(self, *arguments):
        made.append(self.equations.far)
        return original(self, *arguments)

    def iterate(*arguments):
        gone_far.append(inexact_step.iterate(*arguments))
        return gone_far[-1]

    monkeypatch.setattr(snes._HalvedNewton, "_factor_anew", record)
    monkeypatch.setattr(snes, "iterate", iterate)
    problem = replace(PROBLEMS["floating, slip"], harmonics=15)
    exact = solve(problem, tolerance=1e-11, linear_solver=linear_solver)
    assert made.count(True) > 1 and not gone_far
    of_exact = made.copy()
    monkeypatch.setattr(inexact_step, "FEW", 0)
    near = solve(problem, tolerance=1e-11, linear_solver=linear_solver)
    assert not gone_far and near.iterations == exact.iterations, "a splitting ends near enough for exact steps"
    monkeypatch.setattr(snes, "FAR_FROM", 0.0)
    made.clear()
    found = solve(problem, tolerance=1e-11, linear_solver=linear_solver)
    assert gone_far and all(step is not None for step in gone_far)
    assert made.count(True) == 0 and len(made) < len(of_exact)
    np.testing.assert_allclose(found.forces, exact.forces, atol=1e-9 * np.abs(exact.forces).max())
    monkeypatch.setattr(snes, "FAR_ITERATIONS", 1)
    made.clear()
    again = solve(problem, tolerance=1e-11, linear_solver=linear_solver)
    assert made == of_exact and again.iterations == exact.iterations


@pytest.mark.parametrize(
    ("norms", "stalled"),
    [
        ([0.2] * 8, True),
        ([0.2] * 7, False),  # it may yet fall
        (list(0.2 * 0.97 ** np.arange(8)), False),
        ([4e-4] * 6, True),
        (list(4e-4 * 0.95 ** np.arange(6)), False),
        ([9e-6] * 20, False),  # pairs begin to slip one after the other
        ([1.0] * 9 + [2e-3] * 3, False),
    ],
)
def test_runs_that_creep_are_told(norms, stalled):
    assert snes.is_stalled(norms) == stalled


@pytest.mark.parametrize(("tangents", "closure"), [(1, "dashpot"), (1, "spring"), (2, "dashpot")])
def test_pairs_that_stay_open_are_eliminated_with_their_friction(tangents, closure):
    """Rounding pressed them now and then, so that their friction seemed to change, and was solved for densely."""
    model = replace(random_structure(pairs=6, size=24, tangents=tangents), load={1: np.ones(24)})
    parted = np.arange(6) < 4
    laws = ContactLaws(friction=0.3, initial_gap=np.where(parted, 1e3, 0.0))
    solution = solve(ContactProblem(model, laws, 0.05, 5, closure=closure))
    system = solution.problem.system
    assert solution.converged and ("springs" in system.closures) == (closure == "spring")
    assert np.all(solution.history("gap")[:, parted] > 0)
    balance, unknowns = solution.pose()
    rows = [system.row_of(direction, np.flatnonzero(parted)) for direction in ("normal", *model.tangent_directions)]
    forces, rigid = balance.unpack(unknowns)
    for seed in range(3):
        forces[:, np.concatenate(rows)] = 1e-17 * np.random.default_rng(seed).normal(size=(6, 4 * len(rows)))
        assert balance.linearise(balance.pack(forces, rigid)).steady[np.concatenate(rows)].all()
