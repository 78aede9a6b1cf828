"""What every builder promises to the chain, on the meshes themselves: read with gmsh alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gmsh
import numpy as np
import pytest

from ewr_fenicsx.structure.gmsh_inspection import evaluate_scaled_jacobian
from ewr_fenicsx.structure.mesh import load_builder

GEOMETRY = Path(__file__).parents[2] / "geometry"
FIR_TREE, DOVETAIL = GEOMETRY / "fir_tree.py", GEOMETRY / "dovetail.py"
TWO_LOBES = {"top_left", "top_right", "bottom_left", "bottom_right"}

VARIANTS = [
    (FIR_TREE, {}),
    (FIR_TREE, {"lobes": 1}),
    (FIR_TREE, {"lobes": 3, "bottom_neck_width": 9.0e-3}),
    (FIR_TREE, {"flank_angle": 30.0}),
    (FIR_TREE, {"flank_angle": 60.0, "underside_angle": 40.0}),
    (FIR_TREE, {"clearance": 0.1e-3, "fillet": 0.8e-3}),
    (FIR_TREE, {"clearance": 0.6e-3, "pairs": 5}),
    (FIR_TREE, {"pairs": 20, "mesh_size": 0.7e-3}),
    (DOVETAIL, {}),
    (DOVETAIL, {"flank_angle": 35.0, "pairs": 12}),
]


@dataclass(frozen=True)
class Plane:
    """A meshed sector: coordinates (n, 2), cells (m, 4) of each body, edges (k, 2) of each group and body."""

    points: np.ndarray
    cells: dict[str, np.ndarray]
    edges: dict[str, dict[str, np.ndarray]]

    def outline(self, body: str) -> np.ndarray:
        """Edges of one cell only, ``(k, 2)``, turned so that the body lies on their left."""
        cells = self.cells[body]
        edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
        _, where, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
        return edges[where[count == 1]]


def mesh_plane(path: Path, parameters: dict) -> Plane:
    gmsh.initialize(["", "-nopopup"], False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("test")
        with load_builder(path) as builder:
            builder.build(**parameters)
        gmsh.model.mesh.renumberNodes()
        tags, positions, _ = gmsh.model.mesh.getNodes()
        points = np.empty((len(tags), 2))
        points[tags.astype(int) - 1] = positions.reshape(-1, 3)[:, :2]
        groups = {d: {gmsh.model.getPhysicalName(d, n): n for _, n in gmsh.model.getPhysicalGroups(d)} for d in (1, 2)}
        cells = {}
        for name, number in groups[2].items():
            found = []
            for entity in gmsh.model.getEntitiesForPhysicalGroup(2, number):
                kinds, _, nodes = gmsh.model.mesh.getElements(2, entity)
                assert list(kinds) == [3], f"{name}: element types {kinds}, expected 4-node quadrilaterals only"
                found.append(nodes[0].reshape(-1, 4).astype(int) - 1)
            cells[name] = np.concatenate(found)
        edges = {}
        for name, number in groups[1].items():
            nodes = np.concatenate(
                [
                    gmsh.model.mesh.getElements(1, entity)[2][0].reshape(-1, 2).astype(int) - 1
                    for entity in gmsh.model.getEntitiesForPhysicalGroup(1, number)
                ]
            )
            edges[name] = {body: nodes[np.isin(nodes, cells[body]).all(axis=1)] for body in cells}
        return Plane(points, cells, edges)
    finally:
        gmsh.finalize()


@pytest.fixture(scope="module", params=VARIANTS, ids=lambda v: f"{v[0].stem}-{v[1]}")
def plane(request) -> Plane:
    return mesh_plane(*request.param)


@pytest.fixture(scope="module")
def default() -> Plane:
    return mesh_plane(FIR_TREE, {})


def flanks(plane: Plane) -> dict[str, dict[str, np.ndarray]]:
    return {name: sides for name, sides in plane.edges.items() if name not in ("clamp", "tip")}


def along(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Numbers of the nodes of a flank, in the order of their x coordinate (a flank is never vertical)."""
    nodes = np.unique(edges)
    return nodes[np.argsort(points[nodes, 0])]


def test_default_fir_tree_has_the_size_of_the_paper_s_model(default):
    used = np.unique(np.concatenate([cells.ravel() for cells in default.cells.values()]))
    assert 2050 <= len(used) <= 2150
    assert len(used) == len(default.points), "nodes without a cell"
    assert set(flanks(default)) == TWO_LOBES
    assert sum(len(along(default.points, sides["blade"])) for sides in flanks(default).values()) == 40


def test_cells_are_well_shaped_and_counted_counter_clockwise(plane):
    for body, cells in plane.cells.items():
        corners = plane.points[cells]
        assert evaluate_scaled_jacobian(corners, "quadrilateral").min() > 0.35, body
        diagonals = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
        assert (np.cross(*diagonals) > 0).all(), body


