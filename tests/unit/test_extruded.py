"""Solids drawn out of plane profiles: read with gmsh alone, and as the chain takes them."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import gmsh
import numpy as np
import pytest
from mesh_counts import count
from mpi4py import MPI

from ewr_fenicsx.errors import MeshError
from ewr_fenicsx.structure.mesh import build_mesh, load_builder

GEOMETRY = Path(__file__).parents[2] / "geometry"
EXTRUDED = GEOMETRY / "extruded.py"
FLANKS = {
    "fir_tree": ["top_left", "top_right", "bottom_left", "bottom_right"],
    "dovetail": ["left", "right"],
    "two_blocks": ["seat"],
    "lap_joint": ["lap"],
    "platform_damper": ["left", "right"],
    "end_contact": ["face"],
    "damped_ring": ["near"],
    "shrouded_ring": [],  # between sectors alone
}
PAIRS = {
    "fir_tree": 10,
    "dovetail": 8,
    "two_blocks": 9,
    "lap_joint": 26,
    "platform_damper": 8,
    "end_contact": 5,
    "damped_ring": 8,
    "shrouded_ring": 0,
}
TETRAHEDRA = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]  # of a hexahedron

# Two squares with a wall each, the second drawn clockwise.
SQUARES = """
import gmsh
from outlines import MINE


def build(*, cells: int = 2, size: float = 1.0, label: str = "wall", coarse: bool = False) -> None:
    geo, walls, surfaces = gmsh.model.geo, [], []
    for left, turn in ((0.0, 1), (2.0, -1)):
        points = [geo.addPoint(left + x * size, y, 0.0) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))][::turn]
        curves = [geo.addLine(points[k], points[(k + 1) % 4]) for k in range(4)]
        surfaces.append(geo.addPlaneSurface([geo.addCurveLoop(curves)]))
        walls.append(curves[0])
        for curve in curves:
            geo.mesh.setTransfiniteCurve(curve, cells + 1)
        geo.mesh.setTransfiniteSurface(surfaces[-1])
        {recombine}
    geo.synchronize()
    groups = [(2, [surfaces[0]], "a"), (2, [surfaces[1]], "b"), (1, walls, label)]
    for dimension, members, name in groups:
        gmsh.model.setPhysicalName(dimension, gmsh.model.addPhysicalGroup(dimension, members), name)
    {mesh}
