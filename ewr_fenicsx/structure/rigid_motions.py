"""Rigid motions of a structure's parts, and which of them supports leave: what floats, contact alone holds."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np
import scipy.linalg

from ewr_fenicsx.errors import ModesError
from ewr_fenicsx.structure import _compat
from ewr_fenicsx.structure.boundaries import local_to_global, tell_place
from ewr_fenicsx.structure.elasticity import Structure, body_nodes, number_connected
from ewr_fenicsx.structure.interface import Interface
from ewr_fenicsx.structure.mesh import find_body_of_cells

_HELD = 1e-8  # motion of held degrees of freedom, over the largest of any rigid motion, below which it is rounding


def find_rigid_motions(structure: Structure, interface: Interface, contact: np.ndarray) -> np.ndarray:
    """Rigid motions of each part that contact alone keeps from them, at contact degrees of freedom ``(n_c, r)``.

    Columns of size 1: translations and rotations, or what supports along some axes leave of them. Collective.

    Args:
        structure: With its supports.
        interface: The pairs.
        contact: Global numbers of the pairs' free degrees of freedom, ``(n_c,)``.

    Raises:
        ModesError: Supports leave a part free that is not in contact; names its bodies.
    """
    d, part = interface.dimension, structure.part
    nodes = np.concatenate([interface.nodes_a, interface.nodes_b])
    places = np.concatenate([interface.position, interface.position_b])
    position = dict(zip(nodes.tolist(), places, strict=True))
    place = np.array([position[int(dof) // d] for dof in contact])
    motions, loose = [np.zeros((len(contact), 0))], []
    for number in np.unique(part):
        mine = part[contact // d] == number
        if not mine.any():
            if find_free_motions(structure, part == number).size:
                loose.append(number)
            continue
        centre = place[mine].mean(axis=0)
        reach = float(np.abs(place[mine] - centre).max()) or 1.0  # one free node
        free = find_free_motions(structure, part == number, centre, reach)
        seen = np.where(mine[:, None], _move(place, contact % d, centre, reach) @ free, 0.0)
        motions.append(seen / np.abs(seen).max(axis=0, initial=1e-300))
    _refuse_loose(structure, loose)
    return np.hstack(motions)


def find_free_motions(
    structure: Structure, is_moved: np.ndarray, centre: np.ndarray | None = None, reach: float = 1.0
) -> np.ndarray:
    """Rigid motions that supports leave to some nodes, as combinations ``(m, r)`` of translations and rotations.

    Args:
        structure: With its supports.
        is_moved: Which nodes, ``(all nodes,)``.
        centre: Of the rotations ``(d,)`` [m]; None: in the middle of what is held.
        reach: From there, where a rotation moves a point by 1 [m].
    """
    d = structure.mesh.dimension
    mine = is_moved[structure.fixed // d]
    held, place = structure.fixed[mine], structure.fixed_places[mine]
    if not len(held):
        return np.eye(d + d * (d - 1) // 2)
    if centre is None:
        centre = place.mean(axis=0)
        reach = float(np.abs(place - centre).max()) or 1.0
    _, sizes, turn = np.linalg.svd(_move(place, held % d, centre, reach), full_matrices=False)
    stopped = turn[sizes > _HELD * sizes.max()]
    left = np.eye(turn.shape[1]) - stopped.T @ stopped  # projects onto those that nothing stops
    _, _, order = scipy.linalg.qr(left, pivoting=True)
    return left[:, np.sort(order[: len(left) - len(stopped)])]


def _move(place: np.ndarray, component: np.ndarray, centre: np.ndarray, reach: float) -> np.ndarray:
    """What translations, then rotations, do to degrees of freedom, ``(n, m)``.

    Args:
        place: Where they are, ``(n, d)`` [m].
        component: Which component of the displacement each is, ``(n,)``.
        centre, reach: As in ``find_free_motions``.
    """
    d = place.shape[1]
    along, offset = component[:, None] == np.arange(d), (place - centre) / reach
    turns = [offset[:, i] * along[:, j] - offset[:, j] * along[:, i] for i, j in itertools.combinations(range(d), 2)]
    return np.column_stack([along, *turns])


def _gather_nodes(structure: Structure) -> dict[str, np.ndarray]:
    """Global numbers of each body's nodes, from all ranks."""
    comm = structure.mass.comm.tompi4py()
    return {body: np.concatenate(comm.allgather(body_nodes(structure, body))) for body in structure.mesh.bodies}


