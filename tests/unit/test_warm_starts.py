"""Warm starts: a neighbour's solution, with other harmonics, laws or frequency, and what is done with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from models import find_first_mode, two_trusses
from small_models import PROBLEMS, dovetail, lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, PeriodicSolution, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.newton_step import Factorisation
from ewr_fenicsx.errors import ModelError, NotConverged
from ewr_fenicsx.response import following
from ewr_fenicsx.solver import growing_sets, snes, splitting, warm_starts
from ewr_fenicsx.solver.snes import run_newton
from ewr_fenicsx.solver.warm_starts import carry_over, list_starts

SLIPS, LIFTS_OFF = PROBLEMS["floating, slip"], PROBLEMS["lift-off"]


def test_a_solution_is_a_start_for_itself():
    for problem in PROBLEMS.values():
        solution = solve(problem, tolerance=1e-10)
        again = solve(problem, start=solution, tolerance=1e-9)
        assert again.iterations == 0 and again.fallbacks == ()
        np.testing.assert_allclose(again.forces, solution.forces, atol=1e-12 * np.abs(solution.forces).max())


def test_a_start_from_a_neighbour_saves_steps_and_finds_the_same():
    problem = SLIPS
    near = solve(replace(problem, frequency=problem.frequency * 1.005))
    cold, warm = solve(problem, tolerance=1e-10), solve(problem, start=near, tolerance=1e-10)
    assert warm.iterations < cold.iterations
    np.testing.assert_allclose(warm.forces, cold.forces, atol=1e-6 * np.abs(cold.forces).max())


def test_two_neighbours_predict_what_is_linear_along_their_branch(monkeypatch):
    """As under wear a pair that stays closed: from depths of 0 and 0.1 to one of 0.3."""
    closed = ContactProblem(lift_off_oscillator(excitation=0.3), ContactLaws(tangential="frictionless"), 0.2, 3)
    first, second, exact = (solve(replace(closed, wear=[depth])) for depth in (0.0, 0.1, 0.3))
    predicted = []
    predict = following.list_predicted
    monkeypatch.setattr(following, "list_predicted", lambda _, *given: predicted.extend(given) or predict(_, *given))
    found = following.solve_from(exact.problem, second, first, ratio=2.0)
    assert found.converged and exact.merit["tension"] == 0
    for guess, true in zip(predicted, (exact.forces, exact.row_motion, exact.rigid), strict=True):
        np.testing.assert_allclose(guess, true, atol=1e-9)


@pytest.mark.parametrize("harmonics", [3, 9, (0, 1, 4)])
def test_a_start_is_prolonged_or_cut(harmonics):
    solution = solve(LIFTS_OFF)
    problem = replace(solution.problem, harmonics=harmonics)
    balance = HarmonicBalance(problem.system)
    forces, _, _ = carry_over(solution, balance)
    for j, h in enumerate(problem.basis.orders):
        np.testing.assert_allclose(forces[j], solution.forces[h] if h < 10 else 0.0, atol=1e-14)
    assert solve(problem, start=solution).converged


def test_a_start_may_have_other_laws():
    """From friction to none and back: forces that the new laws know are kept."""
    with_friction = solve(SLIPS)
    without = replace(with_friction.problem, laws=ContactLaws("bonded", "coulomb", friction=0.4))
    assert solve(without, start=with_friction).converged


def test_a_start_on_another_joint_is_refused():
    one = ContactProblem(lift_off_oscillator(), ContactLaws(friction=0.3), 0.1, 1)
    six = ContactProblem(dovetail(), ContactLaws(friction=0.3), 200.0, 1)
    with pytest.raises(ModelError, match="start has 6 pairs, the problem 1; give a solution on the same joint"):
        solve(one, start=solve(six))
    with pytest.raises(ModelError, match="start has 1 pairs, the problem 6"):
        solve(six, start=solve(one))


def test_forces_are_the_start_where_they_mean_the_same_motion():
    """Other harmonics, samples or laws: as they are. Another frequency or load: a guiding step first."""
    start = solve(SLIPS)
    same = [replace(SLIPS, harmonics=9), replace(SLIPS, samples=512), replace(SLIPS, laws=ContactLaws(friction=0.25))]
    louder = {h: 1.1 * f for h, f in SLIPS.model.load.items()}
    for problem, guided in [
        *((p, False) for p in same),
        (replace(SLIPS, frequency=490.0), True),
        (replace(SLIPS, load=louder), True),
    ]:
        balance = HarmonicBalance(problem.system)
        forces, _, rigid = carry_over(start, balance)
        (first, near, steps), *others = list_starts(start, balance, 1e-8)
        assert near == (not guided) and steps == guided
        assert np.array_equal(first, balance.pack(forces, rigid)) != guided
        assert others[0][1] != near, "then the other way"


def test_no_step_from_a_near_start_is_shortened(monkeypatch):
    """A cold start's first steps are shifted; one with other harmonics is solved as it is."""
    shifts = []

    class Spy(Factorisation):
        def __init__(self, step, right_side, shift, precision):
            shifts.append(shift)
            super().__init__(step, right_side, shift, precision)

    monkeypatch.setattr(snes, "Factorisation", Spy)
    start = solve(SLIPS)
    assert shifts[0] > 0
    shifts.clear()
    warm = solve(replace(SLIPS, harmonics=9), start)
    assert warm.iterations > 1 and warm.fallbacks == () and set(shifts) == {0.0}


