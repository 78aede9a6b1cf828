"""Rigid modes of a reduced model: found, or given and looked at; what rounding leaves is no spring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st
from small_models import dovetail, random_structure, transform_coordinates

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.model.compliance import condense
from ewr_fenicsx.model.rigid_modes import find_rigid_modes
from ewr_fenicsx.problem.layout import hold

PLAIN = {"mass": np.eye(2), "damping": np.zeros((2, 2)), "stiffness": np.eye(2), "normal": [[1.0, 0.0]]}


def test_rigid_modes_that_only_rounding_resists_are_none_the_less():
    """As the turn of a block, in a reduced model, whose nodes lie on a line: its rows of the stiffness are rounding."""
    stiffness = np.diag([1e9, 1e-7])
    model = ReducedModel(**PLAIN | {"stiffness": stiffness, "rigid_modes": [[0.0], [1.0]]})
    assert model.rigid_modes.shape == (2, 1)
    with pytest.raises(ModelError, match="meets elastic forces of 1 of the stiffness"):
        ReducedModel(**PLAIN | {"stiffness": np.diag([1e9, 1e-2]), "rigid_modes": [[0.0], [1.0]]})


def test_rounding_of_the_stiffness_makes_no_rigid_motion_massless():
    """A block on two nodes, joined by a spring along their line: beside the turn, the way along it has inertia, too."""
    stiffness = np.diag([1e9, 1e9, 1e-7, 2e-7])
    stiffness[0, 1] = stiffness[1, 0] = -1e9
    rigid = [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    block = {"damping": np.zeros((4, 4)), "stiffness": stiffness, "normal": [[0, 0, 1, 0]], "rigid_modes": rigid}
    for modes in (rigid, None):  # given, or to be found: it took the turn for held
        model = ReducedModel(mass=0.1 * np.eye(4), **block | {"rigid_modes": modes})
        assert model.rigid_modes.shape == (4, 3)
    with pytest.raises(ModelError, match="the mass is zero in one of them: it moves coordinate 3 most"):
        ReducedModel(mass=np.diag([0.1, 0.1, 0.1, 0.0]), **block)


def test_a_floating_blade_has_three_rigid_modes():
    model = dovetail()
    assert model.rigid_modes.shape == (26, 3)
    assert np.linalg.matrix_rank(model.rigid_modes) == 3
    force = np.abs(model.stiffness @ model.rigid_modes).max(axis=0)
    assert np.all(force < 1e-12 * (np.abs(model.stiffness) @ np.abs(model.rigid_modes)).max(axis=0))
    np.testing.assert_allclose(model.rigid_modes[14:], 0.0, atol=1e-12 * np.abs(model.rigid_modes).max())


@pytest.mark.parametrize(
    "given, told",
    [
        ([[1.0], [0.0], [0.0]], "1 columns, 1 of them independent, .* leaves 2 motions free"),
        ([[0.0], [0.0], [0.0]], "1 columns, 0 of them independent"),
        (np.zeros((3, 0)), "0 columns, 0 of them independent"),
        ([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]], "3 columns, 2 of them independent"),
    ],
)
def test_rigid_modes_that_are_given_must_be_all_there_are(given, told):
    """One left out would silently be held: its body would not follow its mean load."""
    bodies = {name: np.zeros((3, 3)) for name in ("damping", "stiffness")} | {"mass": np.eye(3), "normal": np.eye(3)}
    bodies["stiffness"][2, 2] = 4.0  # two of three bodies float
    with pytest.raises(ModelError, match=told):
        ReducedModel(**bodies, rigid_modes=given)
    assert ReducedModel(**bodies, rigid_modes=[[1.0, 1.0], [2.0, -1.0], [0.0, 0.0]]).rigid_modes.shape == (3, 2)


@pytest.mark.parametrize("damper", [0.0, 0.5])
def test_a_coordinate_with_neither_mass_nor_stiffness_is_named(damper):
    """As one that another program left behind; the modes of the model would be no numbers."""
    with pytest.raises(ModelError, match=r"the mass is zero in one of them: it moves coordinate 1 most, .* dashpot"):
        ReducedModel(
            mass=np.diag([1.0, 0.0]), damping=np.diag([0.1, damper]), stiffness=np.diag([1.0, 0.0]), normal=[[1.0, 0.0]]
        )


def test_a_mass_without_springs_does_not_pass_for_all_the_mass_there_is():
    """Beside a stiff, light body that floats as well; whatever the units, which alone would not do."""
    light = 1e12 * np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    model = ReducedModel(mass=np.diag([1e-4, 1e-4, 1.0]), damping=np.zeros((3, 3)), stiffness=light, normal=np.eye(3))
    assert model.rigid_modes.shape == (3, 2)


def test_a_grounded_structure_has_none():
    assert random_structure().rigid_modes.shape == (9, 0)


@given(st.integers(0, 4), st.integers(0, 2**32 - 1), st.floats(-6, 6))
def test_as_many_rigid_modes_as_the_stiffness_lacks_in_rank(count, seed, exponent):
    """Whatever the units: a stiffness scaled by powers of ten has the same null space."""
    root = np.random.default_rng(seed).normal(size=(8, 8 - count))
    stiffness = 10.0**exponent * root @ root.T
    modes = find_rigid_modes(stiffness)
    assert modes.shape == (8, count)
    if count:
        angles = scipy.linalg.subspace_angles(modes, scipy.linalg.null_space(root.T))
        assert angles.max() < 1e-6


@pytest.mark.parametrize("ground, modes", [(1e-10, 0), (1e-16, 1), (0.0, 1)])
def test_a_weak_spring_to_the_ground_still_holds(ground, modes):
    """Ten orders of magnitude softer than the body is elastic; what rounding leaves is not."""
    assert find_rigid_modes(np.array([[1.0 + ground, -1.0], [-1.0, 1.0]])).shape == (2, modes)


BENDING = 175.0  # stiffness of a beam's section [N m^2]


def bend(lengths: np.ndarray) -> np.ndarray:
    """Stiffness of a slender free beam of elements of these lengths [m]: deflection and rotation of each node."""
    stiffness = np.zeros((2 * (len(lengths) + 1),) * 2)
    for k, h in enumerate(lengths):
        at = slice(2 * k, 2 * k + 4)
        curved = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
        curved += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
        stiffness[at, at] += BENDING / h**3 * np.array(curved)
    return stiffness


def describe(stiffness: np.ndarray) -> dict[str, np.ndarray]:
    """A model of a beam with contact at its last node."""
    size = len(stiffness)
    return {"mass": np.eye(size), "damping": np.eye(size), "stiffness": stiffness, "normal": np.eye(size)[-2:-1]}


@pytest.mark.parametrize(
    "lengths",
    [np.concatenate([np.full(50, 0.02), np.full(5, h)]) for h in (5e-4, 2e-4)] + [np.full(400, 2.5e-3)],
    ids=["fine at its tip", "finer", "400 elements"],
)
def test_a_slender_beam_that_is_clamped_is_never_taken_for_a_floating_one(lengths):
    """Its softest motion resists by little more than rounding: whoever knows is asked, and believed."""
    beam = describe(bend(lengths)[2:, 2:])
    size = len(beam["stiffness"])
    with pytest.raises(ModelError, match=rf"resists 1 motions by no more than rounding.*np.zeros\(\({size}, 0\)\)"):
        ReducedModel(**beam)
    held = ReducedModel(**beam, rigid_modes=np.zeros((size, 0)))
    flexibility = condense(held, held.normal, {}, 0.0, (0,)).flexibility[0, 0, 0].real
    assert flexibility == pytest.approx(lengths.sum() ** 3 / (3 * BENDING), rel=1e-4)


@pytest.mark.parametrize("elements", [50, 400])
def test_a_beam_that_floats_is_seen_however_many_elements_it_has(elements):
    assert ReducedModel(**describe(bend(np.full(elements, 1.0 / elements)))).rigid_modes.shape[1] == 2


def test_single_precision_does_not_tell_a_floating_body_from_a_soft_one():
    """Its rounding held a floating chain by a spring of 1e-8 of its own stiffness, and the chain swung out 200 m."""
    stretch = np.diff(np.eye(6), axis=0)
    chain = stretch.T @ np.diag(np.random.default_rng(0).uniform(1e6, 3e6, 5)) @ stretch
    whole = describe(chain)
    single = whole | {"stiffness": chain.astype(np.float32)}
    assert ReducedModel(**whole).rigid_modes.shape[1] == 1
    for stiffness in (single["stiffness"], scipy.sparse.csr_matrix(single["stiffness"])):
        with pytest.raises(ModelError, match="the stiffness is in single precision, and resists 1 motions"):
            ReducedModel(**single | {"stiffness": stiffness})
    given = ReducedModel(**single, rigid_modes=np.ones((6, 1)))
    assert given.rigid_modes.shape[1] == 1


def test_rigid_modes_found_between_coordinates_of_unlike_units():
    """Modal coordinates beside displacements: stiffness entries a factor of 1e12 apart."""
    model = transform_coordinates(dovetail(), np.diag(np.logspace(0, 6, 26)))
    assert model.rigid_modes.shape == (26, 3)


def test_given_rigid_modes_are_kept():
    model = dovetail()
    turned = model.rigid_modes @ np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 3.0], [1.0, 0.0, 1.0]])
    np.testing.assert_array_equal(replace(model, rigid_modes=turned).rigid_modes, turned)
    stuck = np.eye(26)[:, :1]
    with pytest.raises(ModelError, match="give null vectors of the stiffness, None to have them found, or a stiffness"):
        replace(model, rigid_modes=stuck)


def test_a_block_on_two_pads_has_no_stiffness_across_them_but_rounding():
    """Nothing resists either pad's own motion: what a reduction leaves there is no spring."""
    stiffness, noise = np.zeros((5, 5)), np.random.default_rng(0).uniform(-2.0, 2.0, (5, 5))
    stiffness[:4:2, :4:2], stiffness[4, 4] = [[1e9, -1e9], [-1e9, 1e9 + 1e5]], 1e9  # x, y of both, and a mode
    known = {
        "mass": np.diag([1.0, 1.0, 1.0, 1.0, 2.0]),
        "damping": np.diag([9.0] * 5),
        "normal": -np.eye(5)[[1, 3]],
        "tangential": np.eye(5)[[0, 2]],
        "load": {0: [0.0, 50.0, 0.0, 50.0, 0.0], 1: [30.0, 0.0, 0.0, 10.0, 9.0]},
        "outputs": {"x": np.eye(5)[0]},
        "rigid_modes": np.eye(5)[:, [1, 3]],
    }
    rounded = stiffness + 1e-7 * (noise + noise.T)
    x, exact = (
        solve(ContactProblem(ReducedModel(stiffness=k, **known), ContactLaws(), 60.0)).output("x")
        for k in (rounded, stiffness)
    )
    np.testing.assert_allclose(x, exact, rtol=0, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("spring", [1e2, 1e6])
def test_springs_on_a_mass_far_above_all_others_are_no_rounding(spring):
    """A ground that is shaken, and a contact node of next to no mass, beside which all other stiffness is little."""
    stiffness = np.array([[spring, -spring, 0.0], [-spring, spring + 1e9, -1e9], [0.0, -1e9, 1e9]])
    mass = np.diag([1e14, 1.0, 1e-12])
    model = ReducedModel(mass, 0 * mass, stiffness, normal=[[0.0, 0.0, 1.0]], rigid_modes=np.ones((3, 1)))
    np.testing.assert_array_equal(model.stiffness, stiffness)


@pytest.mark.parametrize("count, left", [(0, 3), (1, 2), (2, 1), (3, 0), (6, 0)])
def test_bonds_take_rigid_modes_away(count, left):
    model = dovetail()
    rows = np.vstack([model.normal, model.tangential])[np.array([0, 6, 3, 9, 1, 2])[:count]]
    held, _ = hold(model, rows)
    assert held.rigid_modes.shape == (held.size, left)
    assert find_rigid_modes(held.stiffness).shape[1] == left
