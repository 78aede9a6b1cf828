"""The reduced model: what it refuses, its rigid modes, bonding of rows, and its file."""

from __future__ import annotations

import resource
from dataclasses import replace

import h5py
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st
from small_models import dovetail, friction_oscillator, random_structure, transform_coordinates

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.errors import EwrError, ModelError, OutputError, UnwritableFile
from ewr_fenicsx.model.compliance import condense
from ewr_fenicsx.model.rigid_modes import find_rigid_modes
from ewr_fenicsx.problem.layout import hold

PLAIN = {"mass": np.eye(2), "damping": np.zeros((2, 2)), "stiffness": np.eye(2), "normal": [[1.0, 0.0]]}
SKEW = np.array([[1.0, 0.5], [0.0, 1.0]])


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"mass": np.eye(3)}, r"mass has shape \(3, 3\); expected \(2, 2\)"),
        ({"damping": np.zeros((1, 2))}, r"damping has shape \(1, 2\); expected \(2, 2\)"),
        ({"stiffness": [[1.0, np.nan], [np.nan, 1.0]]}, "stiffness has entries that are not finite"),
        ({"mass": SKEW}, "mass is not symmetric: largest difference 0.5; symmetrise it or check its assembly"),
        ({"stiffness": SKEW}, "stiffness is not symmetric: largest difference 0.5"),
        (
            {"stiffness": [[1e9, 0.0], [0.5, 1e-3]]},
            r"stiffness is not symmetric: stiffness\[1, 0\] = 0.5, and stiffness\[0, 1\] = 0; give both triangles",
        ),
        ({"stiffness": -np.eye(2)}, "stiffness is not positive semidefinite: scaled eigenvalue -1"),
        ({"mass": -np.eye(2)}, "mass is not positive semidefinite: scaled eigenvalue -1; check its sign"),
        ({"mass": [[1.0, 2e-5], [2e-5, 1e-10]]}, "mass is not positive semidefinite: scaled eigenvalue -0.0289"),
        ({"mass": [[0.0, 4.0], [4.0, 0.0]]}, "mass is not positive semidefinite: scaled eigenvalue -1e"),
        (
            {"mass": np.zeros((2, 2)), "stiffness": np.diag([1.0, 0.0])},
            "leaves 1 rigid motions free, and the mass is zero in one",
        ),
        ({"stiffness": np.eye(2) * (1 + 0.01j)}, "stiffness = .* is complex; give real .* structural damping belongs"),
        ({"mass": [[1.0, 1j], [1j, 1.0]]}, "mass = .* is complex"),
        ({"normal": [[1j, 0.0]]}, "normal = .* is complex; give real rows"),
        ({"mass": "a"}, "mass = 'a'; give numbers"),
        ({"mass": None}, "mass = None; give numbers"),
        ({"mass": [[1.0, 0.0], [0.0]]}, "mass = .* has rows of unequal lengths"),
        ({"stiffness": np.zeros((0, 0))}, "stiffness is empty; give a model with at least one coordinate"),
        ({"normal": np.zeros((0, 2))}, "contact rows, normal and tangential, are empty; give a row for each pair"),
        ({"normal": None, "tangential": np.zeros((0, 2))}, "are empty; give a row for each pair, at least one"),
        ({"normal": None}, "give normal, tangential or both"),
        ({"normal": [[1.0, 0.0, 0.0]]}, r"normal has shape \(1, 3\); expected \(any, 2\)"),
        (
            {"tangential": np.ones((3, 2))},
            r"tangential has 3 rows for 1 pairs; give 1 \(2-D\) or 2 \(3-D, pair-major\)",
        ),
        ({"pair_area": [1.0, 2.0]}, "pair_area has 2 entries; expected 1"),
        (
            {"normal": None, "tangential": np.eye(2), "pair_area": [1.0]},
            r"2 rows for 1 areas: without normal rows each is a pair .* give normal as well, \(1, 2\) zeros",
        ),
        ({"pair_area": [-2.0]}, r"pair_area\[0\] = -2 m\^2; every tributary area must be positive"),
        ({"pair_area": [0.0]}, r"pair_area\[0\] = 0 m\^2"),
        ({"load": {0: [1j, 0.0]}}, r"load\[0\] is the mean load and must be real"),
        ({"load": [100.0, 0.0]}, r"load = \[100.0, 0.0\]; give a dictionary such as {1: amplitudes}"),
        ({"load": {"first": [1.0, 0.0]}}, "harmonic 'first'; harmonics are whole numbers from 0"),
        ({"load": {np.inf: [1.0, 0.0]}}, "harmonic inf; harmonics are whole numbers from 0"),
        ({"load": {1: ["big", 0.0]}}, r"load\[1\] = \['big', 0.0\]; give numbers"),
        ({"outputs": [1.0, 0.0]}, r"outputs = \[1.0, 0.0\]; give a dictionary such as {\"tip\": row}"),
        ({"pair_area": "wide"}, "pair_area = 'wide'; give numbers"),
        ({"rigid_modes": [1.0, 0.0, 0.0]}, r"rigid_modes has shape \(3, 1\); expected \(2, any\)"),
        ({"load": {1: [1.0]}}, r"load\[1\] has 1 entries; expected 2"),
        ({"load": {-1: [1.0, 0.0]}}, "harmonic -1; harmonics are whole numbers from 0"),
        ({"load": {0.5: [1.0, 0.0]}}, "harmonic 0.5; harmonics are whole numbers from 0"),
        ({"load": {1: [np.inf, 0.0]}}, r"load\[1\] has entries that are not finite"),
        ({"outputs": {"tip": [1.0]}}, r"outputs\['tip'\] has 1 entries; expected 2"),
        ({"outputs": {"": [1.0, 0.0]}}, r"outputs\[''\]: results go to files under that name, which none can have"),
        ({"outputs": {".": [1.0, 0.0]}}, "results go to files under that name"),
        ({"outputs": {"a\0b": [1.0, 0.0]}}, "results go to files under that name"),
        ({"rigid_modes": [[1.0], [0.0]]}, r"rigid_modes\[:, 0\] meets elastic forces of 1 of the stiffness"),
    ],
)
def test_what_makes_no_model_is_refused_by_name(changes, message):
    with pytest.raises(ModelError, match=message) as caught:
        ReducedModel(**PLAIN | changes)
    assert isinstance(caught.value, EwrError) and isinstance(caught.value, ValueError)


