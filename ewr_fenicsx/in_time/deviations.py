"""Small deviations from a periodic solution, stepped once through the period.

They obey the laws' derivatives at the solution::

    M x'' + D x' + K x = B^T lam,      dpsi/dlam lam + dpsi/dq B x + dpsi/dv B x' = 0

Little tells a deviation: the modes that the steps resolve, with their velocities, and how far the contact rows have
moved by the other modes, which follow forces at once. Rows that do not change status over the period obey the same
equation at every instant: it is solved once.

A row that closes stops within a step what it has deviated by. In truth nothing but the contact node itself gives way at
once; modes that so short a step does not resolve stand for it.

Source: the scheme (SDIRK2, L-stable: contact nodes without mass do not ring): Alexander (1977), doi:10.1137/0714068.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance, pose_at
from ewr_fenicsx.balance.law_derivatives import Derivative, find_steady
from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.in_time.followed_modes import Followed, follow_modes
from ewr_fenicsx.problem.contact_system import ContactSystem

if TYPE_CHECKING:
    from ewr_fenicsx.in_time.time_stepping import Period, TimeScheme

STEPS_IN_TIME, THETA = 512, 0.52  # a period of the motion in time; they damp what they do not resolve
FINE_STEPS, FINE_THETA = 1024, 0.505  # where it counts whether it settles: more damping has it settle too soon
PERIODS = 3  # looked at, after a first one
CONTACT_TOLERANCE, SWEEPS = 1e-6, 200  # of a step
VARIABLES = ("force", "displacement", "velocity")  # by which deviations see the laws: nothing is remembered
SHARE = 1 - 1 / np.sqrt(2)  # of a step, at which the scheme's first stage lies
TOGETHER = 64  # steps whose matrices are held at a time
RESOLVED = 8  # steps a period of the fastest mode that is stepped; with many more, what closes gets a kick


def is_followed(derivative: Derivative) -> bool:
    """Whether deviations see it: it is by one of ``VARIABLES``, at its own sample."""
    return derivative.variable in VARIABLES and not derivative.remembers


class Slope(NamedTuple):
    """Derivatives of some laws' rows that change status, one column each."""

    variable: str
    at: np.ndarray  # (K,) which of these rows
    columns: np.ndarray  # (K,)
    values: RealArray  # (n_t, K)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of all laws at a solution with ``m`` rows.

    Attributes:
        derivatives: Sample by sample.
        is_steady: ``(m,)`` rows whose derivatives are the same at every sample.
    """

    derivatives: tuple[Derivative, ...]
    is_steady: np.ndarray

    @classmethod
    def of(cls, derivatives: tuple[Derivative, ...], rows: int) -> Slopes | None:
        """None where a derivative is by something else than ``VARIABLES``, or reaches back."""
        if not all(map(is_followed, derivatives)):
            return None
        return cls(derivatives, find_steady(derivatives, rows))

    @property
    def samples(self) -> int:
        """Samples a period."""
        return len(self.derivatives[0].values)

    @cached_property
    def changing(self) -> np.ndarray:
        """Rows that change status over the period, ``(x,)``."""
        return np.flatnonzero(~self.is_steady)

    @cached_property
    def steady(self) -> np.ndarray:
        """The others, ``(m - x,)``."""
        return np.flatnonzero(self.is_steady)

    @cached_property
    def at_changing(self) -> list[Slope]:
        """Derivatives of the rows that change status."""
        place, slopes = np.cumsum(~self.is_steady) - 1, []
        for d in self.derivatives:
            pick = ~self.is_steady[d.rows]
            slopes.append(Slope(d.variable, place[d.rows[pick]], d.columns[pick], d.values[:, pick]))
        return slopes

    @cached_property
    def at_steady(self) -> dict[str, RealArray]:
        """Variable -> ``(m - x, m)`` derivatives of the steady rows.

        Rows that see nothing but their own velocity, for they stick throughout, see their displacement in its place:
        where they have stuck to is neutral.
        """
        place = np.cumsum(self.is_steady) - 1
        slopes = {name: np.zeros((self.steady.size, self.is_steady.size)) for name in VARIABLES}
        for d in self.derivatives:
            pick = self.is_steady[d.rows]
            slopes[d.variable][place[d.rows[pick]], d.columns[pick]] += d.values[0, pick]
        sticks = ~np.any(slopes["force"], axis=1) & ~np.any(slopes["displacement"], axis=1)
        slopes["displacement"][sticks] = slopes["velocity"][sticks]
        slopes["velocity"][sticks] = 0.0
        return slopes

    def treat_all_as_changing(self) -> Slopes:
        """The same with no row among the steady ones."""
        return Slopes(self.derivatives, np.zeros_like(self.is_steady))

    def slide_through_turns(self, longest: int) -> Slopes:
        """The same, but rows that stick for at most ``longest`` samples on end slide on; itself where none does."""
        order = np.arange(self.samples)[:, None]
        sticks = np.broadcast_to(~self.is_steady, (self.samples, self.is_steady.size)).copy()
        for d in self.derivatives:
            if d.variable != "velocity":
                sticks[:, d.rows] &= d.values == 0
        twice, count = np.vstack([sticks, sticks]), 2 * self.samples
        slid = np.where(twice, -1, np.arange(count)[:, None])
        before = np.maximum.accumulate(slid)[self.samples :]
        after = np.minimum.accumulate(np.where(twice, count, slid)[::-1])[::-1][: self.samples] + self.samples
        short = sticks & (after - before - 1 <= longest)
        if not short.any():
            return self
        source = np.where(short, before % self.samples, order)
        held = (replace(d, values=np.take_along_axis(d.values, source[:, d.rows], axis=0)) for d in self.derivatives)
        return Slopes(tuple(held), self.is_steady)


def differentiate_along(motion: PeriodicMotion) -> Slopes | None:
    """Derivatives of all laws along the motion in time that begins on a solution, over ``PERIODS`` after a first one.

    That motion opens, closes and slips where the laws have it, not where a truncated series does.

    Returns:
        None where the motion grows beyond all bounds.

    Raises:
        ModelError: Time stepping does not know the laws, or takes too few steps for the harmonics.
        ImportError: There is no compiler for it.
    """
    balance, along = HarmonicBalance(motion.problem.system, 1.0), []
    for scheme, period in islice(step_from(motion, STEPS_IN_TIME, THETA), 1 + PERIODS):
        along.append(_differentiate_period(balance, scheme, period))
    if len(along) <= PERIODS:
        return None
    joined = [replace(one[0], values=np.vstack([d.values for d in one])) for one in zip(*along[1:], strict=True)]
    return Slopes.of(tuple(joined), balance.rows)


class Course(NamedTuple):
    """Where the motion in time goes that begins on a solution.

    Attributes:
        changes: ``(periods - 1,)`` from each period to the next, over the oscillation in the last.
        distance: From the first period to the last, over the same.
        forces, motion: ``(n_h, m)`` amplitudes of the contact rows in the last [N], [m].
    """

    changes: RealArray
    distance: float
    forces: ComplexArray
    motion: ComplexArray


def watch_course(motion: PeriodicMotion, periods: int) -> Course | None:
    """How the motion in time that begins on a solution changes, and where it is after so many periods.

    Args:
        motion: The solution.
        periods: How many are stepped.

    Returns:
        None where it leaves all bounds before.

    Raises:
        ModelError, ImportError: As ``differentiate_along``.
    """
    stepped = islice(step_from(motion, FINE_STEPS, FINE_THETA), periods)
    scheme, first = next(stepped, (None, None))
    last, changes = first, []
    for _, period in stepped:
        changes.append(np.linalg.norm(period.positions - last.positions))
        last = period
    if len(changes) < periods - 1 or first is None:
        return None
    distance = np.linalg.norm(last.positions - first.positions)
    swing = max(np.linalg.norm(last.positions - last.positions.mean(axis=0)), np.finfo(float).tiny)
    amplitudes = scheme.contact_amplitudes(last, motion.orders)
    return Course(np.array(changes) / swing, float(distance / swing), *amplitudes)


def step_from(motion: PeriodicMotion, steps: int, theta: float) -> Iterator[tuple[TimeScheme, Period]]:
    """The motion in time that begins on a solution, period by period, within bounds."""
    from ewr_fenicsx.in_time.lifting import lift_out  # both only for those whose deviations grow
    from ewr_fenicsx.in_time.time_stepping import BOUND, State, TimeScheme

    scheme = TimeScheme(motion.problem, steps, theta)
    position, velocity, carried = scheme.begin(lift_out(scheme, State.of(motion.problem, motion.coordinates)))
    while True:
        period = scheme.run_period(position, velocity, carried, CONTACT_TOLERANCE, SWEEPS)
        if not np.all(np.abs(period.positions) < BOUND):
            return
        yield scheme, period
        position, velocity, carried = period.positions[-1], period.velocities[-1], period.carried


def _differentiate_period(balance: HarmonicBalance, scheme: TimeScheme, period: Period) -> tuple[Derivative, ...]:
    """Derivatives of all laws along a period of stepping, as the contact conditions of its steps see them."""
    moved, after = period.positions[:-1] @ scheme.rows.T, period.velocities[1:] @ scheme.rows.T
    signals = {
        "force": lambda: period.impulses / scheme.dt,
        "displacement": lambda: moved + scheme.dt * after,
        "velocity": lambda: after,
    }
    seen = balance.observe(signals, scheme.steps)
    responses = [law.evaluate(at) for law, at in zip(balance.system.laws, seen, strict=True)]
    return balance.differentiate(responses)


class Monodromy(NamedTuple):
    """What one or more periods make of small deviations.

    Attributes:
        matrix: ``(n, n)`` on the state at ``tau = 0``: modal coordinates, their velocities, and the motion that the
            other modes allow the rows whose velocity a law sees. What sticks for good is at rest.
        modes: Modal coordinates ``p``.
    """

    matrix: RealArray
    modes: int


def differentiate_laws(motion: PeriodicMotion, samples: int) -> Slopes | None:
    """Derivatives of all laws at a solution; None where one is by something else than ``VARIABLES``, or remembers."""
    balance, unknowns = pose_at(motion.problem.system.sample(samples), motion.forces, motion.rigid)
    return Slopes.of(balance.linearise(unknowns).derivatives, balance.rows)


def eliminate_steady(modes: Followed, slopes: Slopes, exponents: ComplexArray) -> tuple[ComplexArray, ...]:
    """What forces make of deviations that grow by ``exp(z t)``, with the equations of steady rows solved.

    Args:
        modes: The modes that follow; of waves, one for each exponent.
        slopes: The laws' derivatives.
        exponents: z, ``(k,)`` [1/s].

    Returns:
        Modal coordinates by modal forces ``(k, p, p)``; the rows' motions by their forces ``(k, m, m)``; the inverse of
        what the equations of steady rows make of their forces ``(k, m - x, m - x)``; forces of all rows by those of the
        rows that change status ``(k, m, x)``.

    Raises:
        LinAlgError: The forces of steady rows are not unique.
    """
    z = exponents[:, None, None]
    answer = np.linalg.inv(z**2 * modes.mass + z * modes.damping + modes.stiffness)
    flexibility = modes.rows @ answer @ np.conj(modes.rows).swapaxes(-1, -2) + modes.rest
    x, s, slope = slopes.changing, slopes.steady, slopes.at_steady
    own = slope["force"] + (slope["displacement"] + z * slope["velocity"]) @ flexibility
    inverse = np.linalg.inv(own[:, :, s])
    follow = np.zeros((len(z), modes.rows.shape[-2], x.size), dtype=own.dtype)
    follow[:, x] = np.eye(x.size)
    follow[:, s] = -inverse @ own[:, :, x]
    return answer, flexibility, inverse, follow


def step_deviations(system: ContactSystem, slopes: Slopes, periods: int = 1) -> Monodromy:
    """What one or more periods make of small deviations, stepped; the matrix is not finite where it overflows.

    Args:
        system: The system.
        slopes: Sampled twice a step, over so many periods.
        periods: How many.

    Raises:
        LinAlgError: Redundant pairs share their forces in any way.
    """
    samples, m = slopes.samples, len(system.rows)
    dt = 4 * np.pi * periods / (system.compliance.omega * samples)
    h = SHARE * dt
    modes = follow_modes(system, 2 * np.pi / (RESOLVED * dt))
    at_steady, x, p = slopes.at_steady, slopes.changing, modes.count
    remembers = np.any(at_steady["velocity"], axis=0)
    for slope in slopes.at_changing:
        if slope.variable == "velocity":
            remembers[slope.columns] = True
    remembered = np.flatnonzero(remembers)
    n = 2 * p + remembered.size
    # an implicit step divides by h where exp(z t) multiplies by z
    answer, by_force, steady_inverse, follow = (each[0] for each in eliminate_steady(modes, slopes, np.array([1 / h])))
    free, start = np.zeros((2, p, n))
    free[:, : 2 * p] = answer @ np.hstack([modes.mass / h**2 + modes.damping / h, modes.mass / h])
    start[:, :p] = np.eye(p)
    push, before, by_state = answer @ modes.rows.T, modes.rows @ start, modes.rows @ free
    before[remembered, 2 * p + np.arange(remembered.size)] = 1.0
    none = np.zeros((remembered.size, n))
    unforced, forced = (
        np.concatenate([free, (free - start) / h, none]),
        np.concatenate([push, push / h, modes.rest[remembered]]),
    )
    # forces of all rows, by those that change status and by the state; motions and velocities that come with them
    told = at_steady["displacement"] @ by_state + at_steady["velocity"] @ (by_state - before) / h
    forces = np.hstack([follow, np.zeros((m, n))])
    forces[slopes.steady, x.size :] = -steady_inverse @ told
    motions = by_force @ forces
    motions[:, x.size :] += by_state
    velocities = motions / h
    velocities[:, x.size :] -= before / h
    seen = {"force": forces, "displacement": motions, "velocity": velocities}

    def advance(at: np.ndarray) -> RealArray:
        """``(k, n, n)`` an implicit step over h that ends at each of ``k`` samples."""
        laws = np.zeros((at.size, x.size, x.size + n))
        for slope in slopes.at_changing:
            laws[:, slope.at] += slope.values[at][:, :, None] * seen[slope.variable][slope.columns]
        found = np.linalg.solve(laws[:, :, : x.size], laws[:, :, x.size :])
        return (unforced + forced @ forces[:, x.size :]) - (forced @ forces[:, : x.size]) @ found

    whole = np.eye(n)
    for first in range(0, samples, 2 * TOGETHER):
        ends = np.arange(first + 2, min(first + 2 * TOGETHER, samples) + 1, 2)
        half = advance(ends - 2 + round(2 * SHARE)) - np.eye(n)
        steps = advance(ends % samples) @ (np.eye(n) + (1 - SHARE) / SHARE * half)
        with np.errstate(over="ignore", invalid="ignore"):
            for step in steps:
                whole = step @ whole
    return Monodromy(whole, p)
