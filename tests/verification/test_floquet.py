"""Floquet multipliers of solutions against the equations of deviations solved by scipy, and against stepping."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hard_cases import Case, pose_case
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag
from small_models import dovetail, repeat_first_pair, stop_oscillator

from ewr_fenicsx import (
    ContactLaws,
    ContactProblem,
    ReducedModel,
    build_reduced_model,
    frequency_response,
    integrate,
    load_scene,
    solve,
)
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.in_time import floquet
from ewr_fenicsx.in_time.deviations import differentiate_laws
from ewr_fenicsx.in_time.hill import measure_edges
from ewr_fenicsx.structure.chain import build_chain, pose_problem

DEMOS = Path(__file__).parents[2] / "demos"
FRICTIONLESS = ContactLaws(tangential="frictionless")
STOP = 3.0  # stiffness of the stop of two_masses
DRIVEN = np.linspace(0.395, 0.43, 8)  # Hz, about the sum of their two frequencies


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


def stand_beside(first: ReducedModel, second: ReducedModel, stiffness: float, time: float) -> ReducedModel:
    """Two models that do not touch, the second with so many times its stiffness and forces, ``time`` times as slow."""

    def pad(left, right):
        return block_diag(left, np.zeros((0, second.size))), block_diag(np.zeros((0, first.size)), right)

    second = replace(
        second,
        mass=stiffness * time**2 * second.mass,
        damping=stiffness * time * second.damping,
        stiffness=stiffness * second.stiffness,
        load={h: stiffness * force for h, force in second.load.items()},
    )
    none = [np.zeros(first.size), np.zeros(second.size)]
    return ReducedModel(
        **{name: block_diag(getattr(first, name), getattr(second, name)) for name in ("mass", "damping", "stiffness")},
        normal=np.vstack(pad(first.normal, second.normal)),
        tangential=np.vstack(pad(np.zeros((first.pairs, first.size)), second.tangential)),
        load={h: np.concatenate([first.load.get(h, none[0]), second.load.get(h, none[1])]) for h in (0, 1)},
        outputs={"tip": np.concatenate([first.outputs["tip"], none[1]])},
    )


def step_rubbing_masses(solution, friction: float, steps: int = 4000) -> np.ndarray:
    """As ``step_masses`` where the first mass rubs under the stop's force: turning, its velocity's deviation jumps.

    The jump is the ratio of the accelerations after and before (a saltation).
    """
    model, omega, orders = solution.problem.model, solution.problem.omega, np.array(solution.orders)
    linear, damping = model.stiffness[:2, :2] - np.diag([0.0, STOP]), model.damping[0, 0]
    phases = np.exp(1j * omega * np.outer(np.linspace(0, 2 * np.pi / omega, 2 * steps + 1), orders))
    moved = np.real(phases @ solution.coordinates)[:, :2]
    turning = np.sign(np.real(phases @ (1j * omega * orders[:, None] * solution.coordinates))[:, 0])

    def rate(j, sign, state):
        pressed = STOP * (moved[j, 1] > 0)
        stiffness = linear + np.array([[0.0, friction * sign * pressed], [0.0, pressed]])
        return np.vstack([state[2:], -stiffness @ state[:2] - damping * state[2:]])

    whole, dt = np.eye(4), 2 * np.pi / omega / steps
    for j in range(0, 2 * steps, 2):
        sign = turning[j]
        first = rate(j, sign, whole)
        second = rate(j + 1, sign, whole + dt / 2 * first)
        third = rate(j + 1, sign, whole + dt / 2 * second)
        whole = whole + dt / 6 * (first + 2 * second + 2 * third + rate(j + 2, sign, whole + dt * third))
        if turning[j + 2] != sign:
            push, limit = -(linear @ moved[j + 2])[0], friction * STOP * max(0.0, moved[j + 2, 1])
            assert abs(push) > limit, "it turns and does not stick"
            whole[2] *= (push + sign * limit) / (push - sign * limit)
    return np.linalg.eigvals(whole)


def hold_stop_up(dashpot: float) -> ReducedModel:
    """``two_masses`` with a dashpot beside the stop's spring."""
    model = two_masses()
    beside = np.zeros((3, 3))
    beside[1:, 1:] = dashpot * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return replace(model, damping=model.damping + beside)