@pytest.mark.parametrize("name", ["mass", "stiffness"])
def test_matrices_must_be_square(name):
    with pytest.raises(ModelError, match=name):
        ReducedModel(**PLAIN | {name: np.ones((2, 3))})


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


def test_matrices_may_be_sparse_and_lists():
    sparse = {name: scipy.sparse.csr_matrix(PLAIN[name]) for name in ("mass", "damping", "stiffness", "normal")}
    model = ReducedModel(**sparse)
    np.testing.assert_array_equal(model.stiffness, np.eye(2))
    np.testing.assert_array_equal(model.normal, [[1.0, 0.0]])


def test_arrays_are_copies_that_cannot_be_changed():
    mass = np.eye(2)
    model = ReducedModel(**PLAIN | {"mass": mass})
    mass[0, 0] = 99.0
    assert model.mass[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        model.mass[0, 0] = 2.0


def test_rows_by_direction():
    plane, space = random_structure(pairs=3), random_structure(pairs=3, tangents=2)
    assert (plane.tangents, space.tangents, plane.pairs, space.pairs) == (1, 2, 3, 3)
    np.testing.assert_array_equal(plane.rows("tangential"), plane.tangential)
    np.testing.assert_array_equal(space.rows("tangential"), space.tangential[[0, 2, 4]])
    np.testing.assert_array_equal(space.rows("second_tangential"), space.tangential[[1, 3, 5]])
    with pytest.raises(ModelError, match=r"needs second_tangential contact rows .* give second_tangential=\.\.\."):
        plane.rows("second_tangential")
    with pytest.raises(ModelError, match="needs normal contact rows and the reduced model has none"):
        friction_oscillator().rows("normal")


@pytest.mark.parametrize(
    "model",
    [
        dovetail(),
        random_structure(tangents=2),
        friction_oscillator(),
        replace(friction_oscillator(), outputs={"tip/x": [1.0], "tip/y": [2.0], "tip": [3.0], "50 %2F": [4.0]}),
    ],
    ids=lambda m: f"n={m.size}, {len(m.outputs)} outputs",
)
def test_a_model_survives_its_file(model, tmp_path):
    path = tmp_path / "model.h5"
    model.save(path)
    again = ReducedModel.load(path)
    for name in ("mass", "damping", "stiffness", "normal", "tangential", "pair_area", "rigid_modes"):
        before, after = getattr(model, name), getattr(again, name)
        if before is None:
            assert after is None
        else:
            np.testing.assert_array_equal(before, after)
    for name in ("load", "outputs"):
        before, after = getattr(model, name), getattr(again, name)
        assert before.keys() == after.keys()
        for key in before:
            np.testing.assert_array_equal(before[key], after[key])


def test_a_file_that_is_missing_or_none_of_this_kind_is_named(tmp_path):
    (tmp_path / "text.h5").write_text("no HDF5")
    dovetail().save(tmp_path / "damaged.h5")
    whole = bytearray((tmp_path / "damaged.h5").read_bytes())
    whole[len(whole) // 2] ^= 1
    (tmp_path / "damaged.h5").write_bytes(whole)
    for name, why in (("text.h5", ".*"), ("missing.h5", "there is no such file"), ("damaged.h5", "it is damaged")):
        with pytest.raises(ModelError, match=rf"{name} is no reduced model: {why}; give a file that"):
            ReducedModel.load(tmp_path / name)


def test_a_strange_file_is_refused(tmp_path):
    with h5py.File(tmp_path / "strange.h5", "w") as file:
        file.attrs["format"] = "something else"
    with pytest.raises(
        ModelError, match=r'strange\.h5: format "something else", expected "ewr_fenicsx reduced model, 1"'
    ):
        ReducedModel.load(tmp_path / "strange.h5")


def test_a_model_that_cannot_be_saved_says_why(tmp_path):
    model = ReducedModel(**PLAIN)
    model.save(tmp_path / "no" / "folder yet" / "model.h5")
    assert ReducedModel.load(tmp_path / "no" / "folder yet" / "model.h5").size == 2
    with pytest.raises(OutputError, match=r"folder yet cannot be written: .*; give a place where files can be"):
        model.save(tmp_path / "no" / "folder yet")
    with pytest.raises(OutputError, match=r"deeper.h5 cannot be written: .*; give a place"):
        model.save(tmp_path / "no" / "folder yet" / "model.h5" / "deeper.h5")


def test_a_file_for_which_there_is_no_room_leaves_the_one_before(tmp_path):
    """As on a full disk, where HDF5 itself may bring the process down: it writes in memory alone."""
    path, usual = tmp_path / "model.h5", resource.getrlimit(resource.RLIMIT_FSIZE)
    random_structure(size=3).save(path)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, usual[1]))
    try:
        with pytest.raises(UnwritableFile, match=r"model\.h5 cannot be written: File too large; .* make room$"):
            random_structure(size=90).save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert ReducedModel.load(path).size == 3
    assert [file.name for file in tmp_path.iterdir()] == ["model.h5"]


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


