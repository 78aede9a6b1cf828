"""Solids against plane bodies: without Poisson's ratio and shaken in its plane, a drawn-out profile is the profile."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from ewr_fenicsx import integrate, load_scene
from ewr_fenicsx.errors import SceneError
from ewr_fenicsx.output.output import write_results
from ewr_fenicsx.solution.contact_state import sample_along_tangents
from ewr_fenicsx.solver.newton import solve
from ewr_fenicsx.structure.boundaries import list_dofs
from ewr_fenicsx.structure.chain import build_chain, pose_problem
from ewr_fenicsx.structure.elasticity import BoundaryForce, CentrifugalForce, assemble_structure
from ewr_fenicsx.structure.materials import TITANIUM
from ewr_fenicsx.structure.mesh import build_mesh

GEOMETRY = Path(__file__).parents[2] / "geometry"
DEPTH = 0.02
SCENE = """
[geometry]
source = "{source}"
[geometry.parameters]
{drawn}
pairs = 4
mesh_size = 15e-3
[materials.upper]
poisson = {poisson}
[materials.lower]
poisson = {poisson}
[contact]
body_a = "upper"
body_b = "lower"
friction = 0.3
[loads.press]
boundary = "top"
force = {press}
[loads.shake]
boundary = "top"
force = {shake}
harmonic = 1
[outputs.top]
boundary = "top"
direction = {along}
[reduction]
modes = {modes}
[excitation]
frequency = 1000.0
[solver]
harmonics = 3
{rest}
"""


def write_scene(folder, solid, modes, shake=(400.0, 0.0, 0.0), poisson=0.0, rest=""):
    d = 3 if solid else 2
    plane = "" if solid else f"[elasticity]\nthickness = {DEPTH}\n"
    text = SCENE.format(
        source=GEOMETRY / ("extruded.py" if solid else "two_blocks.py"),
        drawn=f'profile = "two_blocks"\nlayers = 2\ndepth = {DEPTH}' if solid else "",
        poisson=poisson,
        press=list((0.0, -2000.0, 0.0)[:d]),
        shake=list(shake[:d]),
        along=list((1.0, 0.0, 0.0)[:d]),
        modes=modes,
        rest=plane + rest,
    )
    path = folder / f"{'solid' if solid else 'plane'}.toml"
    path.write_text(text)
    return load_scene(path)


def count_modes(scene):
    """All that there are, with which the reduction is exact."""
    return build_chain(scene).reduction.most_modes


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Chains of the plane bodies and of the solids, with all their modes."""
    folder = tmp_path_factory.mktemp("solids")
    return [
        build_chain(write_scene(folder, solid, count_modes(write_scene(folder, solid, 5)))) for solid in (False, True)
    ]


def test_modes_of_the_plane_are_modes_of_the_solid(pair):
    plane, solid = (chain.reduction.full_stick.frequency for chain in pair)
    assert np.abs(solid - plane[0]).min() < 1e-6 * plane[0]


def test_a_solid_shaken_in_its_plane_moves_as_the_plane_does(pair):
    """Step by step from rest, with sticking, sliding and lift-off; no force and no slip across the plane."""
    steady = [
        integrate(pose_problem(c.scene, c.reduction.model, c.interface), "rest", steps=200, periods=3, tolerance=0)
        for c in pair
    ]
    moved = [state.output_history("top") for state in steady]
    np.testing.assert_allclose(moved[1], moved[0], atol=1e-6 * np.abs(moved[0]).max())
    force = [state.history("normal_force", 200) for state in steady]
    assert (force[0] <= 0).any() and (force[0] > 0).any()
    layers = np.stack([force[1][:, k : k + 4] for k in range(0, 12, 4)])  # a row of pairs a layer, halves at the ends
    np.testing.assert_allclose(layers.sum(axis=0), force[0], atol=1e-5 * force[0].max())
    np.testing.assert_allclose(layers[1], 2 * layers[0], atol=1e-5 * force[0].max())
    slip = sample_along_tangents(steady[1], "slip", 200)
    assert np.ptp(slip[0], axis=0).max() > 1e3 * np.ptp(slip[1], axis=0).max()


def test_a_floating_solid_has_six_rigid_motions(pair):
    chain = pair[1]
    model, contact = chain.reduction.model, chain.reduction.contact_dofs
    assert model.rigid_modes.shape[1] == 6 == np.linalg.matrix_rank(model.rigid_modes)
    twist = model.rigid_modes[: len(contact), 3]  # about z: u_x = -y, u_y = x, on body A alone
    on_a = list_dofs(chain.interface.nodes_a, 3).ravel()
    assert not twist[~np.isin(contact, on_a)].any() and not twist[contact % 3 == 2].any()


