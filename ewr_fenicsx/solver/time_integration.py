"""The same contact problem stepped in time: transients, steady states, an independent check of the harmonic solver."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real

import numpy as np

from ewr_fenicsx.balance.periodic_motion import SECOND
from ewr_fenicsx.errors import ModelError, nearest
from ewr_fenicsx.given import ComplexArray, RealArray, is_positive, is_whole
from ewr_fenicsx.in_time.compiled_loop import FRICTION, compile_loop
from ewr_fenicsx.in_time.lifting import lift_out
from ewr_fenicsx.in_time.periodicity import Anderson, Watch, count_missing, fades, find_end, tell_walk
from ewr_fenicsx.in_time.surroundings import Surroundings
from ewr_fenicsx.in_time.time_stepping import BOUND, Period, State, TimeScheme, to_amplitudes
from ewr_fenicsx.model.restriction import find_bond_forces
from ewr_fenicsx.problem.contact_problem import ContactProblem, check_problem
from ewr_fenicsx.progress import count_progress
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.initial_states import choose_start

_RINGS = "; contact nodes with little mass may ring from step to step: theta = 0.52 damps that"
UNDAMPED = 0.5  # theta that conserves the structure's energy
HISTORIES = ("normal_force", "friction_force", "gap", "slip", "slip_velocity")
SECOND_HISTORIES = tuple(SECOND + name for name in ("friction_force", "slip", "slip_velocity"))


@dataclass(frozen=True, eq=False)
class SteadyState:
    """Result of ``integrate``: the last period, step by step.

    Attributes:
        problem: What was integrated.
        scheme: The scheme that did it.
        last: The last period in the scheme's modal coordinates.
        converged: Whether the motion repeats from period to period and every step of the last period was solved; False
            with a tolerance of 0, where nobody asked.
        asked: Whether somebody did.
        reason: Why the integration stopped.
        periods: Periods stepped.
        changes: ``(periods,)`` relative change from each period to the next; the first is infinite.
        distance: Estimated distance to the steady state relative to the oscillation, by Anderson's extrapolation; with
            a slowly decaying motion it is many times the last change. NaN after a single period.
        unsolved: Steps, over all periods, whose contact solve missed its tolerance.
        sweeps: Mean number of Gauss-Seidel sweeps a step.
        seconds: Wall time, compilation left out.
        transients: Name -> that output at all steps from the start, ``(periods * steps + 1,)``; empty when accelerated.
        surroundings: What is next to a steady motion, when accelerated; else None.
    """

    problem: ContactProblem = field(repr=False)
    scheme: TimeScheme = field(repr=False)
    last: Period = field(repr=False)
    converged: bool
    asked: bool
    reason: str
    periods: int
    changes: RealArray = field(repr=False)
    distance: float
    unsolved: int
    sweeps: float
    seconds: float
    transients: Mapping[str, RealArray] = field(repr=False)
    surroundings: Surroundings | None = field(repr=False, default=None)

    @property
    def orders(self) -> tuple[int, ...]:
        """Harmonics of the amplitudes that ``output`` returns."""
        return self.problem.basis.orders

    @cached_property
    def unstable(self) -> bool:
        """Whether motions that begin next to the steady one are seen to leave it; looked at when accelerated.

        Some more periods are stepped the first time that it is asked for, as by ``summary``.
        """
        return self.surroundings is not None and self.surroundings.are_left()

    @property
    def end(self) -> State:
        """State at the end of the last period: where another integration may start."""
        return State(self.scheme.expansion @ self.last.positions[-1], self.scheme.expansion @ self.last.velocities[-1])

    def summary(self) -> str:
        """One line for people."""
        state = "steady" if self.converged else f"NOT steady ({self.reason})" if self.asked else self.reason
        left = "; unstable: motions next to it leave it, and show where to without acceleration" * self.unstable
        return (
            f"{self.problem.frequency:g} Hz, {self.scheme.steps} steps a period: {state} after {self.periods} periods, "
            f"change {self.changes[-1]:.1e}, distance left {self.distance:.1e}, {self.unsolved} steps unsolved, "
            f"{self.sweeps:.0f} sweeps a step, {self.seconds:.2f} s{left}"
        )

    def transient(self, name: str) -> RealArray:
        """A named output at all steps from the start, ``(periods * steps + 1,)``.

        Raises:
            ModelError: The model has no such output, or the integration was accelerated: its periods do not follow
                from one another.
        """
        self._output_row(name)
        if name not in self.transients:
            raise ModelError("an accelerated integration has no transient; integrate with acceleration=False")
        return self.transients[name].copy()

    def output(self, name: str) -> ComplexArray:
        """One-sided complex amplitudes ``(n_h,)`` of a named output over the last period.

        Raises:
            ModelError: The model has no such output.
        """
        return to_amplitudes((self.last.positions[:-1] @ self._output_row(name))[:, None], self.orders)[:, 0]

    @property
    def contact_amplitudes(self) -> tuple[ComplexArray, ComplexArray]:
        """One-sided complex amplitudes of the contact rows' forces [N] and motions [m], ``(n_h, m)``, last period."""
        return self.scheme.contact_amplitudes(self.last, self.orders)

    def output_history(self, name: str, samples: int | None = None) -> RealArray:
        """A named output over the last period, ``(samples,)``, at equal intervals from ``tau = 0``; None: one a step.

        Raises:
            ModelError: The model has no such output.
        """
        return resample_ends((self.last.positions @ self._output_row(name))[:, None], samples)[:, 0]

    def _output_row(self, name: str) -> RealArray:
        known = self.problem.model.outputs
        if name not in known:
            raise ModelError(f'no output "{name}"; the model has {sorted(known)}{nearest(name, known)}')
        return known[name] @ self.scheme.expansion

    def history(self, name: str, samples: int | None = None) -> RealArray:
        """A quantity of every pair over the last period, ``(samples, K_c)``, at equal intervals from ``tau = 0``.

        Forces are impulses over the length of the step, and belong to its middle (``theta``). Between those instants,
        and between the steps' ends for motions, values are linear. Before the first middle and after the last one that
        is between these two: in a transient, which does not repeat itself, the force at ``tau = 0`` means nothing.

        Args:
            name: ``"normal_force"``, ``"friction_force"`` [N]; ``"gap"`` (initial gap included), ``"slip"`` [m];
                ``"slip_velocity"`` [m/s]; in 3-D also those along the second tangent, ``"second_friction_force"``,
                ``"second_slip"``, ``"second_slip_velocity"``.
            samples: Samples a period; None: one a step.

        Raises:
            ModelError: An unknown name, or no whole number of samples.
        """
        model, expansion = self.problem.model, self.scheme.expansion
        known = HISTORIES + (SECOND_HISTORIES if model.tangents == 2 else ())
        if name not in known:
            raise ModelError(f'no history "{name}"; choose one of {", ".join(known)}{nearest(name, known)}')
        along = "second_tangential" if name.startswith(SECOND) else "tangential"
        name = name.removeprefix(SECOND)
        if name in ("normal_force", "friction_force"):
            zero = np.zeros((self.scheme.steps, model.pairs))
            force = self._pair_forces().get("normal" if name == "normal_force" else along, zero)
            return resample(force, self.scheme.theta, samples)
        still = np.zeros((self.scheme.steps + 1, model.pairs))
        if name == "gap":
            opening = still if model.normal is None else self.last.positions @ (model.normal @ expansion).T
            return resample_ends(opening + self.problem.clearance, samples)
        motion = self.last.positions if name == "slip" else self._rates
        return resample_ends(motion @ (model.rows(along) @ expansion).T if model.tangents else still, samples)

    def sliding_speed(self, samples: int | None = None) -> RealArray:
        """Speed of sliding at every pair over the last period, along both tangents in 3-D, ``(samples, K_c)`` [m/s]."""
        model, expansion = self.problem.model, self.scheme.expansion
        speed = np.zeros((self.scheme.steps + 1, model.pairs))
        for direction in model.tangent_directions:
            speed = np.hypot(speed, self._rates @ (model.rows(direction) @ expansion).T)
        return resample_ends(speed, samples)

    def pressing_force(self, samples: int | None = None) -> RealArray:
        """Force that presses at every pair over the last period, ``(samples, K_c)`` [N]."""
        return np.maximum(0.0, self.history("normal_force", samples))

    @property
    def _rates(self) -> RealArray:
        """Modal velocities ``(steps + 1, n')`` as friction sees them: what was late in the step before counts."""
        v, scheme = self.last.velocities, self.scheme
        before, earlier = (v[np.arange(-late, scheme.steps + 1 - late) % scheme.steps] for late in (1, 2))
        return v + (scheme.thetas - scheme.theta) * (before - earlier)

    def _pair_forces(self) -> dict[str, RealArray]:
        """Mean force in each step at all pairs by direction, ``(steps, K_c)``, bonds and given ones included [N]."""
        problem, layout, forces = self.problem, self.scheme.layout, self.last.impulses / self.scheme.dt
        found = {d: layout.spread(forces, d) for d in ("normal", *problem.model.tangent_directions)}
        found["normal"] += self.scheme.sample(problem.given_force, np.arange(problem.model.pairs))
        if problem.bonds:
            self._recover_bonds(found)
        return found

    def _recover_bonds(self, found: dict[str, RealArray]) -> None:
        """Forces in bonded pairs: what the equation of motion leaves over.

        At the middle of steps (``theta``) for all modes, also those that are stepped with a ``theta`` of their own.
        """
        model, scheme, bonds = self.problem.model, self.scheme, self.problem.bonds
        expand = lambda modal: modal @ scheme.expansion.T  # noqa: E731
        blend = lambda ends: expand((1 - scheme.theta) * ends[:-1] + scheme.theta * ends[1:])  # noqa: E731
        x, v = self.last.positions, self.last.velocities
        gained = expand(np.diff(v, axis=0)) / scheme.dt
        left = gained @ model.mass.T + blend(v) @ model.damping.T + blend(x) @ model.stiffness.T
        left -= scheme.sample(self.problem.loads, np.arange(model.size))
        if model.normal is not None:
            left -= found["normal"] @ model.normal
        for direction in model.tangent_directions:
            left -= found[direction] @ model.rows(direction)
        for (direction, pairs), force in zip(bonds, find_bond_forces(model, bonds, left.T), strict=True):
            found[direction][:, pairs] = force.T

    def measure_energy(self) -> dict[str, float]:
        """Works over the last period [J].

        They add up to zero to rounding with ``theta = 1/2``, but for what modes without mass or too fast for the step
        lose to a ``theta`` of their own, which falls with the step.

        Returns:
            ``"excitation"`` done by the load; ``"stored"`` gained by the structure, zero in the steady state;
            ``"viscous"``, ``"friction"``, ``"impact"`` dissipated.
        """
        scheme, last = self.scheme, self.last
        v = scheme.blend(last.velocities[:-1], last.velocities[1:])
        work = (last.impulses * (v @ scheme.rows.T)).sum(axis=0)
        slides = scheme.kind == FRICTION
        energy = 0.5 * (last.velocities**2 @ scheme.mass + last.positions**2 @ scheme.stiffness)
        return {
            "excitation": float(scheme.dt * np.sum(scheme.load * v)),
            "stored": float(energy[-1] - energy[0]),
            "viscous": float(scheme.dt * np.sum(v * (v @ scheme.damping.T))),
            "friction": -float(work[slides].sum()),
            "impact": -float(work[~slides].sum()),
        }


