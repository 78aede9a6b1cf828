"""The sign of the Jacobian's determinant against time stepping: motions leave the solutions that it calls unstable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from checked_solutions import find_turns
from small_models import PROBLEMS, dovetail, repeat_first_pair, stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, close_ring, frequency_response, integrate, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.newton_step import NewtonStep
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.in_time import stability
from ewr_fenicsx.model.compliance import condense
from ewr_fenicsx.problem.contact_system import ContactSystem
from ewr_fenicsx.problem.harmonics import FourierBasis

LAWS = ContactLaws(tangential="frictionless", initial_gap=1.0)


@pytest.fixture(scope="module")
def branches():
    """Solutions at three solutions' frequencies: up to the upper fold, between the folds, from the lower one."""
    curve = frequency_response(stop_oscillator(), LAWS, np.linspace(0.15, 0.18, 13), 9, progress=False)
    turns = find_turns(curve.frequencies)
    assert len(turns) == 2
    pieces = np.split(np.arange(len(curve.solutions)), turns)
    kept = {"upper": pieces[0], "middle": pieces[1][3:-3], "lower": pieces[2][3:]}  # but for the folds' noses
    return {name: [curve.solutions[i] for i in numbers] for name, numbers in kept.items()}


def test_between_the_folds_solutions_are_unstable(branches):
    assert all(len(solutions) >= 5 for solutions in branches.values())
    for name, side in (("upper", 1), ("middle", -1), ("lower", 1)):
        assert {solution.side for solution in branches[name]} == {side}, name
        assert {solution.grows for solution in branches[name]} == {side < 0}, name


def test_a_middle_branch_is_unstable_however_near_the_next_one_is():
    """Where the stop is all but missed, the motion that never touches it lies within three per cent: time goes there.

    It is linear, so known; the middle branch touches.
    """
    model = stop_oscillator(excitation=0.048, damping=0.03, stop_stiffness=0.5)
    curve = frequency_response(model, LAWS, np.linspace(0.15, 0.19, 21), 6, progress=False)
    near = [s for s in curve.solutions if s.side < 0 and abs(s.output("tip")[1]) < 1.1]
    assert len(near) >= 3
    for solution in near:
        alone = 0.048 / (1 - solution.problem.omega**2 + 0.03j * solution.problem.omega)
        steady = integrate(solution.problem, solution, 1000, 400, tolerance=0, theta=0.505)
        assert abs(steady.output("tip")[1]) == pytest.approx(abs(alone), rel=1e-3)
        assert abs(solution.output("tip")[1]) > 1.01 * abs(alone) and solution.touches
        assert solution.grows and solution.unstable


def test_friction_that_wedges_turns_the_sign_and_no_motion_leaves():
    """Mean friction is what turns it: no motion in time grows, and none is told to."""
    model = dovetail(angle=50.0, excitation=200.0, seed=0, damping=2e-5)
    found = solve(ContactProblem(model, ContactLaws(friction=2.0), 481.0, 3))
    assert found.fallbacks == () and found.side == -1 and found.multiplier == 0
    assert not found.grows and not found.unstable and "unstable" not in found.summary()
    steady = integrate(found.problem, found, periods=100, tolerance=0)
    for name in model.outputs:
        assert abs(steady.output(name)[1]) == pytest.approx(abs(found.output(name)[1]), rel=0.03)
    assert np.all(steady.changes[-5:] < 1e-3)


