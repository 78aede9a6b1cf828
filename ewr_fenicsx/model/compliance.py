"""Dynamic condensation: the motion at the contact rows as a function of the contact forces, harmonic by harmonic.

``q_h = H_h lam_h + q_h^f`` with ``H_h = B (K + i h w D - (h w)^2 M)^-1 B^T``; for floating bodies the mean motion has
in addition a rigid part ``G alpha`` and the forces must balance: ``G^T lam_0 + R^T f_0 = 0``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ewr_fenicsx.errors import ModelError, name_pairs
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.model.receptance import GeneralisedInverse, NormalModes, find_normal_modes, solve_directly, superpose
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.model.restriction import bound_motion
from ewr_fenicsx.model.statics import list_most

_SEEN = 1e-10  # motion of rows by rigid modes, over what they could see of them, below which it is rounding
_BALANCED = 1e-12  # work of a load on rigid modes, over that of its parts, below which it is rounding


@dataclass(frozen=True, eq=False)
class DynamicCompliance:
    """Compliance of ``m`` contact rows at ``n_h`` harmonics of one frequency.

    Attributes:
        omega: Angular frequency [rad/s].
        flexibility: ``(n_h, m, m)`` complex ``H_h`` [m/N].
        free_motion: ``(n_h, m)`` complex motion under the loads alone [m].
        rigid_motion: ``(m, r)`` motion of the rows by the rigid modes ``G``; each column's largest entry is 1.
            No columns where the mean is not among the harmonics.
        rigid_load: ``(r,)`` work of the mean load on the rigid modes [N].
        outputs: Name -> ``(n_h, m + 1 + r)`` complex: the output's reaction to row forces, to the load, to rigid modes.
    """

    omega: float
    flexibility: ComplexArray
    free_motion: ComplexArray
    rigid_motion: RealArray
    rigid_load: RealArray
    outputs: Mapping[str, ComplexArray]

    def motion(self, forces: ComplexArray, rigid: RealArray) -> ComplexArray:
        """Motion ``(n_h, m)`` of the rows [m] under forces ``(n_h, m)`` [N] and rigid coordinates ``(r,)``."""
        motion = np.matmul(self.flexibility, forces[:, :, None])[:, :, 0] + self.free_motion
        if rigid.size:
            motion[0] += self.rigid_motion @ rigid
        return motion

    def output(self, name: str, forces: ComplexArray, rigid: RealArray) -> ComplexArray:
        """One-sided amplitudes ``(n_h,)`` of an output under the same arguments as ``motion``.

        Raises:
            KeyError: The model has no output of that name.
        """
        row = self.outputs[name]
        m = forces.shape[1]
        amplitudes = np.einsum("hm,hm->h", row[:, :m], forces) + row[:, m]
        if rigid.size:
            amplitudes[0] += row[0, m + 1 :] @ rigid
        return amplitudes

    def bound_rows(self, forces: ComplexArray) -> RealArray:
        """``(n_h, m)`` what the rows' motion would reach, rigid motion aside, if no forces and loads cancelled."""
        moved = np.einsum("hij,hj->hi", np.abs(self.flexibility), np.abs(forces))
        return moved + np.abs(self.free_motion)

    def bound_output(self, name: str, forces: ComplexArray) -> RealArray:
        """``(n_h,)`` what an output would reach, rigid motion aside, if no forces ``(n_h, m)`` and loads cancelled.

        Raises:
            KeyError: The model has no output of that name.
        """
        row, m = np.abs(self.outputs[name]), forces.shape[1]
        return np.einsum("hm,hm->h", row[:, :m], np.abs(forces)) + row[:, m]