def test_holding_rows_leaves_the_motions_that_obey_them():
    model = dovetail()
    rows = np.vstack([model.normal[:2], model.tangential[1:2]])
    held, basis = hold(model, rows)
    assert basis.shape == (26, 23) and held.size == 23
    np.testing.assert_allclose(rows @ basis, 0.0, atol=1e-14)
    motion = np.random.default_rng(0).normal(size=23)
    x = basis @ motion
    for name in ("mass", "damping", "stiffness"):
        assert motion @ getattr(held, name) @ motion == pytest.approx(x @ getattr(model, name) @ x, rel=1e-12)
    np.testing.assert_allclose(held.normal @ motion, model.normal @ x, atol=1e-13)
    np.testing.assert_allclose(held.tangential @ motion, model.tangential @ x, atol=1e-13)
    for h in model.load:
        assert held.load[h] @ motion == pytest.approx(model.load[h] @ x, rel=1e-12)
    assert held.outputs["tip"] @ motion == pytest.approx(model.outputs["tip"] @ x, rel=1e-12)


@pytest.mark.parametrize("count, left", [(0, 3), (1, 2), (2, 1), (3, 0), (6, 0)])
def test_bonds_take_rigid_modes_away(count, left):
    model = dovetail()
    rows = np.vstack([model.normal, model.tangential])[np.array([0, 6, 3, 9, 1, 2])[:count]]
    held, _ = hold(model, rows)
    assert held.rigid_modes.shape == (held.size, left)
    assert find_rigid_modes(held.stiffness).shape[1] == left


