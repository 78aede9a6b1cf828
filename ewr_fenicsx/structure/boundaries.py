"""Named boundaries of a mesh: their facets, what faces what there, integrals over them, and the numbers of nodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import dolfinx
import numpy as np
import ufl
from petsc4py import PETSc
from scipy.spatial import cKDTree

from ewr_fenicsx.errors import MeshError, nearest
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.mesh import JointMesh, find_body_of_cells, find_cells_beside, number_faces

_CLOSED = 1e-3  # distance of facets face to face that are one, over that from the middle of the cell beside them
_OF_QUADRILATERALS = (4, 9)  # nodes of their facets, of first and of second order
_NEAREST = 8  # facets among which one that lies on another is looked for
_EDGE = 1e-6  # of a facet's size, by which what lies on its edge may be outside


def boundary_facets(mesh: JointMesh, name: str) -> np.ndarray:
    """Local numbers of a named boundary's facets, ghosts included.

    Raises:
        MeshError: No such boundary, or one without facets.
    """
    facets = mesh.facet_tags.find(find_tag(mesh.boundaries, name, "boundary"))
    if mesh.domain.comm.allreduce(len(facets)) == 0:
        raise MeshError(f'boundary "{name}" has no facet; is it the edge or face of a meshed body?')
    return np.unique(facets).astype(np.int32)


def outer_facets(mesh: JointMesh, what: str, name: str, boundary: str) -> np.ndarray:
    """``boundary_facets`` of a boundary that must be no flank, nor be inside, where no integral over it sees it.

    Args:
        mesh: With its boundaries.
        what: "load" or "output", which is on the boundary.
        name: Of the load or output.
        boundary: Physical name.

    Raises:
        MeshError: As ``boundary_facets``, or such a boundary.
    """
    facets, topology = boundary_facets(mesh, boundary), mesh.domain.topology
    topology.create_connectivity(mesh.dimension - 1, mesh.dimension)
    owned = facets[facets < topology.index_map(mesh.dimension - 1).size_local]
    inside = np.setdiff1d(owned, dolfinx.mesh.exterior_facet_indices(topology))
    counts = [mesh.domain.comm.allreduce(len(f)) for f in (inside, owned)]
    if counts[0]:
        raise MeshError(
            f'boundary "{boundary}": {counts[0]} of its {counts[1]} facets lie inside, with a cell on either '
            f"side; a load or an output needs {'an edge' if mesh.dimension == 2 else 'a face'} of the bodies"
        )
    if bodies := find_facing_bodies(mesh, owned):
        each = "each would carry a part of the load" if what == "load" else "the output would be the mean over both"
        raise MeshError(
            f'{what}s.{name}.boundary = "{boundary}" is a flank: it lies on both bodies, '
            f"{' and '.join(bodies)}, and {each}; name a boundary of one body"
        )
    return facets


def find_facing_bodies(mesh: JointMesh, facets: np.ndarray, piece: np.ndarray | None = None) -> tuple[str, ...]:
    """Names of two bodies that have exterior facets at the same place, face to face; none: ``()``. Collective.

    Args:
        mesh: With its bodies.
        facets: Each rank's own, exterior ones.
        piece: Number of the piece of the mesh that each of them is on, the same on all ranks; facets of one piece do
            not count, and two pieces may be of the same body, whose name is then there twice. None: a body is a piece.
    """
    body, middle, outward, depth, piece = _gather_facets(mesh, facets, piece)
    piece = body if piece is None else piece
    for number in np.unique(piece)[1:]:
        mine, others = np.flatnonzero(piece == number), np.flatnonzero(piece < number)
        distance, partner = cKDTree(middle[others]).query(middle[mine])
        there = others[partner]
        opposed = np.sum(outward[mine] * outward[there], axis=1) < -0.5 * depth[mine] * depth[there]
        if np.any(meet := opposed & (distance < depth[mine])):  # also across a gap that the mesh has
            tags_there = body[mine[meet][0]], body[there[meet][0]]
            return tuple(name for name, tag in mesh.bodies.items() for _ in range(tags_there.count(tag)))
    return ()


def doubt_cracks(mesh: JointMesh) -> Iterator[str]:
    """What is probably not meant by facets of a body that lie on one another and share no nodes: a sentence each.

    Facets of boundaries do not count: whoever drew a crack to be one can name it. Collective.
    """
    topology = mesh.domain.topology
    topology.create_connectivity(mesh.dimension - 1, mesh.dimension)
    facets = np.sort(dolfinx.mesh.exterior_facet_indices(topology)).astype(np.int32)
    body, middle, outward, depth, named = _gather_facets(mesh, facets, np.isin(facets, mesh.facet_tags.indices))
    corners = np.concatenate(mesh.domain.comm.allgather(_find_corners(mesh, facets)))
    cracked = np.zeros(len(middle), dtype=bool)
    for other in cKDTree(middle).query(middle, k=range(1, min(_NEAREST, len(middle)) + 1))[1].T:
        opposed = (np.sum(outward * outward[other], axis=1) < 0) & (body == body[other]) & ~(named & named[other])
        cracked[opposed] |= _lie_in(middle[opposed], corners[other[opposed]], _CLOSED * depth[opposed])
    for name, tag in mesh.bodies.items():
        if len(crack := middle[cracked & (body == tag)]):
            first = crack[np.lexsort(np.round(crack.T / np.ptp(middle, axis=0).max(), 9))[0]]
            sides = f"{len(crack)} of its {'edges' if mesh.dimension == 2 else 'faces'}"
            yield (
                f'body "{name}" has a crack: {sides} lie face to face and share no nodes, as at '
                f"{tell_place(first[: mesh.dimension])}, so that they neither hold nor touch each other; let the "
                "pieces share nodes (in gmsh: removeAllDuplicates, or fragment), or, where it is meant, give both "
                "sides a physical group"
            )


def _find_corners(mesh: JointMesh, facets: np.ndarray) -> np.ndarray:
    """Corners of facets, as dolfinx orders them ``(n, k, 3)`` [m]."""
    topology, facet = mesh.domain.topology, mesh.dimension - 1
    topology.create_connectivity(facet, 0)
    topology.create_connectivity(0, mesh.dimension)
    corners_of = topology.connectivity(facet, 0)
    corners = np.array([corners_of.links(f) for f in facets], dtype=np.int32).reshape(-1, len(corners_of.links(0)))
    return dolfinx.mesh.compute_midpoints(mesh.domain, 0, corners.ravel()).reshape(*corners.shape, 3)


def _lie_in(points: np.ndarray, corners: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Whether each point lies in a facet: an edge, a triangle, or a quadrilateral as two of these.

    Args:
        points: One a facet, ``(n, 3)`` [m].
        corners: Of the facets, ``(n, k, 3)`` [m].
        tolerance: Distances that are none, ``(n,)`` [m].
    """
    lies = np.zeros(len(points), dtype=bool)
    for piece in (corners[:, :3], corners[:, 1:])[: corners.shape[1] - 2 or 1]:
        sides, way = piece[:, 1:] - piece[:, :1], points - piece[:, 0]
        along = np.einsum("nki,nk->ni", np.linalg.pinv(sides), way)  # also of a face with a flat corner
        apart = np.linalg.norm(way - np.einsum("ni,nik->nk", along, sides), axis=1)
        within = np.all(along > -_EDGE, axis=1) & (along.sum(axis=1) < 1 + _EDGE)
        lies |= within & (apart < tolerance)
    return lies


