"""Elimination of the contact rows that do not change status over the period.

Their law derivatives are constant in time, so their equations are uncoupled in harmonics: each harmonic is a small
complex system. What is left is real and dense: the rows that do change, and the rigid coordinates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ewr_fenicsx.balance.law_derivatives import Derivative
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.model.compliance import DynamicCompliance
from ewr_fenicsx.problem.contact_system import ContactSystem
from ewr_fenicsx.problem.harmonics import FourierBasis


class Equations(Protocol):
    """What the linear algebra needs to know of a harmonic balance with ``m`` rows and ``r`` rigid coordinates.

    Attributes:
        system, basis, compliance: What is balanced.
        rows: m.
        rigid: r.
        rate: ``(n_h,)`` factor of each harmonic in a time derivative [1/s].
        rigid_motion: ``(m, r)`` motion of the rows by the scaled rigid coordinates [m/N].
        static_row, static_force_row, static_displacement_row: ``(m,)`` weights of the mean equations.
        unknown: ``(n_c, m)`` which coefficients are unknown.
        size: Number of unknowns, rigid coordinates among them.
        force_unit: Force that counts as one [N].
    """

    system: ContactSystem
    basis: FourierBasis
    compliance: DynamicCompliance
    rows: int
    rigid: int
    rate: ComplexArray
    rigid_motion: RealArray
    static_row: RealArray
    static_force_row: RealArray
    static_displacement_row: RealArray
    unknown: np.ndarray
    size: int
    force_unit: float

    def unpack(self, unknowns: RealArray) -> tuple[ComplexArray, RealArray]:
        """Force amplitudes ``(n_h, m)`` [N] and rigid coordinates ``(r,)`` [m] from scaled unknowns."""

    def place(self, vector: RealArray) -> RealArray:
        """Coefficients ``(n_c, m)`` of a vector like the unknowns."""


# Added to the diagonal of H in the Jacobian only, relative to each row's flexibility: redundant pairs stay solvable.
REDUNDANCY = 1e-13
# Matrix entries made at a time: few calls on small joints, temporaries that fit the cache on large ones.
BATCH = 1 << 16


def apply_harmonics(basis: FourierBasis, T: RealArray, V: ComplexArray) -> RealArray:
    """``T . V``: law derivatives T applied to variables that depend on the mixed forces, harmonic by harmonic, by V.

    Args:
        basis: The harmonics.
        T: ``(K, n_c, n_c)`` on real coefficients.
        V: ``(n_h, K, M)`` complex.

    Returns:
        ``(K, n_c, n_c, M)``.
    """
    K, n_c, M = T.shape[0], basis.coefficients, V.shape[2]
    product = np.empty((K, n_c, n_c, M))
    first = 0
    if basis.has_mean:
        np.multiply(T[:, :, :1], V[0].real[:, None, :], out=product[:, :, 0])
        first = 1
    V = np.moveaxis(V[first:], 0, 1)
    real_form = np.empty((K, V.shape[1], 2, 2, M))
    real_form[:, :, 0, 0] = real_form[:, :, 1, 1] = V.real
    real_form[:, :, 1, 0] = V.imag
    np.negative(V.imag, out=real_form[:, :, 0, 1])
    left = T[:, :, first:].reshape(K, n_c, -1, 2).transpose(0, 2, 1, 3)
    out = product[:, :, first:].reshape(K, n_c, -1, 2 * M).transpose(0, 2, 1, 3)
    np.matmul(left, real_form.reshape(K, -1, 2, 2 * M), out=out)
    return product


@dataclass(frozen=True, eq=False)
class Elimination:
    """Steady forces as functions of the mixed ones: ``d_s = offset - reaction d_m - rigid a``, harmonic by harmonic.

    All in newtons: rigid coordinates are taken in units of the mean flexibility.
    """

    balance: Equations
    derivatives: Sequence[Derivative]
    shift: RealArray  # (n_h, m)
    steady: np.ndarray  # (c,)
    mixed: np.ndarray  # (M,)
    reaction: ComplexArray  # (n_h, c, M)
    offset: ComplexArray  # (n_h, c)
    rigid: RealArray  # (c, r)

    @classmethod
    def of(
        cls,
        balance: Equations,
        derivatives: Sequence[Derivative],
        steady: np.ndarray,
        load: RealArray,
        shift: RealArray,
    ) -> Elimination:
        """Eliminate the rows ``steady`` of J plus a diagonal ``shift``, ``(n_h, m)``, for a right side ``(n_c, m)``."""
        basis = balance.basis
        c, mixed = np.flatnonzero(steady), np.flatnonzero(~steady)
        n_h = len(basis.orders)
        reaction = np.zeros((n_h, c.size, mixed.size), dtype=complex)
        offset, rigid = np.zeros((n_h, c.size), dtype=complex), np.zeros((c.size, balance.rigid))
        right = basis.to_amplitudes(load)[:, c]
        for batch in _cut_harmonics(balance, c) if c.size else ():
            A, toward_rigid = _gather(balance, derivatives, c, shift, batch)
            known = np.concatenate([np.take(A, mixed, axis=2), right[batch, :, None], toward_rigid], axis=2)
            solved = np.linalg.solve(np.take(A, c, axis=2), known)
            reaction[batch], offset[batch] = solved[:, :, : mixed.size], solved[:, :, mixed.size]
            if batch.start == 0:
                rigid[:] = solved[0, :, mixed.size + 1 :].real
        return cls(balance, derivatives, shift, c, mixed, reaction, offset, rigid)

    @cached_property
    def inverse(self) -> ComplexArray:
        """``(n_h, c, c)`` of the steady block at each harmonic; only computed for a second right side."""
        return invert_steady(self.balance, self.derivatives, self.steady, self.shift)

    def find_offset(self, load: RealArray) -> ComplexArray:
        """Steady forces ``(n_h, c)`` by another right side ``(n_c, m)`` where the other unknowns are zero."""
        right = self.balance.basis.to_amplitudes(load)[:, self.steady]
        return np.matmul(self.inverse, right[:, :, None])[:, :, 0] if self.steady.size else right

    def follow(self, by_force: bool, columns: np.ndarray) -> tuple[ComplexArray, ComplexArray, RealArray]:
        """Forces or motions at ``columns`` ``(K,)``: on the mixed forces, by themselves, and on the rigid coordinates.

        Returns:
            ``(n_h, K, M)``, ``(n_h, K)`` and ``(K, r)``.
        """
        if by_force:
            place = np.searchsorted(self.steady, columns)
            return -self.reaction[:, place], self.offset[:, place], -self.rigid[place]
        H = np.take(self.balance.compliance.flexibility, columns, axis=1)
        H_m, H_c = (np.take(H, rows, axis=2) for rows in (self.mixed, self.steady))
        own = np.searchsorted(self.mixed, columns)
        near = (own < self.mixed.size) & (self.mixed[np.minimum(own, self.mixed.size - 1)] == columns)
        H_m[:, np.flatnonzero(near), own[near]] += REDUNDANCY * self.balance.system.flexibility[columns[near]]
        G = self.balance.rigid_motion[columns]
        return H_m - H_c @ self.reaction, np.einsum("hkc,hc->hk", H_c, self.offset), G - H_c[0].real @ self.rigid

    def rigid_balance(self) -> tuple[RealArray, RealArray, RealArray]:
        """``G^T d_0`` on the mixed mean forces ``(r, M)``, on the rigid coordinates ``(r, r)``, by itself ``(r,)``."""
        G = self.balance.compliance.rigid_motion
        steady = G[self.steady].T
        return G[self.mixed].T - steady @ self.reaction[0].real, -steady @ self.rigid, steady @ self.offset[0].real

    def expand(self, solution: RealArray) -> RealArray:
        """The scaled unknowns ``(size,)`` from the mixed coefficients and rigid coordinates solved for."""
        balance, basis = self.balance, self.balance.basis
        coefficients = np.zeros(balance.unknown.shape)
        mixed = solution[: solution.size - balance.rigid].reshape(basis.coefficients, self.mixed.size)
        alpha = solution[solution.size - balance.rigid :]
        coefficients[:, self.mixed] = mixed
        if self.steady.size:
            amplitudes = basis.to_amplitudes(coefficients[:, self.mixed])
            steady = self.offset - np.einsum("hcm,hm->hc", self.reaction, amplitudes)
            if balance.rigid:
                steady[0] -= self.rigid @ alpha
            coefficients[:, self.steady] = basis.to_coefficients(steady)
        return np.concatenate([coefficients[balance.unknown], alpha])


def invert_steady(
    balance: Equations, derivatives: Sequence[Derivative], steady: np.ndarray, shift: RealArray
) -> ComplexArray:
    """``(n_h, c, c)`` inverse of J at each harmonic, for steady rows ``(c,)`` by themselves; ``shift`` is ``(n_h, m)``.

    Raises:
        LinAlgError: It is singular.
    """
    batches = _cut_harmonics(balance, steady)
    blocks = (_gather(balance, derivatives, steady, shift, batch)[0][:, :, steady] for batch in batches)
    return np.concatenate([np.linalg.inv(block) for block in blocks])


def _cut_harmonics(balance: Equations, c: np.ndarray) -> Iterator[slice]:
    """Harmonics that are eliminated at a time."""
    step, n_h = max(1, BATCH // max(1, c.size * balance.rows)), len(balance.basis.orders)
    return (slice(first, first + step) for first in range(0, n_h, step))


def _gather(
    balance: Equations, derivatives: Sequence[Derivative], c: np.ndarray, shift: RealArray, batch: slice
) -> tuple[ComplexArray, ComplexArray]:
    """Steady rows of J at a batch of harmonics, ``(b, c, m)``, and of the rigid coordinates, ``(b, c, r)``."""
    H, rate = balance.compliance.flexibility[batch], balance.rate[batch]
    flexibility, G = balance.system.flexibility, balance.rigid_motion
    mean = np.flatnonzero(np.array(balance.basis.orders[batch]) == 0)  # its place in the batch, if it is there
    place, diagonal = np.full(balance.rows, -1), np.arange(c.size)
    place[c] = diagonal
    own = np.zeros((rate.size, c.size), dtype=complex)  # by the rows' own motions: one product for all laws
    forces, crossing = [], []
    for d in derivatives:
        pick = np.flatnonzero(place[d.rows] >= 0)
        at, columns = place[d.rows[pick]], d.columns[pick]
        value = np.outer(rate**d.rates, d.constant[pick])
        if d.by_force:
            forces.append((at, columns, value))
            continue
        if d.blind_to_mean:
            value[mean] = 0.0
        alone = columns == c[at]
        own[:, at[alone]] += value[:, alone]
        if not np.all(alone):
            crossing.append((at[~alone], columns[~alone], value[:, ~alone]))
    A = np.take(H, c, axis=1)
    A *= own[:, :, None]
    A[:, diagonal, c] += own * REDUNDANCY * flexibility[c]
    toward_rigid = np.zeros((rate.size, c.size, balance.rigid), dtype=complex)
    toward_rigid[mean] = own[mean][:, :, None] * G[c]
    for at, columns, value in crossing:
        A[:, at] += value[:, :, None] * np.take(H, columns, axis=1)
        A[:, at, columns] += value * REDUNDANCY * flexibility[columns]
        toward_rigid[np.ix_(mean, at)] += value[mean][:, :, None] * G[columns]
    for at, columns, value in forces:
        A[:, at, columns] += value
    weight, springs = balance.static_row[c], balance.static_displacement_row[c]
    A[mean] = weight[:, None] * A[mean] + springs[:, None] * H[mean][:, c]
    A[mean[:, None], diagonal, c] += balance.static_force_row[c] + springs * REDUNDANCY * flexibility[c]
    toward_rigid[mean] = weight[:, None] * toward_rigid[mean] + springs[:, None] * G[c]
    A[:, diagonal, c] += shift[batch][:, c]
    return A, toward_rigid
