"""Whether contact can hold floating bodies under their mean load, whether by friction only, and what is not pressed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import OptimizeResult, linprog

from ewr_fenicsx.errors import UnheldBody, name_pairs
from ewr_fenicsx.given import RealArray

_BALANCED = 1e-8  # unbalanced share of the mean load taken for zero
_PRESSED = 1e-6  # share of the mean load above which a normal force is none of the program's rounding
# Motion by rigid modes, over the largest of all rows, below which it is rounding: of meshes and of text files as well,
# where normals of a round joint seem to resist rotation
_SEEN = 1e-6
# Of the polygon around the disk of friction forces in a plane: at its corners they are 0.5 % too large; 8 % where it is
# asked what can be pressed, which takes longer
_SIDES, _FEW_SIDES = 32, 8


class Statics(NamedTuple):
    """Floating bodies at rest, and the mean forces that their pairs may carry.

    Attributes:
        normal_motion: ``(K, r)`` motion of the normal rows by the rigid modes.
        tangential_motion: ``(t, K, r)`` motion of the same pairs' ``t`` tangential rows, zero where a pair has none.
        smallest: ``(K,)`` least mean normal force: 0, -inf where bonded, ``largest`` where given [N].
        largest: ``(K,)`` largest mean normal force: inf, or what is given [N].
        friction: ``(K,)`` coefficients of friction, zero where a pair has none.
        rigid_load: ``(r,)`` work of the mean load on the rigid modes [N].
        limit: ``(K,)`` tangential force that a pair carries whatever its normal force [N].
    """

    normal_motion: RealArray
    tangential_motion: RealArray
    smallest: RealArray
    largest: RealArray
    friction: RealArray
    rigid_load: RealArray
    limit: RealArray


def takes_friction(statics: Statics) -> bool:
    """Whether it takes friction to hold the floating bodies, or normal forces do alone.

    A linear program over mean forces ``lam_N >= 0``, ``|lam_T| <= mu lam_N + limit`` for the smallest unbalanced load.
    With two tangents a polygon stands for the disk ``|lam_T|``. The last answers are remembered: every frequency of a
    sweep and every cycle of wear asks the same.

    Raises:
        UnheldBody: Nothing holds a body; names the pairs that the unheld motion opens, or else slides along, most.
    """
    return _takes_friction(*map(_pack, statics))


class _Packed(NamedTuple):
    """An array as what a call can be remembered by."""

    numbers: bytes
    shape: tuple[int, ...]

    def unpack(self) -> RealArray:
        return np.frombuffer(self.numbers).reshape(self.shape)


def _pack(array: RealArray) -> _Packed:
    return _Packed(np.asarray(array, dtype=float).tobytes(), array.shape)


@lru_cache(maxsize=64)
def _takes_friction(*packed: _Packed) -> bool:
    normal_motion, tangential_motion, smallest, largest, friction, rigid_load, limit = (a.unpack() for a in packed)
    r = rigid_load.size
    largest_motion = max(np.abs(normal_motion).max(initial=1e-300), np.abs(tangential_motion).max(initial=0.0))
    sees_all = np.linalg.matrix_rank(normal_motion, tol=_SEEN * largest_motion) == r
    bounds = list(zip(smallest, largest, strict=True))
    nothing = 0 * friction
    if sees_all:
        pressed = _state(normal_motion, tangential_motion, bounds, nothing, nothing, rigid_load)
        if pressed.leave_least()[0] <= _BALANCED:
            return False
    program = _state(normal_motion, tangential_motion, bounds, friction, limit, rigid_load)
    rest, motion = program.leave_least()
    pulls = (smallest < 0) & (friction > 0)
    if rest > _BALANCED and np.any(pulls):
        # the cone lets no bond pull: let each pull beside its pressing, so that nothing that holds is refused
        more = lambda values: np.concatenate([values, np.zeros((np.count_nonzero(pulls), *values.shape[1:]))])  # noqa: E731
        program = _state(
            np.concatenate([normal_motion, normal_motion[pulls]]),
            np.array([more(moved) for moved in tangential_motion]),
            bounds + [(low, 0.0) for low in smallest[pulls]],
            more(friction),
            more(limit),
            rigid_load,
        )
        rest, motion = program.leave_least()
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
        left = 100 * (1 - program.carry_most())
        raise UnheldBody(
            f"nothing holds a floating body: {left:.3g}% of the mean load stays unbalanced, whatever contact forces; "
            f"it drives a rigid motion that {moves}; turn the load round, raise the friction or the prescribed normal "
            "force, or support the body",
            worst,
        )
    return True


def find_unpressed(statics: Statics, pressed: np.ndarray) -> list[int]:
    """Pairs that no equilibrium presses, at floating bodies that no other contact keeps from moving off there.

    A normal force that never pulls and has no mean is zero throughout. Where neither the mean load asks for one nor
    others brace it, as a stop on the other side does, nothing touches the body, and where it lies is open. A linear
    program over the mean forces of ``takes_friction`` presses as many pairs as it can; those in doubt count as pressed.
    The last answers are remembered: a solve that fails asks before it climbs and where it says why.

    ``pressed``: ``(K,)`` pairs of which it is known that something presses them.
    """
    return [*_find_unpressed(*map(_pack, (*statics, pressed)))]


@lru_cache(maxsize=64)
def _find_unpressed(*packed: _Packed) -> tuple[int, ...]:
    normal_motion, tangential_motion, smallest, largest, friction, rigid_load, limit, known = (
        a.unpack() for a in packed
    )
    pressed = known > 0
    size = max(np.abs(normal_motion).max(initial=1e-300), np.abs(tangential_motion).max(initial=0.0))

    def find_free(loose: np.ndarray) -> RealArray:
        """``(r, m)`` rigid motions that no contact notices if these pairs ``(K,)`` do not."""
        rubs = (~loose & (friction > 0)) | (limit > 0)
        seen = np.vstack([normal_motion[~loose], *tangential_motion[:, rubs]])
        _, values, motions = np.linalg.svd(np.linalg.qr(seen, mode="r"))
        return motions[np.count_nonzero(values > _SEEN * size) :].T

    loose = (smallest == 0) & (largest > 0) & ~pressed
    if not np.any(loose) or find_free(loose).size == 0:
        return ()
    limit = np.where((smallest < 0) & (friction > 0), np.inf, limit)  # the cone lets no bond pull
    bounds = list(zip(smallest, largest, strict=True))
    program = _state(normal_motion, tangential_motion, bounds, friction, limit, rigid_load, _FEW_SIDES)
    pushes = np.flatnonzero(loose)
    loose[pushes] = program.press_most(pushes) <= _PRESSED
    free = find_free(loose)
    if np.abs(program.load @ free).max(initial=0.0) > _BALANCED:  # it presses less than the program sees
        return ()
    moved = np.abs(normal_motion @ free).max(axis=1, initial=0.0)
    return tuple(np.flatnonzero(loose & (moved > _SEEN * size)).tolist())


def list_most(moved: RealArray) -> list[int]:
    """The pairs that move most, three at most and none that moves by rounding; ``moved``: ``(K,)``, not negative."""
    return [int(k) for k in np.argsort(-moved, kind="stable")[:3] if moved[k] > _SEEN * moved.max()]


@dataclass(frozen=True)
class _Program:
    """Linear programs over mean forces, normal, then tangential, direction by direction; all over the load's size.

    Attributes:
        forces: ``(r, n)`` work of each on the rigid modes.
        cone: ``(q, n)`` and ``limits`` ``(q,)``: ``cone @ forces <= limits``, by a polygon with two tangents.
        bounds: Of each.
        load: ``(r,)`` work of the mean load on the rigid modes.
    """

    forces: RealArray
    cone: sparse.spmatrix
    limits: RealArray
    bounds: list
    load: RealArray

    def leave_least(self) -> tuple[float, RealArray]:
        """Smallest part of the load that is left over, by its largest component, and the motion it drives ``(r,)``."""
        r, n = self.forces.shape
        if not np.any(self.load):
            return 0.0, np.zeros(r)
        column = -np.ones((r, 1))
        upper = sparse.vstack(
            [
                np.vstack([np.hstack([self.forces, column]), np.hstack([-self.forces, column])]),
                sparse.hstack([self.cone, sparse.csr_matrix((self.cone.shape[0], 1))]),
            ]
        )
        bound = np.concatenate([-self.load, self.load, self.limits])
        found = _solve(np.arange(n + 1) == n, [*self.bounds, (0, np.inf)], A_ub=upper, b_ub=bound)
        push = found.ineqlin.marginals
        return float(found.x[-1]), push[r : 2 * r] - push[:r]

    def carry_most(self) -> float:
        """Largest share of the load that forces balance, whatever the basis of the rigid motions."""
        r, n = self.forces.shape
        found = _solve(
            -1.0 * (np.arange(n + 1) == n),
            [*self.bounds, (0, 1)],
            A_ub=sparse.hstack([self.cone, sparse.csr_matrix((self.cone.shape[0], 1))]),
            b_ub=self.limits,
            A_eq=np.column_stack([self.forces, self.load]),
            b_eq=np.zeros(r),
        )
        return float(found.x[-1])

    def press_most(self, pushes: np.ndarray) -> RealArray:
        """Normal forces, up to 1, of pairs ``pushes`` that only push, as many as can be pressed at once; 1 in doubt.

        All may grow in proportion, load, limits and given forces too: the sum is largest where most are pressed.
        """
        (r, n), k = self.forces.shape, pushes.size
        low, high = np.array(self.bounds).T
        given = np.where(low == high, low, 0.0)  # acts as the load does
        low, high = (np.where(low == high, 0.0, bound) for bound in (low, high))
        grown = np.column_stack([self.forces, self.load + self.forces @ given])  # the last: by how much all grow
        cone = sparse.hstack([self.cone, (self.cone @ given - self.limits)[:, None]])
        counted = sparse.csr_matrix((-np.ones(k), (np.arange(k), pushes)), (k, n + 1))
        found = linprog(
            np.repeat([0.0, -1.0], [n + 1, k]),
            bounds=[*zip(low, high, strict=True), (1, np.inf), *[(0, 1)] * k],
            A_ub=sparse.bmat([[cone, None], [counted, sparse.identity(k)]]),
            b_ub=np.zeros(self.limits.size + k),
            A_eq=sparse.hstack([grown, sparse.csr_matrix((r, k))]),
            b_eq=np.zeros(r),
            method="highs-ipm",
        )
        return found.x[n + 1 :] if found.status == 0 else np.ones(k)


def _state(
    normal_motion: RealArray,
    tangential_motion: RealArray,
    bounds: list,
    friction: RealArray,
    limit: RealArray,
    rigid_load: RealArray,
    sides: int = _SIDES,
) -> _Program:
    size, k = np.abs(rigid_load).max(initial=0.0) or 1.0, friction.size
    rubs = np.flatnonzero((friction > 0) | (limit > 0))
    angle = np.linspace(0, 2 * np.pi, 2 if len(tangential_motion) == 1 else sides, endpoint=False)
    toward = np.column_stack([np.cos(angle), np.sin(angle)])[:, : len(tangential_motion)]
    cone = sparse.csr_matrix((-friction[rubs], (np.arange(rubs.size), rubs)), (rubs.size, k))
    parts = [sparse.kron(np.ones((angle.size, 1)), cone), sparse.kron(toward, sparse.identity(rubs.size))]
    limits = np.tile(limit[rubs] / size, angle.size)
    bounded = np.isfinite(limits)  # what carries any force has no limit
    return _Program(
        np.hstack([normal_motion.T, *(motion[rubs].T for motion in tangential_motion)]),
        sparse.hstack(parts, format="csr")[bounded] if rubs.size else sparse.csr_matrix((0, k)),
        limits[bounded],
        [(low / size, high / size) for low, high in bounds] + [(-np.inf, np.inf)] * (toward.shape[1] * rubs.size),
        rigid_load / size,
    )


def _solve(cost: RealArray, bounds: list, **constraints: object) -> OptimizeResult:
    found = linprog(cost, bounds=bounds, method="highs", **constraints)
    if found.status != 0:
        raise UnheldBody(f"the static equilibrium of the floating bodies could not be examined: {found.message}")
    return found
