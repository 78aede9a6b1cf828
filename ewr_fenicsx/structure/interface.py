"""The joint: which nodes of the two bodies face each other, in which frame, and how far they part.

Flanks are found by name, pairs by coordinates, globally: the two sides of a flank may live on different MPI ranks.
Every rank holds the same interface.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain

import dolfinx
import numpy as np
import scipy.sparse
from scipy.spatial import cKDTree

from ewr_fenicsx.errors import InterfaceError, nearest
from ewr_fenicsx.structure import boundaries, elasticity
from ewr_fenicsx.structure.boundaries import tell_place
from ewr_fenicsx.structure.mesh import JointMesh, Ring, find_body_of_cells, find_cells_beside, rotate_by_sector
from ewr_fenicsx.structure.pair_frames import (
    check_free_to_part,
    check_smooth,
    follow_rows,
    follow_tangent,
    measure_turn,
    point_outward,
    turn_along_supports,
)

CLOSE = 1e-6  # of a flank's length: distance of the two nodes of a pair that is none
_SAME = 1e-9  # of the square of a unit vector, up to which it lies in what others span


@dataclass(frozen=True)
class Interface:
    """Pairs of nodes, ordered by flank and then along the flank's tangent, wherever that turns.

    On triangles of second order, faces of tetrahedra, they are the nodes in the middle of edges: corners would carry
    nothing of an even pressure.

    In ``d`` dimensions, 2 or 3. On a solid's flank pairs are ordered along its mean second tangent, row by row, and
    within a row along its first.

    Attributes:
        flanks: Names.
        flank_of_pair: Index into ``flanks``, ``(K_c,)``.
        position: ``(K_c, d)`` [m].
        normal: Outward unit normal of body A, ``(K_c, d)``, as ``point_outward`` has it.
        tangents: ``(K_c, d - 1, d)`` unit vectors. The first is the normal turned by +90 degrees about the z axis (on a
            solid along ``e_z x normal``, or ``e_x x normal`` where that points along z), the second ``normal x first``.
        area: Tributary area, integral of the node's shape function times the thickness, ``(K_c,)`` [m^2].
        nodes_a: Global node numbers on body A, ``(K_c,)``.
        nodes_b: Global node numbers on body B, ``(K_c,)``.
        normal_gap: ``(K_c, all dofs)``: ``q_N = normal_gap @ u = (u_b - u_a).n``, opening is positive.
        tangential_slip: ``(K_c (d - 1), all dofs)``, pair-major: ``q_T = tangential_slip @ u = (u_a - u_b).t``.
        boundaries: Of each flank that which A's nodes are on.
        is_next: Which pairs have their node of B in the next sector of a ring, ``(K_c,)``: their rows lack its part.
        position_b: Where B's nodes are in the mesh, ``(K_c, d)`` [m]: of the next sector, turned back.
        drawn_gap: How far B's nodes are from A's along the normal in the mesh, ``(K_c,)`` [m], which counts as none;
            negative where the bodies overlap.
        next_normal_gap, next_tangential_slip: That part, to be multiplied with the next sector's ``u``; None: none is.
    """

    flanks: tuple[str, ...]
    flank_of_pair: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    tangents: np.ndarray
    area: np.ndarray
    nodes_a: np.ndarray
    nodes_b: np.ndarray
    normal_gap: scipy.sparse.csr_matrix
    tangential_slip: scipy.sparse.csr_matrix
    boundaries: tuple[str, ...]
    is_next: np.ndarray
    position_b: np.ndarray
    drawn_gap: np.ndarray
    next_normal_gap: scipy.sparse.csr_matrix | None = None
    next_tangential_slip: scipy.sparse.csr_matrix | None = None

    @property
    def nodes_b_here(self) -> np.ndarray:
        """B's nodes, ``(K_c,)``, those of A where B's are in the next sector."""
        return np.where(self.is_next, self.nodes_a, self.nodes_b)

    @property
    def tangent(self) -> np.ndarray:
        """The first tangent, ``(K_c, d)``."""
        return self.tangents[:, 0]

    @property
    def dimension(self) -> int:
        """2 of plane bodies, 3 of solids."""
        return self.normal.shape[1]


@dataclass(frozen=True)
class _Side:
    """The nodes of one body on one flank, gathered on every rank."""

    nodes: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    area: np.ndarray
    turn: np.ndarray  # angle between the edges or faces that meet at each node [degree]

    def take(self, nodes: np.ndarray) -> _Side:
        """Some of the nodes, in an order of one's own."""
        return _Side(*(getattr(self, entry.name)[nodes] for entry in fields(self)))