def condense(
    model: ReducedModel,
    rows: RealArray,
    load: Mapping[int, ComplexArray],
    omega: float,
    orders: tuple[int, ...],
    generalised_inverse: GeneralisedInverse = "inertia relief",
    next_rows: RealArray | None = None,
) -> DynamicCompliance:
    """Compliance of contact rows at the harmonics of one frequency, each computed once.

    Args:
        model: The reduced model.
        rows: ``(m, n)`` contact rows ``B``.
        load: Harmonic -> ``(n,)`` complex amplitude [N].
        omega: Angular frequency [rad/s], positive unless only the mean is asked for.
        orders: Harmonics.
        generalised_inverse: How the singular static stiffness of floating bodies is inverted; no result depends on it.
        next_rows: ``(m, n)`` what the next sector's coordinates of a ring add to the rows; None: nothing.

    Raises:
        ModelError: No positive frequency, a harmonic that hits an undamped mode exactly, or a rigid motion that the
            rows do not see.
    """
    if omega <= 0 and orders != (0,):
        raise ModelError(
            f"frequency = {omega / 2 / np.pi:g} Hz, with harmonics {orders} and loads at harmonics {sorted(load)}; "
            "give a positive frequency, or where nothing oscillates no load but that of harmonic 0"
        )
    m, names = rows.shape[0], list(model.outputs)
    found = _respond_at(model, _Itself(rows), omega, generalised_inverse, _Itself(next_rows))
    readers = found.read()
    modes = scale_rigid_modes(model, rows) if orders[0] == 0 else np.zeros((model.size, 0))
    responses = np.zeros((len(orders), readers.shape[0], m + 1), dtype=complex)
    for j, h in enumerate(orders):
        if m:
            responses[j, :, :m] = found.to_rows(h)
        if h in load:
            responses[j, :, m] = found.to_load(h, load[h])
    motion, rigid_load = readers @ modes, _load_rigid_modes(modes, load.get(0, np.zeros(model.size)).real)
    if modes.shape[1]:  # another generalised inverse, as valid: it keeps H_0 positive where few rows are closed
        stiffness = np.trace((motion @ motion.T)[:m, :m]) / max(np.trace(responses[0, :m, :m].real), 1e-300)
        work = np.column_stack([motion[:m].T, rigid_load])
        responses[0] += motion @ work / stiffness
    rigid = np.zeros((len(orders), readers.shape[0], modes.shape[1]))
    rigid[0] = motion
    return DynamicCompliance(
        omega=omega,
        flexibility=np.ascontiguousarray(responses[:, :m, :m]),
        free_motion=responses[:, :m, m].copy(),
        rigid_motion=rows @ modes,
        rigid_load=rigid_load,
        outputs={n: np.concatenate([responses[:, m + i], rigid[:, m + i]], axis=1) for i, n in enumerate(names)},
    )


def _load_rigid_modes(modes: RealArray, load: RealArray) -> RealArray:
    """``(r,)`` work of a load ``(n,)`` on rigid modes: none if it balances but for rounding, as on a spinning ring."""
    work = modes.T @ load
    return np.where(np.abs(work) > _BALANCED * (np.abs(modes.T) @ np.abs(load)), work, 0.0)


class Responses:
    """What contact rows and outputs do under forces at one frequency: to those of the rows, each harmonic once.

    Problems that differ in weights, closure, laws' parameters, samples or in which harmonics they keep share them.

    Args:
        model, omega, generalised_inverse: As in ``condense``.
        rows, next_rows: ``(m, n)`` contact rows, and what the next sector adds to them or None.
    """

    def __init__(
        self,
        model: ReducedModel,
        rows: RealArray,
        omega: float,
        generalised_inverse: GeneralisedInverse,
        next_rows: RealArray | None = None,
    ):
        self.model, self.omega, self.generalised_inverse = model, omega, generalised_inverse
        self.rows, self.next_rows = rows, next_rows
        self._seen: dict[int, RealArray | ComplexArray] = {}  # by wave, once for all its harmonics
        self._known: dict[int, ComplexArray] = {}

    def read(self, wave: int = 0) -> RealArray | ComplexArray:
        """``(p, n)`` rows, then those of the outputs, in a wave of the ring."""
        return np.vstack([self.model.see_wave(self.rows, self.next_rows, wave), self.model.read_outputs(wave)])

    def to_rows(self, h: int) -> ComplexArray:
        """``(p, m)`` to unit forces at the rows, at a harmonic."""
        if h not in self._known:
            self._known[h] = self._respond_to_rows(h)
        return self._known[h]

    def to_load(self, h: int, force: ComplexArray) -> ComplexArray:
        """``(p,)`` to a load ``(n,)`` at a harmonic."""
        if modes := self._uncouple(h):  # the fewest products first
            return self._see(h, modes) @ (modes.gain(h * self.omega) * (modes.shapes.conj().T @ force))
        return self._solve(h, force[:, None])[:, 0]

    def _respond_to_rows(self, h: int) -> ComplexArray:
        if modes := self._uncouple(h):
            seen = self._see(h, modes)
            return superpose(seen, modes.gain(h * self.omega), seen[: len(self.rows)].conj().T)
        return self._solve(h, self.read(self.model.wave_of(h))[: len(self.rows)].conj().T)

    def _uncouple(self, h: int) -> NormalModes | None:
        pinned = h == 0 and self.generalised_inverse == "pinned"
        return None if pinned else find_normal_modes(self.model, self.model.wave_of(h))

    def _see(self, h: int, modes: NormalModes) -> RealArray | ComplexArray:
        """What the readers see of modes, ``(p, n)``."""
        wave = self.model.wave_of(h)
        if wave not in self._seen:
            self._seen[wave] = self.read(wave) @ modes.shapes
        return self._seen[wave]

    def _solve(self, h: int, forces: ComplexArray) -> ComplexArray:
        wave = self.model.wave_of(h)
        return self.read(wave) @ solve_directly(self.model, h * self.omega, forces, self.generalised_inverse, wave)


