"""Supports along some axes: planes of symmetry, a lock along the slot, and what floats between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from mpi4py import MPI

from ewr_fenicsx import integrate, load_scene, solve
from ewr_fenicsx.errors import InterfaceError, ModesError, SceneError
from ewr_fenicsx.output.mesh_plots import mark_held
from ewr_fenicsx.structure.boundaries import list_dofs
from ewr_fenicsx.structure.chain import build_chain, pose_problem
from ewr_fenicsx.structure.elasticity import assemble_structure
from ewr_fenicsx.structure.interface import pair_interface
from ewr_fenicsx.structure.materials import TITANIUM
from ewr_fenicsx.structure.mesh import build_mesh
from ewr_fenicsx.structure.reduction import reduce_structure
from ewr_fenicsx.structure.rigid_motions import find_rigid_motions

GEOMETRY = Path(__file__).parents[2] / "geometry"
BLOCKS, STACKS = (Path(__file__).parents[1] / "geometry" / f"{name}.py" for name in ("two_blocks", "stacks"))
BOTH = {"blade": TITANIUM, "disk": TITANIUM}
DEPTH = 2e-3
SCENE = """
[geometry]
source = "{source}"
[geometry.parameters]
{drawn}
pairs = 4
mesh_size = 4e-3
[loads.pull]
boundary = "tip"
force = {pull}
[loads.shake]
boundary = "tip"
force = {shake}
harmonic = 1
[outputs.tip]
boundary = "tip"
direction = {along}
[reduction]
modes = {modes}
[excitation]
frequency = 1400.0
[solver]
harmonics = 9
{rest}
"""
FACES = ("front_blade", "front_disk", "back_blade", "back_disk")


def write_dovetail(folder, held=FACES, depth=DEPTH, layers=1, skew=0.0, share=1.0, modes=10):
    """The dovetail drawn out, with end faces held along z, under a share of the forces of one that is 2 mm deep."""
    text = SCENE.format(
        source=GEOMETRY / "extruded.py",
        drawn=f'profile = "dovetail"\nlayers = {layers}\ndepth = {depth}\nskew = {skew}',
        pull=[0.0, 1000.0 * share, 0.0],
        shake=[20.0 * share, 0.0, 0.0],
        along=[1.0, 0.0, 0.0],
        modes=modes,
        rest="[supports.hold]\n" + "\n".join(f'{face} = "z"' for face in held),
    )
    path = folder / f"solid_{layers}_{len(held)}.toml"
    path.write_text(text)
    return load_scene(path)


def write_plane(folder):
    text = SCENE.format(
        source=GEOMETRY / "dovetail.py",
        drawn="",
        pull=[0.0, 1000.0],
        shake=[20.0, 0.0],
        along=[1.0, 0.0],
        modes=10,
        rest=f'closure = "dashpot"\n[elasticity]\nplane = "strain"\nthickness = {DEPTH}',
    )
    (folder / "plane.toml").write_text(text)
    return load_scene(folder / "plane.toml")


def pose(scene):
    chain = build_chain(scene)
    return chain, pose_problem(scene, chain.reduction.model, chain.interface)


def sum_over_depth(chain, values):
    """Sums ``(n, places)`` of values ``(n, K_c)`` over pairs at one place of the profile, in the order of places."""
    place = chain.interface.position[:, :2].round(9)
    places, of_pair = np.unique(place, axis=0, return_inverse=True)
    sums = np.zeros((len(places), len(values)))
    np.add.at(sums, of_pair.ravel(), values.T)
    return sums.T


def test_a_slice_held_at_both_faces_is_in_plane_strain(tmp_path):
    """To rounding in its modes and stepped in time; harmonic balance differs, by truncation, for pairs are others."""
    (plane, of_plane), (solid, of_solid) = pose(write_plane(tmp_path)), pose(write_dovetail(tmp_path))
    model = solid.reduction.model
    assert (model.rigid_modes.shape[1], model.pairs) == (3, 2 * plane.reduction.model.pairs)
    assert not np.any(model.rows("second_tangential"))
    assert "second_tangential" not in of_solid.system.index
    frequencies = [chain.reduction.full_stick.frequency[:3] for chain in (plane, solid)]
    np.testing.assert_allclose(*frequencies, rtol=1e-9)

    steady = [integrate(problem, steps=400, tolerance=1e-7) for problem in (of_plane, of_solid)]
    assert all(one.converged for one in steady)
    tips = [one.output("tip") for one in steady]
    np.testing.assert_allclose(*tips, rtol=0, atol=1e-6 * np.abs(tips[0]).max())
    for name in ("normal_force", "friction_force"):
        of_pairs = [sum_over_depth(c, one.history(name)) for c, one in zip((plane, solid), steady, strict=True)]
        np.testing.assert_allclose(*of_pairs, rtol=0, atol=1e-4 * np.abs(of_pairs[0]).max())

    swing = [abs(solve(problem).output("tip")[1]) for problem in (of_plane, of_solid)]
    assert swing[1] == pytest.approx(swing[0], rel=0.01)


def test_half_of_a_symmetric_joint_moves_as_the_whole(tmp_path):
    """Cut in the middle of its depth; a pair there has half the area, no friction along z, and half of the force.

    With all but the highest modes: among the few lowest the whole has some that its load does not shake.
    """
    whole, of_whole = pose(write_dovetail(tmp_path, held=(), depth=2 * DEPTH, layers=2, share=2.0, modes=160))
    half, of_half = pose(write_dovetail(tmp_path, held=FACES[:2], modes=160))
    assert (whole.reduction.model.rigid_modes.shape[1], half.reduction.model.rigid_modes.shape[1]) == (6, 3)
    steady = [integrate(problem, steps=400, theta=0.52, tolerance=1e-6) for problem in (of_whole, of_half)]
    assert all(one.converged for one in steady)
    tips = [one.output("tip") for one in steady]
    np.testing.assert_allclose(*tips, rtol=0, atol=2e-5 * np.abs(tips[0]).max())


@pytest.mark.parametrize("held, floating", [((), 6), (("back_blade",), 3), (("back_blade", "front_blade"), 3)])
def test_a_lock_along_the_slot_leaves_the_other_rigid_motions(tmp_path, held, floating):
    """A face that is held along z may move in its plane, and turn there; nothing pulls at the model as it does."""
    chain, _ = pose(write_dovetail(tmp_path, held=held, layers=2, skew=10.0))
    model = chain.reduction.model
    assert model.rigid_modes.shape[1] == floating
    assert np.linalg.matrix_rank(model.rigid_modes) == floating
    assert np.abs(model.stiffness @ model.rigid_modes).max() < 1e-9 * np.abs(model.stiffness).max()
    field = chain.reduction.expand(model.rigid_modes @ np.arange(1.0, floating + 1)).x.array.reshape(-1, 3)
    nodes = chain.structure.space.tabulate_dof_coordinates()
    blade = chain.structure.part == chain.structure.part[chain.interface.nodes_a[0]]
    at = blade & (np.abs(nodes[:, 2]) < 1e-12)
    assert (np.abs(field[at, 2]).max() > 1e-3) == (not held)
    assert np.abs(field[blade, :2]).max() > 0.1
    assert np.abs(field[~blade]).max() < 1e-12


def test_friction_alone_or_a_lock_holds_a_blade_in_a_skewed_slot(tmp_path):
    """Locked it does not move along z on average, and friction need not keep it from it."""
    chain, problem = pose(write_dovetail(tmp_path, held=("back_blade",), layers=2, depth=8e-3, skew=10.0, share=4.0))
    assert not problem.system.laws[0].static_displacement_row
    solution = solve(problem)
    assert solution.converged
    field = chain.reduction.expand(solution.coordinates[0].real).x.array.reshape(-1, 3)
    back = np.abs(chain.structure.space.tabulate_dof_coordinates()[:, 2]) < 1e-12
    blade = chain.structure.part == chain.structure.part[chain.interface.nodes_a[0]]
    assert np.abs(field[back & blade, 2]).max() == 0
    assert np.abs(field[~back & blade, 2]).max() > 0


def test_pictures_tell_along_which_axes_a_boundary_is_held(tmp_path):
    axes, scene = Figure().subplots(), write_dovetail(tmp_path, held=("back_blade",))
    mark_held(axes, scene, {"clamp": np.zeros((2, 2)), "back_blade": np.ones((3, 2))}, size=3)
    told = [(line.get_label(), line.get_marker(), len(line.get_xdata())) for line in axes.lines]
    assert told == [("held: clamp", "^", 2), ("held along z: back_blade", "x", 3)]


def test_supports_that_make_no_sense_are_refused(tmp_path):
    mesh = build_mesh(GEOMETRY / "dovetail.py", {"pairs": 4, "mesh_size": 4e-3}, MPI.COMM_WORLD)
    with pytest.raises(SceneError, match=r'supports.hold.tip = "z": the mesh is 2-D; give one or more of x, y'):
        assemble_structure(mesh, materials=BOTH, hold={"tip": "z"})
    flank = next(name for name in mesh.boundaries if name not in ("tip", "clamp"))
    structure = assemble_structure(mesh, materials=BOTH, hold={flank: "xy"})
    with pytest.raises(InterfaceError, match=rf'flank "{flank}": both nodes at .* held along x and y, and cannot part'):
        pair_interface(structure)


@pytest.mark.parametrize(
    "degrees, message", [(20.0, "x, which is 20 degrees askew to it"), (40.0, "x, and cannot part")]
)
def test_a_straight_flank_that_is_held_askew_is_refused(degrees, message):
    """Its normal was turned without a word; of a curve that meets a plane of symmetry it is, by half of an edge."""
    mesh = build_mesh(BLOCKS, {"inclination": degrees}, MPI.COMM_WORLD)
    structure = assemble_structure(mesh, materials=BOTH, hold={"joint": "x"})
    with pytest.raises(InterfaceError, match=f"are held along {message}.*: a plane of symmetry stands at right angles"):
        pair_interface(structure)


def test_what_supports_along_one_axis_leave_of_a_plane_body():
    """A disk on rollers slides along them, and takes the blade that is bonded to it along."""
    mesh = build_mesh(BLOCKS, {}, MPI.COMM_WORLD)
    structure = assemble_structure(mesh, materials=BOTH, clamp=(), hold={"clamp": "y"})
    reduction = reduce_structure(structure, pair_interface(structure), modes=2)
    assert reduction.model.rigid_modes.shape[1] == 3 + 1
    eigenvalues = reduction.full_stick.frequency**2
    assert abs(eigenvalues[0]) < 1e-9 * eigenvalues[1]


def test_a_held_body_may_have_one_free_node_on_the_flank():
    """As where a support takes in all others of a short flank."""
    structure = assemble_structure(build_mesh(BLOCKS, {}, MPI.COMM_WORLD), materials=BOTH)
    interface = pair_interface(structure)
    contact = list_dofs(np.append(interface.nodes_a, interface.nodes_b[0]), 2).ravel()
    motions = find_rigid_motions(structure, interface, contact)
    assert motions.shape == (len(contact), 3)
    assert not motions[-2:].any()


def test_a_piece_that_supports_let_slide_is_named():
    """A disk without contact, on rollers."""
    mesh = build_mesh(STACKS, {"loose": True, "clamped": 0}, MPI.COMM_WORLD)
    structure = assemble_structure(mesh, materials=dict.fromkeys(mesh.bodies, TITANIUM), clamp=(), hold={"rest": "y"})
    with pytest.raises(ModesError, match='nothing holds "disk", or a piece of it: what is held of it along some axes'):
        reduce_structure(structure, pair_interface(structure), modes=2)
