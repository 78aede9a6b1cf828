"""The weighted residual of a contact system and its generalised Jacobian ``J = E + S H``.

Unknowns: the Fourier coefficients of the contact forces, ``(n_c, m)``, and the rigid coordinates of floating bodies.
Laws are evaluated at samples in time and projected on the harmonics. E and S (a law's derivatives) are block-diagonal
over pairs, H (the compliance) is block-diagonal over harmonics. A row whose derivatives do not change over the period
(closed, open or stuck throughout) is uncoupled in harmonics: ``NewtonStep`` eliminates it harmonic by harmonic, so that
the dense solve has only the rows that change status.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, cached_property, partial

import numpy as np
import scipy.linalg

from ewr_fenicsx.contact_problem import ContactSystem
from ewr_fenicsx.elimination import BATCH, REDUNDANCY, Derivative, Elimination, apply_harmonics
from ewr_fenicsx.harmonics import FourierBasis, sample_amplitudes
from ewr_fenicsx.law_kinds import Motion, Response, Signal, Variable
from ewr_fenicsx.reduced_model import ComplexArray, RealArray


class HarmonicBalance:
    """Residual of a contact system as a function of one real vector, scaled to be of order one.

    Args:
        system: The composed system, with at least one row.
        force_unit: Force that counts as one [N]; None: the norm of the full-stick forces.
    """

    def __init__(self, system: ContactSystem, force_unit: float | None = None):
        self.system = system
        self._force_unit = force_unit
        self._last = None  # the point at which the laws were evaluated last, and what came out
        self.basis = system.basis
        self.compliance = system.compliance
        self.rate = 1j * system.compliance.omega * np.array(system.basis.orders)
        self.rows = system.rows.shape[0]
        self.rigid = system.compliance.rigid_motion.shape[1]
        self.law_rows = [system.index[law.direction][law.pairs] for law in system.laws]
        self.static_row, self.static_force_row, self.static_displacement_row = np.zeros((3, self.rows))
        for law, rows in zip(system.laws, self.law_rows, strict=True):
            self.static_row[rows], self.static_force_row[rows] = law.static_row, law.static_force_row
            self.static_displacement_row[rows] = law.static_displacement_row
        self.unknown = np.ones((self.basis.coefficients, self.rows), dtype=bool)
        if self.basis.has_mean:
            self.unknown[0] = self.static_row > 0
        self.size = int(self.unknown.sum()) + self.rigid
        self.linear = self.size == 0 or all(law.linear for law in system.laws)

    @cached_property
    def full_stick(self) -> tuple[ComplexArray, RealArray]:
        """Force amplitudes ``(n_h, m)`` and rigid coordinates when no pair opens or slips: the linear start."""
        compliance = self.compliance
        forces = np.zeros((len(self.basis.orders), self.rows), dtype=complex)
        rigid = np.zeros(self.rigid)
        own = REDUNDANCY * self.system.flexibility
        for law, rows in zip(self.system.laws, self.law_rows, strict=True):
            own[rows] += law.stick_flexibility
        shift = np.diag(own)
        for j, h in enumerate(self.basis.orders):
            if h and np.any(compliance.free_motion[j]):
                forces[j] = np.linalg.solve(compliance.flexibility[j] + shift, -compliance.free_motion[j])
        if self.basis.has_mean:
            target = np.full(self.rows, np.nan)
            for law, rows in zip(self.system.laws, self.law_rows, strict=True):
                target[rows] = np.nan if law.static_target is None else law.static_target
            held = np.flatnonzero(np.isfinite(target))
            unit = np.mean(self.system.flexibility)
            G = compliance.rigid_motion[held]
            saddle = np.block(
                [
                    [(compliance.flexibility[0].real + shift)[np.ix_(held, held)] / unit, G],
                    [G.T, np.zeros((self.rigid,) * 2)],
                ]
            )
            motion = target[held] - compliance.free_motion[0].real[held]
            solution = np.linalg.lstsq(saddle, np.concatenate([motion / unit, -compliance.rigid_load]), rcond=1e-13)[0]
            forces[0, held] = solution[: held.size]
            rigid = solution[held.size :] * unit
        return forces, rigid

    @cached_property
    def force_unit(self) -> float:
        """Force that counts as one [N]: the norm of the full-stick forces where none was given."""
        return self._force_unit or float(np.linalg.norm(self.full_stick[0])) or 1.0

    @cached_property
    def length_unit(self) -> float:
        """Natural length of the problem [m]."""
        return self.force_unit * float(np.mean(self.system.flexibility))

    @cached_property
    def rigid_motion(self) -> RealArray:
        """``(m, r)`` motion of the rows by the scaled rigid coordinates, which are in newtons [m/N]."""
        return self.compliance.rigid_motion * float(np.mean(self.system.flexibility))

    def pack(self, forces: ComplexArray, rigid: RealArray) -> RealArray:
        """Scaled vector of unknowns, ``(size,)``."""
        coefficients = self.basis.to_coefficients(forces)[self.unknown]
        return np.concatenate([coefficients / self.force_unit, rigid / self.length_unit])

    def unpack(self, unknowns: RealArray) -> tuple[ComplexArray, RealArray]:
        """Force amplitudes ``(n_h, m)`` [N] and rigid coordinates ``(r,)`` [m]."""
        forces = self.basis.to_amplitudes(self.place(unknowns) * self.force_unit)
        return forces, unknowns[self.size - self.rigid :] * self.length_unit

    def place(self, vector: RealArray) -> RealArray:
        """Coefficients ``(n_c, m)`` of a vector like the unknowns, ``(size,)``; zero where there is no unknown."""
        coefficients = np.zeros(self.unknown.shape)
        coefficients[self.unknown] = vector[: self.size - self.rigid]
        return coefficients

    def sample(self, forces: ComplexArray, motion: ComplexArray, basis: FourierBasis | None = None) -> list[Motion]:
        """What each law sees over one period under force and motion amplitudes ``(n_h, m)``, for all laws in turn."""
        basis = basis or self.basis
        signals = self.signals(forces, motion, basis)
        seen = []
        for law in self.system.laws:
            columns = {d: rows[law.pairs] for d, rows in self.system.index.items() if np.all(rows[law.pairs] >= 0)}
            variables = {name: Signal(at_rows, columns) for name, at_rows in signals.items()}
            if "normal" not in columns:
                given = cache(partial(sample_amplitudes, self.system.prescribed, law.pairs, basis.samples))
                variables["force"] = Signal(signals["force"], columns, {"normal": given})
            seen.append(Motion(**variables))
        return seen

    def signals(
        self, forces: ComplexArray, motion: ComplexArray, basis: FourierBasis
    ) -> dict[Variable, Callable[[], RealArray]]:
        """Variable -> what computes it at all rows over one period, ``(n_t, m)``, once and only when called."""
        rate, oscillates = self.rate[:, None], (self.rate != 0)[:, None]
        synthesise = {
            "force": lambda: basis.synthesise(forces),
            "force_rate": lambda: basis.synthesise(rate * forces),
            "displacement": lambda: basis.synthesise(motion),
            "oscillation": lambda: basis.synthesise(oscillates * motion),
            "velocity": lambda: basis.synthesise(rate * motion),
        }
        return {name: cache(compute) for name, compute in synthesise.items()}

    def residual(self, unknowns: RealArray) -> RealArray:
        """Scaled weighted residual, ``(size,)``."""
        forces, rigid, _, responses = self._respond(unknowns)
        return self._project(forces, rigid, [r.residual for r in responses])

    def linearise(self, unknowns: RealArray, motion: ComplexArray | None = None) -> NewtonStep:
        """Residual and generalised Jacobian at a point.

        Args:
            unknowns: ``(size,)`` scaled.
            motion: ``(n_h, m)`` motion at which the laws are linearised in place of the one that the forces cause [m]:
                that of a neighbouring problem, whose pairs' states then guide the first step. The residual is the
                linearised one.
        """
        forces, rigid, caused, responses = self._respond(unknowns, motion)
        derivatives, residuals = [], []
        for law, rows, response in zip(self.system.laws, self.law_rows, responses, strict=True):
            residuals.append(response.residual)
            for variable, direction, values, since in response.partials:
                columns = self.system.row_of(direction, law.pairs)
                if np.all(columns >= 0):  # else it is given, not unknown
                    derivatives.append(Derivative(rows, columns, variable, values, since))
        step = NewtonStep(self, tuple(derivatives), self._project(forces, rigid, residuals))
        if motion is not None:
            step.residual = step.residual + step.change(0 * forces, caused - motion, 0 * rigid)
        return step

    def _respond(
        self, unknowns: RealArray, motion: ComplexArray | None = None
    ) -> tuple[ComplexArray, RealArray, ComplexArray, list[Response]]:
        """Forces, rigid coordinates, the motion that they cause, and the laws' responses to it or to another motion.

        The last point is remembered: a Newton step starts where the line search before it ended.
        """
        if motion is None and self._last is not None and np.array_equal(unknowns, self._last[0]):
            return self._last[1]
        forces, rigid = self.unpack(unknowns)
        caused = self.compliance.motion(forces, rigid)
        seen = self.sample(forces, caused if motion is None else motion)
        answer = forces, rigid, caused, [law.evaluate(at) for law, at in zip(self.system.laws, seen, strict=True)]
        if motion is None:
            self._last = unknowns.copy(), answer
        return answer

    def _project(self, forces: ComplexArray, rigid: RealArray, residuals: list[RealArray]) -> RealArray:
        coefficients = np.empty(self.unknown.shape)
        for rows, residual in zip(self.law_rows, residuals, strict=True):
            coefficients[:, rows] = self.basis.project(residual)
        balance = np.zeros(0)
        if self.basis.has_mean:
            mean = forces[0].real
            coefficients[0] = self.static_row * coefficients[0] + self.static_force_row * mean
            if np.any(self.static_displacement_row):
                motion = self.compliance.motion(forces[:1], rigid)[0].real
                coefficients[0] += self.static_displacement_row * motion
            balance = self.compliance.rigid_motion.T @ mean + self.compliance.rigid_load
        return np.concatenate([coefficients[self.unknown], balance]) / self.force_unit


class NewtonStep:
    """The linearised balance at one point: as a product, as a dense matrix, or solved with steady rows eliminated."""

    def __init__(self, balance: HarmonicBalance, derivatives: tuple[Derivative, ...], residual: RealArray):
        self.balance = balance
        self.derivatives = derivatives
        self.residual = residual

    @cached_property
    def steady(self) -> np.ndarray:
        """``(m,)`` rows whose derivatives are the same at every sample."""
        changes = np.zeros(self.balance.rows, dtype=bool)
        for d in self.derivatives:
            changes[d.rows] |= d.changes
        return ~changes

    @cached_property
    def shift_weight(self) -> RealArray:
        """``(n_h, m)`` share of a diagonal shift that each row takes: less where the law barely answers to its motion.

        Mean friction takes none: its own entry is small, and a shift would swamp it.
        """
        balance, answer = self.balance, np.zeros(self.balance.rows)
        for d in self.derivatives:
            if not d.by_force:
                rate = balance.compliance.omega if d.by_rate else 1.0
                largest = rate * np.abs(d.values).max(axis=0) * balance.system.flexibility[d.columns]
                np.maximum.at(answer, d.rows, largest)
        weight = np.tile(np.where(answer > 0, np.minimum(1.0, answer), 1.0), (len(balance.basis.orders), 1))
        if balance.basis.has_mean:
            weight[0] *= balance.static_force_row == 0
        return weight

    def multiply(self, direction: RealArray, shift: float = 0.0) -> RealArray:
        """``(J + shift) v`` without forming J, ``(size,)``."""
        balance = self.balance
        forces, rigid = balance.unpack(direction)
        motion = balance.compliance.motion(forces, rigid) - balance.compliance.free_motion
        product = self.change(forces, motion, rigid)
        if shift:
            moved = balance.size - balance.rigid
            weight = self.shift_weight[balance.basis.slot][balance.unknown]
            product[:moved] += shift * weight * direction[:moved]
        return product

    def change(self, forces: ComplexArray, motion: ComplexArray, rigid: RealArray) -> RealArray:
        """Change of the residual with force and motion amplitudes ``(n_h, m)`` and rigid coordinates ``(r,)``."""
        balance, basis = self.balance, self.balance.basis
        signals = balance.signals(forces, motion, basis)
        samples = np.zeros((basis.samples, balance.rows))
        remembered: list[tuple[Derivative, RealArray]] = []
        for d in self.derivatives:
            product = d.values * signals[d.variable]()[:, d.columns]
            if d.since is None:
                samples[:, d.rows] += product
            elif remembered and d.since is remembered[-1][0].since:  # one law's: looked up together
                remembered[-1][1][:] += product
            else:
                remembered.append((d, product))
        for d, product in remembered:
            samples[:, d.rows] += np.where(d.since >= 0, np.take_along_axis(product, d.since, axis=0), 0.0)
        coefficients = basis.project(samples)
        rigid_balance = np.zeros(0)
        if basis.has_mean:
            coefficients[0] *= balance.static_row
            coefficients[0] += (
                balance.static_force_row * forces[0].real + balance.static_displacement_row * motion[0].real
            )
            rigid_balance = balance.compliance.rigid_motion.T @ forces[0].real
        return np.concatenate([coefficients[balance.unknown], rigid_balance]) / balance.force_unit

    def matrix(self, shift: float = 0.0) -> RealArray:
        """The whole Jacobian, ``(size, size)``, with ``shift`` added on its diagonal, but for mean friction."""
        load = np.zeros(self.balance.unknown.shape)
        nothing = Elimination.of(self.balance, self.derivatives, np.zeros(self.balance.rows, dtype=bool), load)
        matrix, _ = self._assemble(nothing, load, shift)
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

    def _assemble(self, elimination: Elimination, load: RealArray, shift: float) -> tuple[RealArray, RealArray]:
        """Matrix and right side of the mixed rows and the rigid balance.

        Rows are (pair, coefficient), columns (coefficient, pair), rigid coordinates last.
        """
        balance, basis = self.balance, self.balance.basis
        mixed, n_c = elimination.mixed, basis.coefficients
        place = np.full(balance.rows, -1)
        place[mixed] = np.arange(mixed.size)
        size = mixed.size * n_c
        matrix = np.zeros((size + balance.rigid, size + balance.rigid))
        b = np.zeros(size + balance.rigid)
        block = matrix[:size, :size].reshape(mixed.size, n_c, n_c, mixed.size)  # a view: the matrix itself
        pair, order = np.arange(mixed.size)[:, None], np.arange(n_c)
        block[pair, order, order, pair] = shift * self.shift_weight[basis.slot][:, mixed].T
        known = load[:, mixed].T.copy()
        toward_rigid = np.zeros((mixed.size, n_c, balance.rigid))
        if basis.has_mean:
            block[pair[:, 0], 0, 0, pair[:, 0]] += balance.static_force_row[mixed]
        for d in self.derivatives:
            pick = np.flatnonzero(place[d.rows] >= 0)
            if pick.size == 0:
                continue
            at, columns = place[d.rows[pick]], d.columns[pick]
            values = d.values[:, pick]
            T = basis.multiplication(values) if d.since is None else basis.recollection(values, d.since[:, pick])
            if basis.has_mean:
                T[:, 0, :] *= balance.static_row[d.rows[pick], None]
            if d.by_rate:
                T = basis.differentiate_columns(T, balance.compliance.omega)
            if d.by_force:
                inside = place[columns] >= 0
                block[at[inside], :, :, place[columns[inside]]] += T[inside]
                at, columns, T = at[~inside], columns[~inside], T[~inside]
                if at.size == 0:
                    continue
            elif d.blind_to_mean and basis.has_mean:
                T[:, :, 0] = 0.0
                if d.since is None:
                    T[:, 0, 0] = balance.static_displacement_row[d.rows[pick]] * (d.rows[pick] == columns)
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

    Raises:
        LinAlgError: The Jacobian is singular.
    """

    def __init__(self, step: NewtonStep, right_side: RealArray, shift: float = 0.0):
        balance = step.balance
        self.step = step
        load = balance.place(right_side)
        self.elimination = Elimination.of(balance, step.derivatives, step.steady, load, shift * step.shift_weight)
        matrix, b = step._assemble(self.elimination, load, shift)
        b[b.size - balance.rigid :] += right_side[balance.size - balance.rigid :]
        unknown = balance.unknown[:, self.elimination.mixed]
        rigid = np.ones(balance.rigid, dtype=bool)
        self.rows, self.columns = (np.concatenate([u.ravel(), rigid]) for u in (unknown.T, unknown))
        if not self.columns.all():  # mean friction that the law sets to zero
            matrix = matrix[np.ix_(self.rows, self.columns)]
        # LAPACK reads the row-major matrix as its transpose: factor that in place, solve with it transposed back
        self.lu, self.pivots, failed = (
            scipy.linalg.lapack.dgetrf(matrix.T, overwrite_a=True) if b.size else (None, None, 0)
        )
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
            x[self.columns] = scipy.linalg.lu_solve((self.lu, self.pivots), b[self.rows], trans=1, check_finite=False)
        return x
