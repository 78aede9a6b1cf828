"""Solutions of a neighbouring problem, approached from that of a problem at hand: what estimates of errors look at.

The neighbour of most use has more harmonics (``look_ahead``). Newton steps lead to it, one by one. Where each is dear,
since many pairs change status, operator splitting gets closer in less time, as on the way to any solution.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.fft

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.balance.inexact_step import solve_inexactly
from ewr_fenicsx.balance.newton_step import NewtonStep
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.cone import FrictionLaw
from ewr_fenicsx.model.receptance import find_normal_modes
from ewr_fenicsx.problem.closure import find_own_springs, measure_beyond
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.dashpots import use_mobility
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solution.symmetry import leave_out_idle
from ewr_fenicsx.solver.splitting import Splitting, can_split, settle
from ewr_fenicsx.solver.warm_starts import carry_over

LEAST_LOOKAHEAD = 6  # harmonics that the estimate adds to a low order: the next two or three may be small by chance
LEAST_SAMPLES, LEAST_ORDER = 64, 8  # a period, and the harmonic up to which these serve
RINGING = 2.0  # times the flexibility at a neighbouring harmonic: one that lies at a resonance
MOST_RINGING, HIGHEST_RINGING = 3, 63  # harmonics at a resonance that are looked at, and how far they are looked for
RINGING_SAMPLES = 2.5  # a highest harmonic, at least
LARGE = 1000  # unknowns that no elimination takes out, from which on Newton steps are dear
# A splitting is looked at first where its defect is below both of these, over the accuracy and over the first defect;
# and then each time that it has fallen by the last one.
SETTLED, SETTLED_SHARE, FURTHER = 0.01, 0.1, 3.0


@dataclass(frozen=True, eq=False)
class _Neighbour:
    """A neighbouring problem at a solution's forces and motions: ``(n_h, m)`` each, and rigid coordinates ``(r,)``."""

    solution: PeriodicSolution
    problem: ContactProblem
    balance: HarmonicBalance
    forces: ComplexArray
    motion: ComplexArray
    rigid: RealArray

    @classmethod
    def of(cls, solution: PeriodicSolution, problem: ContactProblem) -> _Neighbour:
        problem = leave_out_idle(problem, solution)
        unit = float(np.linalg.norm(solution.forces)) or 1.0  # any: nothing is compared with a tolerance
        balance = HarmonicBalance(problem.system, unit)
        return cls(solution, problem, balance, *carry_over(solution, balance))

    @cached_property
    def step(self) -> NewtonStep:
        """The laws linearised at the solution's own motion, which another compliance would change."""
        return self.balance.linearise(self.balance.pack(self.forces, self.rigid), self.motion)

    def take_step(self) -> PeriodicSolution | None:
        """After one Newton step; None where it cannot be solved for."""
        unknowns = self.balance.pack(self.forces, self.rigid)
        if self.balance.size:
            try:
                unknowns = unknowns - solve_inexactly(self.step)
            except np.linalg.LinAlgError:
                return None
        return self.adopt(unknowns, "one Newton step")

    def adopt(self, unknowns: RealArray, reason: str) -> PeriodicSolution:
        """What was found, as a solution that has not converged."""
        forces, rigid = self.balance.unpack(unknowns)
        return replace(
            self.solution,
            problem=self.problem,
            forces=forces,
            rigid=rigid,
            converged=False,
            reason=reason,
            iterations=1,
        )


def approach(solution: PeriodicSolution, problem: ContactProblem, accuracy: float) -> Iterator[PeriodicSolution]:
    """Approximations of a neighbouring problem's solution, one begun where the last ended, until a step has no answer.

    A splitting takes fewer samples, half as many as the problem or less.

    Args:
        solution: Converged, or nearly.
        problem: The same joint with other harmonics, samples or weights.
        accuracy: Relative error that matters.
    """
    near = _Neighbour.of(solution, problem)
    if _can_split_towards(near):
        for ahead in _split_towards(near, accuracy):
            yield ahead
            near = _Neighbour.of(ahead, ahead.problem)
    while (ahead := near.take_step()) is not None:
        yield ahead
        near = _Neighbour.of(ahead, ahead.problem)


def _can_split_towards(near: _Neighbour) -> bool:
    """Whether a splitting ends at the neighbour's solution, not near it only, and in less time than Newton steps."""
    ends_there = can_split(near.balance) and all(law.impedance is not None for law in near.balance.system.laws)
    return ends_there and near.step.unknowns_left >= LARGE


def _split_towards(near: _Neighbour, accuracy: float) -> Iterator[PeriodicSolution]:
    """Where a splitting from the solution's state comes to, with ever smaller defects; ends where it stalls."""
    try:
        splitting = Splitting(near.balance, _choose_fewer_samples(near))
        state = splitting.join(near.forces, near.motion)
        goal = min(SETTLED * accuracy, SETTLED_SHARE * settle(splitting, state, np.inf).defect)
        while (found := settle(splitting, state, goal)).defect <= goal:
            state, goal = found.state, goal / FURTHER
            yield near.adopt(splitting.unknowns(state), "operator splitting")
    except np.linalg.LinAlgError:  # as next to a mode without damping
        return