def _gather_facets(mesh: JointMesh, facets: np.ndarray, mark: np.ndarray | None) -> tuple[np.ndarray | None, ...]:
    """Of exterior facets of all ranks: body, middle, way there from the cell's middle, its length, and a mark each."""
    beside = find_cells_beside(mesh, facets)
    middle = dolfinx.mesh.compute_midpoints(mesh.domain, mesh.dimension - 1, facets)
    outward = middle - dolfinx.mesh.compute_midpoints(mesh.domain, mesh.dimension, beside)
    mine = find_body_of_cells(mesh)[beside], middle, outward, np.linalg.norm(outward, axis=1), mark
    everyone = zip(*mesh.domain.comm.allgather(mine), strict=True)
    return tuple(None if part[0] is None else np.concatenate(part) for part in everyone)


def tell_place(position: np.ndarray) -> str:
    """A place for messages."""
    return f"({', '.join(f'{x:.6g}' for x in np.round(position, 12) + 0.0)}) m"  # without the minus of -0


def integrate_over_boundary(space, facets: np.ndarray, direction: Sequence[float] | None = None) -> PETSc.Vec:
    """``integral N_k w ds`` over exterior facets [m or m^2]; ``w`` is a direction, or the outward normal (None)."""
    domain = space.mesh
    # a constant enters the compiled code as data: one compilation serves every direction
    w = (
        ufl.FacetNormal(domain)
        if direction is None
        else dolfinx.fem.Constant(domain, np.array(direction, dtype=PETSc.ScalarType))
    )
    return _integrate_field(space, facets, w)