def sprung_slider(closure: str) -> ContactProblem:
    """A mass that feeds on its own motion, on a spring, and by another one on a slider without mass (Jenkins)."""
    model = ReducedModel(
        mass=np.diag([1.0, 0.0]),
        damping=np.diag([-0.1, 0.0]),
        stiffness=[[2.0, -1.0], [-1.0, 1.0]],
        tangential=[[0.0, 1.0]],
        load={1: [1.0, 0.0]},
        outputs={"tip": [1.0, 0.0]},
    )
    return ContactProblem(model, ContactLaws("prescribed", normal_force=0.5, friction=1.0), 0.1, 31, closure=closure)


def step_sprung_slider(solution, steps: int = 2000) -> np.ndarray:
    """Multipliers of its mass, by differences of periods stepped from about the periodic motion."""
    omega, damping = solution.problem.omega, solution.problem.model.damping[0, 0]
    dt, load = 2 * np.pi / omega / steps, np.cos(np.pi * np.arange(2 * steps) / steps)

    def run(state):
        x, v, bent = state
        for early, late in load.reshape(-1, 2):
            middle = x + dt / 2 * v, v + dt / 2 * (early - x - damping * v - bent)
            half = np.clip(bent + dt / 2 * v, -0.5, 0.5)
            x, v = x + dt * middle[1], v + dt * (late - middle[0] - damping * middle[1] - half)
            bent = np.clip(bent + dt * middle[1], -0.5, 0.5)
        return np.array([x, v, bent])

    amplitudes = solution.coordinates
    start = amplitudes.real.sum(axis=0), (1j * omega * np.array(solution.orders) @ amplitudes).real
    state = np.array([start[0][0], start[1][0], np.clip(start[0][0] - start[0][1], -0.5, 0.5)])
    for _ in range(3):
        columns = [(run(state + 1e-5 * unit) - run(state - 1e-5 * unit)) / 2e-5 for unit in np.eye(3)]
        whole = np.array(columns).T
        state = state - np.linalg.solve(whole - np.eye(3), run(state) - state)
    return np.linalg.eigvals(whole)


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
    """As the summary says."""
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
    swings = steady.transient("top")[1:].reshape(40, 400).std(axis=1)  # of each period: the last one's is chance
    moved = swings.max() / (np.linalg.norm(fine.output("top")[1:]) / np.sqrt(2))
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
    shaken = ContactProblem(replace(blade, load=blade.load | {1: 7 * blade.load[1]}), ContactLaws(friction=0.2), 930.0)
    found = solve(replace(shaken, harmonics=9), solve(replace(shaken, harmonics=5)))  # nine from cold take long
    assert found.multiplier == 0 and not found.unstable
    steady = integrate(found.problem, found, 400, 30, tolerance=0, theta=0.52)
    assert steady.changes[1] > 0.1 and steady.changes[-1] < 1e-3
    monkeypatch.setattr(floquet, "is_borne_out", lambda *_: True)
    by_the_series = floquet.find_growth(found)
    assert abs(by_the_series) > floquet.GROWTH
    monkeypatch.setattr("ewr_fenicsx.solution.solution.find_growth", lambda *_: by_the_series)
    assert replace(found).multiplier == 0, "the motion settles beside it, whatever its deviations do"
    monkeypatch.setattr("ewr_fenicsx.solution.solution.settles", lambda *_: False)
    assert replace(found).multiplier == by_the_series


