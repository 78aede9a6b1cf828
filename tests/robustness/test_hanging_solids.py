"""Roots of solids whose slot runs out at both ends: along it friction alone holds the blade."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hanging_solids import build

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solver import at_rest, newton

MOST_STEPS = 60  # Newton steps, those of the static solution with it


@pytest.fixture(scope="module")
def fir_tree() -> ReducedModel:
    return build("fir tree")


@pytest.fixture(scope="module")
def dovetail() -> ReducedModel:
    return build("dovetail")


def keep_means(model: ReducedModel) -> ReducedModel:
    return replace(model, load={0: model.load[0]})


@pytest.mark.parametrize("static_friction", ["resolved", "held"])
@pytest.mark.parametrize("friction", [0.1, 0.3, 0.6])
@pytest.mark.parametrize(
    ("frequency", "harmonics", "shaken"), [(0, 0, 0), (600, 1, 1), (600, 3, 1), (950, 3, 1), (600, 3, 20)]
)
def test_a_root_that_friction_holds_along_its_slot(fir_tree, frequency, harmonics, shaken, friction, static_friction):
    model = replace(fir_tree, load={h: f * (shaken if h else 1) for h, f in fir_tree.load.items() if h <= harmonics})
    laws = ContactLaws(friction=friction, static_friction=static_friction)
    solution = solve(ContactProblem(model, laws, float(frequency), harmonics))
    assert solution.converged and solution.iterations <= MOST_STEPS and not solution.fallbacks


@pytest.mark.parametrize("static_friction", ["resolved", "held"])
def test_a_resonance_at_which_most_pairs_slip(fir_tree, static_friction):
    model = replace(fir_tree, load={0: fir_tree.load[0], 1: 20 * fir_tree.load[1]})
    assert solve(ContactProblem(model, ContactLaws(friction=0.3, static_friction=static_friction), 950.0, 5)).converged


def test_from_rest_and_from_full_stick_come_to_one_solution(fir_tree, monkeypatch):
    problem = ContactProblem(fir_tree, ContactLaws(friction=0.3), 600.0, 1)
    rested = solve(problem)
    monkeypatch.setattr(newton, "begins_at_rest", lambda balance: False)
    stuck = solve(problem)
    assert stuck.iterations > 2 * rested.iterations
    np.testing.assert_allclose(
        rested.coordinates, stuck.coordinates, rtol=0, atol=1e-5 * abs(stuck.coordinates[1]).max()
    )


def test_where_springs_hold_by_far_more_than_friction_needs_their_weight_falls_in_steps(fir_tree, monkeypatch):
    problem = ContactProblem(keep_means(fir_tree), ContactLaws(friction=0.8), 0.0, 0)
    rest, steps = at_rest.find_rest(problem)
    balance = HarmonicBalance(rest.problem.system)
    assert np.linalg.norm(balance.residual(balance.pack(rest.forces, rest.rigid))) < at_rest.REST
    monkeypatch.setattr(at_rest, "SHARES", (0.0,))
    assert at_rest.find_rest(problem)[1] > 1.5 * steps


@pytest.mark.parametrize("static_friction", ["resolved", "held"])
@pytest.mark.parametrize("friction", [0.6, 0.8, 1.0, 1.5])
def test_roots_that_jam_come_to_rest(dovetail, friction, static_friction):
    problem = ContactProblem(
        keep_means(dovetail), ContactLaws(friction=friction, static_friction=static_friction), 0.0, 0
    )
    rest, steps = at_rest.find_rest(problem)
    assert rest is not None and steps <= 3 * at_rest.REST_STEPS


def test_pairs_without_mean_friction_are_not_held_on_the_way(fir_tree):
    pairs = np.arange(fir_tree.pairs)
    laws = [
        (pairs[::2], ContactLaws(friction=0.3)),
        (pairs[1::2], ContactLaws(friction=0.3, static_friction="zero")),
    ]
    solution = solve(ContactProblem(fir_tree, laws, 600.0, 1))
    assert solution.converged and "residual" in solution.summary()
    means = solution.pair_forces["second_tangential"][0].real
    assert not means[1::2].any() and means[::2].any()


def test_a_weight_of_ones_own_changes_nothing_at_rest(fir_tree):
    problem = ContactProblem(fir_tree, ContactLaws(friction=0.3), 600.0, 1)
    weight = next(law.rho for law in problem.system.laws if law.direction == "tangential")
    usual, own = (at_rest.find_rest(p)[0].forces for p in (problem, replace(problem, rho_tangential=100 * weight)))
    np.testing.assert_array_equal(usual, own)
