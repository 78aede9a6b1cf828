"""Forces that a solution reports where no law asks for them: in bonds, given ones, and at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail, friction_oscillator, lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve, solve_to_accuracy
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.solution.contact_state import SLIP, classify_contact


@pytest.mark.parametrize(
    "normal, tangential",
    [("bonded", "bonded"), ("unilateral", "bonded"), ("bonded", "coulomb"), ("unilateral", "coulomb")],
)
@pytest.mark.parametrize(
    "model", [dovetail(excitation=1.0), lift_off_oscillator(excitation=0.1)], ids=["dovetail", "lift-off"]
)
def test_forces_in_bonds_are_those_that_hold_stuck_pairs(normal, tangential, model):
    """Under small excitation nothing opens or slips: every law combination is the same linear problem.

    Mean friction is not comparable: friction of pairs that stick is indeterminate in the mean, and taken near zero.
    """
    frequency = 200.0 if model.size == 26 else 0.1
    laws = ContactLaws(normal, tangential, friction=5.0)
    solution = solve(ContactProblem(model, laws, frequency, 3), tolerance=1e-12)
    bonded = solve(ContactProblem(model, ContactLaws("bonded", "bonded"), frequency, 3))
    assert (bonded.unknowns, bonded.iterations, bonded.converged) == (0, 0, True)
    for direction in ("normal", "tangential"):
        scale = np.abs(bonded.pair_forces["normal"]).max()
        np.testing.assert_allclose(
            solution.pair_forces[direction][1:], bonded.pair_forces[direction][1:], atol=1e-8 * scale
        )
        if tangential == "bonded":
            np.testing.assert_allclose(
                solution.pair_forces[direction][0], bonded.pair_forces[direction][0], atol=1e-8 * scale
            )
    np.testing.assert_allclose(
        solution.output("tip")[1:], bonded.output("tip")[1:], atol=1e-9 * np.abs(bonded.output("tip")[1])
    )
    assert bonded.history("normal_force", 64).min() > 0, "else the comparison is void"


@pytest.mark.parametrize("laws", [ContactLaws(initial_gap=0.01), ContactLaws("bonded", "bonded")])
def test_a_static_state_needs_neither_a_frequency_nor_a_word_on_harmonics(laws):
    """Forces balance, and everything can be read off, at 0 Hz as at any frequency at which nothing oscillates."""
    model = random_structure()
    model = replace(model, load={0: -5 * model.normal.sum(axis=0)})  # towards each other
    static = solve(ContactProblem(model, laws, frequency=0.0))
    assert static.orders == (0,) and static.merit["J_T"] == 0.0 and "at rest" in static.summary()
    x = static.coordinates[0].real
    normal, friction = (static.history(name, 1)[0] for name in ("normal_force", "friction_force"))
    assert np.abs(normal).max() > 0.1
    contact = model.normal.T @ normal + model.tangential.T @ friction
    np.testing.assert_allclose(model.stiffness @ x, model.load[0].real + contact, atol=1e-9)
    slow = solve(ContactProblem(model, laws, frequency=0.1))
    np.testing.assert_allclose(slow.coordinates[0], static.coordinates[0], atol=1e-9)
    accurate = solve_to_accuracy(ContactProblem(model, laws, frequency=0.0), 0.01)
    assert accurate.reached and len(accurate.levels) == 1
    np.testing.assert_allclose(accurate.solution.coordinates, static.coordinates, atol=1e-9)
    shaken = {0: model.load[0], 1: model.load[0]}
    with pytest.raises(ModelError, match=r"loaded at harmonics \[1\].*give a positive frequency or remove the load"):
        ContactProblem(model, laws, frequency=0.0, load=shaken)


@pytest.fixture(scope="module")
def partly_bonded():
    """Three pairs, of which the first rub and the last is bonded, under loads that press and shake; damping couples."""
    model, root = random_structure(size=12, pairs=3, seed=5), np.random.default_rng(6).normal(size=(12, 12))
    load = {0: -5.0 * model.normal.sum(axis=0), 1: 3.0 * np.arange(12) - 10.0j}
    groups = [([0, 1], ContactLaws(friction=0.3)), ([2], ContactLaws("bonded", "bonded"))]
    return ContactProblem(replace(model, load=load, damping=0.02 * root @ root.T), groups, 0.15, 5)


def test_bonds_carry_what_the_other_pairs_leave_over(partly_bonded):
    """All pair forces, those of pairs that rub included, meet the equation of motion at every harmonic."""
    solution, model = solve(partly_bonded, tolerance=1e-11), partly_bonded.model
    forces = solution.pair_forces
    rubbing, bonded = (np.abs(forces["tangential"][1, pairs]).max() for pairs in ([0, 1], [2]))
    assert rubbing > 0.1 and bonded > 0.1 and np.abs(forces["normal"][1, :2]).max() > 0.1, "or the test is void"
    for j, h in enumerate(solution.orders):
        w, x = h * partly_bonded.omega, solution.coordinates[j]
        inner = model.stiffness @ x - w**2 * (model.mass @ x) + 1j * w * (model.damping @ x)
        outer = model.load.get(h, 0) + sum(model.rows(d).T @ forces[d][j] for d in ("normal", "tangential"))
        np.testing.assert_allclose(inner, outer, atol=1e-9 * np.abs(inner).max(), err_msg=f"harmonic {h}")


def test_bonds_carry_what_the_other_pairs_leave_over_in_time(partly_bonded):
    """The same at every step, by the midpoint rule; and with damping that couples the modes all works balance."""
    steady, model, steps = integrate(partly_bonded, "rest", steps=400, periods=30), partly_bonded.model, 400
    forces = steady._pair_forces()
    assert all(np.ptp(forces[d][:, pairs], axis=0).min() > 0.1 for d in forces for pairs in ([0, 1], [2]))
    x, v = (values @ steady.scheme.expansion.T for values in (steady.last.positions, steady.last.velocities))
    middle = lambda values: (values[:-1] + values[1:]) / 2  # noqa: E731
    gained = np.diff(v, axis=0) * steps * partly_bonded.frequency
    inner = gained @ model.mass + middle(v) @ model.damping + middle(x) @ model.stiffness
    tau = 2 * np.pi * np.arange(steps + 1) / steps
    load = middle(model.load[0].real + np.real(np.outer(np.exp(1j * tau), model.load[1])))
    outer = load + forces["normal"] @ model.normal + forces["tangential"] @ model.tangential
    np.testing.assert_allclose(inner, outer, atol=1e-9 * np.abs(inner).max())
    work = steady.measure_energy()
    spent = sum(work[name] for name in ("stored", "viscous", "friction", "impact"))
    assert work["excitation"] == pytest.approx(spent, rel=1e-9) and work["viscous"] > 0.01 * work["excitation"]


@pytest.mark.parametrize(("steps", "close"), [(100, 1.1e-3), (400, 7e-5)])
def test_a_bond_behind_a_node_without_mass_is_stepped_in_phase(steps, close):
    """Three quarters of the load by the springs: what such nodes' own ``theta`` is ahead of others is none of it."""
    springs = [[200.0, 0.0, 0.0], [0.0, 4e4, -3e4], [0.0, -3e4, 3e4]]
    loaded = {1: [0.0, 100.0, 0.0]}
    model = ReducedModel(np.diag([1.0, 0.0, 0.0]), np.diag([1.0, 0.0, 0.0]), springs, [[0.0, 0.0, 1.0]], load=loaded)
    problem = ContactProblem(model, ContactLaws("bonded", "frictionless"), 5.0, 1)
    force = integrate(problem, "rest", steps=steps, periods=3, tolerance=0).history("normal_force")[:, 0]
    assert force == pytest.approx(-75.0 * np.cos(2 * np.pi * np.arange(steps) / steps), abs=75.0 * close)