def test_a_near_start_that_fails_is_tried_with_shortened_steps(monkeypatch):
    tried, original = [], snes.run_newton

    def fail_first(balance, unknowns, tolerance, solver, limit, near):
        tried.append(near)
        return original(balance, unknowns, tolerance, solver, 0 if near else limit, near=near)

    monkeypatch.setattr("ewr_fenicsx.solver.warm_starts.run_newton", fail_first)
    start = solve(SLIPS)
    tried.clear()
    found = solve(replace(SLIPS, harmonics=9), start)
    assert tried == [True, False] and found.converged and found.fallbacks == ()


def test_a_warm_start_that_takes_many_steps_is_given_up(monkeypatch):
    """Those that lead anywhere take few; a cold climb, or a smaller change, is the better way then."""
    start, further = solve(SLIPS), replace(SLIPS, frequency=1.05 * SLIPS.frequency)
    usual = solve(further, start)
    assert usual.iterations > 3 and usual.fallbacks == ()
    monkeypatch.setattr("ewr_fenicsx.solver.warm_starts.WARM_STEPS", 1)
    found = solve(further, start)
    assert found.fallbacks[0] == "given start: too many Newton steps"
    np.testing.assert_allclose(found.forces, usual.forces, atol=1e-6 * np.abs(usual.forces).max())
    with pytest.raises(NotConverged, match="too many Newton steps"):
        solve(further, start, fallbacks=False)


@pytest.mark.parametrize("change", [{"frequency": 470.0}, {"harmonics": 15}, {"laws": ContactLaws(friction=0.15)}])
def test_where_many_pairs_change_status_a_splitting_goes_on_first(change, monkeypatch):
    """It finds the same solution in fewer Newton steps."""
    model = dovetail(excitation=200.0)
    start = solve(ContactProblem(model, ContactLaws(friction=0.2), 481.0, 9))
    problem = replace(start.problem, **change)
    set_worthwhile = lambda least: [  # noqa: E731
        monkeypatch.setattr(warm_starts, name, least) for name in ("WORTHWHILE", "GUIDED_WORTHWHILE")
    ]
    set_worthwhile(50)
    balance = HarmonicBalance(problem.system)
    first, near, steps = next(iter(list_starts(start, balance, 1e-8)))
    assert near and steps == 0 and np.linalg.norm(balance.residual(first)) < 0.1
    split = solve(problem, start)
    set_worthwhile(10**6)
    guided = solve(replace(problem), start)
    assert split.iterations < guided.iterations and split.fallbacks == guided.fallbacks == ()
    np.testing.assert_allclose(split.output("tip"), guided.output("tip"), atol=1e-6 * abs(guided.output("tip")[1]))


def test_where_newton_steps_are_dear_it_does_so_nearer_to_a_solution_too(monkeypatch):
    start = solve(replace(SLIPS, harmonics=25, closure="dashpot"))
    problem = replace(start.problem, harmonics=40)
    balance = HarmonicBalance(problem.system)
    left = np.linalg.norm(balance.residual(balance.pack(*(carry_over(start, balance)[i] for i in (0, 2)))))
    assert warm_starts.DEAR_FAR < left < warm_starts.FAR
    few = solve(problem, start)
    monkeypatch.setattr(warm_starts, "DEAR_FROM", balance.size)
    dear = solve(replace(problem), start)
    assert dear.iterations < few.iterations
    np.testing.assert_allclose(dear.forces, few.forces, atol=1e-6 * np.abs(few.forces).max())


def test_where_hardly_any_does_the_laws_guide_the_start(monkeypatch):
    start = solve(SLIPS)
    asked = []
    monkeypatch.setattr(warm_starts, "come_near", lambda *_: asked.append(1))
    assert solve(replace(SLIPS, frequency=478.0), start).converged and not asked