def pair_interface(
    structure: elasticity.Structure,
    flanks: Sequence[str] | None = None,
    body_a: str = "blade",
    body_b: str | None = "disk",
    tolerance: float = CLOSE,
    in_use: Sequence[str] = (),
    ring: Ring | None = None,
) -> Interface:
    """Pairs the nodes of two bodies across their flanks, and those of a sector across its flanks to the next one.

    Args:
        structure: Of the mesh that holds both bodies.
        flanks: Names of the boundaries that lie on both bodies; None: all that do.
        body_a: The body on which the normals point outward.
        body_b: The other one; None: all flanks are between sectors.
        tolerance: Largest distance between the nodes of a pair, relative to the flank's length.
        in_use: Boundaries held, loaded or followed: without ``flanks``, flanks only where the bodies lie face to face.
        ring: Of which the mesh is a sector; its flanks come after the others.

    Raises:
        InterfaceError: An unknown or empty flank, a third body on one, sides with unequal node counts, nodes further
            apart than the tolerance, a node shared by both bodies or by two flanks, a flank that turns a corner, or
            that has both bodies on the same side, or a pair whose nodes are both held across the flank.
    """
    mesh, beyond = structure.mesh, ring.flanks if ring else {}
    _check_names(mesh, [body_a, *filter(None, [body_b])], [*(flanks or ()), *chain.from_iterable(beyond.values())])
    # ranks must go through the same collective calls in the same order
    sides, apart = ({}, []) if body_b is None else _find_sides(structure, flanks, body_a, body_b, in_use)
    crowded = [n for n, both in sides.items() if len(_gather_side(structure, n).area) > sum(len(s.area) for s in both)]
    if not (sides or beyond):
        raise InterfaceError(
            f'no boundary touches both "{body_a}" and "{body_b}"; give each flank one physical '
            f"group that holds the {_say_outlines(mesh.dimension)} of both bodies"
        )
    if twice := [name for name in beyond if name in sides]:
        raise InterfaceError(
            f'flank "{twice[0]}" is a boundary of both bodies, too; give that to the next sector another name'
        )
    whose = dict.fromkeys(sides, (body_a, body_b)) | {n: (a, f"next sector's {b}") for n, (a, b) in beyond.items()}
    on = (*sides, *(side for side, _ in beyond.values()))
    for name, (side, other) in beyond.items():
        sides[name] = _gather_side(structure, side), _turn(_gather_side(structure, other), ring, mesh.dimension)
    closes = dict.fromkeys(beyond, "; see sectors, centre, axis and which comes first in cyclic.flanks")
    closes |= dict.fromkeys(apart, "; or, if it is no flank, name the flanks in contact.flanks")
    crowd = f"a third body is on it, too: a joint has two, make that a part of {body_b}"
    closes |= dict.fromkeys(crowded, f"; {crowd}")
    paired = {n: _pair_sides(n, *both, *whose[n], tolerance, closes.get(n, "")) for n, both in sides.items()}
    if crowded:  # it would touch nothing
        raise InterfaceError(f'flank "{crowded[0]}": {crowd}')
    for name, (a, b) in paired.items():
        check_smooth(name, a.position, a.turn)
        _check_opposed(name, a, b, *whose[name])
    return _lay_pairs(structure, tuple(paired), list(paired.values()), on, ring)


def _check_names(mesh: JointMesh, bodies: Sequence[str], flanks: Sequence[str]) -> None:
    """Refuses bodies and flanks that the mesh has not."""
    for kind, names, known in (("body", bodies, mesh.bodies), ("flank", flanks, mesh.boundaries)):
        for name in names:
            if name not in known:
                raise InterfaceError(f'no {kind} named "{name}"; there are {", ".join(known)}{nearest(name, known)}')
    if len(set(bodies)) < len(bodies):
        raise InterfaceError(f'both sides of the joint are on the same body, "{bodies[0]}"; name two')