def test_forces_in_bonds_of_bodies_in_space():
    """Two tangents a pair, both bonded: the bonds' forces, applied to the free structure, move it as the bonded one."""
    model = replace(random_structure(size=14, pairs=3, tangents=2), load={1: np.arange(14.0)})
    solution = solve(ContactProblem(model, ContactLaws("bonded", "bonded"), 0.1, 1))
    x, w = solution.coordinates[1], solution.problem.omega
    np.testing.assert_allclose(np.vstack([model.normal, model.tangential]) @ x, 0.0, atol=1e-10 * np.abs(x).max())
    left = model.stiffness @ x + 1j * w * (model.damping @ x) - w**2 * (model.mass @ x) - model.load[1]
    every = np.linalg.lstsq(np.vstack([model.normal, model.tangential]).T, left, rcond=None)[0]
    np.testing.assert_allclose(solution.pair_forces["normal"][1], every[:3], rtol=1e-8)
    np.testing.assert_allclose(solution.pair_forces["tangential"][1], every[3:][::2], rtol=1e-8)


def test_prescribed_forces_are_reported():
    model = random_structure(size=8)
    force = {0: [3.0, 4.0, 5.0], 1: 1j}
    solution = solve(ContactProblem(model, ContactLaws("prescribed", "frictionless", normal_force=force), 0.1, 2))
    np.testing.assert_array_equal(solution.pair_forces["normal"], [[3.0, 4.0, 5.0], [1j, 1j, 1j], [0, 0, 0]])
    tau = 2 * np.pi * np.arange(32) / 32
    np.testing.assert_allclose(solution.history("normal_force", 32)[:, 1], 4.0 - np.sin(tau), atol=1e-14)
    x = np.linalg.solve(model.stiffness, model.normal.T @ force[0])
    np.testing.assert_allclose(solution.coordinates[0], x, rtol=1e-11)