def resample(values: RealArray, offset: float, samples: int | None, end: RealArray | None = None) -> RealArray:
    """Values, one a step at ``offset`` steps past its start, ``(steps, m)``, as ``samples`` from ``tau = 0``.

    Args:
        values, offset, samples: As said.
        end: ``(m,)`` what follows on the last one; None: the first one, as in a period that repeats itself.

    Raises:
        ModelError: No whole number of samples.
    """
    if not (samples is None or is_whole(samples, 1)):
        raise ModelError(f"samples = {samples!r}; give a whole number of samples a period, or None: one a step")
    steps = values.shape[0]
    closed = np.vstack([values, values[0] if end is None else end])
    at = np.arange(steps if samples is None else samples) * (1.0 if samples is None else steps / samples) - offset
    before = np.floor(at).astype(int)
    share = (at - before)[:, None]
    return (1 - share) * closed[before % steps] + share * closed[before % steps + 1]


def resample_ends(values: RealArray, samples: int | None) -> RealArray:
    """Values at the ends of all steps, ``(steps + 1, m)`` with that at ``tau = 0``, as ``samples`` from there."""
    return resample(values[:-1], 0.0, samples, values[-1])


def integrate(
    problem: ContactProblem,
    start: PeriodicSolution | State | str | None = None,
    steps: int = 800,
    periods: int = 200,
    tolerance: float = 1e-5,
    *,
    theta: float = UNDAMPED,
    contact_tolerance: float = 1e-8,
    sweeps: int = 1000,
    acceleration: bool = False,
    progress: bool = False,
) -> SteadyState:
    """Step a contact problem in time until its motion repeats.

    Args:
        problem: The problem; its harmonics choose what ``output`` returns and do not limit the motion.
        start: A ``PeriodicSolution`` on the same model (its state at ``tau = 0``, bodies that overlap moved apart); a
            ``State``, such as the ``end`` of another result (as it is: what overlaps and has a mass of its own flies
            off at that way over the length of a step); ``"rest"``: the static state under the mean load, without
            velocity, in which all pairs are closed, and without friction unless ``static_friction = "held"``; where
            there are gaps, or friction is held, the static solution of the laws; None: that solution there, if it is
            found, else the full-stick periodic state, whose mean is the same state. Bodies that contact cannot hold
            at rest need a ``State``.
        steps: Steps a period.
        periods: Most periods to step.
        tolerance: Largest relative change from one period to the next (rms over the period, of each output, of the
            motion at the pairs, and of all masses) that counts as steady; 0 steps all the periods.
        theta: Weight of a step's end in its mean: 1/2 conserves the structure's energy, more, up to 1, damps what the
            step does not resolve. With few steps a period and 1/2, contact feeds the ringing of nodes that have little
            mass: ``measure_energy`` then tells of a negative loss by impacts (blade root at 100 steps; 0.55 is enough).
            A contact node with a mass of its own rebounds with up to ``1 - theta`` of the speed at which it lands (from
            a third to a half with 1/2), however short the step; with 1 it does not rebound.
        contact_tolerance: Largest change of an impulse in the last sweep of a step, relative to the largest impulse.
        sweeps: Most Gauss-Seidel sweeps a step; a step that needs more is counted in ``unsolved``.
        acceleration: Start each period from Anderson's extrapolation of those before: two to ten times fewer periods
            where a lightly damped motion decays slowly, but no transient. Steadiness is judged by periods that follow
            from one another either way; but extrapolation may end on a motion that others leave (``unstable``).
        progress: Whether to show how many periods are done, how much the last one changed, and the time that all of
            them would take.

    Returns:
        The last period. Not steady, or not solved, is said by ``converged`` and ``reason``.

    Raises:
        ModelError: The problem has no period, the start does not fit it or there is no ``"rest"``, ``steps``,
            ``periods`` or ``sweeps`` is no whole number from one, the steps are too few for the harmonics, or a
            tolerance is negative or no number.
        UnheldBody: Contact cannot hold a floating body under its mean load, and the start is no ``State``.
    """
    check_problem(problem)
    for name, count in (("periods", periods), ("sweeps", sweeps)):
        if not is_whole(count, 1):
            raise ModelError(f"{name} = {count!r}; give a whole number, at least one")
    periods, sweeps = int(periods), int(sweeps)
    if not (isinstance(tolerance, Real) and tolerance >= 0):
        raise ModelError(f"tolerance = {tolerance!r}; give a positive one, or 0 to step all the periods")
    if not is_positive(contact_tolerance):
        raise ModelError(f"contact_tolerance = {contact_tolerance!r}; give a positive one, such as 1e-8")
    scheme = TimeScheme(problem, steps, theta)
    begun = choose_start(problem, start)
    position, velocity, carried = scheme.begin(begun if isinstance(start, State) else lift_out(scheme, begun))
    here = np.concatenate([position, velocity])
    compile_loop()
    begin = time.perf_counter()
    watch, anderson = Watch(scheme), Anderson(scheme)
    sweeps_taken = unsolved = 0
    changes: list[float] = []
    follows = True  # the period starts where the last one ended
    step = lambda state, taken: scheme.run_period(*np.split(state, 2), taken, contact_tolerance, sweeps)  # noqa: E731
    with count_progress("time stepping, periods", periods, progress) as report:
        for _ in range(periods):
            last = step(here, carried)
            end, carried = find_end(last), last.carried
            sweeps_taken, unsolved = sweeps_taken + last.sweeps, unsolved + last.unsolved
            watch.record(last)
            if not np.all(np.abs(end) < BOUND):
                reason = f"without bound in period {len(changes) + 1}{_RINGS if theta == UNDAMPED else ''}"
                changes.append(np.inf)
                break
            changes.append(watch.measure_change(last))
            report(len(changes), f"change {changes[-1]:.0e}")
            ahead = anderson.extrapolate(here, end, last)
            if follows and tolerance and changes[-1] <= tolerance and not last.unsolved:
                reason = "steady"
                break
            follows = not acceleration or anderson.defect <= tolerance
            here = end if follows else ahead
        else:
            reason = f"not steady after {periods} periods" if tolerance else "not asked whether steady (tolerance = 0)"
            if follows and last.unsolved and changes[-1] <= tolerance:
                reason = f"it repeats itself after {periods} periods"
            elif walk := tell_walk(last, watch.ways, scheme):
                reason += f"; {walk}"
            elif follows and tolerance and watch.second_change <= tolerance and not fades(changes):
                reason += "; every second one is the same: step at half the frequency, loads at twice their harmonics"
            elif not acceleration and (missing := count_missing(changes, tolerance)):
                reason += f"; what a period changes falls steadily: some {missing} more may do"
            elif tolerance and theta == UNDAMPED:
                reason += _RINGS
    if last.unsolved:
        reason += f"; {last.unsolved} of the last {scheme.steps} steps missed the contact tolerance in {sweeps} sweeps"
    steady = reason == "steady"
    beside = Surroundings(scheme, last, anderson, contact_tolerance, sweeps)
    return SteadyState(
        problem=problem,
        scheme=scheme,
        last=last,
        converged=steady,
        asked=tolerance > 0,
        reason=reason,
        periods=len(changes),
        changes=np.array(changes),
        distance=anderson.distance,
        unsolved=unsolved,
        sweeps=sweeps_taken / (len(changes) * scheme.steps),
        seconds=time.perf_counter() - begin,
        transients={} if acceleration else watch.transients,
        surroundings=beside if steady and acceleration else None,
    )