def _refuse_loose(structure: Structure, loose: list[int]) -> None:
    part, nodes = structure.part, _gather_nodes(structure)
    if names := [f'"{body}"' for body, of_body in nodes.items() if np.isin(part[of_body], loose).any()]:
        held = np.isin(part[structure.fixed // structure.mesh.dimension], loose).any()
        why = "what is held of it along some axes leaves it free" if held else "no node of it is held"
        raise ModesError(
            f"nothing holds {' and '.join(names)}, or a piece of it: {why}, and none is in contact; clamp it, "
            "let it share nodes with what is held, or leave it out"
        )


def refuse_hinges(structure: Structure) -> None:
    """Refuses pieces of the mesh that are one part, by nodes they share, and that can turn about these; collective.

    A piece is what cells are that facets join, of one body or of several.

    Raises:
        ModesError: Names the bodies of two such pieces and a node.
    """
    part, (nodes, bodies) = structure.part, _gather_pieces(structure)
    common = {both: np.intersect1d(*(nodes[piece] for piece in both)) for both in itertools.combinations(nodes, 2)}
    shared = np.unique(np.concatenate([*common.values(), np.empty(0, dtype=np.int64)]))
    place = _locate(structure, shared)
    for number in np.unique(part[shared]):
        here = {both: np.flatnonzero(np.isin(shared, at[part[at] == number])) for both, at in common.items()}
        here = {both: at for both, at in here.items() if len(at)}
        as_one = find_free_motions(structure, part == number).shape[1]
        if _count_motions(structure, number, nodes, place, here) <= as_one:
            continue
        both = min(here, key=lambda both: len(here[both]))
        count, spot = len(here[both]), tell_place(place[here[both][0]])
        raise ModesError(
            f"{_name_pieces(bodies, both)} share {count} node{'s' * (count > 1)}, as at {spot}, about which they turn "
            "freely, as on a hinge; let them share none, or those of a whole facet"
        )


def doubt_pieces(structure: Structure) -> Iterator[str]:
    """What is probably not meant by pieces of the mesh that share nodes and no facet: a sentence each; collective."""
    nodes, bodies = _gather_pieces(structure)
    for both in itertools.combinations(nodes, 2):
        common = np.intersect1d(*(nodes[piece] for piece in both))
        place = _locate(structure, common)
        if len(common):
            facets = "edge" if structure.mesh.dimension == 2 else "face"
            yield (
                f"{_name_pieces(bodies, both)} share {len(common)} node{'s' * (len(common) > 1)}, as at "
                f"{tell_place(place[0])}, and no {facets} of a cell: they hang together there alone, and neither hold "
                f"nor touch each other between; mesh both alike, with one {'curve' if facets == 'edge' else 'surface'} "
                "between them"
            )


def _locate(structure: Structure, nodes: np.ndarray) -> np.ndarray:
    """Where nodes are, ``(n, d)`` [m], by their global numbers, which rise; collective."""
    d, (first, last) = structure.mesh.dimension, structure.mass.getOwnershipRange()
    mine = nodes[(nodes >= first // d) & (nodes < last // d)] - first // d
    places = structure.space.tabulate_dof_coordinates()[mine, :d]
    return np.concatenate(structure.mass.comm.tompi4py().allgather(places))


def _name_pieces(bodies: Mapping[int, list[str]], both: tuple[int, int]) -> str:
    one, other = sorted(" and ".join(f'"{body}"' for body in bodies[piece]) for piece in both)
    return f"two pieces of {one}" if one == other else f"{one} and {other}"


def _gather_pieces(structure: Structure) -> tuple[dict[int, np.ndarray], dict[int, list[str]]]:
    """Of parts of several pieces, the global numbers of each piece's nodes and the names of its bodies; collective."""
    mesh, space, comm = structure.mesh, structure.space, structure.mass.comm.tompi4py()
    topology, d = mesh.domain.topology, mesh.dimension
    topology.create_connectivity(d, d - 1)
    count, cells = topology.index_map(d - 1).size_global, np.arange(topology.index_map(d).size_local)
    beside = topology.connectivity(d, d - 1)
    facets = topology.index_map(d - 1).local_to_global(beside.array).reshape(beside.num_nodes, -1)[cells]
    piece = number_connected(facets, count, comm)[facets[:, 0]]
    nodes = local_to_global(space, _compat.cell_dofs(space, cells)).reshape(len(cells), -1)
    mine = np.unique(np.stack([structure.part[nodes[:, 0]], piece, find_body_of_cells(mesh)[cells]], axis=1), axis=0)
    found = np.unique(np.concatenate(comm.allgather(mine)), axis=0)
    several = {number for number in found[:, 0] if len({*found[found[:, 0] == number, 1]}) > 1}
    named = {tag: name for name, tag in mesh.bodies.items()}
    bodies: dict[int, list[str]] = {}
    for number, one, tag in found:
        if number in several:
            bodies.setdefault(int(one), []).append(named[tag])
    each = {one: comm.allgather(np.unique(nodes[piece == one])) for one in bodies}
    return {one: np.unique(np.concatenate(of_ranks)) for one, of_ranks in each.items()}, bodies


def _count_motions(
    structure: Structure,
    number: int,
    nodes: Mapping[int, np.ndarray],
    place: np.ndarray,
    shared: Mapping[tuple[int, int], np.ndarray],
) -> int:
    """How many motions supports leave to the pieces of a part, each of them rigid.

    Args:
        structure: With its supports.
        number: Of the part.
        nodes: Of each piece.
        place: Of shared nodes, ``(n, d)`` [m].
        shared: Which of these two pieces share in this part.
    """
    d, pieces = structure.mesh.dimension, sorted({piece for both in shared for piece in both})
    mine = structure.part[structure.fixed // d] == number
    held, held_place = structure.fixed[mine], structure.fixed_places[mine]
    centre = place[np.concatenate([*shared.values()])].mean(axis=0)
    reach = float(np.abs(np.vstack([place, held_place]) - centre).max()) or 1.0
    rows = []
    for piece in pieces:
        on = np.isin(held // d, nodes[piece])
        stopped = np.linalg.qr(_move(held_place[on], held[on] % d, centre, reach), mode="r")  # as much, in few rows
        rows.append(np.hstack([stopped * (piece == other) for other in pieces]))
    for (one, other), at in shared.items():
        moved = _move(np.repeat(place[at], d, axis=0), np.tile(np.arange(d), len(at)), centre, reach)
        moved = np.linalg.qr(moved, mode="r")
        rows.append(np.hstack([moved * ((piece == one) - (piece == other)) for piece in pieces]))
    sizes = np.linalg.svd(np.vstack(rows), compute_uv=False)
    return rows[0].shape[1] - np.count_nonzero(sizes > _HELD * sizes.max())