def _lay_pairs(
    structure: elasticity.Structure,
    names: tuple[str, ...],
    paired: Sequence[tuple[_Side, _Side]],
    on: tuple[str, ...],
    ring: Ring | None,
) -> Interface:
    """The pairs of all flanks, whose sides are ``paired`` node by node, with A's ``on`` boundaries of these names."""
    dimension, beyond = structure.mesh.dimension, ring.flanks if ring else {}
    flank_of_pair = np.repeat(np.arange(len(names)), [len(a.nodes) for a, _ in paired])
    nodes_a, nodes_b = (np.concatenate([pair[k].nodes for pair in paired]) for k in (0, 1))
    position, position_b = (np.concatenate([pair[k].position for pair in paired]) for k in (0, 1))
    is_next = np.array([name in beyond for name in names])[flank_of_pair]
    _check_flanks_apart(names, flank_of_pair, position, nodes_a, nodes_b)
    held_a, held_b = (np.isin(boundaries.list_dofs(nodes, dimension), structure.fixed) for nodes in (nodes_a, nodes_b))
    if beyond:  # what is held in the next sector is turned with it
        squares = rotate_by_sector(ring, dimension) ** 2
        held_b = np.where(is_next[:, None], held_b @ squares.T > 1 - _SAME, held_b)
    still = held_a & held_b
    normal = np.concatenate([a.normal for a, _ in paired])
    check_free_to_part(names, flank_of_pair, position, normal, still)
    normal, tangents = turn_along_supports(normal, still)
    size = structure.mass.getSize()[0]
    each = np.repeat(np.arange(len(normal)), tangents.shape[1])
    tangent, here = np.concatenate(tangents), ~is_next[:, None]
    drawn_gap = np.sum((position_b - position) * normal, axis=1)
    further = {}
    if beyond:
        turned, centre = rotate_by_sector(ring, dimension), np.array(ring.centre)
        position_b = np.where(here, position_b, centre + (position_b - centre) @ turned)
        further["next_normal_gap"] = _move(nodes_b, normal @ turned * ~here, size)
        further["next_tangential_slip"] = -_move(nodes_b[each], tangent @ turned * ~here[each], size)
    return Interface(
        names,
        flank_of_pair,
        position,
        normal,
        tangents,
        np.concatenate([a.area for a, _ in paired]),
        nodes_a,
        nodes_b,
        _move(nodes_b, normal * here, size) - _move(nodes_a, normal, size),
        _move(nodes_a[each], tangent, size) - _move(nodes_b[each], tangent * here[each], size),
        on,
        is_next,
        position_b,
        drawn_gap,
        **further,
    )


def _find_sides(
    structure: elasticity.Structure, flanks: Sequence[str] | None, body_a: str, body_b: str, in_use: Sequence[str]
) -> tuple[dict[str, tuple[_Side, _Side]], list[str]]:
    """Both sides of each flank, by name; and on which, that nobody named, the bodies do not lie face to face."""
    names = sorted(structure.mesh.boundaries) if flanks is None else flanks
    sides = {name: tuple(_gather_side(structure, name, body) for body in (body_a, body_b)) for name in names}
    if flanks is not None:
        return sides, []
    sides = {name: pair for name, pair in sides.items() if all(len(side.nodes) for side in pair)}
    apart = [name for name in sides if not _find_bodies_on(structure, name)]
    return {name: pair for name, pair in sides.items() if name not in {*apart} & {*in_use}}, apart


def _turn(side: _Side, ring: Ring, dimension: int) -> _Side:
    """A side of the next sector, where that is."""
    rotation, centre = rotate_by_sector(ring, dimension), np.array(ring.centre)
    return replace(side, position=centre + (side.position - centre) @ rotation.T, normal=side.normal @ rotation.T)


def _say_outlines(dimension: int) -> str:
    return "curves" if dimension == 2 else "surfaces"


