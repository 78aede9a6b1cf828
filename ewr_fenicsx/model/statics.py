"""Whether contact can hold floating bodies under their mean load, and whether it takes friction to do so."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from ewr_fenicsx.errors import UnheldBody, name_pairs
from ewr_fenicsx.given import RealArray

_BALANCED = 1e-8  # unbalanced share of the mean load taken for zero
# Motion by rigid modes, over the largest of all rows, below which it is rounding: of meshes and of text files as well,
# where normals of a round joint seem to resist rotation
_SEEN = 1e-6
_SIDES = 32  # of the polygon around the disk of friction forces in a plane; at its corners they are 0.5 % too large


def takes_friction(
    normal_motion: RealArray,
    tangential_motion: RealArray,
    smallest: RealArray,
    largest: RealArray,
    friction: RealArray,
    rigid_load: RealArray,
    limit: RealArray,
) -> bool:
    """Whether it takes friction to hold the floating bodies, or normal forces do alone.

    A linear program over mean forces ``lam_N >= 0``, ``|lam_T| <= mu lam_N + limit`` for the smallest unbalanced load.
    With two tangents a polygon stands for the disk ``|lam_T|``. The last answers are remembered: every frequency of a
    sweep and every cycle of wear asks the same.

    Args:
        normal_motion: ``(K, r)`` motion of the normal rows by the rigid modes.
        tangential_motion: ``(t, K, r)`` motion of the same pairs' ``t`` tangential rows, zero where a pair has none.
        smallest: ``(K,)`` least mean normal force: 0, -inf where bonded, ``largest`` where given [N].
        largest: ``(K,)`` largest mean normal force: inf, or what is given [N].
        friction: ``(K,)`` coefficients of friction, zero where a pair has none.
        rigid_load: ``(r,)`` work of the mean load on the rigid modes [N].
        limit: ``(K,)`` tangential force that a pair carries whatever its normal force [N].

    Raises:
        UnheldBody: Nothing holds a body; names the pairs that the unheld motion opens, or else slides along, most.
    """
    arrays = normal_motion, tangential_motion, smallest, largest, friction, rigid_load, limit
    return _takes_friction(*((array.tobytes(), array.shape) for array in arrays))


@lru_cache(maxsize=64)
def _takes_friction(*packed: tuple[bytes, tuple[int, ...]]) -> bool:
    arrays = (np.frombuffer(numbers).reshape(shape) for numbers, shape in packed)
    normal_motion, tangential_motion, smallest, largest, friction, rigid_load, limit = arrays
    r = rigid_load.size
    largest_motion = max(np.abs(normal_motion).max(initial=1e-300), np.abs(tangential_motion).max(initial=0.0))
    sees_all = np.linalg.matrix_rank(normal_motion, tol=_SEEN * largest_motion) == r
    bounds = list(zip(smallest, largest, strict=True))
    nothing = 0 * friction
    if sees_all and _unbalanced(normal_motion, tangential_motion, bounds, nothing, nothing, rigid_load)[0] <= _BALANCED:
        return False
    rest, motion = _unbalanced(normal_motion, tangential_motion, bounds, friction, limit, rigid_load)
    pulls = (smallest < 0) & (friction > 0)
    if rest > _BALANCED and np.any(pulls):
        # the cone lets no bond pull: let each pull beside its pressing, so that nothing that holds is refused
        more = lambda values: np.concatenate([values, np.zeros((np.count_nonzero(pulls), *values.shape[1:]))])  # noqa: E731
        rest, motion = _unbalanced(
            np.concatenate([normal_motion, normal_motion[pulls]]),
            np.array([more(moved) for moved in tangential_motion]),
            bounds + [(low, 0.0) for low in smallest[pulls]],
            more(friction),
            more(limit),
            rigid_load,
        )
    rubs = (friction > 0) | (limit > 0)
    seen = np.vstack([normal_motion, *tangential_motion[:, rubs]])
    if np.linalg.matrix_rank(seen, tol=_SEEN * largest_motion) < r:
        free = np.linalg.svd(seen)[2][-1]
        slides = list_most(np.linalg.norm(tangential_motion @ free, axis=0))
        moves = f"slides along {name_pairs(slides)}, where no friction holds it" if slides else "moves no pair"
        raise UnheldBody(
            f"a floating body can move without any contact noticing: it {moves}; add friction (with a mean: "
            'static_friction = "resolved" or "held"), a support or a flank across it'
        )
    if rest > _BALANCED:
        opening, sliding = normal_motion @ motion, np.linalg.norm(tangential_motion @ motion, axis=0)
        # a slide's multiplier climbs the friction cone (of the polygon up to a corner): what it opens by no more than
        # that stays closed
        climbs = friction * sliding / (np.cos(np.pi / _SIDES) if len(tangential_motion) > 1 else 1.0)
        parts = opening - climbs > _SEEN * np.abs(motion).max() * largest_motion
        how, most = ("opens", np.where(parts, opening, 0.0)) if np.any(parts) else ("slides along", sliding)
        worst = list_most(most)
        moves = f"{how} {name_pairs(worst)} most" if worst else "opens no pair"
        raise UnheldBody(
            f"nothing holds a floating body: {100 * rest:.3g}% of the mean load stays unbalanced whatever the contact "
            f"forces; it drives a rigid motion that {moves}; turn the load round, raise the friction or the "
            "prescribed normal force, or support the body",
            worst,
        )
    return True


def list_most(moved: RealArray) -> list[int]:
    """The pairs that move most, three at most and none that moves by rounding; ``moved``: ``(K,)``, not negative."""
    return [int(k) for k in np.argsort(-moved, kind="stable")[:3] if moved[k] > _SEEN * moved.max()]


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
    angle = np.linspace(0, 2 * np.pi, 2 if len(tangential_motion) == 1 else _SIDES, endpoint=False)
    toward = np.column_stack([np.cos(angle), np.sin(angle)])[:, : len(tangential_motion)]
    sides, sliding = angle.size, toward.shape[1] * rubs.size
    # unknowns: lam_N (k), lam_T (rubbing, direction by direction), t >= |unbalanced|
    forces = np.hstack([normal_motion.T, *(motion[rubs].T for motion in tangential_motion)])
    column = -np.ones((r, 1))
    upper = np.vstack([np.hstack([forces, column]), np.hstack([-forces, column])])
    if rubs.size:
        limits = sparse.csr_matrix((-friction[rubs], (np.arange(rubs.size), rubs)), (rubs.size, k))
        cone = [sparse.kron(np.ones((sides, 1)), limits), sparse.kron(toward, sparse.identity(rubs.size))]
        upper = sparse.vstack([upper, sparse.hstack([*cone, sparse.csr_matrix((sides * rubs.size, 1))])])
    bound = np.concatenate([-rigid_load / size, rigid_load / size, np.tile(limit[rubs] / size, sides)])
    bounds = [(low / size, high / size) for low, high in bounds] + [(-np.inf, np.inf)] * sliding + [(0, np.inf)]
    cost = np.zeros(k + sliding + 1)
    cost[-1] = 1.0
    found = linprog(cost, A_ub=upper, b_ub=bound, bounds=bounds, method="highs")
    if found.status != 0:
        raise UnheldBody(f"the static equilibrium of the floating bodies could not be examined: {found.message}")
    push = found.ineqlin.marginals
    return float(found.x[-1]), push[r : 2 * r] - push[:r]
