"""Component mode synthesis against the full model: exact statics, exact with all modes, and the error in between."""

from __future__ import annotations

import resource
import tracemalloc
from dataclasses import replace
from itertools import pairwise
from math import pi
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from mpi4py import MPI
from petsc4py import PETSc
from small_scenes import read_demo
from sparse_matrices import to_scipy

from ewr_fenicsx import load_scene, solve
from ewr_fenicsx.accuracy.estimates import estimate_modes, measure_distance
from ewr_fenicsx.accuracy.modes_left_out import ModesBesideResponses
from ewr_fenicsx.errors import InterfaceError, ModesError
from ewr_fenicsx.runs.study import list_modes
from ewr_fenicsx.structure.chain import build_chain, pose_problem
from ewr_fenicsx.structure.elasticity import BoundaryForce, OutputSpec, assemble_structure
from ewr_fenicsx.structure.interface import pair_interface
from ewr_fenicsx.structure.materials import TITANIUM, PerMode, Rayleigh, RayleighRatios
from ewr_fenicsx.structure.mesh import build_mesh
from ewr_fenicsx.structure.reduction import _residual_vectors, find_memory, keep_more_modes, reduce_structure

TWO_BLOCKS = Path(__file__).parents[1] / "geometry" / "two_blocks.py"
STACKS = Path(__file__).parents[1] / "geometry" / "stacks.py"
FIR_TREE = Path(__file__).parents[2] / "geometry" / "fir_tree.py"
FIRST_MODE = 1090.0  # Hz, of the default fir tree in full stick


def assemble(source, parameters=None, pull=1000.0, **options):
    mesh = build_mesh(source, parameters or {}, MPI.COMM_WORLD)
    loads = [BoundaryForce("pull", "tip", (0.0, pull)), BoundaryForce("push", "tip", (10.0, 0.0), 1, 0.4)]
    options = {"damping": RayleighRatios((500.0, 3000.0), (0.002, 0.002))} | options
    structure = assemble_structure(
        mesh,
        materials=dict.fromkeys(mesh.bodies, TITANIUM),
        loads=loads,
        outputs=[OutputSpec("tip", "tip", (1.0, 0.0))],
        **options,
    )
    return structure, pair_interface(structure)


def full_matrices(structure, interface):
    """Sparse M, D, K, dense contact rows, loads and tip row on the free degrees of freedom, and their numbers."""
    free = np.setdiff1d(np.arange(structure.mass.getSize()[0]), structure.fixed_dofs)
    mass, damping, stiffness = (
        to_scipy(m)[free][:, free] for m in (structure.mass, structure.damping, structure.stiffness)
    )
    rows = scipy.sparse.vstack([interface.normal_gap, interface.tangential_slip]).tocsc()[:, free].toarray()
    loads = np.column_stack([load.amplitude * load.vector.array for load in structure.loads])[free]
    return mass, damping, stiffness, rows, loads, structure.outputs["tip"].array[free], free


def reduced_matrices(model):
    rows = np.vstack([model.normal, model.tangential])
    return (
        model.mass,
        model.damping,
        model.stiffness,
        rows,
        np.column_stack([model.load[0], model.load[1]]),
        model.outputs["tip"],
    )


def evaluate_compliance(matrices, frequency):
    """Motion of the pairs, then of the tip, for unit pair forces and for the loads: ``(2 K_c + 1, 2 K_c + 2)``."""
    mass, damping, stiffness, rows, loads, tip = matrices[:6]
    omega = 2 * pi * frequency
    dynamic = stiffness + 1j * omega * damping - omega**2 * mass
    forces = np.hstack([rows.T, loads])
    if scipy.sparse.issparse(dynamic):
        response = scipy.sparse.linalg.splu(dynamic.tocsc()).solve(forces)
    else:
        response = np.linalg.solve(dynamic, forces)
    return np.vstack([rows, tip]) @ response


def joint_error(found, expected):
    """Largest error of the joint compliance ``B (K + i w D - w^2 M)^-1 B^T``, relative to its largest entry."""
    pairs = expected.shape[0] - 1
    return np.abs(found - expected)[:pairs, :pairs].max() / np.abs(expected[:pairs, :pairs]).max()