@pytest.mark.parametrize(
    "path, parameters, pairs",
    [
        (FIR_TREE, {}, 10),
        (FIR_TREE, {"pairs": 2}, 2),
        (FIR_TREE, {"pairs": 7, "lobes": 3}, 7),
        (DOVETAIL, {"pairs": 9}, 9),
    ],
)
def test_number_of_pairs_is_the_parameter_on_both_sides(path, parameters, pairs):
    plane = mesh_plane(path, parameters)
    for name, sides in flanks(plane).items():
        assert {body: len(np.unique(edges)) for body, edges in sides.items()} == {"blade": pairs, "disk": pairs}, name


def test_pairs_coincide_are_distinct_and_equally_spaced(plane):
    for name, sides in flanks(plane).items():
        a, b = (along(plane.points, sides[body]) for body in ("blade", "disk"))
        assert not set(a) & set(b), f"{name}: the bodies are welded"
        length = np.linalg.norm(plane.points[a[-1]] - plane.points[a[0]])
        np.testing.assert_allclose(plane.points[a], plane.points[b], atol=1e-12 * length, rtol=0)
        steps = np.linalg.norm(np.diff(plane.points[a], axis=0), axis=1)
        np.testing.assert_allclose(steps, length / len(steps), rtol=1e-9)


def test_flanks_carry_the_outward_pull_of_the_blade(plane):
    """The blade's outward normal points up and towards the disk, whose cells lie just beyond."""
    for name, sides in flanks(plane).items():
        normals = {}
        for body, edges in sides.items():
            for edge in edges:
                (cell,) = plane.cells[body][np.isin(plane.cells[body], edge).sum(axis=1) == 2]
                start, end = plane.points[edge]
                normal = np.array([end[1] - start[1], start[0] - end[0]]) / np.linalg.norm(end - start)
                normal *= np.sign(normal @ ((start + end) / 2 - plane.points[cell].mean(axis=0)))
                normals.setdefault(body, []).append(normal)
        blade, disk = np.array(normals["blade"]), np.array(normals["disk"])
        assert (blade[:, 1] > 0.2).all(), f"{name}: the blade pulled up would leave the disk"
        assert (blade[:, 0] * (-1 if name.endswith("left") else 1) > 0.2).all(), name
        np.testing.assert_allclose(disk.mean(axis=0), -blade.mean(axis=0), atol=1e-9)


@pytest.mark.parametrize("angle", [30.0, 45.0, 60.0])
def test_flank_angle_and_length_are_the_parameters(angle):
    plane = mesh_plane(FIR_TREE, {"flank_angle": angle, "flank_length": 4.0e-3})
    for name, sides in flanks(plane).items():
        nodes = along(plane.points, sides["blade"])
        run = plane.points[nodes[-1]] - plane.points[nodes[0]]
        assert np.hypot(*run) == pytest.approx(4.0e-3, rel=1e-9)
        assert np.degrees(np.arctan2(abs(run[1]), abs(run[0]))) == pytest.approx(angle, rel=1e-9), name


@pytest.mark.parametrize("path, parameters", [variant for variant in VARIANTS if variant[0] == FIR_TREE])
def test_bodies_touch_on_the_flanks_only(path, parameters):
    """Points on the blade's other edges lie outside the disk; away from the ends of the flanks by the clearance."""
    plane = mesh_plane(path, parameters)
    clearance, fillet = parameters.get("clearance", 0.3e-3), parameters.get("fillet", 1.2e-3)
    contact = {tuple(sorted(edge)) for sides in flanks(plane).values() for edge in sides["blade"]}
    edges = np.array([edge for edge in plane.outline("blade") if tuple(sorted(edge)) not in contact])
    share = np.linspace(0.05, 0.95, 10)[:, None, None]
    start, end = plane.points[edges[:, 0]], plane.points[edges[:, 1]]
    points = ((1 - share) * start + share * end).reshape(-1, 2)
    walls = plane.points[plane.outline("disk")]
    assert not is_inside(points, walls).any()
    distance = distance_to(points, walls)
    assert distance.min() > 0
    sides = [along(plane.points, sides["blade"]) for sides in flanks(plane).values()]
    ends = plane.points[[nodes[end] for nodes in sides for end in (0, -1)]]
    away = np.linalg.norm(points[:, None] - ends, axis=2).min(axis=1) > 2 * fillet
    assert distance[away].min() > 0.5 * clearance
    lower = np.isclose(points[:, 1], plane.points[plane.cells["blade"], 1].min())
    assert distance[lower].min() > clearance