def _choose_fewer_samples(near: _Neighbour) -> int:
    """Samples a period of a splitting: half the neighbour's, without those that a low order has on top."""
    neighbour, share = near.problem.basis, min(1.0, near.solution.orders[-1] / LEAST_ORDER) / 2
    fewest = max(share * neighbour.samples, RINGING_SAMPLES * neighbour.orders[-1])
    return scipy.fft.next_fast_len(int(np.ceil(fewest)), real=True)


def take_step(solution: PeriodicSolution, problem: ContactProblem) -> PeriodicSolution | None:
    """One Newton step from a solution towards that of a neighbouring problem; None where it cannot be solved for.

    Args:
        solution, problem: As in ``approach``.
    """
    return _Neighbour.of(solution, problem).take_step()


def look_ahead(solution: PeriodicSolution) -> tuple[ContactProblem, int]:
    """The problem with more harmonics, and up to which of them there are all: those that ring come on top."""
    raised = raise_harmonics(solution.problem)
    top = raised.basis.orders[-1]
    if ringing := find_ringing(solution.problem, top):
        needed = leave_out_idle(raised, solution).basis.orders
        odd = all(h % 2 for h in needed if h)
        ringing = [h for h in ringing if h % 2 or not odd]
    if ringing:
        samples = max(raised.basis.samples, choose_samples(max(ringing), RINGING_SAMPLES))
        raised = replace(raised, harmonics=(*needed, *ringing), samples=samples)
    return raised, top


def raise_harmonics(problem: ContactProblem) -> ContactProblem:
    """The problem with all harmonics up to half as high again, and samples to match.

    What springs leave is small and seen from further off: with twice the harmonics, and dashpots. Behind springs of
    their own pairs are seen from these: what dashpots leave there is the same with some more harmonics.
    """
    highest = problem.basis.orders[-1]
    sprung, owned = "springs" in problem.system.closures, has_own_springs(problem)
    added = highest if sprung else highest // 2 + 1
    raised = highest + max(added, LEAST_LOOKAHEAD)
    # a number leaves out what is zero by symmetry, a list does not
    everything = raised if isinstance(problem.harmonics, (int, np.integer)) else tuple(range(raised + 1))
    density = problem.basis.samples / max(1, highest)
    problem = replace(problem, harmonics=everything, samples=choose_samples(raised, density))
    if owned:
        return replace(problem, closure="spring") if isinstance(problem.closure, str) else problem
    return use_mobility(replace(problem, closure="dashpot")) if sprung else problem


def has_own_springs(problem: ContactProblem) -> bool:
    """Whether all pairs that rub do so behind springs of their own."""
    system, highest = problem.system, problem.basis.orders[-1]
    rub = [system.row_of("tangential", law.pairs) for law in system.laws if isinstance(law, FrictionLaw)]
    if not (rub and problem.frequency and highest):
        return False
    at = np.concatenate(rub)
    wave = system.usual_wave
    rows = system.rows_in(wave)[at]
    return bool(np.all(find_own_springs(system.model, rows, system.flexibility[at], problem.omega, highest, wave)))


def find_ringing(problem: ContactProblem, top: int) -> list[int]:
    """Harmonics above ``top`` at which the open joint resonates: what contact leaves there falls at no steady rate.

    Those with the largest flexibility of any row over the number of the harmonic; of a ring each is in its own wave.
    None where modes do not uncouple the model.
    """
    system, orders = problem.system, np.arange(top, HIGHEST_RINGING + 2)
    model, rows_in = system.model, system.rows_in
    waves = np.array([model.wave_of(h) for h in orders.tolist()])
    if orders.size < 3 or not len(system.rows) or any(find_normal_modes(model, w) is None for w in set(waves.tolist())):
        return []
    beyond = np.zeros((orders.size, len(system.rows)), dtype=complex)
    try:
        for wave in set(waves.tolist()):
            at = waves == wave
            beyond[at] = measure_beyond(model, rows_in(wave), problem.omega, orders[at], wave)
    except ModelError:  # one hits an undamped mode exactly: no step could have it
        return []
    flexibility = np.abs(beyond) / system.flexibility
    largest = flexibility.max(axis=1)
    here, below, above = largest[1:-1], largest[:-2], largest[2:]
    peaks = np.flatnonzero((here >= np.maximum(below, above)) & (here > RINGING * np.minimum(below, above)))
    first = peaks[np.argsort(-here[peaks] / orders[1:-1][peaks], kind="stable")][:MOST_RINGING]
    return sorted(int(h) for h in orders[1:-1][first])


def choose_samples(highest: int, density: float) -> int:
    """Samples a period, even: ``density`` a highest harmonic, and not too few for the low ones."""
    return 2 * int(np.ceil(max(LEAST_SAMPLES, density * highest) / 2))