def doubt_boundaries(
    structure: elasticity.Structure, flanks: Sequence[str], body_a: str, body_b: str, held: Sequence[str]
) -> Iterator[str]:
    """What is probably not meant by boundaries on which bodies lie face to face and no contact is: a sentence each.

    Pieces of the mesh that are joined by shared nodes anywhere do not count. Collective.

    Args:
        structure: Of the mesh that holds the boundaries.
        flanks: Names of those that are in contact.
        body_a: One body of the joint.
        body_b: The other one.
        held: Names of those that are clamped.
    """
    for name in sorted(set(structure.mesh.boundaries) - {*flanks, *held}):
        if bodies := _find_bodies_on(structure, name):
            whose = " and ".join(bodies) if len(set(bodies)) == 2 else f"two pieces of {bodies[0]}"
            yield (
                f'boundary "{name}" lies on {whose}, face to face, and they do not touch each other in '
                f"this model: a joint is between {body_a} and {body_b}, on {', '.join(flanks)}; if they should touch, "
                f"{_tell_how_to_touch(bodies, body_a, body_b)}; if they are glued, let them share nodes"
            )


def doubt_drawn_gaps(interface: Interface) -> Iterator[str]:
    """What is probably not meant by sides of a flank that are drawn apart, or into one another: a sentence each."""
    for k, name in enumerate(interface.flanks):
        mine = interface.flank_of_pair == k
        gap, length = interface.drawn_gap[mine], np.linalg.norm(np.ptp(interface.position[mine], axis=0))
        worst = gap[np.argmax(np.abs(gap))]
        if abs(worst) > CLOSE * length:
            yield (
                f'flank "{name}": its sides are drawn up to {abs(worst):.3g} m '
                f"{'apart' if worst > 0 else 'into one another'}, which contact.pair_tolerance allows and the model "
                "takes no notice of: initial_gap alone says how far apart they are"
            )


def _find_bodies_on(structure: elasticity.Structure, name: str) -> tuple[str, ...]:
    """Two bodies, or two pieces of one, that lie face to face on a boundary; none: ``()``. Collective."""
    mesh, space = structure.mesh, structure.space
    mesh.domain.topology.create_connectivity(mesh.dimension - 1, mesh.dimension)
    outer = dolfinx.mesh.exterior_facet_indices(mesh.domain.topology)
    facets = np.intersect1d(mesh.facet_tags.find(mesh.boundaries[name]), outer).astype(np.int32)
    nodes = [space.dofmap.cell_dofs(cell)[0] for cell in find_cells_beside(mesh, facets)]
    return boundaries.find_facing_bodies(mesh, facets, structure.part[boundaries.local_to_global(space, nodes)])


def _tell_how_to_touch(bodies: tuple[str, ...], body_a: str, body_b: str) -> str:
    """What makes a flank of a boundary that lies on two bodies, which may be of one name."""
    if set(bodies) == {body_a, body_b}:
        return "name it in contact.flanks"
    strangers = set(bodies) - {body_a, body_b}
    if len(set(bodies)) == 2 and len(strangers) == 1:
        other = body_b if body_a in bodies else body_a
        return f"make {strangers.pop()} a part of {other}"
    return f"make one of them a part of {body_a}, the other of {body_b}"


def _gather_side(structure: elasticity.Structure, flank: str, body: str | None = None) -> _Side:
    """The nodes of one body, or of any, on one boundary, from all ranks, in some order (the same everywhere)."""
    mesh, space = structure.mesh, structure.space
    domain, d = mesh.domain, mesh.dimension
    facets = boundaries.boundary_facets(mesh, flank)
    domain.topology.create_connectivity(d - 1, d)
    cells_of = domain.topology.connectivity(d - 1, d)
    in_body = np.isin(find_body_of_cells(mesh), [*mesh.bodies.values()] if body is None else mesh.bodies[body])
    mine = np.array([f for f in facets if in_body[cells_of.links(f)].any()], dtype=np.int32)

    size = boundaries.integrate_over_boundary(space, mine, np.eye(d)[0]).array[::d]
    normal = boundaries.integrate_over_boundary(space, mine).array.reshape(-1, d)
    products = [boundaries.integrate_normals(space, mine, along).array.reshape(-1, d) for along in np.eye(d)]
    turn = measure_turn(size, normal, np.stack(products, axis=1))
    local = dolfinx.fem.locate_dofs_topological(space, d - 1, mine)
    local = np.setdiff1d(local[local < space.dofmap.index_map.size_local], structure.idle_corners)
    columns = (
        boundaries.local_to_global(space, local),
        space.tabulate_dof_coordinates()[local, :d],
        normal[local],
        size[local] * structure.thickness,
        turn[local],
    )
    nodes, position, normal, area, turn = (np.concatenate(c) for c in zip(*domain.comm.allgather(columns), strict=True))
    outward = point_outward(position, normal, boundaries.gather_facets(mesh, space, mine, nodes))
    return _Side(nodes, position, outward, area, turn)