def test_compliance_error_falls_with_the_number_of_modes(capsys):
    """The table of the default fir tree: the default number of modes is within 1e-4 at 1 to 5 times the first mode."""
    structure, interface = assemble(FIR_TREE)
    matrices = full_matrices(structure, interface)
    frequencies = FIRST_MODE * np.arange(1, 6)
    expected = [evaluate_compliance(matrices, f) for f in frequencies]

    def errors(**choice):
        reduction = reduce_structure(structure, interface, **choice)
        model = reduced_matrices(reduction.model)
        found = [joint_error(evaluate_compliance(model, f), e) for f, e in zip(frequencies, expected, strict=True)]
        return len(reduction.fixed_interface_frequencies), reduction.fixed_interface_frequencies[-1], found

    table = [errors(modes=count) for count in (2, 5, 10, 20, 40, 80)]
    default = errors()
    with capsys.disabled():
        print(
            "\nCraig-Bampton, default fir tree: error of the joint compliance at h x 1090 Hz\n"
            "modes  up to kHz " + "".join(f"     h = {h}" for h in range(1, 6))
        )
        for count, highest, row in sorted([*table, default]):
            print(f"{count:5d} {highest / 1e3:10.1f} " + "".join(f"{e:10.1e}" for e in row))
    assert max(default[2]) < 1e-4
    worst = [max(row) for *_, row in table]
    assert all(fine < coarse for coarse, fine in pairwise(worst)), worst
    assert worst[0] > 1e-3, "two modes are too few for 5450 Hz; if they were not, this table would prove nothing"
    assert worst[-1] < 1e-5


@pytest.mark.parametrize("modes", [1, 5, None])
def test_static_response_is_exact_with_any_number_of_modes(modes):
    """h = 0, the floating blade held at three contact degrees of freedom: pair forces and loads, to rounding."""
    structure, interface = assemble(FIR_TREE)
    reduction = reduce_structure(structure, interface, **({} if modes is None else {"modes": modes}))
    _, _, stiffness, rows, loads, tip, free = full_matrices(structure, interface)
    _, _, small, small_rows, small_loads, small_tip = reduced_matrices(reduction.model)
    held = reduction.contact_dofs[[0, 1, 4 * 9 + 1]]  # both of the first blade node, one of the tenth
    kept = ~np.isin(free, held)
    coordinates = ~np.isin(np.arange(reduction.model.size), [0, 1, 4 * 9 + 1])

    def respond(stiffness, rows, loads, tip, solve):
        return np.vstack([rows, tip]) @ solve(stiffness, np.hstack([rows.T, loads.real]))

    expected = respond(
        stiffness[kept][:, kept].tocsc(),
        rows[:, kept],
        loads[kept],
        tip[kept],
        lambda k, f: scipy.sparse.linalg.splu(k).solve(f),
    )
    found = respond(
        small[np.ix_(coordinates, coordinates)],
        small_rows[:, coordinates],
        small_loads[coordinates],
        small_tip[coordinates],
        np.linalg.solve,
    )
    scale = np.outer(np.abs(expected).max(axis=1), np.abs(expected).max(axis=0))
    assert (np.abs(found - expected) / scale * np.abs(expected).max()).max() < 1e-9


@pytest.fixture(scope="module", params=[1, 2])
def small_joint(request):
    """Two blocks, few enough elements to keep every mode."""
    shape = {"columns": 2, "blade_rows": 3, "disk_rows": 2, "skew": 0.01, "inclination": 20.0}
    return assemble(TWO_BLOCKS, shape, pull=-1000.0, degree=request.param)


def test_with_all_modes_the_reduction_is_exact(small_joint):
    """Nothing is lost: compliance to 1e-9, and the load vectors find nothing left to add."""
    structure, interface = small_joint
    matrices = full_matrices(structure, interface)
    interior = matrices[0].shape[0] - 4 * len(interface.area)
    reduction = reduce_structure(structure, interface, modes=interior)
    assert reduction.model.size == matrices[0].shape[0]
    for frequency in (500.0, 5000.0, 40000.0):
        expected = evaluate_compliance(matrices, frequency)
        found = evaluate_compliance(reduced_matrices(reduction.model), frequency)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        assert joint_error(found, expected) < 1e-9


