"""Values of pairs as fields on the mesh: at the nodes of both bodies, or of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import dolfinx
import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.output.gathering import node_interpolation
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.boundaries import boundary_facets, has_idle_corners, local_to_global
from ewr_fenicsx.structure.chain import Chain
from ewr_fenicsx.structure.mesh import find_cells_beside, number_faces


def spread_over_interface(chain: Chain, elsewhere: float = 0.0) -> Callable[..., dolfinx.fem.Function]:
    """Returns a function from pair values ``(K_c,)`` to a field that has them at the nodes of both sides.

    Where a pair's node of B is in the next sector, this one's is the pair's of the sector before: it has that one's
    values, the function's second argument, or the same.
    """
    space, interface = chain.structure.space, chain.interface
    component, parents = space.sub(0).collapse()
    node = np.asarray(parents) // space.dofmap.bs
    pairs = before = find_pairs(chain, interface.nodes_a, interface.nodes_b_here)[node]
    if np.any(interface.is_next):
        before = find_pairs(chain, interface.nodes_b)[node]
    field = dolfinx.fem.Function(component)
    to_nodes = node_interpolation(component)

    def spread(values: RealArray, values_before: RealArray | None = None) -> dolfinx.fem.Function:
        of_before = values if values_before is None else values_before
        others = np.where(before >= 0, of_before[before], elsewhere)
        field.x.array[:] = np.where(pairs >= 0, values[pairs], others)
        return to_nodes(field)

    return spread


def find_pairs(chain: Chain, *sides: np.ndarray) -> np.ndarray:
    """Pair of every node that this rank holds, ghosts included, ``(nodes,)``; -1 where it is on none of the sides.

    Where pairs are in the middle of edges, corners of flanks have the pair of an edge beside them. Collective.

    Args:
        chain: Mesh and interface.
        sides: Global node numbers of the pairs on one body, ``(K_c,)``.
    """
    index_map = chain.structure.space.dofmap.index_map
    local = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    pair_of_node = {int(node): k for nodes in sides for k, node in enumerate(nodes)}
    if has_idle_corners(chain.structure.space):
        pair_of_node |= _lend_to_corners(chain, pair_of_node)
    return np.array([pair_of_node.get(int(node), -1) for node in index_map.local_to_global(local)])


def _lend_to_corners(chain: Chain, pair_of_node: Mapping[int, int]) -> dict[int, int]:
    """Corners of flanks, by global number, and the first of the nearest pairs in the middle of edges."""
    space, mesh = chain.structure.space, chain.mesh
    mesh.domain.topology.create_connectivity(2, 3)
    mesh.domain.topology.create_connectivity(3, 2)
    facets = np.concatenate([boundary_facets(mesh, name) for name in chain.interface.boundaries])
    cells = find_cells_beside(mesh, facets)
    layout, place, lent = space.dofmap.dof_layout, space.tabulate_dof_coordinates(), []
    for cell, number in zip(cells, number_faces(mesh, cells, facets).tolist(), strict=True):
        nodes = _compat.cell_dofs(space, [cell])[layout.entity_closure_dofs(2, number)]
        named = local_to_global(space, nodes).tolist()
        middles = [i for i, node in enumerate(named) if node in pair_of_node]
        for i in set(range(len(named))) - set(middles) if middles else ():
            away = np.linalg.norm(place[nodes[middles]] - place[nodes[i]], axis=1)
            near = [float(f"{distance:.9g}") for distance in away]  # one of both bodies and on all ranks
            lent += [(named[i], far, pair_of_node[named[m]]) for far, m in zip(near, middles, strict=True)]
    everyone = sorted((some for part in mesh.domain.comm.allgather(lent) for some in part), reverse=True)
    return {corner: pair for corner, _, pair in everyone}