def _pair_sides(
    name: str, a: _Side, b: _Side, body_a: str, body_b: str, tolerance: float, closes: str = ""
) -> tuple[_Side, _Side]:
    """Both sides of a flank, ordered along the tangent of A, node by node; ``closes`` ends what is said of nodes."""
    outlines = _say_outlines(a.position.shape[1])
    shared = np.flatnonzero(np.isin(a.nodes, b.nodes))
    if len(shared):
        raise InterfaceError(
            f'flank "{name}": {body_a} and {body_b} share {len(shared)} nodes, e.g. at '
            f"{tell_place(a.position[shared[0]])}; coincident nodes of a joint must stay distinct"
        )
    if len(a.nodes) != len(b.nodes) or not len(a.nodes):
        remedy = f"give both {outlines} the same transfinite count"
        if not (len(a.nodes) and len(b.nodes)):
            remedy = f"a flank has {outlines} of both bodies: name one in contact.flanks, or leave that out for all"
        raise InterfaceError(
            f'flank "{name}": {len(a.nodes)} nodes on the {body_a}, {len(b.nodes)} on the {body_b}; {remedy}{closes}'
        )
    order = (follow_tangent if a.position.shape[1] == 2 else follow_rows)(a.position, a.normal)
    length = np.linalg.norm(np.ptp(a.position, axis=0))
    distance, partner = cKDTree(b.position).query(a.position[order])
    worst = int(np.argmax(distance))
    if distance[worst] > tolerance * length or len(set(partner)) != len(partner):
        way = b.position[partner[worst]] - a.position[order[worst]]
        across = abs(way @ a.normal[order[worst]]) > 0.5 * distance[worst]
        clearance = "; a clearance is not drawn, but given as contact.initial_gap" if across else ""
        raise InterfaceError(
            f'flank "{name}": the {body_a} node at {tell_place(a.position[order[worst]])} is {distance[worst]:.3g} m '
            f"away from the nearest {body_b} node, allowed are {tolerance * length:.3g} m; give both {outlines} "
            f"the same end points and the same transfinite spacing{clearance}{closes}"
        )
    return a.take(order), b.take(partner)


def _check_opposed(name: str, a: _Side, b: _Side, body_a: str, body_b: str) -> None:
    alike = np.flatnonzero(np.sum(a.normal * b.normal, axis=1) > -0.5)
    if len(alike):
        raise InterfaceError(
            f'flank "{name}": {body_a} and {body_b} lie on the same side of it at {tell_place(a.position[alike[0]])}: '
            "they overlap there, and neither could press on the other; draw the bodies on either side of their flank"
        )


def _check_flanks_apart(names, flank_of_pair, position, nodes_a, nodes_b) -> None:
    for nodes in (nodes_a, nodes_b, np.concatenate([nodes_a, nodes_b])):
        _, first, count = np.unique(nodes, return_index=True, return_counts=True)
        if (count > 1).any():
            k, other = np.flatnonzero(nodes == nodes[first[count > 1][0]])[:2] % len(nodes_a)
            raise InterfaceError(
                f'flanks "{names[flank_of_pair[k]]}" and "{names[flank_of_pair[other]]}" share the node '
                f"at {tell_place(position[k])}; leave a gap between them, or, "
                "where they go on without a corner, make them one flank"
            )


def _move(nodes: np.ndarray, axis: np.ndarray, size: int) -> scipy.sparse.csr_matrix:
    """Rows ``u . axis`` of nodes."""
    d = axis.shape[1]
    rows, columns = np.repeat(np.arange(len(nodes)), d), boundaries.list_dofs(nodes, d).ravel()
    return scipy.sparse.csr_matrix((axis.ravel(), (rows, columns)), shape=(len(nodes), size))