def test_underside_clearance_is_the_parameter(default):
    """Halfway down the underside of the upper lobe, the disk is one clearance away."""
    nodes = np.unique(default.outline("blade"))
    x, y = default.points[nodes].T
    upper, lower = (default.points[default.edges[name]["blade"].ravel()] for name in ("top_right", "bottom_right"))
    underside = nodes[(x > 0) & (y < upper[:, 1].min() - 2.5e-3) & (y > lower[:, 1].max() + 2.5e-3)]
    assert len(underside) >= 2
    distance = distance_to(default.points[underside], default.points[default.outline("disk")])
    np.testing.assert_allclose(distance, 0.3e-3, rtol=1e-6)


def is_inside(points: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Even-odd rule: a ray towards +x crosses the closed outline ``walls`` (k, 2 ends, 2) an odd number of times."""
    (x0, y0), (x1, y1) = walls[:, 0].T, walls[:, 1].T
    x, y = points[:, :1], points[:, 1:]
    spans = (y0 > y) != (y1 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    return np.count_nonzero(spans & (crossing > x), axis=1) % 2 == 1


def distance_to(points: np.ndarray, walls: np.ndarray) -> np.ndarray:
    start, run = walls[:, 0], walls[:, 1] - walls[:, 0]
    share = np.clip(((points[:, None] - start) * run).sum(axis=2) / (run**2).sum(axis=1), 0, 1)
    return np.linalg.norm(points[:, None] - start - share[..., None] * run, axis=2).min(axis=1)


def test_sector_is_symmetric_and_stands_on_the_engine_s_axis(default):
    mirrored = default.points * [-1, 1]
    gap = np.linalg.norm(mirrored[:, None] - default.points, axis=2).min(axis=1)
    assert gap.max() < 1e-9
    clamp = default.points[np.unique(default.edges["clamp"]["disk"])]
    assert len(default.edges["clamp"]["blade"]) == 0
    hub = np.isclose(np.linalg.norm(clamp, axis=1), 135.0e-3, rtol=1e-9)
    cut = np.isclose(np.abs(np.degrees(np.arctan2(clamp[:, 0], clamp[:, 1]))), 6.0, rtol=1e-9)
    assert (hub | cut).all() and hub.sum() > 5 and cut.sum() > 20
    tip = default.points[np.unique(default.edges["tip"]["blade"])]
    assert np.ptp(tip[:, 0]) == pytest.approx(5.0e-3) and np.ptp(tip[:, 1]) < 1e-12
    assert tip[0, 1] == default.points[:, 1].max()


@pytest.mark.parametrize(
    "lobes, names",
    [(1, {"left", "right"}), (2, TWO_LOBES), (3, {f"lobe{k}_{hand}" for k in (1, 2, 3) for hand in ("left", "right")})],
)
def test_flanks_are_named_after_the_lobes(lobes, names):
    assert set(flanks(mesh_plane(FIR_TREE, {"lobes": lobes}))) == names


def test_same_parameters_give_the_same_mesh(default):
    again = mesh_plane(FIR_TREE, {})
    np.testing.assert_array_equal(again.points, default.points)
    np.testing.assert_array_equal(again.cells["blade"], default.cells["blade"])


@pytest.mark.parametrize(
    "path, parameters, words",
    [
        (FIR_TREE, {"blade_height": -1.0}, "blade_height = -1.0: expected a positive number"),
        (FIR_TREE, {"lobes": 0}, "lobes = 0"),
        (FIR_TREE, {"clearance": 0.0}, "clearance = 0.0"),
        (FIR_TREE, {"flank_angle": 5.0}, "flank_angle = 5.0: expected degrees"),
        (FIR_TREE, {"pairs": 1}, "pairs = 1: expected at least 2"),
        (FIR_TREE, {"flank_length": 15.0e-3}, "leaves the sector"),
        (FIR_TREE, {"fillet": 8.0e-3}, "fillet"),
        (FIR_TREE, {"bottom_neck_width": 60.0e-3}, "turns back|leaves the sector"),
        (FIR_TREE, {"root_bottom_width": 1.0e-3}, "bottom_fillet"),
        (FIR_TREE, {"hub_radius": 0.17}, "hub_radius = 0.17: expected less than"),
        (FIR_TREE, {"platform_width": 0.1}, "platform_width = 0.1: expected"),
        (DOVETAIL, {"disk_width": 0.02}, "disk_width = 0.02: expected more than"),
        (DOVETAIL, {"clearance": -1e-4}, "clearance = -0.0001"),
        (DOVETAIL, {"disk_height": 0.005}, "disk_height = 0.005"),
    ],
)
def test_impossible_parameters_are_refused_by_name(path, parameters, words):
    with pytest.raises(ValueError, match=words):
        mesh_plane(path, parameters)
