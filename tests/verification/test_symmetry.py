"""Harmonics that are left out are zero: the same solved with all of them; and where the symmetry fails none is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail, friction_oscillator, lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, integrate, solve
from ewr_fenicsx.solution.symmetry import find_idle_harmonics, include_idle, leave_out_idle

N = 7
EVERY = tuple(range(N + 1))  # listed: nothing is left out


def rub(force=0.6, **other) -> ContactLaws:
    return ContactLaws("prescribed", normal_force=force, friction=0.5, **other)


def shaken(size: int = 9, **load) -> ContactProblem:
    """Three pairs on a structure with no symmetry of its own, shaken at harmonics 1 and 3."""
    rng = np.random.default_rng(5)
    model = replace(
        random_structure(size=size),
        load={1: rng.normal(size=size) + 1j * rng.normal(size=size), 3: 0.4 * rng.normal(size=size)},
    )
    return ContactProblem(model, rub(), 0.15, N)


def compare(problem: ContactProblem, idle: tuple[int, ...]) -> None:
    """Solved without the idle harmonics and with all: the same forces and outputs, and nothing at the idle ones."""
    assert find_idle_harmonics(problem).orders == idle
    short, full = solve(problem, tolerance=1e-11), solve(replace(problem, harmonics=EVERY), tolerance=1e-11)
    assert full.left_out == () and short.left_out == idle
    scale = np.abs(full.forces).max()
    assert scale > 0
    slips = np.abs(full.history("slip_velocity")).max()
    assert slips > 1e-3 or len(idle) == N, "something must slip, or the comparison is one of linear problems"
    assert np.abs(full.forces[list(idle)]).max() < 1e-8 * scale, "they are zero"
    np.testing.assert_array_equal(short.forces[list(idle)], 0.0)
    np.testing.assert_allclose(short.forces, full.forces, atol=1e-8 * scale)
    np.testing.assert_allclose(short.output("tip"), full.output("tip"), atol=1e-8 * np.abs(full.output("tip")).max())
    kept = sum(1 if h == 0 else 2 for h in EVERY if h not in idle)
    rigid = full.rigid.size
    assert short.unknowns - rigid == (full.unknowns - rigid) * kept // (2 * N + 1)


def test_given_normal_force_and_odd_loads():
    """The structure has normal rows: the constant force loads its mean, which friction does not see."""
    problem = shaken()
    compare(problem, (2, 4, 6))
    assert "harmonics 2, 4, 6 left out: half-wave symmetry" in solve(problem).summary()
    assert "harmonics 2, 4, 6, ..., 30 left out: half" in solve(replace(problem, harmonics=31)).summary()


def test_no_normal_rows_no_mean():
    problem = shaken()
    compare(replace(problem, model=replace(problem.model, normal=None)), (0, 2, 4, 6))


def test_a_limit_that_repeats_every_half_period():
    problem = shaken()
    model = replace(problem.model, normal=None)
    compare(replace(problem, model=model, laws=rub({0: 0.8, 2: 0.3 + 0.2j})), (0, 2, 4, 6))


def test_mean_load_with_friction_alone():
    problem = shaken()
    compare(replace(problem, model=replace(problem.model, load=problem.model.load | {0: 2 * np.ones(9)})), (2, 4, 6))


def test_mean_friction_set_to_zero():
    problem = replace(shaken(), laws=rub(static_friction="zero"))
    assert find_idle_harmonics(problem).orders == (2, 4, 6)
    short, full = solve(problem, tolerance=1e-11), solve(replace(problem, harmonics=EVERY), tolerance=1e-11)
    np.testing.assert_allclose(short.forces, full.forces, atol=1e-8 * np.abs(full.forces).max())


def test_some_pairs_bonded_some_free():
    problem = shaken(size=12)
    laws = [([0], rub()), ([1], ContactLaws("bonded", "bonded")), ([2], ContactLaws("bonded", "frictionless"))]
    compare(replace(problem, laws=laws), (2, 4, 6))


@pytest.mark.parametrize("model", [lift_off_oscillator(excitation=0.0), dovetail(excitation=0.0)])
def test_nothing_oscillates(model):
    problem = ContactProblem(model, ContactLaws(initial_gap=1e-7), 0.15, N)
    compare(problem, (1, 2, 3, 4, 5, 6, 7))
    assert "left out: nothing oscillates" in solve(problem).summary()


def even_load(problem: ContactProblem) -> ContactProblem:
    return replace(problem, load=problem.model.load | {2: 0.3 * np.ones(9)})


def odd_limit(problem: ContactProblem) -> ContactProblem:
    return replace(problem, model=replace(problem.model, normal=None), laws=rub({0: 0.8, 1: 0.3}))


def even_force_on_the_structure(problem: ContactProblem) -> ContactProblem:
    return replace(problem, laws=rub({0: 0.8, 2: 0.3}))


def contact_that_could_open(problem: ContactProblem) -> ContactProblem:
    return replace(problem, load=problem.model.load | {0: press(problem)}, laws=ContactLaws())


def friction_on_a_bond(problem: ContactProblem) -> ContactProblem:
    return replace(problem, load=problem.model.load | {0: press(problem)}, laws=ContactLaws("bonded"))


def press(problem: ContactProblem) -> np.ndarray:
    """A mean load that keeps all pairs closed most of the time [N]."""
    return -3 * problem.model.normal.sum(axis=0)


@pytest.mark.parametrize(
    "change", [even_load, odd_limit, even_force_on_the_structure, contact_that_could_open, friction_on_a_bond]
)
def test_where_the_symmetry_fails_even_harmonics_are_there_and_kept(change):
    problem = change(shaken())
    assert find_idle_harmonics(problem).orders == ()
    assert leave_out_idle(problem) is problem
    solution = solve(problem)
    assert solution.left_out == ()
    assert np.abs(solution.forces[2::2]).max() > 1e-3 * np.abs(solution.forces).max()


def test_a_list_of_harmonics_is_taken_at_its_word():
    problem = replace(shaken(), harmonics=(0, 1, 2, 3))
    assert solve(problem).unknowns == 3 * 7


def test_an_odd_number_of_samples_breaks_the_symmetry():
    assert find_idle_harmonics(replace(shaken(), samples=129)).orders == ()
    assert find_idle_harmonics(replace(shaken(), samples=130)).orders == (2, 4, 6)


def test_floating_bodies_keep_their_mean():
    free = friction_oscillator(stiffness=0.0, load={1: 1.0})
    assert find_idle_harmonics(ContactProblem(free, rub(), 0.1, N)).orders == ()


def test_a_start_that_uses_the_idle_harmonics_keeps_them():
    problem = shaken()
    start = solve(replace(problem, load=problem.model.load | {2: 0.3 * np.ones(9)}))
    assert np.abs(start.forces[2]).max() > 0
    assert solve(problem, start=start).left_out == ()
    assert solve(problem, start=solve(problem)).left_out == (2, 4, 6)


def test_harmonics_that_were_solved_for_are_not_told_to_be_left_out():
    """Also where ``solve`` went back to default weights, and states both problems anew."""
    problem = shaken()
    start = solve(replace(problem, load=problem.model.load | {2: 0.3 * np.ones(9)}))
    kept = include_idle(solve(problem, start=start), replace(problem))
    assert (kept.left_out, kept.why_left_out) == ((), "")


def test_time_stepping_finds_no_even_harmonic_either():
    """Another formulation, which knows of no symmetry: the spectrum of its steady state."""
    model = friction_oscillator(damping=0.1)
    problem = ContactProblem(model, rub(), 0.1, N)
    assert find_idle_harmonics(problem).orders == (0, 2, 4, 6)
    steady = integrate(problem, start=solve(problem), steps=800, periods=400, tolerance=1e-9)
    spectrum = np.abs(steady.output("tip"))
    assert spectrum[[0, 2, 4, 6]].max() < 1e-6 * spectrum[1]
    assert spectrum[3] > 1e-3 * spectrum[1]