@pytest.mark.parametrize("engine_order", [0, 1])
def test_of_a_ring_friction_that_wedges_is_told_from_growth_as_well(engine_order, branches):
    """Sectors that nothing joins are each what they are alone, whichever way their loads follow one another."""
    ring = {"sectors": 6, "engine_order": engine_order}
    wedged = close_ring(dovetail(angle=50.0, excitation=200.0, seed=0, damping=2e-5), [], [], **ring)
    found = solve(ContactProblem(wedged, ContactLaws(friction=2.0), 481.0, 3))
    assert found.side == -1 and not found.grows and not found.unstable and "unstable" not in found.summary()
    for name, grows in (("upper", False), ("middle", True), ("lower", False)):
        begun = branches[name][len(branches[name]) // 2]
        sector = solve(replace(begun.problem, model=close_ring(begun.problem.model, [], [], **ring)), begun)
        assert sector.grows == sector.unstable == grows
        assert sector.output("tip") == pytest.approx(begun.output("tip"), rel=1e-6, abs=1e-6)


def test_a_summary_says_so_however_it_was_found(branches):
    for name, told in (("upper", False), ("middle", True), ("lower", False)):
        solution = branches[name][len(branches[name]) // 2]
        assert solution.fallbacks == ()
        assert any("unstable: motions in time leave it" in line for line in solution.cautions) == told
        assert ("unstable" in solution.summary()) == told


def test_harmonics_do_not_change_the_side(branches):
    for name, side in (("upper", 1), ("middle", -1), ("lower", 1)):
        middle = branches[name][len(branches[name]) // 2]
        for harmonics in (5, 14, 21):
            found = solve(replace(middle.problem, harmonics=harmonics), middle)
            assert found.side == side


def test_a_motion_in_time_leaves_the_unstable_solutions_and_no_other(branches):
    """Begun on the solution, but for its truncation: after three hundred periods the middle branch is left."""
    for name, stays in (("upper", True), ("middle", False), ("lower", True)):
        begun = branches[name][len(branches[name]) // 2]
        fine = solve(replace(begun.problem, harmonics=31), begun)
        # theta above 1/2: the stop's end has no mass, and would ring from step to step
        steady = integrate(fine.problem, fine, steps=1024, periods=300, tolerance=1e-7, theta=0.52)
        here, there = abs(fine.output("tip")[1]), abs(steady.output("tip")[1])
        assert steady.converged
        assert (abs(there / here - 1) < 2e-3) == stays, name


@pytest.mark.parametrize("name", [name for name in PROBLEMS if name != "stuck"])
def test_what_time_stepping_settles_on_is_on_the_stable_side(name):
    problem = PROBLEMS[name]
    found = solve(problem)
    steady = integrate(problem, found, steps=512, periods=200, tolerance=1e-5, acceleration=True)
    assert steady.converged
    output = next(iter(problem.model.outputs))
    assert abs(steady.output(output)[1] - found.output(output)[1]) < 0.1 * abs(found.output(output)[1])
    assert found.side == 1


def pound(frequency: float, damping: float = 0.5, **settings) -> ContactProblem:
    """A mass that presses on a springy stop for half of its period: its stiffness alternates between 1 and 6."""
    model = stop_oscillator(excitation=1.0, damping=damping, stop_stiffness=5.0)
    settings = {"harmonics": 15} | settings
    return ContactProblem(model, ContactLaws(tangential="frictionless"), frequency, **settings)


@pytest.mark.parametrize(
    ("frequency", "damping", "alternates"),
    [(0.2, 0.05, False), (0.38, 0.05, True), (0.46, 0.05, True), (0.34, 0.5, False), (0.42, 0.5, True)],
)
def test_motions_in_time_leave_what_alternates(frequency, damping, alternates):
    """By factors of 1.6 to 5.6; with other harmonics the same is said."""
    found = solve(pound(frequency, damping))
    assert found.side == 1 and found.fallbacks == ()
    others = [solve(replace(found.problem, harmonics=harmonics)) for harmonics in (5, 30)]
    assert {solution.alternates for solution in (found, *others)} == {alternates}
    assert ("leave it, most often for one that repeats every second period" in found.summary()) == alternates
    assert found.unstable == alternates
    steady = integrate(found.problem, found, steps=1024, periods=150, tolerance=1e-7, theta=0.52)
    here, there = abs(found.output("tip")[1]), abs(steady.output("tip")[1])
    assert steady.converged == (not alternates) == (abs(there / here - 1) < 5e-3)


@pytest.mark.parametrize("samples", [72, 128, 288])
def test_few_samples_do_not_hide_what_alternates(samples):
    """A stop touched for a thirteenth of the period: exact solutions between events give the multiplier -1.82."""
    load = {0: -38.902, 1: 93.128}
    model = stop_oscillator(stiffness=1.4397e5, stop_stiffness=2.7608e6, damping=26.264, load=load)
    laws = ContactLaws(tangential="frictionless", initial_gap=1e-3)
    assert solve(ContactProblem(model, laws, 47.8772, harmonics=9, samples=samples)).alternates


def test_a_curve_marks_what_alternates():
    curve = frequency_response(pound(0.3).model, pound(0.3).laws, np.linspace(0.3, 0.42, 7), 9, progress=False)
    assert curve.unstable.tolist() == [solution.alternates for solution in curve.solutions]
    assert not curve.unstable[curve.frequencies < 0.37].any() and curve.unstable[curve.frequencies > 0.41].all()


def test_over_two_periods_it_is_periodic():
    """The remedy that time stepping names: half the frequency, the load at harmonic 2."""
    problem = pound(0.42)
    once = integrate(problem, steps=512, theta=0.52)
    assert once.reason.endswith("step at half the frequency, loads at twice their harmonics") and not once.converged
    twice = integrate(replace(problem, frequency=0.21, load={2: problem.loads[1]}), steps=1024, theta=0.52)
    assert twice.converged
    last_two = 2 / 1024 * np.fft.fft(once.transient("tip")[-1025:-1])
    np.testing.assert_allclose(np.abs(last_two[1:3]), np.abs(twice.output("tip")[1:3]), rtol=1e-3)
    assert abs(last_two[1]) > 1.5 * abs(last_two[2]), "the response has mostly half the frequency"


def see_over_two_periods(system: ContactSystem) -> ContactSystem:
    """The same system at half the frequency: every harmonic is twice as high, and odd ones come in between."""
    twice = lambda of: {2 * h: amplitude for h, amplitude in of.items()}  # noqa: E731
    orders = tuple(sorted({*(2 * h for h in system.basis.orders), *range(1, 2 * system.basis.orders[-1], 2)}))
    load, basis = twice(system.load), FourierBasis(orders, 2 * system.basis.samples)
    compliance = condense(system.model, system.rows, load, system.compliance.omega / 2, orders)
    return replace(system, load=load, prescribed=twice(system.prescribed), basis=basis, compliance=compliance)


@pytest.mark.parametrize("name", [*PROBLEMS, "springs", "alternates"])
def test_both_signs_make_that_of_the_doubled_problem(name):
    """The Jacobian over two periods is that over one and that of the odd harmonics: so are the signs."""
    more = {"springs": replace(PROBLEMS["lift-off"], closure="spring"), "alternates": pound(0.42, harmonics=7)}
    found = solve((PROBLEMS | more)[name])
    doubled = see_over_two_periods(found.problem.system)
    balance, orders = HarmonicBalance(doubled, 1.0), doubled.basis.orders
    forces = np.zeros((len(orders), found.forces.shape[1]), dtype=complex)
    forces[[orders.index(2 * h) for h in found.orders]] = found.forces
    unknowns = balance.pack(forces, found.rigid)
    assert np.linalg.norm(balance.residual(unknowns)) < 1e-6 * np.linalg.norm(found.forces)
    alternates = stability.alternates(found)
    assert stability.find_side(balance, unknowns) == found.side * (-1 if alternates else 1)
    assert alternates == (name == "alternates")
    odd = (np.array(orders)[doubled.basis.slot] % 2 == 1)[:, None] & balance.unknown
    picked = np.append(odd[balance.unknown], np.zeros(balance.rigid, dtype=bool))
    expected = balance.linearise(unknowns).matrix()
    assert np.abs(expected[np.ix_(picked, ~picked)]).max() < 1e-12 * np.abs(expected).max()
    solved = HarmonicBalance(found.problem.system, 1.0)
    derivatives = solved.linearise(solved.pack(found.forces, found.rigid)).derivatives
    between = HarmonicBalance(stability.see_between(found.problem.system, found.orders[-1]), 1.0)
    step = NewtonStep(between, tuple(map(stability.repeat, derivatives)), np.zeros(between.size))
    np.testing.assert_allclose(step.matrix(), expected[np.ix_(picked, picked)], atol=1e-9 * np.abs(expected).max())


def test_the_summary_says_so_of_what_a_fallback_found(branches):
    for name, told in (
        ("middle", "this one is unstable: motions in time leave it; integrate("),
        ("upper", "the stability of this one is not known"),
    ):
        found = replace(branches[name][5], fallbacks=("given start: lost", "time stepping: found"))
        assert f"found by a fallback: there may be other solutions, and {told}" in found.summary()


def test_where_it_is_not_looked_at(branches, monkeypatch):
    bonded = ContactLaws("bonded", "frictionless")
    assert solve(replace(branches["upper"][0].problem, laws=bonded, harmonics=3)).side == 0
    redundant = solve(ContactProblem(repeat_first_pair(dovetail()), ContactLaws(friction=0.2), 481.0, 3))
    assert redundant.converged and redundant.side == 0, "rounding decides the sign"
    found = replace(branches["upper"][0])
    assert replace(found, converged=False).side == 0
    at_rest = solve(replace(found.problem, frequency=0.0, load={0: found.problem.loads[1]}, harmonics=0))
    assert not stability.alternates(at_rest)
    monkeypatch.setattr(stability, "MOST_UNKNOWNS", 3)
    assert found.side == 0 and solve(pound(0.42)).alternates, "the lowest harmonic in between is enough there"
    monkeypatch.setattr(stability, "MOST_UNKNOWNS", 1)
    assert not solve(pound(0.42)).alternates
    monkeypatch.undo()

    def hit(*_):
        raise ModelError("hits an undamped mode exactly")

    monkeypatch.setattr(stability, "condense", hit)
    assert not solve(pound(0.42)).alternates