def test_prescribed_forces_outside_the_harmonics_kept_are_reported():
    """Odd harmonics suffice for a mass that rubs under a constant force: the force is no less there."""
    laws = ContactLaws("prescribed", normal_force={0: 0.8, 2: 0.1}, friction=0.5)
    solution = solve(ContactProblem(friction_oscillator(damping=0.1), laws, 0.1, (1, 3, 5)))
    expected = 0.8 + 0.1 * np.cos(4 * np.pi * np.arange(64) / 64)
    np.testing.assert_allclose(solution.history("normal_force", 64)[:, 0], expected, atol=1e-14)
    assert 0 < solution.merit["cone_violation"] < 0.3
    assert np.any(classify_contact(solution, 64) == SLIP)


@pytest.mark.parametrize("unit", [1.0, 1e8, 1e11, 1e14])
def test_bonds_that_differ_in_responses_to_unit_forces_alone_are_as_many(unit):
    """A block's own motion has its mode in m, each place where it is held its response to ``unit`` N, of 1e-11 m/N.

    Rows as (1, 1e-11, 0) and (1, 0, 3e-11) were taken for one, and the block moved by a third too far.
    """
    mount, flexibility, omega = 1e6, np.array([1e-11, 3e-11]), 2 * np.pi * 50.0
    stiffness = np.diag([mount, *(flexibility * unit**2)])
    rows = np.column_stack([[1.0, 1.0], np.diag(flexibility * unit)])
    model = ReducedModel(
        np.diag([1.0, 0.0, 0.0]),
        1e-4 * stiffness,
        stiffness,
        0 * rows,
        rows,
        {1: [100.0, 0, 0]},
        outputs={"x": [1, 0, 0]},
    )
    problem = ContactProblem(model, ContactLaws("prescribed", "bonded", normal_force=1.0), 50.0, 1)
    drag = 1 + 1e-4j * omega
    moved = 100.0 / (drag * (mount + np.sum(1 / flexibility)) - omega**2)
    for found, close in ((solve(problem), 1e-9), (integrate(problem, steps=400, tolerance=1e-10), 1e-3)):
        assert found.output("x")[1] == pytest.approx(moved, rel=close)
        force = to_amplitude(found.history("friction_force", 400))
        np.testing.assert_allclose(force, -drag * moved / flexibility, rtol=2 * close)


def to_amplitude(samples):
    """Of harmonic 1, one a column."""
    return 2 * np.fft.fft(samples, axis=0)[1] / len(samples)
