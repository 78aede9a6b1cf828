"""Floquet multipliers of solutions against closed forms, the equations of deviations solved by scipy, and stepping."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_models import dovetail, repeat_first_pair, stop_oscillator

from ewr_fenicsx import (
    ContactLaws,
    ContactProblem,
    ReducedModel,
    build_reduced_model,
    floquet,
    frequency_response,
    integrate,
    load_scene,
    solve,
)
from ewr_fenicsx.chain import build_chain, pose_problem
from ewr_fenicsx.deviations import differentiate_laws
from ewr_fenicsx.errors import ModelError

DEMOS = Path(__file__).parents[2] / "demos"
FRICTIONLESS = ContactLaws(tangential="frictionless")
STOP = 3.0  # stiffness of the stop of two_masses
DRIVEN = np.linspace(0.395, 0.43, 8)  # Hz, about the sum of their two frequencies


def gyroscope(damping: np.ndarray) -> ReducedModel:
    """Two masses, the first held by a pair that is pressed for good: linear where that stays closed."""
    stiffness = [[3.0, -1.0, -1.0], [-1.0, 2.0, 0.0], [-1.0, 0.0, 1.1]]
    return ReducedModel(
        mass=np.diag([1.0, 1.0, 0.0]),
        damping=np.pad(damping, (0, 1)),
        stiffness=stiffness,
        normal=[[0.0, 0.0, 1.0]],
        load={0: [0.0, 0.0, -5.0], 1: [0.2, 0.0, 0.0]},
        outputs={"tip": [1.0, 0.0, 0.0]},
    )


def two_masses() -> ReducedModel:
    """Two equal masses, joined by a spring; the second touches a springy stop, and is driven."""
    stiffness = [[1.6, -0.6, 0.0], [-0.6, 1.6 + STOP, -STOP], [0.0, -STOP, STOP]]
    return ReducedModel(
        mass=np.diag([1.0, 1.0, 0.0]),
        damping=np.diag([0.01, 0.01, 0.0]),
        stiffness=stiffness,
        normal=[[0.0, 0.0, -1.0]],
        load={1: [0.0, 1.0, 0.0]},
        outputs={"driven": [0.0, 1.0, 0.0]},
    )


def tapping(frequency: float, harmonics: int = 15) -> ContactProblem:
    return ContactProblem(two_masses(), FRICTIONLESS, frequency, harmonics)


def step_masses(solution) -> np.ndarray:
    """Multipliers of the masses' own deviations: the stop adds to the stiffness while it is pressed."""
    model = solution.problem.model
    mass, damping, stiffness = (matrix[:-1, :-1] for matrix in (model.mass, model.damping, model.stiffness))
    stop, orders, n = model.stiffness[-1, -1], np.array(solution.orders), len(mass)
    pressed = np.diag([0.0] * (n - 1) + [stop])
    name, gap = next(iter(model.outputs)), float(np.ravel(solution.problem.laws.initial_gap)[0])
    amplitudes = solution.output(name)

    def rate(t, state):
        x, v = np.split(state.reshape(2 * n, 2 * n), 2)
        moved = np.real(amplitudes @ np.exp(1j * orders * solution.problem.omega * t))
        force = (stiffness - pressed * (moved < gap)) @ x + damping @ v
        return np.concatenate([v, -np.linalg.solve(mass, force)]).ravel()

    period = 1 / solution.problem.frequency
    end = solve_ivp(rate, (0, period), np.eye(2 * n).ravel(), max_step=period / 2000, rtol=1e-8).y[:, -1]
    return np.linalg.eigvals(end.reshape(2 * n, 2 * n))


@pytest.mark.parametrize(
    ("damping", "grows"),
    [([[0.3, 1.6], [-1.6, -0.32]], True), ([[-0.2, 0], [0, 0.1]], True), ([[0.1, 0.5], [-0.5, 0.1]], False)],
)
def test_a_closed_pair_leaves_the_multipliers_of_a_linear_system(damping, grows):
    model = gyroscope(np.array(damping))
    found = solve(ContactProblem(model, FRICTIONLESS, 0.11, 9))
    zero, one = np.zeros((2, 2)), np.eye(2)
    state = np.block([[zero, one], [-model.stiffness[:2, :2], -model.damping[:2, :2]]])
    exact = max(np.exp(np.linalg.eigvals(state) / 0.11), key=lambda m: (abs(m), m.imag))
    assert (abs(exact) > 1.1) == grows
    assert found.multiplier == pytest.approx(exact if grows else 0.0, rel=1e-9)
    assert found.unstable == grows


