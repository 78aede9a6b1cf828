"""Contact nodes of a flank: their unit vectors, what supports make of these, how sharply they turn, and their order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ewr_fenicsx.errors import InterfaceError
from ewr_fenicsx.structure.boundaries import tell_place

STRAIGHT = 1.0  # degrees to which a flank is at right angles to what holds it
_ALIKE = 2 / 3  # curvatures of neighbouring nodes, one over the other, from where on a side is round there
_SAME = 1e-9  # angle between normals that are one but for rounding
SHARPEST = 70.0  # degrees from edge to edge: more is a corner, less a coarse curve (a bore of six edges has 60)


def point_outward(position: np.ndarray, normal: np.ndarray, edges: Sequence[Sequence[int]]) -> np.ndarray:
    """Unit normals of a side's nodes ``(n, d)``; where it is round in a plane, of circles through neighbouring nodes.

    Means over the edges that meet at a node are askew: by half the angle of an edge where a flank ends, and by half of
    the difference where unlike edges meet. A pin in a part of a bore, which only friction keeps from turning, was
    wedged by that, and turned until its last node jammed.

    Args:
        position: Of the nodes, ``(n, d)`` [m].
        normal: ``integral N n ds``, ``(n, d)``.
        edges: Of a plane side, both ends of each and the node between; of a solid's none.
    """
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = np.divide(normal, size, out=np.zeros_like(normal), where=size > 0)
    beside: list[list[int]] = [[] for _ in position]
    for first, last, *between in edges:
        beside[first].append(last)
        beside[last].append(first)
        for node in between:
            beside[node] = [first, last]
    along, bend = {}, {}
    for k, others in enumerate(beside):
        if len(others) == 2:
            before, after = position[k] - position[others[0]], position[others[1]] - position[k]
            along[k] = before / (before @ before) + after / (after @ after)  # the circle's own direction
            sides = [np.linalg.norm(way) for way in (before, after, before + after)]
            inwards = np.sign((after - before) @ unit[k])
            bend[k] = inwards * 2 * abs(before[0] * after[1] - before[1] * after[0]) / np.prod(sides)
    for k, others in enumerate(beside):
        c = k if k in bend else others[0] if len(others) == 1 else None
        near = [bend[i] for i in beside[c] if i in bend] if c in bend else []
        if not near or not all(_ALIKE * bend[c] ** 2 < b * bend[c] < bend[c] ** 2 / _ALIKE for b in near):
            continue  # straight, or from straight to round
        x, y = along[c]
        if c != k:  # an end: of the next node's circle, which makes the same angle with the edge between
            edge = position[c] - position[k]
            x, y = 2 * (along[c] @ edge) / (edge @ edge) * edge - along[c]
        askew = unit[k] @ (x, y) / np.hypot(x, y)
        if abs(askew) > _SAME:
            unit[k] = np.array([y, -x]) / np.hypot(x, y) * np.sign(unit[k] @ (y, -x))
    return unit


def turn_tangents(normal: np.ndarray) -> np.ndarray:
    """Tangents ``(K_c, d - 1, d)`` of unit normals ``(K_c, d)``, as ``Interface`` has them."""
    if normal.shape[1] == 2:
        return np.stack([-normal[:, 1], normal[:, 0]], axis=1)[:, None]
    first = np.cross(np.where(np.abs(normal[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]), normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first)], axis=1)


def turn_along_supports(normal: np.ndarray, still: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals ``(K_c, d)`` and tangents of pairs; at right angles to axes along which both nodes are held.

    On a plane of symmetry a flank's own normals, means over one side of it, may point out of the plane by a little. Of
    a solid's tangents the second is then along the axis.

    Args:
        normal: As the flanks have them.
        still: ``(K_c, d)`` axes along which both nodes of a pair are held, none of them across the flank.
    """
    within = np.where(still, 0.0, normal)
    turned = np.where(still.any(axis=1)[:, None], within / np.linalg.norm(within, axis=1)[:, None], normal)
    tangents = turn_tangents(turned)
    for k in np.flatnonzero(still.sum(axis=1) == 1) if normal.shape[1] == 3 else ():
        axis = still[k].astype(float)
        tangents[k] = np.cross(axis, turned[k]), axis
    return turned, tangents


