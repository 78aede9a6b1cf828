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
from ewr_fenicsx.structure.facing import find_body_of_cells


@dataclass(frozen=True)
class Cells:
    """All cells of a mesh, gathered for drawing: each has corners of its own.

    Attributes:
        corners: ``(n_cells, 3 or 4, 2)`` around each cell [m].
        values: ``(n_cells, 3 or 4, 2)`` a vector field at the corners, zero where none was given.
        body: ``(n_cells,)`` tag of each cell's body.
    """

    corners: RealArray
    values: RealArray
    body: np.ndarray

    @property
    def scale(self) -> float:
        """Largest extent of the mesh [m]."""
        return float(np.ptp(self.corners.reshape(-1, 2), axis=0).max())

    def outline(self, displaced: float = 0.0) -> RealArray:
        """Edges that belong to one cell of their body only, ``(n, 2, 2)``, displaced by a multiple of ``values``."""
        starts, ends = self.corners, np.roll(self.corners, -1, axis=1)
        body = np.broadcast_to(self.body[:, None], starts.shape[:2])
        key = np.sort(np.round(np.stack([starts, ends], axis=2) / (1e-9 * self.scale)) @ np.array([1.0, np.pi]), axis=2)
        _, first, count = np.unique(
            np.column_stack([key.reshape(-1, 2), body.ravel()]), axis=0, return_index=True, return_counts=True
        )
        moved = self.corners + displaced * self.values
        return np.stack([moved, np.roll(moved, -1, axis=1)], axis=2).reshape(-1, 2, 2)[first[count == 1]]


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
    """Cells and a displacement field on rank 0, None elsewhere; collective."""
    domain = chain.mesh.domain
    if field is None:
        field = dolfinx.fem.Function(_compat.function_space(domain, "Lagrange", 1, (2,)))
    field = vertex_interpolation(field.function_space)(field)
    owned = np.arange(domain.topology.index_map(2).size_local)
    body = find_body_of_cells(chain.mesh)[owned]
    dofs = _compat.cell_dofs(field.function_space, owned).reshape(owned.size, -1)
    if dofs.shape[1] == 4:
        dofs = dofs[:, [0, 1, 3, 2]]  # from tensor order to going round
    mine = field.function_space.tabulate_dof_coordinates()[dofs, :2], field.x.array.reshape(-1, 2)[dofs], body
    everyone = domain.comm.gather(mine, root=0)
    return None if everyone is None else Cells(*(np.concatenate(part) for part in zip(*everyone, strict=True)))


def measure_thinnest_body(chain: Chain) -> float:
    """Smallest width of a body in any direction, however the scene is turned [m]; collective."""
    space, comm = chain.structure.space, chain.mesh.domain.comm
    nodes = space.tabulate_dof_coordinates()[:, :2]
    widths = []
    for tag in chain.mesh.bodies.values():
        mine = nodes[np.unique(_compat.cell_dofs(space, chain.mesh.cell_tags.find(tag)))]
        widths.append(measure_width(np.concatenate(comm.allgather(mine[_find_hull(mine)]))))
    return min(widths)


def measure_width(points: RealArray) -> float:
    """Smallest extent of points ``(n, 2)`` over all directions [m]: across a side of their convex hull.

    Source: Houle & Toussaint (1988), doi:10.1109/34.6790.
    """
    hull = ConvexHull(points)
    return float(np.ptp(points[hull.vertices] @ hull.equations[:, :2].T, axis=0).min())


def _find_hull(points: RealArray) -> np.ndarray:
    """Numbers of the points that are corners of the convex hull; none of none, as on a rank without the body."""
    return ConvexHull(points).vertices if len(points) else np.empty(0, dtype=np.int32)


def gather_boundary(chain: Chain, name: str) -> RealArray | None:
    """Node positions ``(n, 2)`` of a named boundary on rank 0, None elsewhere; collective."""
    space = chain.structure.space
    nodes = dolfinx.fem.locate_dofs_topological(space, 1, boundary_facets(chain.mesh, name))
    everyone = chain.mesh.domain.comm.gather(space.tabulate_dof_coordinates()[nodes, :2], root=0)
    return None if everyone is None else np.unique(np.concatenate(everyone).round(12), axis=0)
