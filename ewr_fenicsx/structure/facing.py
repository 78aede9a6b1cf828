"""Edges or faces of two bodies at the same place, face to face, as on the flanks of a joint."""

from __future__ import annotations

import dolfinx
import numpy as np
from scipy.spatial import cKDTree

from ewr_fenicsx.structure.mesh import JointMesh


def find_facing_bodies(mesh: JointMesh, facets: np.ndarray, piece: np.ndarray | None = None) -> tuple[str, ...]:
    """Names of two bodies that have exterior facets at the same place, face to face; none: ``()``. Collective.

    Args:
        mesh: With its bodies.
        facets: Each rank's own, exterior ones.
        piece: Number of the piece of the mesh that each of them is on, the same on all ranks; facets of one piece do
            not count, and two pieces may be of the same body, whose name is then there twice. None: a body is a piece.
    """
    domain = mesh.domain
    beside = find_cells_beside(mesh, facets)
    tags = find_body_of_cells(mesh)[beside]
    middle = dolfinx.mesh.compute_midpoints(domain, mesh.dimension - 1, facets)
    outward = middle - dolfinx.mesh.compute_midpoints(domain, mesh.dimension, beside)
    everyone = domain.comm.allgather((tags, tags if piece is None else piece, middle, outward))
    body, piece, middle, outward = (np.concatenate(part) for part in zip(*everyone, strict=True))
    depth = np.linalg.norm(outward, axis=1)
    for number in np.unique(piece)[1:]:
        mine, others = np.flatnonzero(piece == number), np.flatnonzero(piece < number)
        distance, partner = cKDTree(middle[others]).query(middle[mine])
        there = others[partner]
        opposed = np.sum(outward[mine] * outward[there], axis=1) < -0.5 * depth[mine] * depth[there]
        if np.any(meet := opposed & (distance < depth[mine])):  # also across a gap that the mesh has
            tags_there = body[mine[meet][0]], body[there[meet][0]]
            return tuple(name for name, tag in mesh.bodies.items() for _ in range(tags_there.count(tag)))
    return ()


def find_body_of_cells(mesh: JointMesh) -> np.ndarray:
    """Tag of the body of every cell that this rank holds, ghosts included, ``(cells,)``."""
    cells = mesh.domain.topology.index_map(mesh.dimension)
    body = np.zeros(cells.size_local + cells.num_ghosts, dtype=np.int32)
    body[mesh.cell_tags.indices] = mesh.cell_tags.values
    return body


def number_faces(mesh: JointMesh, cells: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Which of its cell's own faces each facet is, of the cells beside them."""
    faces_of = mesh.domain.topology.connectivity(mesh.dimension, mesh.dimension - 1)
    found = [np.flatnonzero(faces_of.links(c) == f)[0] for c, f in zip(cells, facets, strict=True)]
    return np.array(found, dtype=np.int64)


def find_cells_beside(mesh: JointMesh, facets: np.ndarray) -> np.ndarray:
    """Local number of the cell beside each exterior facet."""
    cells_of = mesh.domain.topology.connectivity(mesh.dimension - 1, mesh.dimension)
    return np.array([cells_of.links(f)[0] for f in facets], dtype=np.int32)