def test_where_a_guided_run_fails_a_splitting_is_the_other_way(monkeypatch):
    """In the smallest joint as well: a run that creeps into a corner creeps there with unshortened steps, too."""
    start, problem = solve(SLIPS), replace(SLIPS, frequency=1.05 * SLIPS.frequency)
    balance = HarmonicBalance(problem.system)
    (guided, *_), (split, near, _) = list_starts(start, balance, 1e-8)
    assert near and np.linalg.norm(balance.residual(split)) < 0.5 * np.linalg.norm(balance.residual(guided))
    tried, original = [], snes.run_newton

    def fail_first(balance, unknowns, tolerance, solver, limit, near):
        tried.append(near)
        return original(balance, unknowns, tolerance, solver, limit if near else 0, near=near)

    usual = solve(problem, start)
    monkeypatch.setattr("ewr_fenicsx.solver.warm_starts.run_newton", fail_first)
    found = solve(problem, start)
    assert tried == [False, True] and found.converged and found.fallbacks == ()
    np.testing.assert_allclose(found.forces, usual.forces, atol=1e-6 * np.abs(usual.forces).max())


def crowd(
    monkeypatch, friction: float, harmonics: int = 9, samples: int | None = None
) -> tuple[PeriodicSolution, HarmonicBalance]:
    """A dovetail's solution, and the balance with another friction, in which many pairs count as changing status."""
    for name in ("WORTHWHILE", "GUIDED_WORTHWHILE"):
        monkeypatch.setattr(warm_starts, name, 50)
    start = solve(ContactProblem(dovetail(excitation=200.0), ContactLaws(friction=0.2), 481.0, harmonics, samples))
    return start, HarmonicBalance(replace(start.problem, laws=ContactLaws(friction=friction)).system)


def test_newton_begins_ever_nearer_before_a_warm_start_is_given_up(monkeypatch):
    """Runs from where a splitting ended first crept, and those from the forces as they were took 40 steps each."""
    start, balance = crowd(monkeypatch, 0.25, samples=64)  # as many as the splitting has
    *starts, (carried, *_) = list_starts(start, balance, 1e-8)
    left = [np.linalg.norm(balance.residual(unknowns)) for unknowns, _, _ in starts]
    assert len(starts) == 3 and all(near for _, near, _ in starts)
    assert np.array_equal(carried, balance.pack(*carry_over(start, balance)[::2])), "in the end"
    assert left[1] < 0.5 * left[0] and left[2] < 0.5 * left[1]


def test_a_splitting_that_ends_nowhere_is_begun_with_few_harmonics(monkeypatch):
    """As a cold start does, which took a few steps where the warm one took a hundred and went to the ladder."""
    start, balance = crowd(monkeypatch, 0.3, harmonics=15)
    tops, original = [], splitting.come_near

    def end_nowhere(level, begin):
        tops.append(level.basis.orders[-1])
        return iter(()) if len(tops) == 1 else original(level, begin)

    monkeypatch.setattr(warm_starts, "come_near", end_nowhere)
    monkeypatch.setattr(growing_sets, "come_near", end_nowhere)
    starts = list(list_starts(start, balance, 1e-8))
    assert tops == [15, 5, 15] and starts and all(near for _, near, _ in starts)
    found = run_newton(balance, starts[0][0], 1e-8, "elimination", near=True)
    assert found.converged
    wanted = solve(replace(start.problem, laws=ContactLaws(friction=0.3)))
    np.testing.assert_allclose(
        balance.unpack(found.unknowns)[0], wanted.forces, atol=1e-6 * np.abs(wanted.forces).max()
    )


def test_laws_that_are_no_projections_are_tried_with_unshortened_steps(monkeypatch):
    """There is no splitting for them."""
    start, problem = solve(SLIPS), replace(SLIPS, frequency=1.05 * SLIPS.frequency)
    monkeypatch.setattr(warm_starts, "are_projections", lambda _: False)
    (guided, *first), (again, *second) = list_starts(start, HarmonicBalance(problem.system), 1e-8)
    assert np.array_equal(again, guided) and (first, second) == ([False, 1], [True, 0])


@pytest.mark.parametrize(("load", "most_steps", "most_fallbacks"), [(0.06, 12.0, 0), (0.1, 16.0, 1)])
def test_a_sweep_of_solves_takes_few_steps_a_point(load, most_steps, most_fallbacks):
    """Ten pairs that slip and lift off near a resonance, 2 % a step: 9.6 and 12.7 steps a point measured.

    Guided starts alone took 15.5 and 19.0: two and three of the points went to the ladder, at up to 120 steps each.
    """
    model = two_trusses(10, load)
    steps, fallbacks, solution = 0, 0, None
    frequencies = find_first_mode(model) * np.linspace(0.7, 1.15, 24)
    for frequency in frequencies:
        problem = ContactProblem(model, ContactLaws(friction=0.3), float(frequency), 5, 128)
        solution = solve(problem, start=solution)
        steps += solution.iterations
        fallbacks += bool(solution.fallbacks)
    assert steps <= most_steps * len(frequencies)
    assert fallbacks <= most_fallbacks