@pytest.mark.parametrize("frequency", [0.42, 0.425, 0.43])
def test_two_masses_that_tap_leave_in_a_spiral_as_scipy_says(frequency):
    """Driven near the sum of their frequencies, they take up both: no sign of a determinant tells."""
    found = solve(tapping(frequency, 31))
    assert found.fallbacks == () and found.side == 1 and not found.alternates
    exact = max(step_masses(found), key=lambda m: (abs(m), m.imag))
    assert abs(exact) > 1.05 and abs(exact.imag) > 0.4
    assert found.multiplier == pytest.approx(exact, rel=2e-3)
    assert "leave it, most often for one that never repeats; integrate(problem, solution" in found.summary()


def test_stepping_leaves_what_spirals_and_nothing_else():
    """As the summary says; theta above 1/2, for the stop's end has no mass and would ring."""
    for frequency, leaves in ((0.4, False), (0.42, True)):
        found = solve(tapping(frequency, 31))
        assert (found.multiplier != 0) == leaves
        steady = integrate(found.problem, found, tolerance=0, theta=0.52)
        changed = np.abs(steady.output("driven")[1] / found.output("driven")[1] - 1)
        assert (changed > 0.1) == leaves and (changed < 0.02) == (not leaves)
        assert np.all(steady.changes[-5:] > 0.05) == leaves


@pytest.mark.parametrize(("shake", "leaves"), [(1.0, False), (12.0, True)])
def test_blocks_from_a_geometry_jump_in_a_spiral(shake, leaves):
    """As many modes and pairs as a mesh gives: few and many harmonics agree, and stepping leaves what spirals."""
    blocks = build_reduced_model(load_scene(DEMOS / "two_blocks.toml"))
    shaken = replace(blocks, load=blocks.load | {1: shake * blocks.load[1]})
    laws = ContactLaws(friction=0.6, initial_gap=1e-5)
    coarse, fine = (solve(ContactProblem(shaken, laws, 8706.0, n)) for n in (9, 21))
    assert (abs(fine.multiplier) > 3) == leaves and fine.side == 1 and not fine.alternates
    assert coarse.multiplier == pytest.approx(fine.multiplier, rel=0.2)
    steady = integrate(fine.problem, fine, 400, 40, tolerance=0, theta=0.52)
    moved = steady.output_history("top").std() / (np.linalg.norm(fine.output("top")[1:]) / np.sqrt(2))
    assert moved > 1.5 if leaves else moved == pytest.approx(1.0, abs=0.02)


def test_a_rod_that_taps_between_its_resonances_never_settles():
    """Neither fold nor doubling tells: the branch of the tapping rod's demo past its folds."""
    scene = load_scene(DEMOS / "tapping_rod.toml")
    chain = build_chain(scene)
    problem = replace(pose_problem(scene, chain.reduction.model, chain.interface), frequency=6800.0)
    found = solve(problem)
    assert abs(found.multiplier.imag) > 0.3 and not (found.grows or found.alternates)
    steady = integrate(problem, found, 800, 60, tolerance=0, theta=0.52)
    assert np.all(steady.changes[-5:] > 0.05)


def test_what_motions_in_time_do_not_bear_out_is_no_instability(monkeypatch):
    """A truncated series makes forty pairs lift off at wrong instants: its deviations grow, and motions stay."""
    blade = build_reduced_model(load_scene(DEMOS / "blade_root.toml"))
    shaken = replace(blade, load=blade.load | {1: 6 * blade.load[1]})
    found = solve(ContactProblem(shaken, ContactLaws(friction=0.2), 930.0, 9))
    assert found.multiplier == 0 and not found.unstable
    steady = integrate(found.problem, found, 400, 30, tolerance=0, theta=0.52)
    assert steady.changes[1] > 0.1 and steady.changes[-1] < 1e-3
    by_the_series = []
    monkeypatch.setattr(floquet, "is_borne_out", lambda *_: not by_the_series.append(1))
    assert abs(replace(found).multiplier) > floquet.GROWTH and by_the_series


