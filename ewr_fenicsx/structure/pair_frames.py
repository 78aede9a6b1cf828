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


def point_outward(position: np.ndarray, normal: np.ndarray, facets: Sequence[Sequence[Sequence[int]]]) -> np.ndarray:
    """Unit normals of a side's nodes ``(n, d)``; where it is round, across the circles through neighbouring nodes.

    Means over the facets that meet at a node are askew: by half the angle of a facet where a flank ends, and by half of
    the difference where unlike facets meet. A pin in a part of a bore, which only friction keeps from turning, was
    wedged by that, and turned until its last node jammed.

    Args:
        position: Of the nodes, ``(n, d)`` [m].
        normal: ``integral N n ds``, ``(n, d)``.
        facets: Edges of each, as ``gather_facets`` has them.
    """
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = np.divide(normal, size, out=np.zeros_like(normal), where=size > 0)
    lines, ends = _follow_lines(facets)
    along, bend = {}, {}  # of the circle at a node, by the next node on its line
    for k, a, b in lines:
        before, after = position[k] - position[a], position[b] - position[k]
        aside = after - (after @ before) / (before @ before) * before
        inwards = np.sign((after - before) @ unit[k])
        along[k, a] = before / (before @ before) + after / (after @ after)
        bend[k, a] = bend[k, b] = (
            inwards * 2 * np.linalg.norm(aside) / (np.linalg.norm(after) * np.linalg.norm(before + after))
        )
    across: dict[int, list[np.ndarray]] = {}
    for k, a, b in lines:
        here, near = bend[k, a], [bend[i, k] for i in (a, b) if (i, k) in bend]
        if not near or not all(_ALIKE * here**2 < there * here < here**2 / _ALIKE for there in near):
            continue  # straight, or from straight to round
        across.setdefault(k, []).append(along[k, a])
        for end in {(a, k), (b, k)} & ends:  # the same circle, which makes the same angle with the edge between
            edge = position[k] - position[end[0]]
            mirrored = 2 * (along[k, a] @ edge) / (edge @ edge) * edge - along[k, a]
            across.setdefault(end[0], []).append(mirrored)
    turned = set()
    for k, circles in across.items():
        plane = np.linalg.qr(np.transpose(circles))[0]
        askew = plane.T @ unit[k]
        if np.linalg.norm(askew) > _SAME:
            unit[k] -= plane @ askew
            turned.add(k)
    for first, last, *between in (edge for facet in facets for edge in facet):
        if {first, last} <= turned:
            unit[between] = unit[first] / np.linalg.norm(unit[first]) + unit[last] / np.linalg.norm(unit[last])
            turned.update(between)
    turned = sorted(turned)
    unit[turned] /= np.linalg.norm(unit[turned], axis=1, keepdims=True)
    return unit


def _follow_lines(
    facets: Sequence[Sequence[Sequence[int]]],
) -> tuple[list[tuple[int, int, int]], set[tuple[int, int]]]:
    """Lines of edges: each corner that one goes on through with those beside it; each that one ends at with the next.

    A line goes on to the one edge that has no facet in common with the last. It ends where the side does.
    """
    beside: dict[int, dict[int, set[int]]] = {}
    for number, facet in enumerate(facets):
        for first, last, *_ in facet:
            beside.setdefault(first, {}).setdefault(last, set()).add(number)
            beside.setdefault(last, {}).setdefault(first, set()).add(number)
    lines, ends = [], set()
    for k, around in beside.items():
        opposite = {a: [b for b in around if not around[a] & around[b]] for a in around}
        lines += [(k, a, b[0]) for a, b in opposite.items() if len(b) == 1 and a < b[0] and opposite[b[0]] == [a]]
        if any(len(common) == 1 for common in around.values()):
            ends |= {(k, a) for a, b in opposite.items() if not b}
    return lines, ends


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
