"""Rigid motions of a structure's parts, and which of them supports leave: what floats, contact alone holds."""

from __future__ import annotations

import itertools

import numpy as np
import scipy.linalg

from ewr_fenicsx.errors import ModesError
from ewr_fenicsx.structure.elasticity import Structure, body_nodes
from ewr_fenicsx.structure.interface import Interface

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


def _refuse_loose(structure: Structure, loose: list[int]) -> None:
    comm, part = structure.mass.comm.tompi4py(), structure.part
    nodes = {body: np.concatenate(comm.allgather(body_nodes(structure, body))) for body in structure.mesh.bodies}
    if names := [f'"{body}"' for body, of_body in nodes.items() if np.isin(part[of_body], loose).any()]:
        held = np.isin(part[structure.fixed // structure.mesh.dimension], loose).any()
        why = "what is held of it along some axes leaves it free" if held else "no node of it is held"
        raise ModesError(
            f"nothing holds {' and '.join(names)}, or a piece of it: {why}, and none is in contact; clamp it, "
            "let it share nodes with what is held, or leave it out"
        )
