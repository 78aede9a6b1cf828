"""One step in time of a contact system.

Moreau's scheme, in velocities ``v`` and impulses ``p``, with ``x_theta = (1 - theta) x_k + theta x_(k+1)``::

    M (v_(k+1) - v_k) = dt (f_theta - D v_theta - K x_theta) + B^T p,      x_(k+1) = x_k + dt v_theta
    0 <= p_N  _|_  g_k + dt v_N >= 0                                       v at the end of the step: Stewart & Trinkle
    |p_T| <= mu p_N, slip v_T opposes p_T                                  the true cone; in 3-D both are in a plane

With ``A = M + theta dt D + (theta dt)^2 K`` this is ``v_(k+1) = v_free + A^-1 B^T p``, and the contact conditions see
only ``B v_free + W p``, ``W = B A^-1 B^T``: ``compiled_loop`` solves for the impulses.
M and K are diagonalised together: with a damping that the modes diagonalise too, a step costs two products of size rows
x coordinates beside the contact solve. With 1/2, modes without mass, or far too fast for the step, would ring from step
to step for ever: they have a ``theta`` of their own, and follow impulses extrapolated to it, from the last two steps:
``p_k + (theta_own - theta) (p_k - p_(k-1))``. The laws are written again here, apart from the folder ``laws``: this is
the second formulation, by which the first is judged.

Source: Moreau (1988), doi:10.1007/978-3-7091-2624-0_1; Stewart & Trinkle (1996),
doi:10.1002/(SICI)1097-0207(19960815)39:15<2673::AID-NME972>3.0.CO;2-I.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import NamedTuple

import numpy as np
import scipy.linalg

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray, is_whole
from ewr_fenicsx.in_time.compiled_loop import BILATERAL, FRICTION, UNILATERAL, compile_loop
from ewr_fenicsx.laws.law_kinds import spread_over_pairs
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.harmonics import sample_amplitudes

BOUND = 1e100  # a motion past this grows without bound: its squares would soon overflow
_KNOWN = {"normal": ("unilateral", "bonded", "prescribed"), "tangential": ("coulomb", "frictionless", "bonded")}
# A mode whose mass makes up no more than this share of what resists it in a step (mass, and stiffness over the step) is
# far too fast for the step; and the least theta of such a mode.
_TOO_FAST, _FOLLOWING = 1e-3, 0.6
_DIAGONAL = 1e-9  # modal damping counts as diagonal up to this share of the geometric mean of the diagonal entries


@dataclass(frozen=True, eq=False)
class State:
    """Reduced coordinates ``(n,)`` and their velocities ``(n,)`` [per s] at ``tau = 0``."""

    position: RealArray
    velocity: RealArray

    @classmethod
    def of(cls, problem: ContactProblem, coordinates: ComplexArray) -> State:
        """State of a periodic motion of a problem, by its amplitudes ``(n_h, n)``."""
        rate = 1j * problem.omega * np.array(problem.basis.orders)
        return cls(coordinates.sum(axis=0).real, (rate @ coordinates).real)


class Carried(NamedTuple):
    """What a step takes over from the one before, row by row ``(m,)``: the impulse [N s], and what is late [m/s].

    Late is the velocity by which modes with a ``theta`` of their own put a row ahead of its end velocity.
    """

    impulse: RealArray
    late: RealArray


@dataclass(frozen=True, eq=False)
class Period:
    """One period as stepped, in modal coordinates.

    Attributes:
        positions, velocities: ``(steps + 1, n')`` at the ends of the steps.
        impulses: ``(steps, m)`` of the contact rows [N s].
        sweeps: Gauss-Seidel sweeps taken.
        unsolved: Steps whose contact solve missed its tolerance.
        carried: What the next step takes over.
    """

    positions: RealArray
    velocities: RealArray
    impulses: RealArray
    sweeps: int
    unsolved: int
    carried: Carried


class TimeScheme:
    """The matrices of one step of a contact problem.

    Args:
        problem: The problem; its frequency sets the period.
        steps: Steps a period.
        theta: 1/2 conserves energy, up to 1 damps what the step does not resolve.

    Attributes:
        contraction: ``(n', n)`` to modal coordinates, which have a unit of inertia in a step each.
        first_load: ``(steps, n')`` modal load at the begin of each step.
        thetas: ``(n',)`` that of each mode: more for those without mass, or far too fast for the step.
        push: ``(n', m)`` what a unit of each impulse does to the velocities in its step.
        echo, echoes: ``(k, m)`` what it takes back in the next step, and from which ``k`` modes.

    Raises:
        ModelError: No period, no whole number of steps, too few for the problem's harmonics, so long that inertia is
            lost beside stiffness, or ``theta`` outside [1/2, 1]; a sector of a ring.
    """

    def __init__(self, problem: ContactProblem, steps: int, theta: float = 0.5):
        if problem.model.cyclic:
            raise ModelError("in time the sectors of a ring go their own ways; step all of them: unroll_ring(model)")
        if problem.frequency <= 0:
            raise ModelError(f"frequency = {problem.frequency} Hz; a time step needs a period: give a positive one")
        if not is_whole(steps, 1):
            raise ModelError(f"steps = {steps!r}; give a whole number of steps a period, at least one")
        if not (isinstance(theta, Real) and 0.5 <= theta <= 1):
            raise ModelError(f"theta = {theta!r}; from 1/2 (conserves energy) to 1 (damps); less than 1/2 is unstable")
        if steps <= 2 * (highest := max(*problem.basis.orders, 0, *problem.driven)):
            raise ModelError(f"steps = {steps} cannot resolve harmonic {highest}; give at least {2 * highest + 1}")
        self.problem, self.steps, self.theta = problem, int(steps), float(theta)
        self.dt = 1 / (problem.frequency * steps)
        self.layout = problem.layout  # whether contact holds all bodies need not be known
        model = self.layout.model
        reach = (self.theta * self.dt) ** 2
        inertia = model.mass + reach * model.stiffness
        try:  # a singular mass does no harm in this pencil
            _, modes = scipy.linalg.eigh(reach * model.stiffness, inertia)
        except np.linalg.LinAlgError:  # of bodies that float, rounding leaves less than nothing
            raise ModelError(
                f"frequency = {problem.frequency:g} Hz: with {steps} steps a period, inertia is lost in the rounding "
                "of stiffness; take more steps or a higher frequency"
            ) from None
        self.expansion = self.layout.expansion @ modes
        self.contraction = self.expansion.T @ (problem.model.mass + reach * problem.model.stiffness)
        self.mass = np.einsum("ni,nm,mi->i", modes, model.mass, modes, optimize=True)
        self.stiffness = np.einsum("ni,nm,mi->i", modes, model.stiffness, modes, optimize=True)
        self.thetas = np.where(self.mass > _TOO_FAST, self.theta, max(self.theta, _FOLLOWING))
        self.damping = modes.T @ model.damping @ modes
        self.rows = np.ascontiguousarray(self.layout.rows @ modes)
        load = self.layout.project(problem.excitation)
        self.first_load = sample_amplitudes(load, np.arange(model.size), self.steps) @ modes
        self._compose_step()
        self._compose_laws()

    def _compose_step(self) -> None:
        theta, dt, n = self.thetas, self.dt, self.mass.size
        own = np.diag(self.damping)
        rounding = _DIAGONAL * np.sqrt(np.abs(np.outer(own, own))) + 1e-12 * np.abs(own).max(initial=0.0)
        self.is_diagonal = bool(np.all(np.abs(self.damping - np.diag(own)) <= rounding))
        spring = theta * dt**2 * self.stiffness
        if self.is_diagonal:
            self._inverse = inverse = 1 / (self.mass + theta * dt * own + theta * spring)
            self.keep, self.pull = 1 - inverse * (dt * own + spring), -dt * inverse * self.stiffness
            self.keep_dense = self.pull_dense = np.zeros((0, 0))
        else:
            self._factor = scipy.linalg.lu_factor(np.diag(self.mass + theta * spring) + dt * self.damping * theta)
            self.keep = self.pull = np.zeros(0)
            self.keep_dense = np.ascontiguousarray(np.eye(n) - self._solve(dt * self.damping + np.diag(spring)))
            self.pull_dense = np.ascontiguousarray(-dt * self._solve(np.diag(self.stiffness)))
        ahead = (theta - self.theta)[:, None] * self.rows.T
        self.push = np.ascontiguousarray(self._solve(self.rows.T + ahead))
        echo = self._solve(ahead)
        self.echoes = np.flatnonzero(np.any(echo != 0, axis=1))
        self.echo = np.ascontiguousarray(echo[self.echoes])
        self.delassus_columns = np.ascontiguousarray((self.rows @ self.push).T)  # row i: what impulse i does to all

    def _solve(self, forces: RealArray) -> RealArray:
        """Modal velocities ``(n', k)`` that a step's ``k`` impulses add at its end."""
        return self._inverse[:, None] * forces if self.is_diagonal else scipy.linalg.lu_solve(self._factor, forces)

    def _compose_laws(self) -> None:
        problem, layout = self.problem, self.layout
        m, total = layout.rows.shape[0], problem.model.pairs
        self.kind, self.partner, self.twin = np.full(m, -1), np.full(m, -1), np.full(m, -1)
        self.friction, self.initial_gap = np.zeros(m), np.zeros(m)
        self.given_limit = np.zeros((self.steps, m))
        order = []
        for pairs, laws in problem.groups:
            for side, known in _KNOWN.items():
                if (name := getattr(laws, side)) not in known:
                    raise ModelError(f'{side} = "{name}": time integration knows only {", ".join(known)}; use solve')
            normal, tangential = layout.row_of("normal", pairs), layout.row_of("tangential", pairs)
            if np.all(normal >= 0):
                self.kind[normal] = UNILATERAL if laws.normal == "unilateral" else BILATERAL
                self.initial_gap[normal] = problem.clearance[pairs]
            if laws.tangential == "coulomb":
                rubs = tangential >= 0
                row, friction = tangential[rubs], spread_over_pairs(laws.friction, pairs, total)[rubs]
                self.kind[row], self.partner[row], self.friction[row] = FRICTION, normal[rubs], friction
                self.twin[row] = second = layout.row_of("second_tangential", pairs[rubs])
                self.kind[second[second >= 0]] = FRICTION
                if laws.normal == "prescribed":
                    force = np.maximum(0.0, self.sample(problem.given_force, pairs[rubs]))
                    self.given_limit[:, row] = self.dt * friction * force
            order += [row for both in zip(normal, tangential, strict=True) for row in both if row >= 0]
        self.order = np.array(order, dtype=np.int64)

    def sample(self, amplitudes: Mapping[int, ComplexArray], columns: np.ndarray) -> RealArray:
        """Signals, harmonic -> amplitudes, at ``theta`` within each step: the mean of its ends, ``(steps, K)``."""
        ends = sample_amplitudes(amplitudes, columns, self.steps)
        return (1 - self.theta) * ends + self.theta * np.roll(ends, -1, axis=0)

    @cached_property
    def load(self) -> RealArray:
        """Modal load at each mode's ``theta`` within each step, ``(steps, n')``."""
        return self.blend(self.first_load, np.roll(self.first_load, -1, axis=0))

    @cached_property
    def velocity_of_load(self) -> RealArray:
        """Velocity that the load alone adds in each step, ``(steps, n')``."""
        return np.ascontiguousarray(self.dt * self._solve(self.load.T).T)

    def blend(self, begins: RealArray, ends: RealArray) -> RealArray:
        """Modal values ``(steps, n')`` at each mode's ``theta`` between those at the begin and at the end of steps."""
        return (1 - self.thetas) * begins + self.thetas * ends

    def begin(self, state: State) -> tuple[RealArray, RealArray, Carried]:
        """Where a motion begins: modal coordinates and velocities ``(n',)``, but for bonds', and what is carried.

        The impulses of the step before are those under which the modes with a ``theta`` of their own are in balance.
        """
        position, velocity = self.contraction @ state.position, self.contraction @ state.velocity
        force = self.stiffness * position + self.damping @ velocity - self.first_load[0]
        fast = self.thetas != self.theta
        impulse = self.dt * np.linalg.lstsq(self.rows[:, fast].T, force[fast], rcond=1e-12)[0]
        return position, velocity, Carried(impulse, np.zeros_like(impulse))

    def contact_amplitudes(self, period: Period, orders: Sequence[int]) -> tuple[ComplexArray, ComplexArray]:
        """One-sided complex amplitudes of the contact rows' forces [N] and motions [m] over a period, ``(n_h, m)``."""
        late = 2 * np.pi * self.theta / self.steps  # an impulse belongs to the middle of its step
        force = to_amplitudes(period.impulses / self.dt, orders) * np.exp(-1j * late * np.array(orders))[:, None]
        return force, to_amplitudes(period.positions[:-1] @ self.rows.T, orders)

    def run_period(
        self, position: RealArray, velocity: RealArray, carried: Carried, tolerance: float, sweeps: int
    ) -> Period:
        """Step once through the period.

        Args:
            position, velocity: ``(n',)`` modal coordinates at ``tau = 0``.
            carried: From the step before.
            tolerance: Largest change of an impulse in the last sweep, relative to the period's largest impulse so far.
            sweeps: Largest number of sweeps a step.
        """
        n, m = self.mass.size, self.rows.shape[0]
        positions, velocities = np.empty((self.steps + 1, n)), np.empty((self.steps + 1, n))
        impulses = np.empty((self.steps, m))
        positions[0], velocities[0] = position, velocity
        ends = Carried(*(np.array(given) for given in carried))
        taken, unsolved = compile_loop()(
            self.theta, self.thetas, self.dt,
            self.keep, self.pull, self.keep_dense, self.pull_dense, self.velocity_of_load,
            self.rows, self.push, self.echo, self.echoes, self.delassus_columns,
            self.order, self.kind, self.partner, self.twin, self.friction, self.initial_gap, self.given_limit,
            *ends, tolerance, sweeps, positions, velocities, impulses,
        )  # fmt: skip
        return Period(positions, velocities, impulses, taken, unsolved, ends)


def to_amplitudes(values: RealArray, orders: Sequence[int]) -> ComplexArray:
    """One-sided complex amplitudes ``(n_h, m)`` of values over a period at equal intervals, ``(steps, m)``."""
    kept = np.array(orders)
    spectrum = np.fft.fft(values, axis=0) / len(values)
    return np.where(kept == 0, 1.0, 2.0)[:, None] * spectrum[kept % len(values)]
