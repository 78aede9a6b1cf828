"""Pairs that cannot slide along a tangent, as on a plane of symmetry: zero rows, without friction along them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail, sled_in_a_plane

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve


def add_second_tangents(model: ReducedModel) -> ReducedModel:
    """The model with a second tangent a pair, along which nothing moves."""
    rows = np.stack([model.tangential, np.zeros_like(model.tangential)], axis=1)
    return replace(model, tangential=rows.reshape(-1, model.size))


@pytest.mark.parametrize("friction", [0.3, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]])
def test_second_tangents_at_rest_change_nothing(friction):
    """Rows, unknowns, Newton steps and forces are those of the model in a plane, and so is the motion in time."""
    plane = dovetail()
    solid = add_second_tangents(plane)
    laws = ContactLaws(friction=friction)
    one, other = (solve(ContactProblem(model, laws, 150.0, 5)) for model in (plane, solid))
    assert (one.iterations, one.unknowns) == (other.iterations, other.unknowns)
    assert one.history("slip").any() and one.merit["friction_dissipation"] > 0
    np.testing.assert_allclose(other.forces, one.forces, atol=1e-9 * np.abs(one.forces).max())
    for name in ("friction_force", "slip", "gap"):
        np.testing.assert_allclose(other.history(name), one.history(name), atol=1e-8 * np.abs(one.history(name)).max())
    for name in ("second_friction_force", "second_slip", "second_slip_velocity", "second_admissible_friction_force"):
        assert not other.history(name).any()
    for name, figure in one.merit.items():
        assert other.merit[name] == pytest.approx(figure, rel=1e-6, abs=1e-12), name
    assert one.unstable == other.unstable
    steady = [integrate(ContactProblem(model, laws, 150.0, 5), steps=200) for model in (plane, solid)]
    forces = [state.history("friction_force") for state in steady]
    np.testing.assert_allclose(*forces, atol=1e-9 * np.abs(forces[0]).max())
    assert not steady[1].history("second_friction_force").any()


def test_what_rounding_leaves_of_a_row_is_no_motion():
    """Or else a law would obey itself along it without any Newton step, and friction in the plane come out wrong."""
    plane = dovetail()
    rows = np.stack([plane.tangential, 1e-17 * plane.normal], axis=1).reshape(-1, plane.size)
    laws = ContactLaws(friction=0.3)
    one, other = (solve(ContactProblem(m, laws, 150.0, 5)) for m in (plane, replace(plane, tangential=rows)))
    assert (one.iterations, one.unknowns) == (other.iterations, other.unknowns)
    np.testing.assert_allclose(other.forces, one.forces, atol=1e-9 * np.abs(one.forces).max())


def test_pairs_at_rest_beside_others_go_without_friction():
    """In a plane as if frictionless, whatever coefficients the group has, pair by pair; the others rub as before."""
    model, still = dovetail(), [1, 4]
    rows = model.tangential.copy()
    rows[still] = 0.0
    rubbing = [k for k in range(model.pairs) if k not in still]
    friction = np.array([0.1, 9.0, 0.3, 0.4, 9.0, 0.6])
    resting = ContactProblem(replace(model, tangential=rows), ContactLaws(friction=friction), 150.0, 5)
    groups = [(rubbing, ContactLaws(friction=friction[rubbing])), (still, ContactLaws(tangential="frictionless"))]
    stated = ContactProblem(model, groups, 150.0, 5)
    one, other = solve(stated), solve(resting)
    assert (one.iterations, one.unknowns) == (other.iterations, other.unknowns)
    for name in ("normal_force", "friction_force", "gap"):
        np.testing.assert_allclose(other.history(name), one.history(name), atol=1e-8 * np.abs(one.history(name)).max())
    assert not other.history("slip")[:, still].any()
    steady = [integrate(problem, steps=200) for problem in (stated, resting)]
    np.testing.assert_allclose(*(state.history("normal_force") for state in steady), atol=1e-6 * model.load[0].max())


def test_a_joint_may_have_pairs_with_two_tangents_one_and_none():
    """Three sleds that do not touch each other move as each does alone, with its own limit and coefficient."""
    sled, kept = sled_in_a_plane({1: [1.0, 0.4j]}), (2, 1, 0)  # tangents of each
    repeat = lambda matrix: np.kron(np.eye(3), matrix)  # noqa: E731
    tangential = repeat(sled.tangential)
    tangential[[3, 4, 5]] = 0.0
    three = ReducedModel(
        mass=repeat(sled.mass),
        damping=repeat(sled.damping),
        stiffness=repeat(sled.stiffness),
        normal=np.zeros((3, 6)),
        tangential=tangential,
        load={1: np.tile(sled.load[1], 3)},
    )
    force, friction = np.array([0.5, 0.6, 0.7]), np.array([0.5, 0.4, 0.3])
    together = solve(ContactProblem(three, given(force, friction), 0.15, 5, closure="dashpot"))
    for k, count in enumerate(kept):
        model = replace(sled, tangential=sled.tangential * (np.arange(2) < count)[:, None])
        alone = solve(ContactProblem(model, given(force[k], friction[k]), 0.15, 5, closure="dashpot"))
        for direction, name in enumerate(("friction_force", "second_friction_force")):
            here = together.history(name)[:, k]
            np.testing.assert_allclose(here, alone.history(name)[:, 0], atol=1e-7)
            assert here.any() == (direction < count)


def given(force: object, friction: object) -> ContactLaws:
    return ContactLaws("prescribed", normal_force=force, friction=friction)
