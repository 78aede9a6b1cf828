"""Dynamic compliance against plain linear algebra on all coordinates, and the statics of floating bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from counted_calls import count_calls
from small_models import bar_against_wall, dovetail, random_structure, transform_coordinates

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.model.compliance import Responses, condense, scale_rigid_modes
from ewr_fenicsx.model.receptance import find_normal_modes, receptance, solve_static
from ewr_fenicsx.model.statics import Statics, find_unpressed

ORDERS = (0, 1, 2, 5)
INVERSES = ("inertia relief", "pinned")


def respond_by_brute_force(model: ReducedModel, omega: float, force: np.ndarray) -> np.ndarray:
    """Coordinates under a harmonic force: the real 2n x 2n system of cosine and sine parts, no complex numbers."""
    dynamic, viscous = model.stiffness - omega**2 * model.mass, omega * model.damping
    both = np.linalg.solve(
        np.block([[dynamic, -viscous], [viscous, dynamic]]), np.concatenate([force.real, force.imag])
    )
    return both[: model.size] + 1j * both[model.size :]


def with_damping(model: ReducedModel, kind: str) -> ReducedModel:
    if kind == "none":
        return replace(model, damping=np.zeros_like(model.damping))
    if kind == "proportional":
        return replace(model, damping=0.02 * model.stiffness + 0.1 * model.mass)
    dashpot = np.zeros(model.size)
    dashpot[:2] = 1.0, -0.5
    return replace(model, damping=np.outer(dashpot, dashpot))


def with_loads(model: ReducedModel, seed: int = 5) -> ReducedModel:
    rng = np.random.default_rng(seed)
    loads = {h: rng.normal(size=model.size) + 1j * (h > 0) * rng.normal(size=model.size) for h in (0, 1, 5)}
    return replace(model, load=loads)


@pytest.mark.parametrize("kind", ["none", "proportional", "dashpot"])
@pytest.mark.parametrize("orders", [ORDERS, (1, 3), (0,)])
def test_compliance_is_the_response_to_unit_forces(kind, orders):
    model = with_damping(with_loads(random_structure()), kind)
    rows = np.vstack([model.normal, model.tangential])
    found = condense(model, rows, model.load, 0.83, orders)
    assert found.flexibility.shape == (len(orders), 6, 6)
    for j, h in enumerate(orders):
        for k in range(6):
            x = respond_by_brute_force(model, h * 0.83, rows[k])
            np.testing.assert_allclose(found.flexibility[j, :, k], rows @ x, rtol=1e-10, atol=1e-11)
        x = respond_by_brute_force(model, h * 0.83, model.load.get(h, np.zeros(9)))
        np.testing.assert_allclose(found.free_motion[j], rows @ x, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("kind", ["proportional", "dashpot"])
def test_neighbouring_problems_share_the_harmonics_that_they_have_in_common(kind, monkeypatch):
    model = dovetail()
    problem = ContactProblem(with_damping(model, kind), ContactLaws(), 0.1, 5)
    responded = count_calls(monkeypatch, Responses, "_respond_to_rows")
    first = problem.system.compliance
    assert len(responded) == 6
    other = replace(problem, rho_tangential=0.3, rho_normal=2.0, samples=256).system.compliance
    assert len(responded) == 6
    np.testing.assert_array_equal(other.flexibility, first.flexibility)
    more = replace(problem, harmonics=8, load={1: 2.0 * problem.loads[1]}).system.compliance
    assert len(responded) == 6 + 3
    np.testing.assert_array_equal(more.flexibility[:6], first.flexibility)
    np.testing.assert_allclose(more.free_motion[1], 2.0 * first.free_motion[1], rtol=1e-14)
    moved = replace(problem, frequency=0.11).system.compliance
    assert len(responded) == 6 + 3 + 6
    assert np.all(moved.flexibility[1:] != first.flexibility[1:])


@pytest.mark.parametrize("kind", ["none", "proportional", "dashpot"])
def test_motion_and_outputs_follow_the_forces(kind):
    rng = np.random.default_rng(6)
    model = with_damping(with_loads(random_structure()), kind)
    forces = rng.normal(size=(4, 3)) + 1j * rng.normal(size=(4, 3))
    forces[0] = forces[0].real
    compliance = condense(model, model.normal, model.load, 0.83, ORDERS)
    for j, h in enumerate(ORDERS):
        x = respond_by_brute_force(model, h * 0.83, model.normal.T @ forces[j] + model.load.get(h, 0))
        np.testing.assert_allclose(compliance.motion(forces, np.zeros(0))[j], model.normal @ x, rtol=1e-10)
        assert compliance.output("tip", forces, np.zeros(0))[j] == pytest.approx(model.outputs["tip"] @ x, rel=1e-10)


def test_weak_coupling_by_damping_is_not_dropped():
    """A dashpot between two slow modes counts, even beside a stiff mode that is damped a billion times more."""
    model = ReducedModel(
        mass=np.eye(3),
        damping=np.diag([1e-3, 1e-3, 1e8]) + 1e-3 * np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]]),
        stiffness=np.diag([1.0, 1.1, 1e12]),
        normal=[[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]],
    )
    found = condense(model, model.normal, {}, 1.0, (1,)).flexibility[0]
    for k in range(2):
        x = respond_by_brute_force(model, 1.0, model.normal[k])
        np.testing.assert_allclose(found[:, k], model.normal @ x, rtol=1e-8)


@pytest.mark.parametrize("kind", ["none", "proportional", "dashpot"])
def test_floating_bodies_vibrate_on_their_inertia(kind):
    model = with_damping(dovetail(), kind)
    if kind == "proportional":
        model = replace(model, damping=1e-6 * model.stiffness + 5.0 * model.mass)
    rows = np.vstack([model.normal, model.tangential])
    omega = 2 * np.pi * 700.0
    found = condense(model, rows, model.load, omega, (0, 1, 3))
    for j, h in ((1, 1), (2, 3)):
        expected = np.column_stack([rows @ respond_by_brute_force(model, h * omega, row) for row in rows])
        np.testing.assert_allclose(found.flexibility[j], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("inverse", INVERSES)
@pytest.mark.parametrize("kind", ["proportional", "dashpot"])
def test_static_motion_of_a_floating_body_meets_equilibrium(inverse, kind):
    """K x = F for balanced forces, and the rows' motion is B x up to a rigid motion."""
    model = with_damping(dovetail(), kind)
    rows = np.vstack([model.normal, model.tangential])
    compliance = condense(model, rows, model.load, 1e3, (0, 1), inverse)
    free = np.random.default_rng(7).normal(size=12) * 100
    G, pull = compliance.rigid_motion, compliance.rigid_load
    forces = np.zeros((2, 12), dtype=complex)
    forces[0] = free - np.linalg.lstsq(G.T, G.T @ free + pull, rcond=None)[0]  # contact forces that balance the pull
    applied = rows.T @ forces[0].real + model.load[0].real
    np.testing.assert_allclose(model.rigid_modes.T @ applied, 0.0, atol=1e-10 * np.abs(applied).max())
    x = np.linalg.lstsq(model.stiffness, applied, rcond=1e-12)[0]
    np.testing.assert_allclose(model.stiffness @ x, applied, atol=1e-9 * np.abs(applied).max())
    motion = compliance.motion(forces, np.zeros(3))[0].real
    readers = np.vstack([rows, model.outputs["tip"]])
    found = np.append(motion, compliance.output("tip", forces, np.zeros(3))[0].real)
    rigid = readers @ model.rigid_modes
    left = (readers @ x - found) - rigid @ np.linalg.lstsq(rigid, readers @ x - found, rcond=None)[0]
    assert np.abs(left).max() < 1e-10 * np.abs(readers @ x).max()
    moved = compliance.motion(forces, np.array([1.0, 2.0, 3.0]))[0].real
    np.testing.assert_allclose(moved - motion, G @ [1.0, 2.0, 3.0], atol=1e-13)


