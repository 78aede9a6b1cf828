"""The weighted residual of a contact system and its generalised Jacobian ``J = E + S H``.

Unknowns: the Fourier coefficients of the contact forces, ``(n_c, m)``, and the rigid coordinates of floating bodies.
Laws are evaluated at samples in time and projected on the harmonics. E and S (a law's derivatives) are block-diagonal
over pairs, H (the compliance) is block-diagonal over harmonics.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property, partial

import numpy as np

from ewr_fenicsx.balance.elimination import REDUNDANCY
from ewr_fenicsx.balance.law_derivatives import Derivative
from ewr_fenicsx.balance.newton_step import NewtonStep
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.law_kinds import Motion, Response, Signal, Variable
from ewr_fenicsx.problem.contact_system import ContactSystem
from ewr_fenicsx.problem.harmonics import FourierBasis, sample_amplitudes
from ewr_fenicsx.problem.law_claims import check_claims, check_response

# Least share of the mean friction force in its own equation, where a run starts: with less, Newton's method stalls at
# pairs that are about to stick. From the solution with this share, that of the law is a step or two away.
FIRM = 1e-4
HELD_FIRMER = 10.0  # times that share for springs that hold a pair in place
# Full stick closes every gap and holds a resonance, which may take far larger forces than the joint ever has: gaps that
# do close take less, and pairs slip before. How many times that without the two the force may be that counts as one.
MOST = 3.0
ROUNDED = 1e-12  # share of what rows would take to close by themselves, up to which forces are rounding
LOST = 1e6  # norm of the scaled unknowns, of order one, above which whole steps lead nowhere, or to no numbers at all


class HarmonicBalance:
    """Residual of a contact system as a function of one real vector, scaled to be of order one.

    Args:
        system: The composed system, with at least one row.
        force_unit: Force that counts as one [N]; None: the norm of the full-stick forces, or less.
        least_share: Least weight of the mean force in its mean equation, where it has any; that of the mean
            displacement rises with it.
    """

    def __init__(self, system: ContactSystem, force_unit: float | None = None, least_share: float = 0.0):
        self.system, self.least_share = system, least_share
        self._force_unit = force_unit
        self._seen: deque = deque(maxlen=1)  # the point at which the laws were evaluated last, and what came out
        self.basis = system.basis
        self.compliance = system.compliance
        self.rate = 1j * system.compliance.omega * np.array(system.basis.orders)
        self.rows = system.rows.shape[0]
        self.rigid = system.compliance.rigid_motion.shape[1]
        self.law_rows = match_rows(system)
        for law in system.laws:
            check_claims(law)
        self.static_row, self.static_force_row, self.static_displacement_row = np.zeros((3, self.rows))
        for law, rows in zip(system.laws, self.law_rows, strict=True):
            self.static_row[rows], self.static_force_row[rows] = law.static_row, law.static_force_row
            self.static_displacement_row[rows] = law.static_displacement_row
        weak = (self.static_force_row > 0) & (self.static_force_row < least_share)
        self.static_displacement_row[weak] *= least_share / self.static_force_row[weak]  # what shares a load does still
        self.static_force_row[weak] = least_share
        self.held = (self.static_displacement_row > 0) & (self.static_force_row == 0)  # in place, by springs alone
        least = HELD_FIRMER * least_share / system.flexibility
        self.static_displacement_row[self.held] = np.maximum(self.static_displacement_row, least)[self.held]
        self.unknown = np.ones((self.basis.coefficients, self.rows), dtype=bool)
        if self.basis.has_mean:
            self.unknown[0] = self.static_row > 0
        self.size = int(self.unknown.sum()) + self.rigid
        self.hangs_on_friction = bool(self.rigid and np.any(self.static_displacement_row > 0))
        self.linear = self.size == 0 or all(law.linear for law in system.laws)

    @cached_property
    def full_stick(self) -> tuple[ComplexArray, RealArray]:
        """Force amplitudes ``(n_h, m)`` and rigid coordinates when no pair opens or slips: the linear start."""
        return self._stick(self.static_target)

    @cached_property
    def cold_start(self) -> tuple[ComplexArray, RealArray]:
        """``full_stick`` of all pairs but those with wide gaps, which are apart."""
        return self._start[1]

    @property
    def wide_gaps(self) -> RealArray:
        """``(m,)`` gaps that full stick pulls shut by over ``MOST`` times what holds all pairs in place, else 0 [m]."""
        return np.where(self._start[0], -self.static_target, 0.0)

    @cached_property
    def _start(self) -> tuple[np.ndarray, tuple[ComplexArray, RealArray]]:
        """Which rows ``(m,)`` have wide gaps, and ``cold_start``.

        Of more rows than coordinates no motion closes all gaps: some are pushed apart until others are left open.
        """
        gaps, wide, stick = self.static_target < 0, np.zeros(self.rows, dtype=bool), self.full_stick
        most = MOST * float(np.linalg.norm(self._in_place))
        while self.basis.has_mean and np.any(more := gaps & ~wide & (-stick[0][0].real > most)):
            wide, joined = wide | more, np.ones(self.rows, dtype=bool)
            apart = self.system.spread(wide, "normal")
            for rows in self.system.index.values():
                joined[rows[apart & (rows >= 0)]] = False
            stick = self._stick(np.where(joined, self.static_target, np.nan), joined)
            if self.rows <= self.system.model.size:
                break
        return wide, stick

    @cached_property
    def static_target(self) -> RealArray:
        """``(m,)`` mean motion at which the laws would hold each row; NaN where they do not say [m]."""
        target = np.full(self.rows, np.nan)
        for law, rows in zip(self.system.laws, self.law_rows, strict=True):
            if law.static_target is not None:
                target[rows] = law.static_target
        return target

    @cached_property
    def _in_place(self) -> ComplexArray:
        """Force amplitudes ``(n_h, m)`` of full stick if no gap were closed for it [N]."""
        closes = np.any(self.static_target < 0)
        return self._stick(np.maximum(self.static_target, 0.0))[0] if closes else self.full_stick[0]

    def _stick(self, target: RealArray, joined: np.ndarray | slice = slice(None)) -> tuple[ComplexArray, RealArray]:
        """``full_stick`` of rows joined, at mean motions ``(m,)``, or free where these are NaN [m]."""
        compliance = self.compliance
        forces = np.zeros((len(self.basis.orders), self.rows), dtype=complex)
        rigid = np.zeros(self.rigid)
        shift = np.diag(REDUNDANCY * self.system.flexibility + self.system.stick_flexibility)
        for j, h in enumerate(self.basis.orders):
            if h and np.any(compliance.free_motion[j]):
                flexibility = (compliance.flexibility[j] + shift)[joined][:, joined]
                forces[j, joined] = _hold_still(flexibility, compliance.free_motion[j, joined])
        if self.basis.has_mean:
            held = np.flatnonzero(np.isfinite(target))
            unit = self.mean_flexibility
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
        """Force that counts as one [N]: what full stick takes, up to ``MOST`` times the usual, where none was given."""
        return self._force_unit or self.measure_stick(MOST)

    def measure_stick(self, most: float) -> float:
        """Norm of the full-stick forces, up to ``most`` times the usual [N]; one where they are none, or rounding.

        Full stick closes every gap, and holds the pairs at a resonance of the stuck joint. That may take forces beside
        which all others would be rounding, while gaps that do close take less, and pairs slip before they hold a
        resonance. Usual is what holds the pairs where they are, each row by itself where they oscillate.
        """
        held, stick = self._in_place, self.full_stick[0]
        oscillates = self.rate != 0
        alone = self.compliance.free_motion[oscillates] / self.system.flexibility
        usual = np.hypot(
            np.linalg.norm(held[~oscillates]), min(np.linalg.norm(held[oscillates]), np.linalg.norm(alone))
        )
        unit = float(np.linalg.norm(stick))
        closing = np.linalg.norm(np.nan_to_num(self.static_target) / self.system.flexibility)
        if unit <= ROUNDED * closing:  # a floating body gives way to what is closed
            return 1.0
        return min(unit, float(most * usual) or unit) or 1.0

    @cached_property
    def firm(self) -> HarmonicBalance:
        """The balance to start with: each mean friction force has the share ``FIRM`` at least in its own equation."""
        firm = self.with_least_share(max(FIRM, self.least_share))
        return self if firm.is_like(self) else firm

    def with_least_share(self, least_share: float) -> HarmonicBalance:
        """The balance of the same system with another least share: what its laws answered to one serves both."""
        other = HarmonicBalance(self.system, self.force_unit, least_share)
        other._seen = self._seen
        return other

    def is_like(self, other: HarmonicBalance) -> bool:
        """Whether another balance of the same system has the same mean equations."""
        weights = ("static_force_row", "static_displacement_row")
        return all(np.array_equal(getattr(self, w), getattr(other, w)) for w in weights)

    @cached_property
    def mean_flexibility(self) -> float:
        """Of the rows, by which motions are brought to forces [m/N]; one where there are none."""
        return float(np.mean(self.system.flexibility)) if self.rows else 1.0

    @cached_property
    def length_unit(self) -> float:
        """Natural length of the problem [m]."""
        return self.force_unit * self.mean_flexibility

    @cached_property
    def rigid_motion(self) -> RealArray:
        """``(m, r)`` motion of the rows by the scaled rigid coordinates, which are in newtons [m/N]."""
        return self.compliance.rigid_motion * self.mean_flexibility

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
        return self.observe(self.signals(forces, motion, basis), basis.samples)

    def observe(self, signals: Mapping[Variable, Callable[[], RealArray]], samples: int) -> list[Motion]:
        """What each law sees of signals, variable -> what computes it at all rows over one period ``(samples, m)``."""
        seen = []
        for law in self.system.laws:
            columns = self.system.rows_of(law.pairs)
            variables = {name: Signal(at_rows, columns) for name, at_rows in signals.items()}
            if "normal" not in columns:
                given = cache(partial(sample_amplitudes, self.system.prescribed, law.pairs, samples))
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
            "acceleration": lambda: basis.synthesise(rate**2 * motion),
        }
        return {name: cache(compute) for name, compute in synthesise.items()}

    def residual(self, unknowns: RealArray, motion: ComplexArray | None = None) -> RealArray:
        """Scaled weighted residual, ``(size,)``, of the laws at the motion that the forces cause or another one [m]."""
        forces, caused, _, projected = self._respond(unknowns, motion)
        return self._weigh(forces, caused, projected)

    def measure_residual(self, unknowns: RealArray) -> float:
        """Norm of the residual at unknowns ``(size,)``."""
        return float(np.linalg.norm(self.residual(unknowns)))

    def linearise(self, unknowns: RealArray, motion: ComplexArray | None = None) -> NewtonStep:
        """Residual and generalised Jacobian at a point.

        Args:
            unknowns: ``(size,)`` scaled.
            motion: ``(n_h, m)`` motion at which the laws are linearised in place of the one that the forces cause [m]:
                that of a neighbouring problem, whose pairs' states then guide the first step. The residual is the
                linearised one.
        """
        forces, caused, responses, projected = self._respond(unknowns, motion)
        step = NewtonStep(self, self.differentiate(responses), self._weigh(forces, caused, projected))
        if motion is not None:
            step.residual = step.residual + step.change(0 * forces, caused - motion)
        return step

    def within(self, tolerance: float) -> Callable[[RealArray], bool]:
        """Of unknowns ``(size,)``: whether they leave a residual norm below a tolerance."""
        return lambda unknowns: self.measure_residual(unknowns) < tolerance

    def take_whole_steps(
        self,
        unknowns: RealArray,
        most: int,
        arrived: Callable[[RealArray], bool],
        motion: ComplexArray | None = None,
    ) -> tuple[RealArray | None, int]:
        """Unknowns where Newton's method comes to without a line search, in ``most`` steps at most; None if nowhere.

        Args:
            unknowns: ``(size,)`` scaled, where it begins.
            most: Linearisations.
            arrived: Of unknowns, whether they are where it should come to, as ``within`` says.
            motion: At which the first step linearises the laws, as in ``linearise``.

        Returns:
            These unknowns, and the steps taken.
        """
        for taken in range(most):
            if not np.linalg.norm(unknowns) < LOST:
                return None, taken
            if motion is None and arrived(unknowns):
                return unknowns, taken
            step = self.linearise(unknowns, motion)
            try:
                unknowns, motion = unknowns - step.solve(step.residual), None
            except np.linalg.LinAlgError:
                return None, taken
        return None, most

    def differentiate(self, responses: Sequence[Response]) -> tuple[Derivative, ...]:
        """Derivatives of all laws by what is unknown, from their responses."""
        derivatives = []
        for law, rows, response in zip(self.system.laws, self.law_rows, responses, strict=True):
            for variable, direction, values, since, kept in response.partials:
                columns = self.system.row_of(direction, law.pairs)
                if np.all(columns >= 0):  # else it is given, not unknown
                    derivatives.append(Derivative(rows, columns, variable, values, since, kept))
        return tuple(derivatives)

    def _respond(
        self, unknowns: RealArray, motion: ComplexArray | None = None
    ) -> tuple[ComplexArray, ComplexArray, list[Response], RealArray]:
        """Forces, the motion caused, responses of the laws to it or another, and these projected, ``(n_c, m)``.

        The last point is remembered: a Newton step starts where the line search before it ended.
        """
        if motion is None and self._seen and np.array_equal(unknowns, self._seen[0][0]):
            return self._seen[0][1]
        forces, rigid = self.unpack(unknowns)
        caused = self.compliance.motion(forces, rigid)
        seen = self.sample(forces, caused if motion is None else motion)
        responses = [law.evaluate(at) for law, at in zip(self.system.laws, seen, strict=True)]
        if not self._seen:  # a law that answers well once does so always
            for law, response in zip(self.system.laws, responses, strict=True):
                check_response(law, response, (self.basis.samples, law.pairs.size))
        projected = np.empty(self.unknown.shape)
        for rows, response in zip(self.law_rows, responses, strict=True):
            projected[:, rows] = self.basis.project(response.residual)
        answer = forces, caused, responses, projected
        if motion is None:
            self._seen.append((unknowns.copy(), answer))
        return answer

    def _weigh(self, forces: ComplexArray, caused: ComplexArray, projected: RealArray) -> RealArray:
        """The residual, ``(size,)``: the projected laws, with what decides mean friction, and the rigid balance."""
        coefficients, balance = projected.copy(), np.zeros(0)
        if self.basis.has_mean:
            mean = forces[0].real
            coefficients[0] = self.static_row * coefficients[0] + self.static_force_row * mean
            coefficients[0] += self.static_displacement_row * caused[0].real
            balance = self.compliance.rigid_motion.T @ mean + self.compliance.rigid_load
        return np.concatenate([coefficients[self.unknown], balance]) / self.force_unit


def pose_at(system: ContactSystem, forces: ComplexArray, rigid: RealArray) -> tuple[HarmonicBalance, RealArray]:
    """The balance of a system and its unknowns ``(size,)`` at forces ``(n_h, m)`` [N], rigid coordinates ``(r,)`` [m].

    In units of these forces, for full stick would take as long as a step.
    """
    balance = HarmonicBalance(system, float(np.linalg.norm(forces)) or 1.0)
    return balance, balance.pack(forces, rigid)


def match_rows(system: ContactSystem) -> list[np.ndarray]:
    """``(K,)`` rows of each law's pairs.

    Raises:
        ModelError: A law owns a direction in which its kind does not act; or a row has no law, or two.
    """
    for law in system.laws:
        if law.direction not in system.index or np.any(system.index[law.direction][law.pairs] < 0):
            known = ", ".join(f'"{direction}"' for direction in system.index)
            raise ModelError(
                f'{type(law).__name__}.direction = "{law.direction}", where its pairs have no unknown force; they have '
                f"one in {known}: make it one of these, or name it in the kind's acts_in"
            )
    rows = [system.index[law.direction][law.pairs] for law in system.laws]
    owners = np.bincount(np.concatenate([np.zeros(0, dtype=int), *rows]), minlength=system.rows.shape[0])
    for direction, index in system.index.items():
        wrong = [pair for pair, row in enumerate(index) if row >= 0 and owners[row] != 1]
        if wrong:
            raise ModelError(
                f"{owners[index[wrong[0]]]} laws own the {direction.replace('_', ' ')} force of pair {wrong[0]}; the "
                "kind that acts there must build one law for each direction that acts_in names"
            )
    return rows


def _hold_still(flexibility: ComplexArray, motion: ComplexArray) -> ComplexArray:
    """Forces ``(m,)`` that cancel a motion; the least ones where redundant pairs look the same next to a resonance."""
    try:
        return np.linalg.solve(flexibility, -motion)
    except np.linalg.LinAlgError:
        return np.linalg.lstsq(flexibility, -motion, rcond=REDUNDANCY)[0]