@dataclass(frozen=True, eq=False)
class _Itself:
    """An array, or none, that equals itself alone: by what something is remembered."""

    array: RealArray | None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and other.array is self.array

    def __hash__(self) -> int:
        return id(self.array)


@lru_cache(maxsize=2)  # as much memory as a compliance each
def _respond_at(
    model: ReducedModel, rows: _Itself, omega: float, generalised_inverse: GeneralisedInverse, next_rows: _Itself
) -> Responses:
    return Responses(model, rows.array, omega, generalised_inverse, next_rows.array)


def scale_rigid_modes(model: ReducedModel, rows: RealArray) -> RealArray:
    """Rigid modes ``(n, r)`` orthogonalised as the contact rows see them, each with a largest row motion of 1.

    Raises:
        ModelError: A rigid motion moves no contact row: nothing could ever hold it.
    """
    modes = model.rigid_modes
    if modes.shape[1] == 0:
        return modes
    motion = np.abs(rows @ modes).max(axis=0, initial=0.0)
    seen = motion > _SEEN * bound_motion(model, rows)
    modes = modes / np.where(seen, motion, np.inf)  # what is rounding must not become a motion
    _, values, turn = np.linalg.svd(rows @ modes, full_matrices=True)
    if rows.shape[0] < modes.shape[1] or values[-1] <= 1e-10 * max(values[0], 1e-300):
        share = turn[-1] / np.where(seen, motion, 1.0)
        raise ModelError(
            f"{modes.shape[1]} rigid motions of floating bodies, but the forces of contact tell only "
            f"{int((values > 1e-10 * values.max(initial=0.0)).sum())} of them apart: one that they do not see "
            f"{_tell_unseen(model, share)}"
        )
    modes = modes @ turn.T
    return modes / np.abs(rows @ modes).max(axis=0)


def _tell_unseen(model: ReducedModel, share: RealArray) -> str:
    """Which pairs a rigid motion moves that no unknown force sees, and what to do; ``share``: ``(r,)`` of the modes."""

    def list_moving(directions: Sequence[str]) -> list[int]:
        rows = [model.rows(direction) for direction in directions]
        moved = np.linalg.norm([along @ model.rigid_modes @ share for along in rows], axis=0)
        least = _SEEN * bound_motion(model, np.vstack(rows)) @ np.abs(share)
        return list_most(np.where(moved > least, moved, 0.0))

    if model.tangents and (slides := list_moving(model.tangent_directions)):
        told = f"slides along {name_pairs(slides)} without friction"
        return f"{told}; clamp the body, bond a flank, or add friction or pairs"
    if model.normal is not None and (opens := list_moving(["normal"])):
        return (
            f"moves {name_pairs(opens)} along the normal, where forces are given and hold nothing; clamp the body, "
            'bond a flank, or let contact push back: normal = "unilateral"'
        )
    return "moves no pair, so that no contact could hold it; clamp a body, or add pairs that it moves"