@pytest.mark.parametrize("inverse", INVERSES)
def test_generalised_inverses_solve_balanced_forces(inverse):
    model = dovetail()
    rng = np.random.default_rng(8)
    forces = model.stiffness @ rng.normal(size=(26, 4))  # balanced by construction
    x = solve_static(model, forces, inverse)
    np.testing.assert_allclose(model.stiffness @ x, forces, atol=1e-10 * np.abs(forces).max())


@pytest.mark.parametrize("frequency, harmonics", [(200.0, 3), (481.0, 5), (0.0, 0)])
def test_no_result_depends_on_the_generalised_inverse(frequency, harmonics):
    model = dovetail()
    if harmonics == 0:
        model = replace(model, load={0: model.load[0]})
    laws = ContactLaws(friction=0.3)
    first, second = (
        solve(ContactProblem(model, laws, frequency, harmonics, generalised_inverse=inverse), tolerance=1e-11)
        for inverse in INVERSES
    )
    assert first.converged and second.converged
    np.testing.assert_allclose(first.forces, second.forces, atol=1e-8 * np.abs(first.forces).max())
    np.testing.assert_allclose(first.output("tip"), second.output("tip"), atol=1e-8 * np.abs(first.output("tip")).max())
    for name in ("gap", "slip"):
        a, b = first.history(name, 64), second.history(name, 64)
        np.testing.assert_allclose(a, b, atol=1e-8 * np.abs(first.history("slip", 64)).max())