def test_contact_coordinates_are_displacements_of_the_contact_nodes(small_joint):
    """Expanding a coordinate vector gives it back at the contact nodes, and nothing at the clamp."""
    structure, interface = small_joint
    reduction = reduce_structure(structure, interface, modes=3)
    x = np.random.default_rng(1).normal(size=reduction.model.size)
    field = reduction.expand(x).x.array
    np.testing.assert_allclose(field[reduction.contact_dofs], x[: len(reduction.contact_dofs)], rtol=1e-14)
    np.testing.assert_array_equal(field[structure.fixed_dofs], 0)
    np.testing.assert_allclose(interface.normal_gap @ field, reduction.model.normal @ x, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(
        interface.tangential_slip @ field, reduction.model.tangential @ x, rtol=1e-10, atol=1e-12
    )
    assert reduction.model.outputs["tip"] @ x == pytest.approx(structure.outputs["tip"].array @ field, rel=1e-10)


def test_bonded_static_state_is_the_full_models(small_joint):
    """The reduced model with the joint bonded, expanded to the mesh, is the sparse static solution."""
    structure, interface = small_joint
    reduction = reduce_structure(structure, interface, modes=2)
    _, _, stiffness, rows, loads, _, free = full_matrices(structure, interface)
    stuck = scipy.sparse.csc_matrix(scipy.linalg.null_space(rows))
    expected = stuck @ scipy.sparse.linalg.spsolve((stuck.T @ stiffness @ stuck).tocsc(), stuck.T @ loads[:, 0].real)
    model = reduction.model
    small = scipy.linalg.null_space(np.vstack([model.normal, model.tangential]))
    x = small @ np.linalg.solve(small.T @ model.stiffness @ small, small.T @ model.load[0].real)
    np.testing.assert_allclose(reduction.expand(x).x.array[free], expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_basis_is_well_conditioned(small_joint):
    """Modal and load vectors are mass-orthonormal; the static load vectors are independent of the modes."""
    structure, interface = small_joint
    reduction = reduce_structure(structure, interface, modes=5)
    model, contacts = reduction.model, len(reduction.contact_dofs)
    assert model.size == contacts + 5 + 2
    np.testing.assert_allclose(model.mass[contacts:, contacts:], np.eye(7), atol=1e-10)
    for matrix in (model.mass, model.damping, model.stiffness):
        np.testing.assert_array_equal(matrix, matrix.T)
    omega = 2 * pi * reduction.fixed_interface_frequencies
    np.testing.assert_allclose(np.diag(model.stiffness)[contacts : contacts + 5], omega**2, rtol=1e-9)
    largest = np.abs(model.stiffness).max()
    assert np.abs(model.stiffness[:contacts, contacts : contacts + 5]).max() < 1e-9 * largest


def test_rigid_modes_of_the_floating_blade(small_joint):
    """Three, without elastic force, and the rigid motion of the whole blade once expanded; the disk is clamped."""
    structure, interface = small_joint
    reduction = reduce_structure(structure, interface, modes=2)
    rigid = reduction.model.rigid_modes
    assert rigid.shape == (reduction.model.size, 3)
    force = reduction.model.stiffness @ rigid
    assert np.abs(force).max() < 1e-9 * np.abs(reduction.model.stiffness).max()
    # u = (0, 1) on the blade: mass times acceleration of the blade alone
    body_mass = TITANIUM.density * 0.01 * 0.04 * 0.06
    for column in rigid[:, :2].T:
        assert column @ reduction.model.mass @ column == pytest.approx(body_mass, rel=1e-9)
    assert np.linalg.matrix_rank(rigid) == 3


def test_nothing_clamped_leaves_both_bodies_floating():
    """Six rigid modes of two bodies; three of the bonded joint."""
    reduction = reduce_structure(*assemble(TWO_BLOCKS, clamp=()), modes=2)
    assert reduction.model.rigid_modes.shape[1] == 6
    eigenvalues = reduction.full_stick.frequency**2
    assert (np.abs(eigenvalues[:3]) < 1e-9 * eigenvalues[3]).all()


@pytest.mark.parametrize("clamped, floating", [(2, 6), (1, 9)])
def test_each_piece_that_nothing_clamps_floats_whatever_its_body(clamped, floating):
    """Two stacks: both blades, one body, float each by itself, and so do a disk and base that are not clamped."""
    reduction = reduce_structure(*assemble(STACKS, {"stacks": 2, "clamped": clamped}), modes=2)
    model = reduction.model
    assert model.rigid_modes.shape[1] == floating
    force = model.stiffness @ model.rigid_modes
    assert np.abs(force).max() < 1e-9 * np.abs(model.stiffness).max()


def test_bodies_that_share_nodes_are_one_piece():
    """A disk glued to a base of the same material is the disk in one, though only the base is clamped."""
    layers, whole = (reduce_structure(*assemble(STACKS, {"base": base}), modes=4) for base in ("base", "disk"))
    assert layers.model.rigid_modes.shape[1] == 3
    np.testing.assert_allclose(layers.full_stick.frequency, whole.full_stick.frequency, rtol=1e-9)
    values = [scipy.linalg.eigvalsh(r.model.stiffness, r.model.mass) for r in (layers, whole)]
    np.testing.assert_allclose(values[0], values[1], atol=1e-9 * values[1].max())


def test_a_piece_that_nothing_holds_is_named():
    with pytest.raises(ModesError, match='nothing holds "disk", or a piece of it'):
        reduce_structure(*assemble(STACKS, {"loose": True}), modes=2)


@pytest.mark.parametrize("clamp, floating", [(("clamp", "tip"), 0), (("clamp",), 3)])
def test_damping_ratio_per_mode(clamp, floating):
    """Open: the ratio; stuck: never more, and just it where the joint holds a body; closed: about it; nothing gains."""
    structure, interface = assemble(TWO_BLOCKS, damping=PerMode(0.01), clamp=clamp)
    model = reduce_structure(structure, interface, modes=6).model
    stuck = np.vstack([model.normal, model.tangential])
    ratios = {}
    for state, rows in {"open": np.zeros((1, model.size)), "closed": model.normal, "stuck": stuck}.items():
        free = scipy.linalg.null_space(rows)
        values, vectors = scipy.linalg.eigh(free.T @ model.stiffness @ free, free.T @ model.mass @ free)
        first = np.count_nonzero(values < 1e-9 * values[-1])
        assert first == (floating if state == "open" else 0) or state == "closed"
        modal = (vectors.T @ free.T @ model.damping @ free @ vectors)[first:, first:]
        ratios[state] = np.diag(modal) / (2 * np.sqrt(values[first:]))
        if state == "open" and not floating:
            np.testing.assert_allclose(modal, np.diag(np.diag(modal)), atol=1e-8 * modal.max())
    np.testing.assert_allclose(ratios["open"], 0.01, rtol=0.1 if floating else 1e-6)
    np.testing.assert_allclose(ratios["stuck"][:floating], 0.01, rtol=1e-6)
    assert ratios["stuck"].max() <= 0.01 * (1 + 1e-6)
    for state, ratio in ratios.items():
        assert ratio[:6].min() > 0.005 and ratio.max() < 0.011, (state, ratio)
    assert np.linalg.eigvalsh(model.damping)[0] > -1e-12 * np.abs(model.damping).max()


def test_the_drag_of_a_floating_body_is_measured():
    """Rayleigh's part by mass is just that; a ratio per mode drags the block about as its stuck modes are damped."""
    plain = reduce_structure(*assemble(TWO_BLOCKS, damping=Rayleigh(7.0, 1e-6)), modes=6)
    assert plain.rigid_drag == pytest.approx(7.0, rel=1e-6)
    per_mode = reduce_structure(*assemble(TWO_BLOCKS, damping=PerMode(0.01)), modes=6)
    highest = 2 * pi * per_mode.full_stick.frequency.max()
    assert 0.1 * 0.02 * highest < per_mode.rigid_drag < 0.02 * highest
    held = reduce_structure(*assemble(TWO_BLOCKS, damping=PerMode(0.01), clamp=("clamp", "tip")), modes=6)
    assert held.rigid_drag == 0.0


def test_the_damping_of_the_bonded_joint_is_told():
    """Rayleigh's formula at its first mode; a ratio asked for by mode is that of the mode which holds the block."""
    structure, interface = assemble(TWO_BLOCKS)
    reduction = reduce_structure(structure, interface, modes=12)
    damping, omega = (
        RayleighRatios((500.0, 3000.0), (0.002, 0.002)).rayleigh(),
        2 * pi * reduction.full_stick.frequency[0],
    )
    expected = damping.alpha / (2 * omega) + damping.beta * omega / 2
    assert reduction.full_stick_ratio == pytest.approx(expected, rel=1e-4)
    per_mode = reduce_structure(*assemble(TWO_BLOCKS, damping=PerMode(0.01)), modes=12)
    assert per_mode.full_stick_ratio == pytest.approx(0.01, rel=1e-4)


def test_loads_of_one_harmonic_are_summed_with_their_phases():
    mesh = build_mesh(TWO_BLOCKS, {}, MPI.COMM_WORLD)
    loads = [BoundaryForce("a", "tip", (2.0, 0.0), 1), BoundaryForce("b", "tip", (3.0, 0.0), 1, pi / 2)]
    structure = assemble_structure(
        mesh,
        materials=dict.fromkeys(mesh.bodies, TITANIUM),
        loads=loads,
        outputs=[OutputSpec("tip", "tip", (1.0, 0.0))],
    )
    model = reduce_structure(structure, pair_interface(structure), modes=3).model
    np.testing.assert_allclose(model.load[1], (2 + 3j) * model.outputs["tip"], rtol=1e-10, atol=1e-14)


def test_reduced_full_stick_frequency_is_that_of_the_sparse_matrices():
    structure, interface = assemble(FIR_TREE)
    reduction = reduce_structure(structure, interface)
    model = reduction.model
    stuck = scipy.linalg.null_space(np.vstack([model.normal, model.tangential]))
    values = scipy.linalg.eigh(stuck.T @ model.stiffness @ stuck, stuck.T @ model.mass @ stuck, eigvals_only=True)
    error = np.sqrt(values[:3]) / (2 * pi) / reduction.full_stick.frequency[:3] - 1
    assert (np.abs(error) < (1e-8, 1e-7, 1e-5)).all(), error


def test_too_many_modes_and_clamped_pairs_are_refused():
    structure, interface = assemble(TWO_BLOCKS, {"columns": 1, "blade_rows": 1, "disk_rows": 1})
    for modes in (100, 10**7):  # these would fit into no memory
        with pytest.raises(ModesError, match=f"{modes} modes asked for; the matrices have .* degrees of freedom"):
            reduce_structure(structure, interface, modes=modes)
    with pytest.raises(InterfaceError, match=r'flank "joint": both nodes at .* held along x and y, and cannot part'):
        assemble(TWO_BLOCKS, clamp=("clamp", "joint"))


def test_modes_added_later_give_the_model_of_all_at_once():
    """Deflation finds the modes that come next, and what the load responses had outside the first is enough."""
    structure, interface = assemble(TWO_BLOCKS)
    once = reduce_structure(structure, interface, modes=20)
    grown = keep_more_modes(keep_more_modes(reduce_structure(structure, interface, modes=2), 5), 20)
    np.testing.assert_allclose(grown.fixed_interface_frequencies, once.fixed_interface_frequencies, rtol=1e-9)
    assert grown.modal_coordinates == once.modal_coordinates
    for name in ("mass", "damping", "stiffness", "normal", "tangential"):
        expected = getattr(once.model, name)
        np.testing.assert_allclose(getattr(grown.model, name), expected, atol=1e-9 * np.abs(expected).max())
    for h, load in once.model.load.items():
        np.testing.assert_allclose(grown.model.load[h], load, atol=1e-9 * np.abs(load).max())


def test_what_load_responses_have_outside_the_modes_is_orthogonal_to_them():
    """Also where that is so little of them that one pass leaves the rounding of the rest in it."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(12, 12))
    mass = root @ root.T + np.eye(12)
    shapes = scipy.linalg.eigh(mass, mass)[1][:, :5]
    responses = shapes @ rng.normal(size=(5, 2)) + 1e-6 * rng.normal(size=(12, 2))
    sparse = scipy.sparse.csr_matrix(mass)
    matrix = PETSc.Mat().createAIJ((12, 12), csr=(sparse.indptr, sparse.indices, sparse.data), comm=MPI.COMM_SELF)
    rest = _residual_vectors(responses, shapes, matrix)
    assert rest.shape == (12, 2)
    basis = np.column_stack([shapes, rest])
    np.testing.assert_allclose(basis.T @ mass @ basis, np.eye(7), atol=1e-12)


def test_no_more_modes_than_there_are():
    reduction = reduce_structure(*assemble(TWO_BLOCKS), modes=3)
    for count in (3, reduction.most_modes):  # SLEPc finds no last one beside those that are known
        with pytest.raises(
            ModesError, match=f"{count} modes asked for; give more than the 3 there are, and fewer than"
        ):
            keep_more_modes(reduction, count)


def measure_memory() -> int:
    """Resident memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def test_the_basis_is_in_memory_but_once_and_reducing_again_takes_no_more():
    structure, interface = assemble(FIR_TREE, {"mesh_size": 8e-4})
    tracemalloc.start()
    reduction = reduce_structure(structure, interface)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert reduction.basis.flags.f_contiguous
    assert peak < 2.5 * reduction.basis.nbytes
    seen = []
    for _ in range(4):
        reduction = reduce_structure(structure, interface)
        seen.append(measure_memory())
    assert seen[-1] - seen[1] < reduction.basis.nbytes


def test_a_reduction_that_no_memory_holds_is_refused_at_once(monkeypatch):
    structure, interface = assemble(FIR_TREE)
    monkeypatch.setattr("ewr_fenicsx.structure.reduction.os.sysconf", lambda name: 1000)
    with pytest.raises(InterfaceError, match=r"40 pairs on .* needs 0\.00[0-9]+ GB, and it may have 0\.001 GB here"):
        reduce_structure(structure, interface)


@pytest.mark.parametrize(
    ("group", "file"),
    [("0::/job/step", "job/memory.max"), ("4:memory:/job/step", "memory/job/memory.limit_in_bytes")],
)
def test_memory_is_what_the_control_groups_of_a_container_or_job_leave(tmp_path, group, file):
    (tmp_path / "proc" / "self").mkdir(parents=True)
    (tmp_path / "proc" / "self" / "cgroup").write_text(f"9:name=systemd:/\n{group}\n")
    whole = find_memory(tmp_path)
    limit = tmp_path / "sys" / "fs" / "cgroup" / file
    (limit.parent / "step").mkdir(parents=True)
    (limit.parent / "step" / limit.name).write_text("max\n")
    limit.write_text("4096000\n")
    assert find_memory(tmp_path) == 4096000 < whole


def test_the_error_by_modes_is_that_of_a_reduction_with_fewer(tmp_path):
    """Its estimate drops modes from the model, whose static responses then have to do for these too."""
    text = read_demo("two_blocks").replace("harmonics = 9", "harmonics = 3")
    found = {}
    for count in (30, 20):
        (tmp_path / "scene.toml").write_text(f"{text}\n[reduction]\nmodes = {count}\n")
        scene = load_scene(tmp_path / "scene.toml")
        chain = build_chain(scene)
        found[count] = solve(pose_problem(scene, chain.reduction.model, chain.interface)), chain.reduction
    solution, reduction = found[30]
    true = measure_distance(found[20][0], solution)
    modes = reduction.modal_coordinates
    beside = estimate_modes(solution, ModesBesideResponses(modes, reduction.response_coordinates))
    assert true / 3 < beside < 3 * true
    assert estimate_modes(solution, modes) > 30 * true, (
        "without a word of the responses the modes are missed altogether"
    )


@pytest.mark.parametrize(
    ("laws", "mode", "modes"), [("friction = 0.3", 1, 8), ('normal = "bonded"\ntangential = "bonded"', 2, 8)]
)
def test_the_error_by_modes_next_to_a_resonance(tmp_path, laws, mode, modes):
    """Where pairs slip, and of a linear joint: what moves the resonance are modes that were never kept."""
    text = read_demo("two_blocks").replace("harmonics = 9", "harmonics = 3").replace("friction = 0.3", laws)
    found, listed = {}, None
    for count in (120, modes):
        (tmp_path / "scene.toml").write_text(f"{text}\n[reduction]\nmodes = {count}\n")
        scene = load_scene(tmp_path / "scene.toml", warn=False)
        chain = build_chain(scene)
        frequency = 0.999 * chain.reduction.full_stick.frequency[mode - 1]
        problem = pose_problem(scene, chain.reduction.model, chain.interface)
        found[count], listed = solve(replace(problem, frequency=frequency)), list_modes(chain)
    true = measure_distance(found[modes], found[120])
    assert true / 3 < estimate_modes(found[modes], listed) < 3 * true
    assert estimate_modes(found[modes], ModesBesideResponses(listed, listed.responses)) < true / 3
