"""Edges of two bodies at the same place, face to face, as on the flanks of a joint."""

from __future__ import annotations

import dolfinx
import numpy as np
from scipy.spatial import cKDTree

from ewr_fenicsx.mesh import JointMesh


def find_facing_bodies(mesh: JointMesh, facets: np.ndarray) -> tuple[str, ...]:
    """Names of two bodies that have exterior facets, given by each rank's own, at the same place; else none."""
    domain = mesh.domain
    cells_of, cells = domain.topology.connectivity(1, 2), domain.topology.index_map(2)
    tags = np.zeros(cells.size_local + cells.num_ghosts, dtype=np.int32)
    tags[mesh.cell_tags.indices] = mesh.cell_tags.values
    beside = np.array([cells_of.links(f)[0] for f in facets], dtype=np.int32)
    middle = dolfinx.mesh.compute_midpoints(domain, 1, facets)
    outward = middle - dolfinx.mesh.compute_midpoints(domain, 2, beside)
    everyone = domain.comm.allgather((tags[beside], middle, outward))
    body, middle, outward = (np.concatenate(part) for part in zip(*everyone, strict=True))
    depth = np.linalg.norm(outward, axis=1)
    for tag in np.unique(body)[1:]:
        mine, others = np.flatnonzero(body == tag), np.flatnonzero(body < tag)
        distance, partner = cKDTree(middle[others]).query(middle[mine])
        there = others[partner]
        opposed = np.sum(outward[mine] * outward[there], axis=1) < -0.5 * depth[mine] * depth[there]
        if np.any(meet := opposed & (distance < depth[mine])):  # also across a gap that the mesh has
            return tuple(name for name, known in mesh.bodies.items() if known in (tag, body[there[meet][0]]))
    return ()