@pytest.mark.parametrize("inverse", INVERSES)
def test_contact_forces_carry_the_static_pull(inverse):
    """Resultant of the contact forces on the blade = minus the mean load, to 1e-10 of it."""
    model = dovetail(pull=1000.0)
    solution = solve(ContactProblem(model, ContactLaws(friction=0.3), 200.0, 3, generalised_inverse=inverse))
    normal, friction = solution.pair_forces["normal"][0].real, solution.pair_forces["tangential"][0].real
    on_blade = (model.normal.T @ normal + model.tangential.T @ friction)[:14]
    resultant = on_blade[0::2].sum(), on_blade[1::2].sum()
    np.testing.assert_allclose(resultant, [0.0, -1000.0], atol=1e-7)
    assert np.all(normal > 0)


def test_rigid_modes_are_scaled_to_what_the_rows_see():
    model = dovetail()
    rows = np.vstack([model.normal, model.tangential])
    modes = scale_rigid_modes(transform_coordinates(model, 1e-4 * np.eye(26)), rows)
    np.testing.assert_allclose(np.abs(rows @ modes).max(axis=0), 1.0, rtol=1e-12)
    overlap = (rows @ modes).T @ (rows @ modes)
    np.testing.assert_allclose(overlap, np.diag(np.diag(overlap)), atol=1e-12)


def test_rigid_motions_that_contact_cannot_tell_apart_are_refused():
    model = dovetail()
    with pytest.raises(
        ModelError, match=r"3 rigid motions of floating bodies, but .* tell only 2 of them apart: .*; clamp"
    ):
        condense(model, model.normal[:2], {}, 1.0, (0, 1))
    with pytest.raises(ModelError, match=r"3 rigid motions .* tell only 0 of them apart: .* add friction or pairs"):
        condense(model, model.normal[:0], {}, 1.0, (0, 1))  # given and bonded forces are none that could hold