def test_laws_that_are_not_stepped_in_time_are_taken_by_their_series(monkeypatch):
    def refuse(*_):
        raise ModelError("time integration knows only others; use solve")

    found = solve(tapping(0.42))
    monkeypatch.setattr("ewr_fenicsx.deviations.TimeScheme", refuse)
    assert replace(found).multiplier == found.multiplier != 0


def test_a_curve_marks_what_spirals():
    curve = frequency_response(two_masses(), FRICTIONLESS, DRIVEN, 15, progress=False)
    spirals = [max(abs(step_masses(solution))) > floquet.GROWTH for solution in curve.solutions]
    assert curve.unstable.tolist() == spirals
    assert 0 < sum(spirals) < len(spirals)


def test_between_folds_and_at_doublings_it_agrees_with_the_determinants():
    """Along a folded curve: a real multiplier above one where the side is negative, and none elsewhere."""
    laws = replace(FRICTIONLESS, initial_gap=1.0)
    curve = frequency_response(stop_oscillator(), laws, np.linspace(0.15, 0.18, 13), 21, progress=False)
    sides = np.array([solution.side for solution in curve.solutions])
    multipliers = np.array([solution.multiplier for solution in curve.solutions])
    folds = np.flatnonzero(np.diff(sides)) + 1
    clear = np.min(np.abs(np.arange(len(sides))[:, None] - folds), axis=1) > 1  # of the folds' noses
    assert len(folds) == 2 and np.count_nonzero(clear & (sides < 0)) >= 5
    np.testing.assert_array_equal(sides[clear] < 0, multipliers[clear].real > 1.0)
    knocking = stop_oscillator(excitation=1.0, damping=0.5, stop_stiffness=5.0)
    doubled = solve(ContactProblem(knocking, FRICTIONLESS, 0.42, 31))
    exact = max(step_masses(doubled), key=abs)
    assert doubled.alternates and exact < -1.3
    assert doubled.multiplier == pytest.approx(exact, rel=5e-3)


def test_where_it_is_not_looked_at(monkeypatch):
    """Where very many rows change status, and under laws that remember: it is zero, which says nothing."""
    sprung = solve(ContactProblem(dovetail(), ContactLaws(friction=0.2), 481.0, 3, closure="spring"))
    assert differentiate_laws(sprung.problem.system, sprung.forces, sprung.rigid, 512) is None
    assert floquet.find_growth(sprung.problem, sprung.forces, sprung.rigid, sprung.coordinates) == 0
    found = solve(tapping(0.42))
    assert found.multiplier != 0 and replace(found, converged=False).multiplier == 0
    monkeypatch.setattr(floquet, "MOST_UNKNOWNS", 9)
    assert replace(found).multiplier == 0 and not replace(found).unstable


def test_redundant_pairs_and_a_joint_at_rest_have_none():
    model = dovetail()
    assert solve(ContactProblem(repeat_first_pair(model), ContactLaws(friction=0.2), 481.0, 3)).multiplier == 0
    still = replace(model, load={0: model.load[0]})
    assert solve(ContactProblem(still, ContactLaws(friction=0.2), 0.0, 0)).multiplier == 0


@pytest.mark.parametrize("closure", ["dashpot", "spring"])
def test_friction_that_hardly_acts_changes_no_multiplier(closure):
    """The first mass rubs a little while the second one presses on its stop; springs are taken for dashpots."""
    model = replace(two_masses(), tangential=[[1.0, 0.0, 0.0]])
    problem = replace(tapping(0.425, 31), model=model, laws=ContactLaws(friction=1e-4), closure=closure)
    expected = solve(tapping(0.425, 31)).multiplier
    assert abs(expected) > 1.1
    assert solve(problem).multiplier == pytest.approx(expected, rel=0.02)