def test_redundant_bonds_do_no_harm():
    model = dovetail()
    once, _ = hold(model, model.normal)
    twice, _ = hold(model, np.vstack([model.normal, 1e3 * model.normal]))
    assert once.size == twice.size == 20
    eigenvalues = [scipy.linalg.eigvalsh(m.stiffness, m.mass) for m in (once, twice)]
    np.testing.assert_allclose(*eigenvalues, rtol=1e-9, atol=1e-9 * eigenvalues[0].max())


def test_bonds_to_bodies_on_weak_springs_keep_their_digits():
    """Beside a soft suspension: what is bonded there has far more inertia than its own springs would tell."""
    random, n, bodies = np.random.default_rng(0), 11, [8, 9, 10]
    spread, stiff = random.normal(size=(7, 7)), slice(1, 8)
    mass, stiffness = np.diag([5.0, *[1.0] * 3, *[0.01] * 4, *[10.0] * 3]), np.diag([1e-4] * n)
    stiffness[stiff, stiff] = 1e9 * (spread @ spread.T / 7 + 0.05 * np.eye(7))
    bonds = np.eye(n)[bodies] - np.eye(n)[[4, 5, 6]] + 0.3 * np.eye(n)[[9, 10, 8]]
    damping, force, omega = 1e-6 * stiffness + 5.0 * mass, 100.0 * random.normal(size=n), 2 * np.pi * 2000.0
    outputs = {f"x{k}": row for k, row in enumerate(np.eye(n))}
    model = ReducedModel(mass, damping, stiffness, tangential=bonds, load={1: force}, outputs=outputs)
    laws = ContactLaws("prescribed", "bonded", normal_force=0.0)
    solution = solve(ContactProblem(model, laws, omega / (2 * np.pi), harmonics=(1,)))
    impedance = stiffness + 1j * omega * damping - omega**2 * mass
    whole = np.block([[impedance, bonds.T], [bonds, np.zeros((3, 3))]])  # with the forces in the bonds
    exact = np.linalg.solve(whole, [*force, 0.0, 0.0, 0.0])[:n]
    moved = [solution.output(name)[0] for name in outputs]
    np.testing.assert_allclose(moved, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_holding_all_motions_is_refused():
    model = ReducedModel(**PLAIN | {"tangential": [[0.0, 1.0]]})
    with pytest.raises(
        ModelError, match="bonds hold all 2 coordinates of the model, and nothing is left to move; bond"
    ):
        hold(model, np.eye(2))


def test_holding_nothing_returns_the_model_itself():
    model = dovetail()
    held, basis = hold(model, np.zeros((0, 26)))
    assert held is model
    np.testing.assert_array_equal(basis, np.eye(26))


def test_massless_coordinates_are_no_negative_mass():
    """Also where the rounding of a projection leaves a little on or beside the diagonal."""
    mass = np.diag([1.0, 0.0])
    mass[0, 1] = mass[1, 0] = 1e-17
    mass[1, 1] = -1e-17
    assert ReducedModel(**PLAIN | {"mass": mass}).size == 2


@pytest.mark.parametrize("damping", [[[0.0, 50.0], [-50.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]])
def test_damping_may_turn_or_feed_a_motion(damping):
    """Gyroscopic, or that of flutter; what it feeds is told of the solution."""
    np.testing.assert_array_equal(ReducedModel(**PLAIN | {"damping": damping}).damping, damping)