@pytest.mark.parametrize(
    "normals, friction, load, unpressed",
    [
        ([(0, 1), (0, 1)], 0.3, [0.0, 0.0], [0, 1]),
        ([(0, 1), (0, 1)], 0.3, [0.0, -1.0], []),
        ([(0, 1), (0, 1)], 0.3, [0.0, -1e-7], []),
        ([(0, 1), (0, -1)], 0.3, [0.0, 0.0], []),
        ([(0.6, 0.8), (-0.6, 0.8)], 0.3, [0.0, 0.0], [0, 1]),
        ([(0.8, 0.6), (-0.8, 0.6)], 0.8, [0.0, 0.0], []),
        ([(0, 1), (1, 0)], 0.0, [0.0, -1.0], [1]),
        ([(0, 1), (1, 0)], 0.3, [0.0, -1.0], []),
        ([(0, 1), (0.5, 0.866)], 0.7, [0.0, -1.0], []),
    ],
    ids=[
        "nothing acts", "pressed", "hardly pressed", "two stops", "a flat wedge", "a wedge that locks itself",
        "beside it", "friction braces it", "one presses another",
    ],
)  # fmt: skip
def test_pairs_go_unpressed_where_no_equilibrium_has_a_force_there(normals, friction, load, unpressed):
    """A body in a plane that does not turn; the other pairs keep it from moving off or not."""
    normal = np.array(normals, dtype=float)
    tangential = normal[None] @ [[0.0, -1.0], [1.0, 0.0]]
    none, all_that_push = np.zeros(2), np.full(2, np.inf)
    statics = Statics(normal, tangential, none, all_that_push, np.full(2, friction), np.array(load), np.zeros(2))
    assert find_unpressed(statics, none > 0) == unpressed


def test_bodies_without_any_stiffness_only_move_rigidly():
    """Two masses, with a dashpot between them or without: nothing bends, and contact balances the load."""
    model = ReducedModel(
        mass=np.diag([1.0, 2.0]),
        damping=np.diag([0.1, 0.2]),
        stiffness=np.zeros((2, 2)),
        normal=np.eye(2),
        load={0: [-1.0, -2.0], 1: [0.3, 0.0]},
    )
    coupled = replace(model, damping=[[0.2, -0.2], [-0.2, 0.2]])
    assert find_normal_modes(model) is not None and find_normal_modes(coupled) is None
    for held in (model, coupled):
        solution = solve(ContactProblem(held, ContactLaws(tangential="frictionless"), 0.5, 3))
        np.testing.assert_allclose(solution.forces[:2], [[1.0, 2.0], [-0.3, 0.0]], atol=1e-8)


def test_a_vibration_without_mean_needs_no_equilibrium():
    model = bar_against_wall(elements=4, mean=0.0, amplitude=1.0)
    compliance = condense(model, model.normal, {1: model.load[1]}, 1.0, (1, 3))
    assert compliance.rigid_motion.shape == (1, 0) and compliance.rigid_load.shape == (0,)


def test_a_periodic_motion_needs_a_frequency():
    model = random_structure()
    with pytest.raises(
        ModelError, match=r"frequency = 0 Hz, with harmonics \(0, 1\) and loads at harmonics \[1\]; give a pos"
    ):
        condense(model, model.normal, {1: np.ones(model.size)}, 0.0, (0, 1))
    assert condense(model, model.normal, {}, 0.0, (0,)).flexibility.shape == (1, 3, 3)


@pytest.mark.parametrize("omega", [0.0, 1.3])
@pytest.mark.parametrize("coupled", [False, True])
def test_without_rows_all_coordinates_are_read(omega, coupled):
    model = random_structure()
    if coupled:
        model = replace(model, damping=model.damping + np.diag(np.arange(9.0)))
    assert (find_normal_modes(model) is None) == coupled
    forces = np.arange(18.0).reshape(9, 2) + 1j
    expected = receptance(model, omega, np.eye(9), forces)
    np.testing.assert_allclose(receptance(model, omega, None, forces), expected, rtol=1e-12)


def test_an_undamped_mode_that_is_hit_exactly_is_named_where_damping_couples_the_others():
    """It was an error of linear algebra, which said nothing of a frequency."""
    stiffness = [[200.0, -100.0, 0.0], [-100.0, 300.0, 0.0], [0.0, 0.0, 64.0]]
    model = ReducedModel(
        mass=np.eye(3), damping=np.diag([5.0, 0.0, 0.0]), stiffness=stiffness, normal=[[1.0, 0.0, 0.0]]
    )
    assert find_normal_modes(model) is None
    with pytest.raises(ModelError, match=r"1\.27324 Hz hits an undamped mode exactly; give the model some damping"):
        condense(model, model.normal, {}, 8.0, (0, 1))