def rubbed_frame(seed: int) -> ReducedModel:
    """Six masses joined at random; each of three pairs rubs at one massless node and presses at another."""
    random = np.random.default_rng(seed)
    root, feet = random.normal(size=(2, 6, 6))
    reach = np.hstack([feet / np.linalg.norm(feet, axis=1, keepdims=True), -np.eye(6)])
    mass, own = np.diag([0.6] * 6 + [0.0] * 6), np.zeros((12, 12))
    own[:6, :6] = root @ root.T / 6 + 0.3 * np.eye(6)
    stiffness = own + 5.0 * reach.T @ reach
    return ReducedModel(
        mass,
        0.004 * stiffness + 0.01 * mass,
        stiffness,
        normal=np.eye(12)[6:9],
        tangential=np.eye(12)[9:],
        load={0: [0.0] * 6 + [-8.0] * 3 + [0.0] * 3, 1: [*random.normal(size=6), *[0.0] * 6]},
        outputs={"x": np.eye(12)[0]},
    )


@pytest.mark.parametrize("seed, leaves", [(69, False), (92, False), (5, True)])
def test_beside_joints_that_only_rub_motions_settle_or_leave_as_stepping_says(seed, leaves):
    """By five harmonics all have a multiplier of 1.04 and more, by fifteen one; no pair opens."""
    solution = solve(ContactProblem(rubbed_frame(seed), ContactLaws(friction=0.5), 0.2, 5))
    assert solution.touches and solution.history("gap").max() < 1e-9
    steady = integrate(solution.problem, solution, 500, 150, tolerance=0, theta=0.502)
    assert (steady.changes[-1] > 0.05) == leaves and (steady.changes[-1] < 1e-5) == (not leaves)
    assert solution.unstable == leaves


def test_a_deviation_that_is_cut_off_at_the_highest_harmonics_has_no_exponent(monkeypatch):
    """Steps so coarse that contact chatters bear it out; in 4096 a period the motion comes to repeat itself."""
    case = Case("blade root", 0.85, ("applied", 0.3), 0.2, 15, 1e-4, "even", (1, 1))
    found = solve(pose_case(case))
    assert found.multiplier == 0 and not found.unstable
    monkeypatch.setattr(floquet, "EDGE", np.inf)
    cut_off = floquet.find_growth(found)
    assert abs(cut_off) > 1.1


def test_what_is_cut_off_is_told_by_what_lies_at_the_edge():
    inside, outside, even, still = np.zeros((4, 11, 2), dtype=complex)
    inside[4:7], outside[-1], even[:] = 1.0, 2.0j, 0.5
    np.testing.assert_allclose(measure_edges(np.array([inside, outside, even, still])), [0.0, 1.0, 4 / 11, 1.0])
    np.testing.assert_allclose(measure_edges(inside[None, 4:7]), 2 / 3, err_msg="of three harmonics, two")


def test_laws_that_are_not_stepped_in_time_are_taken_by_their_series(monkeypatch):
    def refuse(*_):
        raise ModelError("time integration knows only others; use solve")

    found = solve(tapping(0.42))
    monkeypatch.setattr("ewr_fenicsx.in_time.time_stepping.TimeScheme", refuse)
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
    folds = np.flatnonzero(np.diff(sides))
    beside = curve.frequencies[np.concatenate([folds, folds + 1])]  # on either side of the noses
    clear = np.min(np.abs(curve.frequencies[:, None] - beside), axis=1) > 2e-5
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
    assert differentiate_laws(sprung, 512) is None
    assert floquet.find_growth(sprung) == 0
    found = solve(tapping(0.42))
    assert found.multiplier != 0 and replace(found, converged=False).multiplier == 0
    monkeypatch.setattr(floquet, "MOST_UNKNOWNS", 9)
    assert replace(found).multiplier == 0 and not replace(found).unstable


def test_redundant_pairs_and_a_joint_at_rest_have_none():
    model = dovetail()
    assert solve(ContactProblem(repeat_first_pair(model), ContactLaws(friction=0.2), 481.0, 3)).multiplier == 0
    still = replace(model, load={0: model.load[0]})
    assert solve(ContactProblem(still, ContactLaws(friction=0.2), 0.0, 0)).multiplier == 0


