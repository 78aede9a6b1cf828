"""Harmonics in which no contact force can act, by symmetry or for want of excitation: left out of the solve.

*Nothing oscillates.* Without a load or a given force at any harmonic above 0 the steady state is at rest: harmonic 0
is all there is.

*Half-wave symmetry.* Where every load acts at odd harmonics and every law changes sign with the forces and motions
that it sees, ``-x(t + T/2)`` is a solution with every solution ``x(t)``, and there is one that is both: its even
harmonics are zero. Coulomb's law has the symmetry while its limit repeats every half period: a normal force that is
given, at even harmonics. A normal force that is sought (contact that opens, or a bond that must carry friction) would
itself be odd, and the limit another one in each half. A mean load, or a mean normal force that bends the structure,
takes nothing from the symmetry where the bodies are held and the laws see velocities alone; harmonic 0 is then kept.

A problem with the symmetry may have solutions without it (Den Hartog's oscillator at even fractions of its natural
frequency): a start that has even harmonics keeps them all, and so does a list of harmonics in place of their number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.problem.layout import demand_rows, lay_out
from ewr_fenicsx.solution.solution import PeriodicSolution

_ASYMMETRY = 1e-6  # share of a start's forces at harmonics that could be left out, above which they are kept


@dataclass(frozen=True)
class IdleHarmonics:
    """Harmonics of a problem that may be left out, and why; none and "" where all are needed."""

    orders: tuple[int, ...]
    why: str


_NONE = IdleHarmonics((), "")


def find_idle_harmonics(problem: ContactProblem) -> IdleHarmonics:
    """Harmonics at which every contact force of a problem is zero; none where the problem lists its harmonics."""
    orders, model = problem.basis.orders, problem.model
    if not isinstance(problem.harmonics, (int, np.integer)):
        return _NONE
    demands = [demand_rows(model, pairs, laws.kinds) for pairs, laws in problem.groups]
    if not any(demand.active for demand in demands):
        return _NONE  # a linear problem has no unknowns to save
    given = {h for h, force in problem.given_force.items() if np.any(force)}
    loaded = {h for h, f in problem.loads.items() if np.any(f)}
    if not any(loaded | given):
        return IdleHarmonics(orders[1:], "nothing oscillates: a static solve")
    if model.normal is not None:
        loaded |= given
    blind = True
    for (_, laws), demand in zip(problem.groups, demands, strict=True):
        for kind in laws.kinds:
            sees_unknown = any(direction in demand.active for direction in kind.needs)
            limit_differs = "normal" in kind.needs and any(h % 2 for h in given)
            if not kind.odd or sees_unknown or limit_differs:
                return _NONE
            blind &= kind.blind_to_mean
    mean = 0 in loaded
    if any(h % 2 == 0 for h in loaded if h) or (mean and not blind) or problem.basis.samples % 2:
        return _NONE
    if lay_out(model, tuple(demands)).model.rigid_modes.shape[1]:
        return _NONE
    idle = tuple(h for h in orders if h % 2 == 0 and not (h == 0 and mean))
    return IdleHarmonics(idle, "half-wave symmetry: odd loads, and laws that change sign with their motions")


def leave_out_idle(problem: ContactProblem, start: PeriodicSolution | None = None) -> ContactProblem:
    """The problem without its idle harmonics; itself where it has none, or where the start uses them."""
    idle = find_idle_harmonics(problem).orders
    if start is not None:
        at = [j for j, h in enumerate(start.orders) if h in idle]
        if np.linalg.norm(start.forces[at]) > _ASYMMETRY * np.linalg.norm(start.forces):
            return problem
    if not idle:
        return problem
    kept = tuple(h for h in problem.basis.orders if h not in idle)
    samples = 1 if kept == (0,) else problem.basis.samples
    return replace(problem, harmonics=kept, samples=samples)


def include_idle(solution: PeriodicSolution, problem: ContactProblem) -> PeriodicSolution:
    """A solution without the idle harmonics of ``problem`` as one with them, at zero."""
    if solution.orders == problem.basis.orders:  # its start used them
        return solution
    forces = np.zeros((len(problem.basis.orders), solution.forces.shape[1]), dtype=complex)
    for j, h in enumerate(solution.orders):
        forces[problem.basis.orders.index(h)] = solution.forces[j]
    idle = find_idle_harmonics(problem)
    return replace(solution, problem=problem, forces=forces, left_out=idle.orders, why_left_out=idle.why)