def integrate_normals(space, facets: np.ndarray, direction: Sequence[float]) -> PETSc.Vec:
    """``integral N_k (n . e) n ds`` over exterior facets, as ``integrate_over_boundary``; ``n`` the outward normal."""
    n = ufl.FacetNormal(space.mesh)
    e = dolfinx.fem.Constant(space.mesh, np.array(direction, dtype=PETSc.ScalarType))
    return _integrate_field(space, facets, ufl.inner(e, n) * n)


def _integrate_field(space, facets: np.ndarray, w) -> PETSc.Vec:
    domain = space.mesh
    tags = dolfinx.mesh.meshtags(domain, domain.topology.dim - 1, facets, np.ones(len(facets), dtype=np.int32))
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags, subdomain_id=1)
    form = ufl.inner(w, ufl.TestFunction(space)) * ds
    return _compat.assemble_vector(_compat.compile_form(form, "a boundary integral"))


def mean_over_boundary(space, facets: np.ndarray, direction: Sequence[float]) -> PETSc.Vec:
    """Row of the mean displacement along ``direction``; also the nodal forces of that resultant spread evenly."""
    row = integrate_over_boundary(space, facets, direction)
    along_x = integrate_over_boundary(space, facets, np.eye(len(direction))[0])
    row.scale(1.0 / along_x.sum())
    return row


def local_to_global(space, nodes: np.ndarray) -> np.ndarray:
    """Global node numbers of local ones (int64)."""
    return space.dofmap.index_map.local_to_global(np.asarray(nodes, dtype=np.int32)).astype(np.int64)


def gather_facets(mesh: JointMesh, space, facets: np.ndarray, nodes: np.ndarray) -> list[list[list[int]]]:
    """Edges of exterior facets: both ends and, of second order, the node between; collective. Of triangles none.

    A facet of a plane mesh is one edge, a quadrilateral has four.

    Args:
        mesh: With its bodies.
        space: Of the displacements on it.
        facets: Those that this rank holds, ghosts included.
        nodes: Global numbers of the nodes of all ranks; edges have their places in it.
    """
    d, mine = mesh.dimension, []
    mesh.domain.topology.create_connectivity(d, d - 1)
    cells, layout = find_cells_beside(mesh, facets), space.dofmap.dof_layout
    for cell, number in zip(cells, number_faces(mesh, cells, facets).tolist(), strict=True):
        around = _compat.cell_dofs(space, [cell])[layout.entity_closure_dofs(d - 1, number)]
        around = local_to_global(space, around).tolist()
        if d == 3 and len(around) not in _OF_QUADRILATERALS:
            continue
        corners = [(0, 1)] if d == 2 else [(0, 1), (0, 2), (1, 3), (2, 3)]
        numbered = enumerate(corners, 2 ** (d - 1))  # nodes between follow the corners, if there are any
        mine.append([(*sorted((around[i], around[j])), *around[k : k + 1]) for k, (i, j) in numbered])
    place = {int(node): k for k, node in enumerate(nodes)}
    everyone = {tuple(sorted(facet)) for part in mesh.domain.comm.allgather(mine) for facet in part}  # ghosts once
    return [[[place[node] for node in edge] for edge in facet] for facet in sorted(everyone)]


def list_dofs(nodes: np.ndarray, dimension: int) -> np.ndarray:
    """Degrees of freedom of nodes ``(n,)``, by component ``(n, dimension)``."""
    return dimension * np.asarray(nodes)[:, None] + np.arange(dimension)


def find_tag(known: Mapping[str, int], name: str, kind: str) -> int:
    """Tag of a body or boundary by its name.

    Args:
        known: Name -> tag.
        name: Which one.
        kind: "body" or "boundary", for the message.

    Raises:
        MeshError: There is none of that name.
    """
    if name not in known:
        raise MeshError(
            f'no {kind} named "{name}" in the mesh; there are {", ".join(known) or "none"}{nearest(name, known)}'
        )
    return known[name]


def find_idle_corners(space) -> np.ndarray:
    """Local numbers of nodes at corners whose shape functions have no integral over faces, ghosts included.

    Those of tetrahedra of second order, all of them; other cells have none.
    """
    if not has_idle_corners(space):
        return np.empty(0, dtype=np.int32)
    layout, topology = space.dofmap.dof_layout, space.mesh.topology
    cells = topology.index_map(topology.dim)
    dofs = _compat.cell_dofs(space, np.arange(cells.size_local + cells.num_ghosts))
    return np.unique(dofs.reshape(-1, layout.num_dofs)[:, [layout.entity_dofs(0, k)[0] for k in range(4)]])


def has_idle_corners(space) -> bool:
    """Whether a space has such nodes."""
    return space.mesh.topology.dim == 3 and space.dofmap.dof_layout.num_dofs == 10
