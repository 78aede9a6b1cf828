"""The two cuts of a sector of a ring: their nodes, one to one, and how the next sector's displacements are turned."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx
import numpy as np
from scipy.spatial import cKDTree

from ewr_fenicsx.errors import MeshError, SceneError
from ewr_fenicsx.structure.boundaries import boundary_facets, list_dofs, local_to_global, tell_place
from ewr_fenicsx.structure.elasticity import Structure
from ewr_fenicsx.structure.interface import Interface
from ewr_fenicsx.structure.mesh import Ring, rotate_by_sector
from ewr_fenicsx.structure.rigid_motions import find_free_motions

_NEAR = 1e-6  # distance of two nodes that are one, over the extent of the cuts
_HELD = 1e-9  # of a turned displacement along what is held, below which it is rounding


@dataclass(frozen=True)
class SectorCuts:
    """Degrees of freedom at the cuts, those that supports hold left out.

    Attributes:
        ring: What was asked for.
        low, high: Global numbers ``(k,)``: the next sector's ``low[i]`` is at ``high[i]``.
        turn: ``(k, k)`` with ``u[high] = turn @ u_next[low]``, each in its own sector's directions.
    """

    ring: Ring
    low: np.ndarray
    high: np.ndarray
    turn: np.ndarray


def list_boundary(contact: np.ndarray, cuts: SectorCuts | None) -> np.ndarray:
    """Degrees of freedom ``(n_b,)`` that a reduction keeps: in contact, and of a sector on both cuts."""
    return contact if cuts is None else np.concatenate([contact, cuts.low, cuts.high])


def find_cuts(structure: Structure, interface: Interface, ring: Ring) -> SectorCuts:
    """Matches the nodes of both cuts, of which a ring that only contact joins has none; collective.

    Raises:
        MeshError: Cuts without facets, with other nodes than the turned ones of each other, with nodes that both have,
            or with nodes in contact; a sector that no support holds.
        SceneError: Supports that hold one cut otherwise than the other; damping by modes, which differ from wave to
            wave.
    """
    if structure.modal_damping is not None:
        raise SceneError(
            'damping.kind = "modal": the modes of a ring differ from wave to wave; give "ratios" or "rayleigh"'
        )
    if ring.low is None:
        return SectorCuts(ring, *np.zeros((2, 0), dtype=int), np.zeros((0, 0)))
    d = structure.mesh.dimension
    rotation = rotate_by_sector(ring, d)
    (low, at_low), (high, at_high) = (_gather_nodes(structure, name) for name in (ring.low, ring.high))
    centre = np.array(ring.centre)
    where = f"cyclic: {ring.sectors} sectors, of {360 / ring.sectors:.6g} degrees each"
    if touching := {*low, *high} & {*interface.nodes_a, *interface.nodes_b}:
        raise MeshError(
            f"{where}: {len(touching)} nodes of the cuts are in contact; cut the sector elsewhere, or end the flank "
            "short of the cuts"
        )
    if len(low) != len(high):
        raise MeshError(
            f"{where}: {len(low)} nodes on {ring.low}, and {len(high)} on {ring.high}; mesh both cuts alike (in gmsh: "
            "setPeriodic)"
        )
    distance, partner = cKDTree(at_high).query(centre + (at_low - centre) @ rotation.T)
    if distance.max() > _NEAR * np.ptp(np.vstack([at_low, at_high]), axis=0).max() or len({*partner}) < len(low):
        raise MeshError(
            f"{where}: turned about the axis, the nodes of {ring.low} are up to {distance.max():.3g} m from those of "
            f"{ring.high}; see sectors, centre, axis and which cut is low (the next sector follows in the sense of "
            "the axis), and mesh both cuts alike"
        )
    shared = np.intersect1d(low, high)
    if not np.isin(list_dofs(shared, d), structure.fixed).all():
        raise MeshError(
            f"{where}: {ring.low} and {ring.high} share {len(shared)} node{'s' * (len(shared) > 1)}, as at "
            f"{tell_place(at_low[low == shared[0]][0])}: on the axis a node would be one of all sectors; leave a bore"
        )
    of_cuts = np.isin(structure.part, np.unique(structure.part[np.concatenate([low, high])]))
    if find_free_motions(structure, of_cuts).size:
        raise MeshError(f"{where}: supports leave what its cuts bound free to move; clamp it, as at a hub")
    turn = np.kron(np.eye(len(low)), rotation)
    low_dofs, high_dofs = (list_dofs(nodes, d).ravel() for nodes in (low, high[partner]))
    free = [~np.isin(dofs, structure.fixed) for dofs in (low_dofs, high_dofs)]
    mixed = [np.abs(turn[np.ix_(free[1], ~free[0])]), np.abs(turn[np.ix_(~free[1], free[0])])]
    if max(part.max(initial=0.0) for part in mixed) > _HELD:
        raise SceneError(
            f"supports hold nodes of {ring.low} otherwise than those of {ring.high}; hold what is on both cuts, in all "
            "directions or along the axis"
        )
    return SectorCuts(ring, low_dofs[free[0]], high_dofs[free[1]], turn[np.ix_(free[1], free[0])])


def _gather_nodes(structure: Structure, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Global numbers ``(n,)`` and places ``(n, d)`` [m] of a boundary's nodes, from all ranks, ordered by place."""
    mesh, space = structure.mesh, structure.space
    local = dolfinx.fem.locate_dofs_topological(space, mesh.dimension - 1, boundary_facets(mesh, name))
    local = local[local < space.dofmap.index_map.size_local]
    mine = local_to_global(space, local), space.tabulate_dof_coordinates()[local, : mesh.dimension]
    numbers, places = (np.concatenate(c) for c in zip(*mesh.domain.comm.allgather(mine), strict=True))
    order = np.lexsort(np.round(places.T / np.ptp(places, axis=0).max(), 9))
    return numbers[order], places[order]