def test_frames_are_orthonormal_and_slip_is_that_of_a_against_b(pair):
    interface = pair[1].interface
    frames = np.concatenate([interface.normal[:, None], interface.tangents], axis=1)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (12, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    moved = np.zeros(pair[1].structure.mass.getSize()[0])
    moved[list_dofs(interface.nodes_a, 3)] = (1.0, 2.0, 3.0)
    np.testing.assert_allclose(interface.normal_gap @ moved, -interface.normal @ (1.0, 2.0, 3.0), atol=1e-12)
    along = interface.tangents @ (1.0, 2.0, 3.0)
    np.testing.assert_allclose(interface.tangential_slip @ moved, along.ravel(), atol=1e-12)
    assert interface.area.sum() == pytest.approx(0.04 * DEPTH)


def test_loads_of_solids_have_their_resultants():
    mesh = build_mesh(GEOMETRY / "extruded.py", {"profile": "two_blocks", "depth": DEPTH}, MPI.COMM_WORLD)
    loads = [
        BoundaryForce("push", "top", (3.0, -7.0, 5.0), 1),
        CentrifugalForce("spin", 100.0, (9.0, 0.5, -0.2), (2.0, 0.0, 0.0)),
    ]
    structure = assemble_structure(mesh, materials=dict.fromkeys(mesh.bodies, TITANIUM), loads=loads)
    push, spin = (load.vector.array.reshape(-1, 3).sum(axis=0) for load in structure.loads)
    np.testing.assert_allclose(push, (3.0, -7.0, 5.0))
    masses = TITANIUM.density * DEPTH * np.array([0.04 * 0.06, 0.08 * 0.03])
    outward = np.array([[0.0, y - 0.5, DEPTH / 2 + 0.2] for y in (0.03, -0.015)])  # from the axis along x
    np.testing.assert_allclose(spin, 1e4 * masses @ outward, rtol=1e-9, atol=1e-9)


def test_what_is_written_of_a_solid_tells_of_both_tangents(tmp_path):
    """Shaken along both tangents."""
    scene = write_scene(tmp_path, True, 20, shake=(300.0, 0.0, 150.0), poisson=0.3)
    chain = build_chain(scene)
    solution = solve(pose_problem(scene, chain.reduction.model, chain.interface))
    files = {path.name for path in write_results(tmp_path / "out", chain, solution)}
    assert {"second_slip.xdmf", "second_friction_traction.xdmf", "mesh.png", "full_stick_mode.png"} <= files
    rows = list(csv.DictReader((tmp_path / "out" / "pairs.csv").open()))
    assert [float(row["z [m]"]) for row in rows[::4]] == pytest.approx([0.0, DEPTH / 2, DEPTH])
    assert {float(row["normal_y"]) for row in rows} == {-1.0} and "normal_z" in rows[0]
    forces = {"normal": -1.0, "tangent": 1.0, "second_tangent": 1.0}  # sign of the force on body A along each
    named = {"normal": "normal_force", "tangent": "friction_force", "second_tangent": "second_friction_force"}
    on_a = sum(
        sign * float(row[f"{named[name]}_mean [N]"]) * np.array([float(row[f"{name}_{axis}"]) for axis in "xyz"])
        for row in rows
        for name, sign in forces.items()
    )
    np.testing.assert_allclose(on_a, (0.0, 2000.0, 0.0), atol=1e-6)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["model"]["cells"] == 2 * (3 * 4 + 5 * 2)
    assert max(float(row["second_slip_max [m]"]) - float(row["second_slip_min [m]"]) for row in rows) > 1e-9


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"shake": "[400.0, 0.0]"}, r"loads\.shake\.force = \[400\.0, 0\.0\]: the mesh is 3-D; give 3 components"),
        ({"along": "[1.0, 0.0]"}, r"outputs\.top\.direction = \[1\.0, 0\.0\]: the mesh is 3-D; give 3 components"),
        ({"rest": "[elasticity]\nthickness = 0.01"}, r"elasticity\.thickness: the mesh is of solids.*remove it"),
    ],
)
def test_scenes_of_solids_say_nothing_of_planes(tmp_path, change, told):
    fields = {
        "source": GEOMETRY / "extruded.py", "drawn": 'profile = "two_blocks"\nlayers = 1', "poisson": 0.3,
        "press": "[0.0, -1.0, 0.0]", "shake": "[1.0, 0.0, 0.0]", "along": "[1.0, 0.0, 0.0]", "modes": 5, "rest": "",
    }  # fmt: skip
    (tmp_path / "scene.toml").write_text(SCENE.format(**(fields | change)))
    with pytest.raises(SceneError, match=told):
        build_chain(load_scene(tmp_path / "scene.toml"))


def test_springs_that_solids_do_not_have_are_told(tmp_path):
    chain = build_chain(write_scene(tmp_path, True, 5, rest='closure = "spring"\n'))
    assert [doubt for doubt in chain.doubts if "does nothing: the mesh is of solids" in doubt]
    problem = pose_problem(chain.scene, chain.reduction.model, chain.interface)
    assert not problem.system.closures


def test_a_plane_turns_about_its_normal_only():
    mesh = build_mesh(GEOMETRY / "two_blocks.py", {}, MPI.COMM_WORLD)
    spin = CentrifugalForce("spin", 2 * pi, (0.0, 0.0), (1.0, 0.0, 0.0))
    with pytest.raises(SceneError, match=r"loads\.spin\.axis = .*: a plane turns about an axis normal to it"):
        assemble_structure(mesh, materials=dict.fromkeys(mesh.bodies, TITANIUM), loads=[spin])
    with pytest.raises(SceneError, match=r"axis is .* other than zero"):
        replace(spin, axis=(0.0, 0.0, 0.0))