"""


@dataclass(frozen=True)
class Model:
    """Points ``(n, 3)``; of the cells of each body and the facets of each boundary, the nodes, counted from 0."""

    points: np.ndarray
    bodies: dict[str, np.ndarray]
    boundaries: dict[str, np.ndarray]

    def volumes(self) -> dict[str, np.ndarray]:
        """Signed, of every hexahedron."""
        volumes = {}
        for name, cells in self.bodies.items():
            corners = self.points[cells][:, TETRAHEDRA]
            volumes[name] = np.linalg.det(corners[:, :, 1:] - corners[:, :, :1]).sum(axis=1) / 6
        return volumes

    def areas(self) -> dict[str, float]:
        """Of the bodies of a plane model."""
        x, y = self.points[:, 0], self.points[:, 1]
        turn = lambda a, b: x[a] * y[b] - x[b] * y[a]  # noqa: E731
        areas = {}
        for name, cells in self.bodies.items():
            areas[name] = float(np.abs(sum(turn(cells[:, k - 1], cells[:, k]) for k in range(4))).sum() / 2)
        return areas


def make(source: Path, parameters: dict, dimension: int = 3) -> Model:
    """Run a builder beside another model, which it must leave alone, and read what it made."""
    gmsh.initialize(["", "-nopopup"], False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("beside")
        gmsh.model.geo.addPoint(1.0, 2.0, 3.0)
        gmsh.model.geo.synchronize()
        gmsh.model.add("test")
        models = sorted(gmsh.model.list())
        with load_builder(source) as builder:
            builder.build(**parameters)
        assert gmsh.model.getCurrent() == "test" and sorted(gmsh.model.list()) == models
        assert {d for d, _ in gmsh.model.getPhysicalGroups()} == {dimension, dimension - 1}
        gmsh.model.mesh.renumberNodes()
        tags, positions, _ = gmsh.model.mesh.getNodes()
        points = np.empty((len(tags), 3))
        points[tags.astype(int) - 1] = positions.reshape(-1, 3)
        found = Model(points, read_groups(dimension), read_groups(dimension - 1))
        used = np.unique(np.concatenate([cells.ravel() for cells in found.bodies.values()]))
        assert len(used) == len(points), "nodes without a cell"
        gmsh.model.setCurrent("beside")
        assert gmsh.model.getEntities() == [(0, 1)]
        return found
    finally:
        gmsh.finalize()


def read_groups(dimension: int) -> dict[str, np.ndarray]:
    groups = {}
    for _, number in gmsh.model.getPhysicalGroups(dimension):
        nodes = [
            gmsh.model.mesh.getElements(dimension, entity)[2][0].reshape(-1, 2**dimension)
            for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, number)
        ]
        groups[gmsh.model.getPhysicalName(dimension, number)] = np.concatenate(nodes).astype(int) - 1
    return groups


@pytest.fixture(scope="module", params=FLANKS)
def profile(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def plane(profile) -> Model:
    return make(GEOMETRY / f"{profile}.py", {}, dimension=2)


@pytest.fixture(scope="module", params=[0.0, -20.0], ids=["straight", "skewed"])
def solid(profile, request) -> Model:
    return make(EXTRUDED, {"profile": profile, "depth": 0.03, "layers": 4, "skew": request.param})


def test_every_builder_of_a_plane_is_a_profile_here():
    plane = {path.stem for path in GEOMETRY.glob("*.py") if "def build(" in path.read_text()}
    assert plane - {"extruded", "twisted_blade"} == set(FLANKS)


def test_volumes_are_areas_times_depth_skewed_or_not(plane, solid):
    for body, volumes in solid.volumes().items():
        assert volumes.min() > 0, f"{body}: an inverted cell"
        assert volumes.sum() == pytest.approx(0.03 * plane.areas()[body], rel=1e-10)


def test_names_are_those_of_the_profile_and_of_the_ends(plane, solid):
    ends = {f"{end}_{body}" for body in plane.bodies for end in ("front", "back")}
    assert set(solid.bodies) == set(plane.bodies)
    assert set(solid.boundaries) == set(plane.boundaries) | ends
    for name, edges in plane.boundaries.items():
        assert len(solid.boundaries[name]) == 4 * len(edges), name
    for body, cells in plane.bodies.items():
        assert len(solid.bodies[body]) == 4 * len(cells)
        for end, z in (("front", 0.03), ("back", 0.0)):
            faces = solid.boundaries[f"{end}_{body}"]
            assert len(faces) == len(cells) and np.isin(faces, solid.bodies[body]).all()
            assert np.ptp(solid.points[faces][..., 2]) == 0 and solid.points[faces[0, 0], 2] == pytest.approx(z)


def test_every_face_of_a_boundary_is_one_of_exactly_one_cell(solid):
    sides = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    of_cells = np.concatenate([cells[:, sides].reshape(-1, 4) for cells in solid.bodies.values()])
    faces, times = np.unique(begin_with_least(of_cells), axis=0, return_counts=True)
    outside = {tuple(face) for face in faces[times == 1]}
    named = [tuple(face) for faces in solid.boundaries.values() for face in begin_with_least(faces)]
    assert len(set(named)) == len(named) and set(named) <= outside
    assert times.max() == 2 and len(outside) < len(faces), "within a body cells share their faces"


def begin_with_least(faces: np.ndarray) -> np.ndarray:
    """The same faces, each from its least node on round towards the lesser neighbour of that."""
    faces = np.array([np.roll(face, -face.argmin()) for face in faces])
    return np.where(faces[:, [1]] < faces[:, [3]], faces, faces[:, [0, 3, 2, 1]])


def test_nodes_of_flanks_coincide_and_are_distinct(profile, solid):
    for name in FLANKS[profile]:
        nodes = np.unique(solid.boundaries[name])
        one, other = (nodes[np.isin(nodes, cells)] for cells in solid.bodies.values())
        assert not set(one) & set(other), f"{name}: the bodies are welded"
        assert len(one) == len(other) == PAIRS[profile] * 5, name
        distance = np.linalg.norm(solid.points[one][:, None] - solid.points[other], axis=2)
        assert max(distance.min(axis=0).max(), distance.min(axis=1).max()) < 1e-12 * distance.max(), name
        assert np.unique(distance.argmin(axis=1)).size == len(one), name


@pytest.mark.parametrize("skew", [0.0, 15.0, -59.0])
def test_skew_moves_the_layers_along_x(plane, profile, skew):
    solid = make(EXTRUDED, {"profile": profile, "depth": 6e-3, "layers": 2, "skew": skew})
    flat = solid.points - solid.points[:, 2:] * [np.tan(np.radians(skew)), 0.0, 1.0]
    layer = np.round(solid.points[:, 2] / 3e-3).astype(int)
    np.testing.assert_allclose(solid.points[:, 2], layer * 3e-3, atol=1e-15)
    for k in range(3):
        there = flat[layer == k]
        assert len(there) == len(plane.points)
        sort = lambda points: points[np.lexsort(np.round(points[:, :2], 10).T)]  # noqa: E731
        np.testing.assert_allclose(sort(there)[:, :2], sort(plane.points)[:, :2], atol=1e-12)


def test_the_chain_takes_it(profile):
    mesh = build_mesh(EXTRUDED, {"profile": profile, "layers": 2, "skew": 10.0}, MPI.COMM_SELF)
    plane = count(build_mesh(GEOMETRY / f"{profile}.py", {}, MPI.COMM_SELF))
    found = count(mesh)
    assert mesh.domain.topology.dim == 3 and mesh.smallest_scaled_jacobian > 0.3
    assert (found["nodes"], found["cells"]) == (3 * plane["nodes"], 2 * plane["cells"])
    assert found["bodies"] == {body: 2 * cells for body, cells in plane["bodies"].items()}
    ends = {f"{end}_{body}": cells for body, cells in plane["bodies"].items() for end in ("front", "back")}
    assert found["boundaries"] == {name: 2 * edges for name, edges in plane["boundaries"].items()} | ends


def write_squares(
    folder: Path, recombine: str = "geo.mesh.setRecombine(2, surfaces[-1])", mesh: str = "gmsh.model.mesh.generate(2)"
) -> str:
    (folder / "outlines.py").write_text("MINE = True\n")
    path = folder / "squares.py"
    path.write_text(SQUARES.format(recombine=recombine, mesh=mesh))
    return str(path)


def test_a_profile_of_one_s_own_is_given_by_its_path(tmp_path):
    """Its second square is drawn clockwise; files beside it come before those beside ``extruded.py``."""
    solid = make(EXTRUDED, {"profile": write_squares(tmp_path), "depth": 2.0, "layers": 3, "cells": 4, "size": 1})
    assert "outlines" not in sys.modules
    for volumes in solid.volumes().values():
        np.testing.assert_allclose(volumes, 2.0 / 3 / 16, rtol=1e-9)


def test_parameters_reach_the_profile():
    given = {"profile": "two_blocks", "depth": 0.01, "layers": 1, "pairs": 5, "width": 0.02, "mesh_size": 0.01}
    solid = make(EXTRUDED, given)
    assert len(solid.boundaries["seat"]) == 2 * 4
    assert np.ptp(solid.points[solid.boundaries["top"]][..., 0]) == pytest.approx(0.02)


@pytest.mark.parametrize(
    "parameters, words",
    [
        ({"depth": 0.0}, "depth = 0.0: expected a positive number"),
        ({"depth": float("nan")}, "depth = nan: expected a positive number"),
        ({"layers": 0}, "layers = 0: expected at least 1"),
        ({"skew": 60.0}, "skew = 60.0: expected degrees"),
        ({"skew": float("nan")}, "skew = nan: expected degrees"),
        ({"profile": "dovetial"}, r'profile = "dovetial": no builder .*; did you mean "dovetail"\?'),
        (
            {"profile": "zzz"},
            "known are damped_ring, dovetail, end_contact, fir_tree, lap_joint, platform_damper, shrouded_ring, "
            "two_blocks, and",
        ),
        ({"profile": "/nowhere/mine.py"}, "no builder /nowhere/mine.py; known are"),
        ({"profile": "blocks"}, 'profile = "blocks": no function `build`'),
        ({"profile": "extruded"}, 'profile = "extruded": it has a parameter depth, a name that is taken here'),
        ({"lobes": 2}, r'unknown parameter "lobes" = 2, also of profile "dovetail"; did you mean "layers"\?'),
        ({"layer": 2}, r'unknown parameter "layer" = 2, .*; did you mean "layers"\?'),
        (
            {"viscosity": 2},
            r'unknown parameter "viscosity" = 2, .*; known are profile, depth, layers, skew, flank_angle',
        ),
        ({"pairs": 3.0}, "parameter pairs = 3.0 of .*: expected a whole number"),
        ({"pairs": True}, "parameter pairs = True of .*: expected a whole number"),
        ({"clearance": "1e-3"}, "parameter clearance = '1e-3' of .*: expected a finite number"),
        ({"clearance": float("inf")}, "parameter clearance = inf of .*: expected a finite number"),
        ({"clearance": -1e-3}, "clearance = -0.001: expected a positive number"),
    ],
)
def test_impossible_parameters_are_refused_by_name(parameters, words):
    with pytest.raises(ValueError, match=words):
        make(EXTRUDED, parameters)


@pytest.mark.parametrize(
    "changes, parameters, words",
    [
        ({"recombine": "pass"}, {}, "cells of type Triangle 3; expected quadrilaterals of first order: .*setRecombine"),
        ({"mesh": "gmsh.model.mesh.generate(2); gmsh.model.mesh.setOrder(2)"}, {}, "Quadrilateral 9; .*ElementOrder"),
        ({"mesh": "gmsh.model.remove(); gmsh.model.add('test')"}, {}, "expected a builder of a plane mesh"),
        ({"mesh": "pass"}, {}, "does the builder call gmsh.model.mesh.generate"),
        ({}, {"label": "front_b"}, 'its group "front_b" has the name of an end face of the solid; rename it'),
        ({}, {"label": 3}, "parameter label = 3 of .*: expected text"),
        ({}, {"coarse": 1}, "parameter coarse = 1 of .*: expected true or false"),
        ({"mesh": "gmsh.model.mesh.generate(2); gmsh.model.removePhysicalGroups([(2, 1)])"}, {}, "belong to no body"),
    ],
)
def test_profiles_that_cannot_be_drawn_out_are_refused(tmp_path, changes, parameters, words):
    with pytest.raises(MeshError, match=words):
        build_mesh(EXTRUDED, {"profile": write_squares(tmp_path, **changes), **parameters}, MPI.COMM_SELF)
