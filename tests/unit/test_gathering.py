"""What is gathered of meshes: faces to draw, boundaries, and how thin a body is, whichever way the scene is turned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import dolfinx
import numpy as np
import pytest
import ufl
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI
from petsc4py import PETSc
from small_scenes import write_blocks

from ewr_fenicsx import load_scene
from ewr_fenicsx.output.gathering import Cells, gather_boundary, gather_cells, measure_thinnest_body, measure_width
from ewr_fenicsx.output.pair_fields import spread_over_interface
from ewr_fenicsx.structure._compat import compile_form, function_space
from ewr_fenicsx.structure.chain import build_chain
from ewr_fenicsx.structure.elasticity import assemble_structure
from ewr_fenicsx.structure.interface import pair_interface
from ewr_fenicsx.structure.materials import TITANIUM
from ewr_fenicsx.structure.mesh import build_mesh

EXTRUDED = Path(__file__).parents[2] / "geometry" / "extruded.py"
DOVETAIL = {"profile": "dovetail", "pairs": 4, "layers": 3, "mesh_size": 4e-3}
BLOCKS_OF_TETRAHEDRA = Path(__file__).parents[1] / "geometry" / "tetrahedra.py"
TETRAHEDRA = """
import gmsh

def build():
    gmsh.model.occ.addBox(0, 0, 0, 0.03, 0.02, 0.01)
    gmsh.model.occ.synchronize()
    gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [1], 7), "block")
    gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [5], 3), "back")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.006)
    gmsh.model.mesh.generate(3)
"""


@pytest.mark.parametrize("inclination", [0.0, 45.0, 63.7])
def test_the_thinnest_body_is_as_thin_however_the_scene_is_turned(tmp_path, inclination):
    """Blocks of 40 mm by 30 and 6 mm; a box along the axes was 33 mm wide at 45 degrees."""
    turned = f"inclination = {inclination}, disk_height = 0.006"
    (tmp_path / "scene.toml").write_text(write_blocks(parameters=turned))
    chain = build_chain(load_scene(tmp_path / "scene.toml", warn=False))
    assert measure_thinnest_body(chain) == pytest.approx(0.006, rel=1e-9)


@given(st.floats(0, 360), st.floats(0.01, 1.0), st.integers(0, 100))
def test_the_width_is_the_smallest_extent_of_all_directions(degrees, aspect, seed):
    """Of points in a rectangle none is smaller, and one direction has it."""
    turn = np.radians(degrees)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    points = (np.random.default_rng(seed).random((30, 2)) * [1.0, aspect]) @ axes
    angle = np.radians(np.linspace(0, 180, 3601))
    extents = np.ptp(points @ np.array([np.cos(angle), np.sin(angle)]), axis=0)
    width = measure_width(points)
    assert width <= extents.min() * (1 + 1e-12)
    assert width == pytest.approx(extents.min(), abs=np.radians(0.025) * 2)


def measure_areas(corners: np.ndarray) -> np.ndarray:
    """Of triangles and plane quadrilaterals ``(n, 3 or 4, 3)``: those of bow ties would be too small."""
    parts = [np.cross(corners[:, k] - corners[:, 0], corners[:, k + 1] - corners[:, 0])
             for k in range(1, corners.shape[1] - 1)]  # fmt: skip
    return np.linalg.norm(np.sum(parts, axis=0), axis=1) / 2


@pytest.fixture(params=["hexahedra", "tetrahedra"])
def solid(request, tmp_path):
    """What gathering needs of a chain, on a solid."""
    source, parameters = EXTRUDED, DOVETAIL
    if request.param == "tetrahedra":
        source, parameters = tmp_path / "box.py", {}
        source.write_text(TETRAHEDRA)
    mesh = build_mesh(source, parameters, MPI.COMM_WORLD)
    return SimpleNamespace(mesh=mesh, structure=SimpleNamespace(space=function_space(mesh.domain, "Lagrange", 1, (3,))))


def test_outer_faces_of_a_solid_are_its_surface(solid):
    cells, domain = gather_cells(solid), solid.mesh.domain
    one = dolfinx.fem.Constant(domain, PETSc.ScalarType(1.0))
    surface = dolfinx.fem.assemble_scalar(compile_form(one * ufl.ds(domain=domain), "the surface"))
    assert measure_areas(cells.corners).sum() == pytest.approx(surface, rel=1e-9)
    assert set(cells.body) == set(solid.mesh.bodies.values())
    assert not cells.values.any()


def test_faces_go_round(solid):
    """Both triangles of a quadrilateral turn alike; they would not in a bow tie."""
    corners = gather_cells(solid).corners
    first = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    second = np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 0])
    assert (np.linalg.norm(first, axis=1) > 0).all()
    assert corners.shape[1] == 3 or (np.sum(first * second, axis=1) > 0).all()


@pytest.mark.parametrize("degree", [1, 2])
def test_faces_have_the_field_of_their_corners(solid, degree):
    field = dolfinx.fem.Function(function_space(solid.mesh.domain, "Lagrange", degree, (3,)))
    field.interpolate(lambda x: np.array([x[0] + 2 * x[1], x[1] - 3 * x[2], x[2] * 5 + 1]))
    cells = gather_cells(solid, field)
    x, y, z = np.moveaxis(cells.corners, 2, 0)
    np.testing.assert_allclose(cells.values, np.stack([x + 2 * y, y - 3 * z, 5 * z + 1], axis=2), atol=1e-12)


def test_the_outline_of_a_solid_is_where_it_turns(tmp_path):
    """A box has twelve edges, and both ends of each are on two of its sides; it moves along."""
    (tmp_path / "box.py").write_text(TETRAHEDRA)
    cells = gather_cells(SimpleNamespace(mesh=build_mesh(tmp_path / "box.py", {}, MPI.COMM_WORLD)))
    sides = np.array([0.03, 0.02, 0.01])
    outline = cells.outline()
    on_sides = (np.abs(outline) < 1e-9) | (np.abs(outline - sides) < 1e-9)
    assert (on_sides.all(axis=1).sum(axis=1) == 2).all()
    lengths = np.linalg.norm(outline[:, 1] - outline[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(4 * sides.sum())
    moved = replace(cells, values=np.ones_like(cells.corners))
    np.testing.assert_allclose(moved.outline(0.5), outline + 0.5)


def test_what_moves_apart_is_outlined_on_both_sides():
    """Two squares of one body that meet, as the shrouds of two sectors do."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners = np.array([square, square + np.array([1.0, 0.0])])
    cells = Cells(corners, np.zeros_like(corners), np.array([1, 1]))
    assert len(cells.outline()) == 6
    apart = np.zeros_like(corners)
    apart[1] = [0.1, 0.0]
    assert len(replace(cells, values=apart).outline()) == len(replace(cells, values=apart).outline(1.0)) == 8


