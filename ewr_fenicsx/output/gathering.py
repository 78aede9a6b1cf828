"""Meshes and fields gathered on rank 0 for drawing, and taken to vertices or nodes for writing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import dolfinx
import numpy as np
from scipy.spatial import ConvexHull

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.boundaries import boundary_facets
from ewr_fenicsx.structure.chain import Chain
from ewr_fenicsx.structure.mesh import JointMesh, find_body_of_cells, find_cells_beside, number_faces

SAME = 1e-10  # distance of corners at one place, over the extent of a mesh, that rounding may leave
SHARP = 35.0  # degrees between two faces, from which the edge between them is part of the outline


@dataclass(frozen=True)
class Cells:
    """What is drawn of a mesh, gathered: the cells of a plane one, the outer faces of a solid's; each has own corners.

    In ``d`` dimensions, 2 or 3.

    Attributes:
        corners: ``(n, 3 or 4, d)`` around each cell or face [m].
        values: ``(n, 3 or 4, d)`` a vector field at the corners, zero where none was given.
        body: ``(n,)`` tag of the body that each belongs to.
    """

    corners: RealArray
    values: RealArray
    body: np.ndarray

    @property
    def scale(self) -> float:
        """Largest extent of the mesh [m]."""
        return float(np.ptp(self.corners.reshape(-1, self.corners.shape[2]), axis=0).max())

    @property
    def normals(self) -> RealArray:
        """Unit normals ``(n, 3)``, on either side: corners go round as the cells of the mesh have them."""
        corners = np.pad(self.corners, ((0, 0), (0, 0), (0, 3 - self.corners.shape[2])))
        normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1])
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def outline(self, displaced: float = 0.0) -> RealArray:
        """Edges where a body ends or, of a solid, turns sharply, ``(n, 2, d)``, displaced by a multiple of ``values``.

        Of the normals beside an edge, turned until both faces go round alike, one stands alone where the body ends, and
        two differ by ``2 sin(angle / 2)``.
        """
        number = self._number_corners()
        keys = np.stack([number, np.roll(number, -1, axis=1)], axis=2)
        body = np.broadcast_to(self.body[:, None], keys.shape[:2])
        _, first, number = np.unique(
            np.column_stack([np.sort(keys, axis=2).reshape(-1, 2), body.ravel()]),
            axis=0,
            return_index=True,
            return_inverse=True,
        )
        there_or_back = np.sign(keys[..., 1] - keys[..., 0])[..., None]
        difference = np.zeros((len(first), 3))
        np.add.at(difference, number.ravel(), (there_or_back * self.normals[:, None]).reshape(-1, 3))
        drawn = np.linalg.norm(difference, axis=1) > 2 * np.sin(np.radians(SHARP) / 2)
        moved = self.corners + displaced * self.values
        edges = np.stack([moved, np.roll(moved, -1, axis=1)], axis=2)
        return edges.reshape(-1, *edges.shape[2:])[first[drawn]]

    def _number_corners(self) -> np.ndarray:
        """One number ``(n, 3 or 4)`` for all corners at one place that move as one: not on two sides of a flank."""
        places = [self._number(places) for places in (self.corners, self.corners + self.values)]
        _, numbers = np.unique(np.column_stack(places), axis=0, return_inverse=True)
        return numbers.reshape(self.corners.shape[:2])

    def _number(self, places: RealArray) -> np.ndarray:
        """A number for each of ``(n, 3 or 4, d)`` places, told apart along a direction that no mesh has."""
        along = places @ np.pi ** np.arange(places.shape[2])
        order = np.argsort(along, axis=None)
        apart = np.diff(along.ravel()[order]) > SAME * self.scale
        numbers = np.empty(along.size, dtype=int)
        numbers[order] = np.concatenate([[0], np.cumsum(apart)])
        return numbers


Interpolation = Callable[[dolfinx.fem.Function], dolfinx.fem.Function]


def vertex_interpolation(space) -> Interpolation:
    """Returns a function that takes fields of ``space`` to the mesh's vertices, which pictures show."""
    return _interpolation(space, 1)


def node_interpolation(space) -> Interpolation:
    """Returns a function that takes fields of ``space`` to all nodes of the mesh's cells, which files hold."""
    return _interpolation(space, space.mesh.geometry.cmap.degree)