@pytest.mark.parametrize("harmonics", [9, 63])
@pytest.mark.parametrize(("frequency", "friction"), [(0.42, 0.03), (0.42, 0.1), (0.425, 0.06)])
def test_masses_that_rub_and_turn(frequency, friction, harmonics):
    """Stepping by itself has them stick for a sample, and sees no growth."""
    model = replace(two_masses(), tangential=[[1.0, 0.0, 0.0]])
    found = solve(replace(tapping(frequency, harmonics), model=model, laws=ContactLaws(friction=friction)))
    exact = max(abs(step_rubbing_masses(found, friction)))
    assert exact > 1.04
    assert abs(found.multiplier) == pytest.approx(exact, rel=0.02 if harmonics < 20 else 0.01)


def test_a_mass_that_friction_all_but_stops_where_it_turns_settles():
    """Newton's method leads to no solution with the default dashpots: 21 % a period was seen with none at all."""
    stiffness = [[1.01, -0.63, 0.0], [-0.63, 12.49, -10.32], [0.0, -10.32, 10.32]]
    model = ReducedModel(
        mass=np.diag([1.77, 1.06, 0.0]),
        damping=np.diag([0.01, 0.01, 0.0]),
        stiffness=stiffness,
        normal=[[0.0, 0.0, 1.0]],
        tangential=[[1.0, 0.0, 0.0]],
        load={0: [-0.04, -0.33, 0.0], 1: [-0.81 - 0.15j, -0.78 - 0.39j, 0.0]},
    )
    found = solve(ContactProblem(model, ContactLaws(friction=0.26), 0.44245, 21))
    assert found.problem.has_masses and found.multiplier == 0 and not found.unstable
    changes = integrate(found.problem, found, 1024, 150, tolerance=0, theta=0.505).changes
    assert changes[-1] < 0.1 * changes[5]


@pytest.mark.parametrize(("frequency", "dashpot", "leaves"), [(0.41, 0.5, False), (0.42, 1.0, True)])
def test_a_dashpot_without_mass_beside_a_stop_holds_motions_back(frequency, dashpot, leaves):
    """Without it both would leave, by 1.12 and 1.17 a period."""
    found = solve(ContactProblem(hold_stop_up(dashpot), FRICTIONLESS, frequency, 31))
    assert (found.multiplier != 0) == leaves == found.unstable
    assert abs(found.multiplier) < 1.05
    steady = integrate(found.problem, found, 1024, 150, tolerance=0, theta=0.52)
    assert np.all(steady.changes[-5:] > 0.05) if leaves else steady.changes[-1] < 1e-6


@pytest.mark.parametrize("closure", ["dashpot", "spring"])
def test_a_slider_on_a_spring(closure):
    """Springs for the harmonics left out remember: dashpots are taken in their place."""
    found = solve(sprung_slider(closure))
    assert found.fallbacks == () and found.problem.has_springs == (closure == "spring")
    exact = max(step_sprung_slider(found), key=abs)
    assert exact.real > 1.4
    assert found.multiplier == pytest.approx(exact, rel=0.05)


def test_beside_a_floating_joint_folds_are_told_as_they_are_without():
    """Rows that stick and bodies that float make pivots which look like rounding; the determinant's sign is certain."""
    opens = replace(FRICTIONLESS, initial_gap=1.0)
    joined = stand_beside(stop_oscillator(), dovetail(pull=1000.0, excitation=10.0), stiffness=1e-7, time=5000.0)
    laws = [([0], opens), (range(1, joined.pairs), ContactLaws(friction=0.5))]
    alone, both = (
        frequency_response(model, each, np.linspace(0.15, 0.18, 13), 9, progress=False)
        for model, each in ((stop_oscillator(), opens), (joined, laws))
    )
    for curve in (alone, both):
        between = [solution for solution in curve.solutions if solution.side < 0]
        assert len(between) > 5 and all(solution.grows for solution in between[1:-1]), "at a nose motions may settle"