def test_boundaries_of_solids_are_faces(solid):
    name = next(name for name in solid.mesh.boundaries if name.startswith("back"))
    nodes = gather_boundary(solid, name)
    assert nodes.shape[1] == 3 and np.ptp(nodes[:, 2]) < 1e-12 and (np.ptp(nodes[:, :2], axis=0) > 1e-3).all()


def test_the_thinnest_solid_is_as_thin_as_its_depth(solid):
    """Blade and disk are 12 mm deep, and wider elsewhere; the box is 10 mm deep."""
    assert measure_thinnest_body(solid) == pytest.approx(0.012 if "blade" in solid.mesh.bodies else 0.01, rel=1e-9)


def test_across_faces_a_tetrahedron_is_wider_than_across_edges():
    points = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    assert measure_width(points) == pytest.approx(4 / np.sqrt(3)), "2 across two edges"


def test_corners_without_pairs_show_one_pair_on_both_bodies():
    """Of edges as long as each other each body took the one that it met first, and each number of ranks another."""
    mesh = build_mesh(BLOCKS_OF_TETRAHEDRA, {}, MPI.COMM_WORLD)
    structure = assemble_structure(mesh, materials=dict.fromkeys(mesh.bodies, TITANIUM), degree=2)
    interface = pair_interface(structure)
    chain = SimpleNamespace(mesh=mesh, structure=structure, interface=interface)
    field = spread_over_interface(chain, -1.0)(np.arange(len(interface.area)))
    shown = np.flatnonzero(field.x.array > -0.5)
    places = field.function_space.tabulate_dof_coordinates()[shown].round(9)
    _, place, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    assert len(count) == 16 and (count == 2).all()
    for here in range(len(count)):
        assert np.ptp(field.x.array[shown[place == here]]) == pytest.approx(0, abs=1e-9), places[place == here]
