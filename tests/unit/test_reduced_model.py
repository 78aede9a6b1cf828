"""The reduced model: what it refuses, bonding of rows, and its file."""

from __future__ import annotations

import resource
from dataclasses import replace

import h5py
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from small_models import dovetail, friction_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.errors import EwrError, ModelError, OutputError, UnwritableFile
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
        assert list(before) == list(after)  # columns of tables are in the order of outputs
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
