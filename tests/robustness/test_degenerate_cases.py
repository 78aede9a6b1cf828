"""Degenerate cases by name: limits met exactly, no load, no preload, and redundant, stiff or identical pairs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from counted_calls import count_calls
from degenerate_cases import DEGENERATE, press_one_pair, shake_dovetail
from hard_cases import TOLERANCE, run_case

from ewr_fenicsx import ContactLaws, ContactProblem, PeriodicSolution, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.elimination import REDUNDANCY
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.model.statics import _Program
from ewr_fenicsx.solution.remedies import find_dependent_pairs, list_remedies

MANY = "one thousand identical pairs"  # seconds a Newton step: among the slow ones


@cache
def solve_degenerate(name: str) -> PeriodicSolution:
    """Solved once for all tests that look at it."""
    return solve(DEGENERATE[name]())


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n == MANY else ()) for n in DEGENERATE])
def test_degenerate_cases_are_solved(name):
    outcome = run_case(name, DEGENERATE[name], cap=120.0)
    assert outcome.status == "converged", outcome.reason
    assert outcome.residual <= 1.01 * TOLERANCE


@pytest.mark.parametrize("name", ["a pair is just about to lift off", "friction limit met exactly"])
def test_limits_met_exactly_change_nothing(name):
    """The full-stick solution still holds where a pair touches the edge of its law once a period."""
    solution = solve_degenerate(name)
    stick, _ = HarmonicBalance(solution.problem.system).full_stick
    np.testing.assert_allclose(solution.forces, stick, atol=1e-7 * np.abs(stick).max())
    still = solution.history("slip") if "friction" in name else solution.history("gap")
    moved = solution.coordinates[1]
    assert np.abs(still - still[0]).max() < 1e-7 * np.abs(moved).max()


def test_a_pair_that_just_touches_can_lift():
    """Nothing presses the last pair at rest; shaken, it opens and closes within the truncation."""
    solution = solve_degenerate("a pair just touches at rest")
    gap, force = solution.history("gap")[:, -1], solution.history("normal_force")
    scale = np.abs(gap).max()
    assert scale > 0 and gap.min() > -0.3 * scale and force[:, -1].min() > -0.05 * force.max()
    assert np.any(gap > 0.5 * scale) and np.any(force[:, -1] > 0.01 * force.max())


def test_without_excitation_nothing_moves():
    solution = solve_degenerate("zero excitation")
    assert np.abs(solution.forces[1:]).max() < 1e-9 * np.abs(solution.forces[0]).max()
    assert solution.history("normal_force").min() > 0
    idle = solve_degenerate("zero excitation, zero preload")
    assert np.all(idle.forces == 0.0) and np.all(idle.history("gap") == 0.0)


def test_without_preload_the_answer_scales_with_the_load():
    """No length, no force in the problem but the load: a shake of nanonewtons has the same shape as one of newtons."""
    strong, weak = (solve_degenerate(f"zero preload, body held, {word}") for word in ("shaken", "barely shaken"))
    np.testing.assert_allclose(weak.forces * 5e9, strong.forces, atol=1e-6 * np.abs(strong.forces).max())
    assert strong.merit["energy_error"] == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("name", ["redundant pairs", "one pair of six twice"])
def test_redundant_pairs_share_what_one_would_carry(name):
    single = solve(replace(shake_dovetail(), rho_normal=None))
    double = solve_degenerate(name)
    np.testing.assert_allclose(
        double.output("tip"), single.output("tip"), atol=2e-2 * np.abs(single.output("tip")).max()
    )
    total = double.pair_forces["normal"][0].real.sum()
    assert total == pytest.approx(single.pair_forces["normal"][0].real.sum(), rel=1e-2)


@pytest.mark.parametrize("friction", [0.3, 0.6])
@pytest.mark.parametrize("off", [1e-5, 1e-4])
def test_redundant_pairs_next_to_a_resonance_act_as_one(friction, off):
    """There pairs give way thousandfold more than at rest, and what tells redundant ones apart is beyond rounding."""

    def swing(pairs: int) -> np.ndarray:
        model = ReducedModel(
            [[1.0]], [[1e-6]], [[1.0]], tangential=[[1.0]] * pairs, load={1: [1.0]}, outputs={"m": [1]}
        )
        laws = ContactLaws("prescribed", normal_force=2.0 / pairs, friction=friction)
        problem = ContactProblem(model, laws, (1 + off) / (2 * np.pi), (1, 3, 5), closure="dashpot")
        return solve(problem).output("m")

    np.testing.assert_allclose(swing(2), swing(1), rtol=1e-6, atol=1e-9)


def test_a_stiff_pair_weighs_no_more_than_a_soft_one():
    """Pairs that share nothing, with stiffnesses over ten decades: all answer alike, each in its own scale."""
    solution = solve_degenerate("compliance condition 1e10")
    H = solution.problem.system.compliance.flexibility[0]
    assert np.linalg.cond(H) > 0.9e10
    forces = solution.pair_forces["normal"]
    assert np.all(np.isfinite(forces)) and forces[0].real == pytest.approx(np.full(8, forces[0, 0].real), rel=0.5)


def test_preloads_span_as_much_as_areas():
    """Pressed evenly, from 0.05 to 549 N: to what holding redundant rows in place costs each, a 1e-7th at most."""
    problem = DEGENERATE["areas spanning 1e4"]()
    area, balance = problem.model.pair_area, HarmonicBalance(problem.system)
    assert area.max() / area.min() == pytest.approx(1e4)
    preload, normal = 700.0 * area / area.sum(), slice(0, area.size)
    flexibility = problem.system.compliance.flexibility[0, normal, normal].real
    held = REDUNDANCY * np.diag(problem.system.flexibility[normal])
    allowed = 2 * np.abs(np.linalg.solve(flexibility, held)) @ preload
    assert np.all(allowed < 1e-7 * preload)
    assert np.all(np.abs(balance.full_stick[0][0, normal].real - preload) < allowed)


@pytest.mark.parametrize("pairs, harmonics", [(10, 1), (10, 5), (50, 5), pytest.param(1000, 1, marks=pytest.mark.slow)])
def test_identical_pairs_act_as_one(pairs, harmonics):
    """Their forces add up, and so does what their weights stand for: springs and dashpots side by side."""
    known = {(50, 5): "fifty identical pairs", (1000, 1): MANY}.get((pairs, harmonics))
    many = solve_degenerate(known) if known else solve(press_one_pair(pairs, harmonics))
    assert (many.problem.model.pairs, many.orders[-1]) == (pairs, harmonics)
    normal, tangential = (law.rho[0] for law in many.problem.system.laws)
    single = replace(press_one_pair(1, harmonics), rho_normal=pairs * normal, rho_tangential=tangential / pairs)
    one = solve(single)
    np.testing.assert_allclose(many.output("tip"), one.output("tip"), atol=1e-6 * np.abs(one.output("tip")).max())
    total = many.pair_forces["normal"].sum(axis=1)
    np.testing.assert_allclose(total, one.pair_forces["normal"][:, 0], atol=1e-6 * np.abs(total).max())


def rub_twice(springs: float) -> ContactProblem:
    """A mass in a plane that two pads rub, their tangents turned; one of them behind springs, or on the mass itself.

    The pads' normal forces rise and fall at different harmonics, so that their shares differ at every instant.
    """
    turned = np.array([[0.8, 0.6], [-0.6, 0.8]])
    rubs = np.eye(4) if springs else np.vstack([np.eye(2), turned])
    size = rubs.shape[1]
    stiffness, mass = np.zeros((2, size, size))
    stiffness[:2, :2], mass[:2, :2] = [[1.0e5, 2e4], [2e4, 1.5e5]], np.eye(2)
    if springs:
        apart = np.hstack([turned, -np.eye(2)])
        stiffness += springs * apart.T @ apart
    load = {1: np.zeros(size, dtype=complex), 2: np.zeros(size, dtype=complex)}
    load[1][:2], load[2][:2] = [150.0, 60j], [40.0, -50.0]
    one = ContactLaws("prescribed", friction=0.4, normal_force={0: 150.0, 1: 60.0, 3: 20j})
    other = ContactLaws("prescribed", friction=0.5, normal_force={0: 90.0, 2: 35.0 - 10j})
    model = ReducedModel(mass, 2e-4 * stiffness, stiffness, normal=np.zeros((2, size)), tangential=rubs, load=load)
    return ContactProblem(model, [([0], one), ([1], other)], 40.0, 15)


def test_pairs_that_depend_on_one_another_are_named_where_nothing_is_found():
    assert find_dependent_pairs(shake_dovetail()) == []
    assert find_dependent_pairs(DEGENERATE["one pair of six twice"]()) == [1, 2]
    assert find_dependent_pairs(rub_twice(0.0)) == [0, 1] and find_dependent_pairs(rub_twice(1e9)) == []
    alike, apart = (solve(rub_twice(springs)) for springs in (0.0, 1e9))  # what the remedy says changes next to nothing
    assert apart.merit["friction_dissipation"] == pytest.approx(alike.merit["friction_dissipation"], rel=1e-3)
    assert "The rows of pairs 0, 1 depend on one another" in list_remedies(alike)
    assert "depend on one another" not in list_remedies(apart)


def rest_among_stops(seed: int) -> ContactProblem:
    """Springs in one to six coordinates, pressed among up to 24 stops: half of them touch, others are wide open."""
    rng = np.random.default_rng(seed)
    n, pairs = rng.integers(1, 7), rng.integers(8, 25)
    root, normal = rng.normal(size=(n, n)), rng.normal(size=(pairs, n))
    gap = np.where(rng.random(pairs) < 0.5, 10 ** rng.uniform(-3.0, 1.5, pairs), 0.0)
    load = 10.0 * rng.normal(size=n) - normal.T @ np.where(rng.random(pairs) < 0.5, 10 ** rng.uniform(-1, 1, pairs), 0)
    stiffness = root @ root.T / n + 0.05 * np.eye(n)
    model = ReducedModel(np.eye(n), np.zeros((n, n)), stiffness, normal, load={0: load})
    return ContactProblem(model, ContactLaws(tangential="frictionless", initial_gap=gap), 0.0, 0)


@pytest.mark.parametrize("seed", [7, 8, 9, 10, 15, 16, 28, 31, 35, 36])  # which no other rung finds
def test_springs_come_to_rest_among_far_more_stops_than_coordinates(seed):
    """A convex problem has one position of rest: there no pair overlaps or pulls, and none presses across a gap."""
    problem = rest_among_stops(seed)
    solution = solve(problem)
    model, x = problem.model, solution.coordinates[0].real
    force, gap = solution.history("normal_force", 1)[0], model.normal @ x + problem.clearance
    size, length = np.abs(model.load[0]).max(), np.abs(problem.clearance).max()
    np.testing.assert_allclose(model.stiffness @ x, model.load[0].real + model.normal.T @ force, atol=1e-9 * size)
    assert gap.min() > -1e-7 * length and force.min() > -1e-7 * size
    assert np.abs(force * gap).max() < 1e-6 * size * length


@pytest.mark.parametrize("frequency, top", [(0.0, 0), (50.0, 7)])
def test_interferences_that_no_motion_relieves_are_named(frequency, top):
    """A rigid peg of 1.2 mm in a rigid slot of 1.0 mm; a third pair, across the slot, has nothing to do with it."""
    stiffness, load = np.diag([1e6, 2e6]), {1: [1.0, 1.0]} if frequency else {}
    model = ReducedModel(np.eye(2), 1e-3 * stiffness, stiffness, [[1.0, 0], [-1.0, 0], [0, 1.0]], load=load)

    def pose(*gaps: float) -> ContactProblem:
        laws = ContactLaws(tangential="frictionless", initial_gap=[*gaps, -1e-4])
        return ContactProblem(model, laws, frequency, top)

    assert solve(pose(-2e-4, 2.1e-4)).converged  # the slot is wide enough, but not where the peg is
    with pytest.raises(NotConverged, match="No motion relieves the interferences of pairs 0, 1 together") as told:
        solve(pose(-1e-4, -1e-4))
    assert not told.value.best.fallbacks  # there is nothing to look for


def stand_on_a_sprung_mass(load: float, clearance: float = 0.0) -> ContactProblem:
    """A sprung mass pressed against the ground at pair 0; on it, at pairs 1 and 2, floats one with a mean ``load``."""
    model = ReducedModel(
        np.diag([1.0, 0.5, 0.5]),
        0.05 * np.eye(3),
        [[5.0, 0.0, 0.0], [0.0, 2.0, -2.0], [0.0, -2.0, 2.0]],
        [[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]],
        None,
        {0: [-1.0, -load, -load], 1: [0.1, 0.2, -0.1]},
        rigid_modes=[[0.0], [1.0], [1.0]],
    )
    return ContactProblem(
        model, ContactLaws(tangential="frictionless", initial_gap=[0.0, clearance, clearance]), 0.3, 3
    )


def test_a_body_that_nothing_presses_is_named_after_the_cold_start():
    """Wherever it does not touch is a solution, and Newton's matrix singular there: no rung is worth its steps."""
    told = r"Nothing presses pairs 1, 2: no equilibrium has a mean force there.*Give each a mean load"
    with pytest.raises(NotConverged, match=told) as refused:
        solve(stand_on_a_sprung_mass(0.0))
    assert refused.value.best.iterations < 60 and not refused.value.best.fallbacks
    assert solve(stand_on_a_sprung_mass(1.0)).converged


def test_what_nothing_presses_is_looked_for_once_where_a_solve_fails(monkeypatch):
    """Before rungs are climbed, and where it is said why; with a thousand pairs that takes half a second."""
    calls = count_calls(monkeypatch, _Program, "press_most")
    problem = stand_on_a_sprung_mass(0.0)
    fresh = replace(
        problem, model=replace(problem.model, normal=problem.model.normal * [1.0, 1.0, 1.5])
    )  # not asked yet
    with pytest.raises(NotConverged, match="Nothing presses pairs 1, 2"):
        solve(fresh)
    assert len(calls) == 1


def test_a_body_that_nothing_presses_may_lie_anywhere():
    """Found where it does not touch, which is said; under a mean load there is nothing to say."""
    still = stand_on_a_sprung_mass(0.0)
    still = replace(still, load={0: [-1.0, 0.0, 0.0]})
    assert any(line.startswith("nothing presses pairs 1, 2: ") for line in solve(still).cautions)
    assert not any("presses" in line for line in solve(stand_on_a_sprung_mass(1.0)).cautions)
