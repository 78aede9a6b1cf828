"""Whether contact can hold floating bodies under their mean load, and whether it takes friction to do so."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import linprog

from ewr_fenicsx.errors import UnheldBody
from ewr_fenicsx.reduced_model import RealArray

_BALANCED = 1e-8  # unbalanced share of the mean load taken for zero


def find_holding(
    normal_motion: RealArray,
    tangential_motion: RealArray,
    smallest: RealArray,
    largest: RealArray,
    friction: RealArray,
    rigid_load: RealArray,
    limit: RealArray,
) -> Literal["normal", "friction"]:
    """What holds the floating bodies: normal forces alone, or friction as well.

    A linear program over mean forces ``lam_N >= 0``, ``|lam_T| <= mu lam_N + limit`` for the smallest unbalanced load.

    Args:
        normal_motion: ``(K, r)`` motion of the normal rows by the rigid modes.
        tangential_motion: ``(K, r)`` motion of the same pairs' tangential rows, zero where a pair has none.
        smallest: ``(K,)`` least mean normal force: 0, -inf where bonded, ``largest`` where given [N].
        largest: ``(K,)`` largest mean normal force: inf, or what is given [N].
        friction: ``(K,)`` coefficients of friction, zero where a pair has none.
        rigid_load: ``(r,)`` work of the mean load on the rigid modes [N].
        limit: ``(K,)`` tangential force that a pair carries whatever its normal force [N].

    Raises:
        UnheldBody: Nothing holds a body; names the pairs that the unheld motion opens most.
    """
    r = rigid_load.size
    sees_all = np.linalg.matrix_rank(normal_motion, tol=1e-9 * np.abs(normal_motion).max(initial=1e-300)) == r
    bounds = list(zip(smallest, largest, strict=True))
    nothing = 0 * friction
    if sees_all and _unbalanced(normal_motion, tangential_motion, bounds, nothing, nothing, rigid_load)[0] <= _BALANCED:
        return "normal"
    rest, motion = _unbalanced(normal_motion, tangential_motion, bounds, friction, limit, rigid_load)
    rubs = (friction > 0) | (limit > 0)
    seen = np.vstack([normal_motion, tangential_motion[rubs]])
    if np.linalg.matrix_rank(seen, tol=1e-9 * np.abs(seen).max(initial=1e-300)) < r:
        free = np.linalg.svd(seen)[2][-1]
        raise UnheldBody(
            "a floating body can move without any contact noticing: its rigid motion is "
            f"{np.array2string(free, precision=3)} in the model's rigid modes; add friction (resolved), a support or a "
            "flank across it"
        )
    if rest > _BALANCED:
        opening = normal_motion @ motion
        worst = [int(k) for k in np.argsort(-opening)[:3] if opening[k] > 0]
        opens = f"pairs {', '.join(map(str, worst))} most" if worst else "no pair"
        raise UnheldBody(
            f"nothing holds a floating body: {rest:.0%} of the mean load stays unbalanced whatever the contact forces; "
            f"it drives a rigid motion that opens {opens}; turn the load round, raise the friction or the prescribed "
            "normal force, or support the body",
            worst,
        )
    return "friction"


def _unbalanced(
    normal_motion: RealArray,
    tangential_motion: RealArray,
    bounds: list,
    friction: RealArray,
    limit: RealArray,
    rigid_load: RealArray,
) -> tuple[float, RealArray]:
    """Smallest unbalanced share of the mean load, and the rigid motion that it drives ``(r,)``."""
    size, r = np.abs(rigid_load).max(initial=0.0), rigid_load.size
    if size == 0:
        return 0.0, np.zeros(r)
    k = friction.size
    rubs = np.flatnonzero((friction > 0) | (limit > 0))
    # unknowns: lam_N (k), lam_T (rubbing), t >= |unbalanced|
    forces = np.hstack([normal_motion.T, tangential_motion[rubs].T])
    cone = np.zeros((2 * rubs.size, k + rubs.size))
    for half, sign in enumerate((1.0, -1.0)):
        rows = half * rubs.size + np.arange(rubs.size)
        cone[rows, rubs] = -friction[rubs]
        cone[rows, k + np.arange(rubs.size)] = sign
    column = -np.ones((r, 1))
    upper = np.vstack(
        [np.hstack([forces, column]), np.hstack([-forces, column]), np.hstack([cone, np.zeros((len(cone), 1))])]
    )
    bound = np.concatenate([-rigid_load / size, rigid_load / size, np.tile(limit[rubs] / size, 2)])
    bounds = [(low / size, high / size) for low, high in bounds] + [(-np.inf, np.inf)] * rubs.size + [(0, np.inf)]
    cost = np.zeros(k + rubs.size + 1)
    cost[-1] = 1.0
    found = linprog(cost, A_ub=upper, b_ub=bound, bounds=bounds, method="highs")
    if found.status != 0:
        raise UnheldBody(f"the static equilibrium of the floating bodies could not be examined: {found.message}")
    push = found.ineqlin.marginals
    return float(found.x[-1]), push[r : 2 * r] - push[:r]
