"""Contact nodes of a flank: their unit vectors, what supports make of these, how sharply they turn, and their order."""

from __future__ import annotations

import numpy as np


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