def measure_turn(size: np.ndarray, normal: np.ndarray, products: np.ndarray) -> np.ndarray:
    """Angle between the normals of the edges or faces that meet at each node, however large each is, ``(n,)`` [degree].

    Args:
        size: ``integral N ds``, ``(n,)`` [m, of solids m^2].
        normal: ``integral N n ds``, ``(n, d)``.
        products: ``integral N n n^T ds``, ``(n, d, d)``.

    With shares ``w_i`` of normals at angles ``t_ij``, their mean is shorter than one: ``1 - |mean|^2`` is the sum of
    ``2 w_i w_j (1 - cos t_ij)`` over all pairs of them, and ``1 - |P|^2`` of the mean P of ``n n^T``, which has the
    trace one, that of ``2 w_i w_j sin^2 t_ij``. So their quotient is one and the cosine; of more than two normals, a
    mean cosine in which sharp pairs count most.
    """
    share = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    missing = 1 - ((normal * share[:, None]) ** 2).sum(axis=1)
    spread = 1 - ((products * share[:, None, None]) ** 2).sum(axis=(1, 2))
    bent = (missing > 0.01) & (size > 0)  # less: straight to rounding, or curved inside an edge
    cosine = np.divide(spread, missing, out=np.full_like(size, 2.0), where=bent) - 1
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def check_smooth(name: str, position: np.ndarray, turn: np.ndarray) -> None:
    """Refuses a flank that turns a corner, by the places ``(n, d)`` [m] of its nodes and their ``measure_turn``.

    Raises:
        InterfaceError: Names the corner.
    """
    k = int(np.argmax(turn))
    if turn[k] > SHARPEST:
        raise InterfaceError(
            f'flank "{name}" turns a corner of {turn[k]:.0f} degrees at {tell_place(position[k])}: a pair '
            f"there has no normal, it would be a wedge (curves turn by up to {SHARPEST:.0f} degrees at a node); "
            "end the flank short of the corner on both sides of it, as two flanks with an edge between that is on none"
        )


def check_free_to_part(
    names: Sequence[str], flank_of_pair: np.ndarray, position: np.ndarray, normal: np.ndarray, still: np.ndarray
) -> None:
    """Refuses pairs both nodes of which are held across their flank, or askew where it does not curve that way.

    Args:
        names: Of the flanks.
        flank_of_pair, position, normal: As ``Interface`` has them.
        still: ``(K_c, d)`` axes along which both nodes of a pair are held.

    Raises:
        InterfaceError: Names the flank and the pair's place.
    """
    tilt = np.degrees(np.arcsin(np.minimum(1.0, np.linalg.norm(np.where(still, normal, 0.0), axis=1))))
    for k in np.argsort(-tilt)[: np.count_nonzero(tilt > STRAIGHT)]:
        others = (flank_of_pair == flank_of_pair[k]) & ~still.any(axis=1)
        curves = np.degrees(np.arccos(np.clip(normal[others] @ normal[k], -1.0, 1.0))).max(initial=0.0)
        if tilt[k] < SHARPEST / 2 and curves > tilt[k] / 2:
            continue
        axes = " and ".join(axis for axis, is_still in zip("xyz", still[k], strict=False) if is_still)
        how = "and cannot part" if tilt[k] >= SHARPEST / 2 else f"which is {tilt[k]:.0f} degrees askew to it"
        raise InterfaceError(
            f'flank "{names[flank_of_pair[k]]}": both nodes at {tell_place(position[k])} are held along {axes}, {how}: '
            "a plane of symmetry stands at right angles to its flanks; take the flank out of the boundary that is "
            "held, or end it short of that"
        )


def follow_tangent(position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Order of a plane side's nodes, one after the other along its tangent, wherever that turns, as round a bore."""
    mean = normal.mean(axis=0)
    if np.linalg.norm(mean) < 1e-6:  # a closed curve, or opposite faces: begin at the lowest node
        mean = np.array([1.0, 0.0])
    along = position @ np.array([-mean[1], mean[0]])
    first = np.lexsort([position[:, 0], np.round(along / np.ptp(position, axis=0).max(), 9)])[0]
    order, left = [first], np.delete(np.arange(len(along)), first)
    while len(left):
        step = position[left] - position[order[-1]]
        x, y = normal[order[-1]]
        nearest_ahead = np.argmin(2 * np.linalg.norm(step, axis=1) - step @ np.array([-y, x]))
        order.append(left[nearest_ahead])
        left = np.delete(left, nearest_ahead)
    return np.array(order)


def follow_rows(position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Order of the nodes of a solid's side: along its mean second tangent, where these are alike its first."""
    mean = normal.mean(axis=0)
    size = np.linalg.norm(mean)
    mean = mean / size if size > 1e-6 else np.array([1.0, 0.0, 0.0])  # a closed surface, or opposite faces
    first, second = turn_tangents(mean[None])[0] @ position.T
    return np.lexsort(np.round([first, second] / np.ptp(position, axis=0).max(), 9))