def _interpolation(space, degree: int) -> Interpolation:
    if _compat.element_degree(space) == degree:
        return lambda field: field
    shape = (space.dofmap.bs,) if space.dofmap.bs > 1 else ()
    taken = dolfinx.fem.Function(_compat.function_space(space.mesh, "Lagrange", degree, shape))

    def interpolate(field: dolfinx.fem.Function) -> dolfinx.fem.Function:
        taken.interpolate(field)
        return taken

    return interpolate


def gather_cells(chain: Chain, field: dolfinx.fem.Function | None = None) -> Cells | None:
    """Cells, or a solid's outer faces, and a displacement field on rank 0, None elsewhere; collective."""
    mesh, d = chain.mesh, chain.mesh.dimension
    if field is None:
        field = dolfinx.fem.Function(_compat.function_space(mesh.domain, "Lagrange", 1, (d,)))
    field = vertex_interpolation(field.function_space)(field)
    space = field.function_space
    cells, faces, faces_a_cell = _list_drawn(mesh)
    layout = space.dofmap.dof_layout
    corners = np.array([np.sort(layout.entity_closure_dofs(2, k)) for k in range(faces_a_cell)])
    dofs = np.take_along_axis(_compat.cell_dofs(space, cells).reshape(cells.size, -1), corners[faces], axis=1)
    if dofs.shape[1] == 4:
        dofs = dofs[:, [0, 1, 3, 2]]  # from tensor order to going round
    body = find_body_of_cells(mesh)[cells]
    mine = space.tabulate_dof_coordinates()[dofs, :d], field.x.array.reshape(-1, d)[dofs], body
    everyone = mesh.domain.comm.gather(mine, root=0)
    return None if everyone is None else Cells(*(np.concatenate(part) for part in zip(*everyone, strict=True)))


def _list_drawn(mesh: JointMesh) -> tuple[np.ndarray, np.ndarray, int]:
    """This rank's plane cells, or cells beside outer faces; which of a cell's faces each is; how many a cell has."""
    topology = mesh.domain.topology
    if mesh.dimension == 2:
        cells = np.arange(topology.index_map(2).size_local)
        return cells, np.zeros_like(cells), 1
    topology.create_connectivity(2, 3)
    topology.create_connectivity(3, 2)
    outer = dolfinx.mesh.exterior_facet_indices(topology)
    cells = find_cells_beside(mesh, outer)
    return cells, number_faces(mesh, cells, outer), len(topology.connectivity(3, 2).links(0))


def measure_thinnest_body(chain: Chain) -> float:
    """Smallest width of a body, by ``measure_width``, however the scene is turned [m]; collective."""
    space, comm = chain.structure.space, chain.mesh.domain.comm
    nodes = space.tabulate_dof_coordinates()[:, : chain.mesh.dimension]
    widths = []
    for tag in chain.mesh.bodies.values():
        mine = nodes[np.unique(_compat.cell_dofs(space, chain.mesh.cell_tags.find(tag)))]
        widths.append(measure_width(np.concatenate(comm.allgather(mine[_find_hull(mine)]))))
    return min(widths)


def measure_width(points: RealArray) -> float:
    """Smallest extent of points ``(n, d)`` across a side or face of their convex hull [m].

    In a plane no direction has a smaller one. In space one may, across two edges that face each other: by 13 % in a
    regular tetrahedron, not at all in a prism of which neither end is slanted.

    Source: Houle & Toussaint (1988), doi:10.1109/34.6790.
    """
    hull = ConvexHull(points)
    return float(np.ptp(points[hull.vertices] @ hull.equations[:, :-1].T, axis=0).min())


def _find_hull(points: RealArray) -> np.ndarray:
    """Numbers of the points that are corners of the convex hull; none of none, as on a rank without the body."""
    return ConvexHull(points).vertices if len(points) else np.empty(0, dtype=np.int32)


def gather_boundary(chain: Chain, name: str) -> RealArray | None:
    """Node positions ``(n, d)`` of a named boundary on rank 0, None elsewhere; collective."""
    space, d = chain.structure.space, chain.mesh.dimension
    nodes = dolfinx.fem.locate_dofs_topological(space, d - 1, boundary_facets(chain.mesh, name))
    everyone = chain.mesh.domain.comm.gather(space.tabulate_dof_coordinates()[nodes, :d], root=0)
    return None if everyone is None else np.unique(np.concatenate(everyone).round(12), axis=0)
