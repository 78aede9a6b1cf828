"""The static state of the blade root: what the flanks carry is what pulls, however the floating blade is condensed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, load_scene, solve
from ewr_fenicsx.errors import ModelError, UnheldBody
from ewr_fenicsx.structure.chain import build_chain, pose_problem

SCENE = Path(__file__).parents[2] / "demos" / "blade_root.toml"


INVERSES = ("inertia relief", "pinned")


@pytest.fixture(scope="module")
def chain():
    return build_chain(load_scene(SCENE))


@pytest.fixture(scope="module", params=["at rest", "shaken"])
def solutions(request, chain):
    """Solutions of the default scene by generalised inverse, without the shaker and with it."""
    problem = pose_problem(chain.scene, chain.reduction.model)
    if request.param == "at rest":
        model = chain.reduction.model
        problem = replace(problem, model=replace(model, load={0: model.load[0]}), harmonics=0)
    return {name: solve(replace(problem, generalised_inverse=name), tolerance=1e-12) for name in INVERSES}


@pytest.mark.parametrize("inverse", INVERSES)
def test_contact_forces_balance_the_pull(chain, solutions, inverse):
    """The mean force on the blade, in both directions and about the disk's axis, to 1e-10 of the load."""
    interface, solution = chain.interface, solutions[inverse]
    normal, friction = (solution.history(name, 64).mean(axis=0) for name in ("normal_force", "friction_force"))
    forces = friction[:, None] * interface.tangent - normal[:, None] * interface.normal
    x, y = interface.position.T
    moment = (x * forces[:, 1] - y * forces[:, 0]).sum()
    pull = np.array(chain.scene.loads["axial_pull"].force)
    size = np.linalg.norm(pull)
    np.testing.assert_allclose(forces.sum(axis=0), -pull, rtol=0, atol=1e-10 * size)
    assert abs(moment) < 1e-10 * size * y.max(), "the tip lies above the axis: the pull has no moment"


def test_both_inverses_give_the_same_forces(solutions):
    for name in ("normal_force", "friction_force"):
        one, other = (solutions[inverse].history(name, 64) for inverse in INVERSES)
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-10 * np.abs(one).max(), err_msg=name)


def pressed_plate(friction: float, push: float) -> ContactProblem:
    """A plate of 1 kg that 100 N press on a springy floor and ``push`` [N] drive along it."""
    model = ReducedModel(
        mass=np.eye(4),
        damping=10 * np.eye(4),
        stiffness=np.diag([0.0, 0.0, 1e7, 1e7]),
        normal=[[-1, 0, 1, 0]],
        tangential=[[0, 1, 0, -1]],
        load={0: [100.0, push, 0, 0], 1: [0, 1.0, 0, 0]},
    )
    return ContactProblem(model, ContactLaws("unilateral", "coulomb" if friction else "frictionless", friction), 50.0)


def test_a_plate_that_is_pressed_and_pushed_too_hard_is_told_to_slide():
    """It was said to open its pair, on which 100 N press it."""
    assert solve(pressed_plate(0.6, 50.0)).converged
    with pytest.raises(UnheldBody, match="drives a rigid motion that slides along pair 0 most") as told:
        solve(pressed_plate(0.1, 50.0))
    assert told.value.pairs == (0,)
    with pytest.raises(ModelError, match=r"tell only 1 of them apart: one .* slides along pair 0 without friction"):
        solve(pressed_plate(0.0, 50.0))


@pytest.mark.parametrize("tangents", [[1.0], [np.sqrt(0.5), -np.sqrt(0.5)]], ids=["one tangent", "two tangents"])
def test_a_plate_under_a_given_normal_force_is_told_to_move_along_the_normal(tangents):
    """It was said to move no pair, or, where rounding was taken for sliding, to slide without the friction it has."""
    problem = pressed_plate(0.6, 5.0)
    model = replace(problem.model, tangential=np.outer(tangents, problem.model.tangential))
    given = ContactLaws("prescribed", normal_force=100.0, friction=0.6)
    with pytest.raises(ModelError, match=r'do not see moves pair 0 along the normal, where .* normal = "unilateral"'):
        solve(replace(problem, model=model, laws=given))
