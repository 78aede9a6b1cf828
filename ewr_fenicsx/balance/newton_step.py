"""One Newton step: the linearised balance as a product, as a dense matrix, or solved with steady rows eliminated.

A row whose derivatives do not change over the period (closed, open or stuck throughout) is uncoupled in harmonics, and
is eliminated harmonic by harmonic (``elimination.py``): the dense solve has only the rows that change status.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.linalg

from ewr_fenicsx.balance.elimination import BATCH, Elimination, Equations, apply_harmonics
from ewr_fenicsx.balance.law_derivatives import Derivative, ProjectedDerivative, find_steady, project_derivatives
from ewr_fenicsx.given import ComplexArray, RealArray


class NewtonStep:
    """The linearised balance at one point: as a product, as a dense matrix, or solved with steady rows eliminated."""

    def __init__(self, balance: Equations, derivatives: tuple[Derivative, ...], residual: RealArray):
        self.balance = balance
        self.derivatives = derivatives
        self.residual = residual

    @cached_property
    def steady(self) -> np.ndarray:
        """``(m,)`` rows whose derivatives are the same at every sample."""
        return find_steady(self.derivatives, self.balance.rows)

    @property
    def unknowns_left(self) -> int:
        """Number of unknowns that no elimination takes out."""
        return int(self.balance.unknown[:, ~self.steady].sum()) + self.balance.rigid

    @cached_property
    def projected(self) -> list[ProjectedDerivative]:
        """The derivatives projected on the harmonics."""
        balance = self.balance
        static = balance.static_row, balance.static_displacement_row
        return project_derivatives(self.derivatives, balance.basis, balance.compliance.omega, *static)

    @cached_property
    def shift_weight(self) -> RealArray:
        """``(n_h, m)`` share of a diagonal shift that each row takes: less where the law barely answers to its motion.

        Mean friction takes none: its own entry is small, and a shift would swamp it.
        """
        balance, answer = self.balance, np.zeros(self.balance.rows)
        for d in self.derivatives:
            if not d.by_force:
                rate = balance.compliance.omega**d.rates
                largest = rate * np.abs(d.values).max(axis=0) * balance.system.flexibility[d.columns]
                np.maximum.at(answer, d.rows, largest)
        weight = np.tile(np.where(answer > 0, np.minimum(1.0, answer), 1.0), (len(balance.basis.orders), 1))
        if balance.basis.has_mean:
            weight[0] *= (balance.static_force_row == 0) & (balance.static_displacement_row == 0)
        return weight

    def spread(self, shift: float) -> RealArray:
        """``(n_h, m)`` what a diagonal shift adds to each row."""
        return shift * self.shift_weight if shift else np.zeros((len(self.balance.basis.orders), self.balance.rows))

    def multiply(self, direction: RealArray, shift: float = 0.0) -> RealArray:
        """``(J + shift) v`` without forming J, ``(size,)``."""
        balance = self.balance
        forces, rigid = balance.unpack(direction)
        motion = balance.compliance.motion(forces, rigid) - balance.compliance.free_motion
        product, moved = self.change(forces, motion), balance.size - balance.rigid
        if shift:  # mostly there is none, and products are many
            product[:moved] += self.spread(shift)[balance.basis.slot][balance.unknown] * direction[:moved]
        return product

    def change(self, forces: ComplexArray, motion: ComplexArray) -> RealArray:
        """Change of the residual with force and motion amplitudes ``(n_h, m)``, rigid motion included."""
        balance, basis = self.balance, self.balance.basis
        by_force, by_motion = basis.to_coefficients(forces), basis.to_coefficients(motion)
        coefficients = np.zeros((balance.rows, basis.coefficients))
        for d in self.projected:
            at = (by_force if d.by_force else by_motion)[:, d.columns].T
            coefficients[d.rows] += np.matmul(d.matrices, at[:, :, None])[:, :, 0]
        rigid_balance = np.zeros(0)
        if basis.has_mean:
            coefficients[:, 0] += balance.static_force_row * forces[0].real
            rigid_balance = balance.compliance.rigid_motion.T @ forces[0].real
        return np.concatenate([coefficients.T[balance.unknown], rigid_balance]) / balance.force_unit

    def matrix(self, shift: float = 0.0) -> RealArray:
        """The whole Jacobian, ``(size, size)``, with ``shift`` added on its diagonal, but for mean friction."""
        load = np.zeros(self.balance.unknown.shape)
        none = np.zeros(self.balance.rows, dtype=bool)
        nothing = Elimination.of(self.balance, self.derivatives, none, load, self.spread(shift))
        matrix, _ = self._assemble(nothing, load)
        unknown = self.balance.unknown
        rigid = np.arange(unknown.size, matrix.shape[0])
        rows = np.arange(unknown.size).reshape(unknown.T.shape).T[unknown]
        return matrix[np.ix_(np.concatenate([rows, rigid]), np.concatenate([np.flatnonzero(unknown), rigid]))]

    def solve(self, right_side: RealArray, shift: float = 0.0) -> RealArray:
        """``(J + shift)^-1 b`` with the steady rows eliminated, ``(size,)``: the same step as with ``matrix(shift)``.

        Raises:
            LinAlgError: The Jacobian is singular.
        """
        return Factorisation(self, right_side, shift).solution

    def _assemble(
        self, elimination: Elimination, load: RealArray, precision: type = np.float64
    ) -> tuple[RealArray, RealArray]:
        """Matrix and right side of the mixed rows and the rigid balance.

        Rows are (pair, coefficient), columns (coefficient, pair), rigid coordinates last.
        """
        balance, basis = self.balance, self.balance.basis
        mixed, n_c = elimination.mixed, basis.coefficients
        place = np.full(balance.rows, -1)
        place[mixed] = np.arange(mixed.size)
        size = mixed.size * n_c
        matrix = np.zeros((size + balance.rigid, size + balance.rigid), precision)
        b = np.zeros(size + balance.rigid)
        block = matrix[:size, :size].reshape(mixed.size, n_c, n_c, mixed.size)  # a view: the matrix itself
        pair, order = np.arange(mixed.size)[:, None], np.arange(n_c)
        block[pair, order, order, pair] = elimination.shift[basis.slot][:, mixed].T
        if basis.has_mean:
            block[pair[:, 0], 0, 0, pair[:, 0]] += balance.static_force_row[mixed]
        known = load[:, mixed].T.copy()
        toward_rigid = np.zeros((mixed.size, n_c, balance.rigid))
        for d in self.projected:
            pick = place[d.rows] >= 0
            if d.by_force:  # by those of mixed rows themselves
                inside = pick & (place[d.columns] >= 0)
                block[place[d.rows[inside]], :, :, place[d.columns[inside]]] += d.matrices[inside]
                pick &= ~inside
            at, columns, T = place[d.rows[pick]], d.columns[pick], d.matrices[pick]
            if at.size == 0:
                continue
            V, v, g = elimination.follow(d.by_force, columns)
            rows = max(1, BATCH // (n_c * n_c * mixed.size))
            for first in range(0, at.size, rows):
                part = slice(first, first + rows)
                block[at[part]] += apply_harmonics(basis, T[part], V[:, part])
            known[at] -= np.einsum("kij,jk->ki", T, basis.to_coefficients(v))
            if balance.rigid:
                toward_rigid[at] += T[:, :, :1] * g[:, None, :]
        b[:size] = known.reshape(size)
        if balance.rigid:
            matrix[:size, size:] = toward_rigid.reshape(size, balance.rigid)
            rows, corner, offset = elimination.rigid_balance()
            matrix[size:, :size].reshape(balance.rigid, n_c, mixed.size)[:, 0] = rows
            matrix[size:, size:] = corner
            b[size:] = -offset
        return matrix, b


class Factorisation:
    """``J + shift`` factored, the steady rows eliminated: for one right side at once, for more of them later.

    Args:
        step: The linearised balance.
        right_side: ``(size,)``, of which ``solution`` is the solution.
        shift: On the diagonal, but for mean friction.
        precision: Of the factors; in single precision they are a preconditioner, in half the time and memory.

    Raises:
        LinAlgError: The Jacobian is singular.
    """

    def __init__(self, step: NewtonStep, right_side: RealArray, shift: float = 0.0, precision: type = np.float64):
        balance = step.balance
        self.step = step
        load = balance.place(right_side)
        self.elimination = Elimination.of(balance, step.derivatives, step.steady, load, step.spread(shift))
        matrix, b = step._assemble(self.elimination, load, precision)
        b[b.size - balance.rigid :] += right_side[balance.size - balance.rigid :]
        unknown = balance.unknown[:, self.elimination.mixed]
        rigid = np.ones(balance.rigid, dtype=bool)
        self.rows, self.columns = (np.concatenate([u.ravel(), rigid]) for u in (unknown.T, unknown))
        if not self.columns.all():  # mean friction that the law sets to zero
            matrix = matrix[np.ix_(self.rows, self.columns)]
        # LAPACK reads the row-major matrix as its transpose: factor that in place, solve with it transposed back
        factor = scipy.linalg.get_lapack_funcs("getrf", (matrix,))
        self.lu, self.pivots, failed = factor(matrix.T, overwrite_a=True) if b.size else (None, None, 0)
        if failed:
            raise np.linalg.LinAlgError("the Newton matrix is singular")
        self.solution = self.elimination.expand(self._solve_mixed(b))

    def solve(self, right_side: RealArray) -> RealArray:
        """The solution for another right side, ``(size,)``."""
        step, balance = self.step, self.step.balance
        offset = self.elimination.find_offset(balance.place(right_side))
        elimination = replace(self.elimination, offset=offset)
        left = right_side - step.multiply(elimination.expand(np.zeros(self.columns.size)))
        b = np.concatenate([balance.place(left)[:, elimination.mixed].T.ravel(), left[balance.size - balance.rigid :]])
        return elimination.expand(self._solve_mixed(b))

    def _solve_mixed(self, b: RealArray) -> RealArray:
        """Mixed coefficients and rigid coordinates, zeros among them, from a right side by pair and coefficient."""
        x = np.zeros(self.columns.size)
        if b.size:
            known = b[self.rows].astype(self.lu.dtype, copy=False)
            x[self.columns] = scipy.linalg.lu_solve((self.lu, self.pivots), known, trans=1, check_finite=False)
        return x
