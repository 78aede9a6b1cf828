"""``solve``: a contact problem's periodic solution, from a neighbour's or from cold."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import islice
from numbers import Real
from reprlib import repr as shorten
from typing import TYPE_CHECKING, get_args

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import ModelError, NotConverged, nearest
from ewr_fenicsx.problem.composition import list_unpressed
from ewr_fenicsx.problem.contact_problem import ContactProblem, check_problem
from ewr_fenicsx.solution.loading_history import hold_in_place
from ewr_fenicsx.solution.remedies import find_jammed_pairs, list_remedies
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solution.symmetry import include_idle, leave_out_idle
from ewr_fenicsx.solver.at_rest import begins_at_rest, start_at_rest
from ewr_fenicsx.solver.faint_forces import attend_to_faint_forces
from ewr_fenicsx.solver.growing_load import grow_load, trace_load
from ewr_fenicsx.solver.growing_sets import add_harmonics
from ewr_fenicsx.solver.ladder import (
    FINE_LEVELS,
    FINE_TOLERANCE,
    LARGEST_DAMPED,
    LARGEST_TRACED,
    SPRING_LEVELS,
    SPRING_TOLERANCE,
    begin_at_full_stick,
    climb,
    come_down,
    sharpen_corners,
    start_cold,
    trace_damping,
)
from ewr_fenicsx.solver.long_splitting import split_at_length
from ewr_fenicsx.solver.newton_path import can_follow, follow_from_afar
from ewr_fenicsx.solver.snes import TIGHTEST, Attempt, LinearSolver, run_newton
from ewr_fenicsx.solver.splitting import are_projections
from ewr_fenicsx.solver.warm_starts import go_on_from, guide, pick_first
from ewr_fenicsx.solver.weights import approach_weights, has_far_weights, has_own_weights, use_default_weights

if TYPE_CHECKING:
    from ewr_fenicsx.solver.time_integration import SteadyState

LOG = logging.getLogger(__name__)  # INFO: which rung comes next, and why

# Time stepping to a start: steps a period (at least, and times the highest harmonic), periods, and how steady.
TIME_STEPS, TIME_STEPS_A_HARMONIC, TIME_PERIODS, TIME_TOLERANCE = 256, 8, 40, 1e-3  # half that with more harmonics
TIME_DAMPING = 0.6  # theta above 1/2, which damps what so few steps do not resolve
TIME_CONTACT, TIME_SWEEPS = 1e-4, 100  # tolerance of a step's contact forces, and its most sweeps
TIME_NEWTON = 30  # Newton steps a run from there: those that arrive take fewer
# Median change from one of the last periods to the next that casts doubt on there being a periodic motion.
APERIODIC, LAST_PERIODS = 0.1, 10
# How many times more harmonics are tried where so few find no solution: up to which harmonic, and how many unknowns
MORE_HARMONICS, HIGHEST_FEW, LARGEST_FEW = 2, 15, 3000
LOOSEST = 1e-3  # tolerance above which even a start may pass for a solution
OWN_STEPS = 40  # of a cold start with weights of one's own, whose last ones mostly creep; the default ones are quicker
GROSS = 1e-2  # residual above which a failed attempt is far from a solution
ASTRAY = 0.3  # residual of a start from which hardly any run arrives where no long splitting has led on


def solve(
    problem: ContactProblem,
    start: PeriodicSolution | None = None,
    tolerance: float = 1e-8,
    *,
    linear_solver: LinearSolver = "elimination",
    fallbacks: bool | int = True,
    raise_on_failure: bool = True,
) -> PeriodicSolution:
    """Periodic solution of a contact problem with the harmonics that it gives.

    From a given start, Newton at the harmonics asked for. Cold, or where that fails, the ladder, rung by rung until one
    holds: from where operator splitting ends, or else from the linear full-stick solution up through growing sets of
    harmonics, each starting at the one before, solids that hang on friction from rest (``at_rest.py``), and at rest
    what hangs on friction from where springs hold its pairs in place; from where a few periods of time stepping end,
    and a long splitting or Newton's path leads from there (in a ring of sectors, and at rest, a long splitting from
    full stick); along Newton's path while the oscillating load grows, with few samples a period first; from time
    stepping with twice as many harmonics, and down to those asked for; laws with rounded corners that are sharpened
    along their branch; damping traced from where little can bounce to the model's own; rounded corners through more
    sets of harmonics, with the oscillating load traced from a small share to the whole, past folds; and that tracing by
    itself. Weights of one's own that the first climb does not find, or that are far from the default ones, are come to
    from a solution with these, which takes all these rungs and is the answer itself where no way leads on. Where
    Newton's method stalls next to a solution, its path leads on from corner to corner (``newton_path.py``); each
    factorisation counts as a Newton step. Where floating bodies touch that nothing presses, or no motion relieves all
    interferences, the cold start is the only rung.

    Harmonics that are zero by symmetry are left out of the solve, and are zero in the solution (``symmetry.py``).

    Args:
        problem, start, tolerance, linear_solver, raise_on_failure: As users call it, in ``solving.py``.
        fallbacks: Whether to go on to the next rung where the first one fails (the given start, cold the first climb),
            or to how many more.

    Returns:
        The solution: motions, contact forces and figures of merit, and how it was found. Its ``problem`` has the
        default weights and dashpots where none was found with what it asks for; ``fallbacks`` says so.

    Raises:
        ModelError: ``start`` is no solution, not finite or has another number of pairs, the tolerance is out of
            bounds, or there is no such ``linear_solver``.
        NotConverged: No solution was found; carries the best iterate and the rungs tried.
    """
    check_problem(problem)
    if start is not None and not isinstance(start, PeriodicSolution):
        raise ModelError(f"start = {shorten(start)}; give a solution that solve returned, or None")
    if start is not None and start.problem.model.pairs != problem.model.pairs:
        raise ModelError(
            f"start has {start.problem.model.pairs} pairs, the problem {problem.model.pairs}; give a solution on "
            "the same joint, or none"
        )
    if start is not None and not np.all(np.isfinite(start.forces)):
        raise ModelError("start has forces that are not finite; give a solution that converged, or none")
    if linear_solver not in (known := get_args(LinearSolver)):
        raise ModelError(
            f"linear_solver = {linear_solver!r}; choose one of {', '.join(known)}{nearest(linear_solver, known)}"
        )
    if not (isinstance(tolerance, Real) and TIGHTEST <= tolerance <= LOOSEST):
        raise ModelError(
            f"tolerance = {tolerance!r}; give one from {TIGHTEST:g}, below which rounding decides, to {LOOSEST:g}, "
            "above which even a start may pass for a solution; 1e-8 is usual"
        )
    begin = time.perf_counter()
    asked, problem = problem, leave_out_idle(problem, start)
    system = problem.system
    composed = time.perf_counter()
    balance, best, attempts, tried = None, None, [], []
    if system.rows.shape[0]:
        balance = HarmonicBalance(system)
        rungs = list_rungs(problem, balance, start, tolerance, linear_solver, fallbacks)
        for name, rung in islice(rungs, None if fallbacks is True else 1 + fallbacks):
            if tried:
                LOG.info("%g Hz: %s; next: %s", problem.frequency, tried[-1], name)
            attempts.append(rung(best))
            tried.append(f"{name}: {attempts[-1].told}")
            if attempts[-1].decides:
                attempts[-1] = attend_to_faint_forces(balance, attempts[-1], tolerance, linear_solver)
                break
            best = replace(min(best or begin_at_full_stick(balance), attempts[-1]), iterations=0)
    if attempts and attempts[-1].usual:
        asked, problem = use_default_weights(asked), use_default_weights(problem)
    fell_back = tuple(tried) if len(tried) > 1 or any(a.usual or a.detour for a in attempts) else ()
    end = time.perf_counter()
    solution = include_idle(wrap(problem, balance, attempts, fell_back, end - begin), asked)
    iterated = balance is not None and not balance.linear
    solution = replace(
        solution, stages={"compose": composed - begin} | ({"newton": end - composed} if iterated else {})
    )
    if raise_on_failure and not solution.converged:
        told = f". Tried: {'; '.join(fell_back)}" if fell_back else ""
        advice = "" if attempts[-1].walks else list_remedies(solution)
        raise NotConverged(
            f"no periodic solution at {problem.frequency:g} Hz: {solution.reason}; residual {solution.residual:.1e} "
            f"after {solution.iterations} Newton steps{told}{advice}",
            best=solution,
        )
    return solution


def list_rungs(
    problem: ContactProblem,
    balance: HarmonicBalance,
    start: PeriodicSolution | None,
    tolerance: float,
    linear_solver: LinearSolver,
    fallbacks: bool | int = True,
) -> Iterator[tuple[str, Callable[[Attempt | None], Attempt]]]:
    """The ways to a solution, the cheapest first: name, and what makes an attempt of the best one so far.

    The first way has no attempt before it, and takes no ladder unless ``fallbacks`` may follow. An attempt counts its
    own Newton steps only: it is given one that counts none.
    """
    if balance.linear:
        yield "one linear solve", lambda _: solve_linear(balance, tolerance)
        return
    if start is not None:
        yield "given start", lambda _: go_on_from(start, balance, tolerance, linear_solver)
    own = has_own_weights(problem)
    sets = (SPRING_LEVELS, SPRING_TOLERANCE) if problem.has_springs else ()  # or the usual ones
    limit = OWN_STEPS if own and not problem.system.closures else None
    cold = "cold start", lambda _: start_cold(balance, tolerance, linear_solver, *sets, limit=limit)
    if begins_at_rest(balance):
        cold = "start at rest", lambda _: start_at_rest(problem, balance, tolerance, linear_solver, limit)
    if own:  # the default ones take all rungs that there are
        given = (problem, balance, start, tolerance, linear_solver)
        usual = "from the default weights and dashpots", lambda _: leave_default_weights(*given)
        yield from (usual, cold) if fallbacks and has_far_weights(problem) else (cold, usual)
        return
    yield cold
    loose = list_unpressed(problem, balance.system)
    if np.any(problem.clearance[loose] <= 0):  # they lie where they touch, and each place off there is as good
        return
    if find_jammed_pairs(problem):  # there is no solution
        return
    if not problem.frequency and balance.hangs_on_friction and not np.any(balance.held):
        yield "from where pairs are held in place", lambda _: start_held(problem, balance, tolerance, linear_solver)
    stepped = cache(lambda: step_coarsely(problem))  # for both rungs that go by it
    if problem.model.cyclic or not problem.frequency:  # a wave that travels round is no motion of one sector in time
        yield "long splitting", partial(split_from_full_stick, balance, tolerance, linear_solver)
    else:
        yield "time stepping", lambda best: start_from_time_stepping(stepped(), balance, tolerance, linear_solver, best)
    if problem.frequency and balance.size <= LARGEST_TRACED and can_follow(balance):
        yield "load grown over corners", partial(grow_load, balance, tolerance)
    is_few = 0 < balance.basis.orders[-1] <= HIGHEST_FEW and balance.size <= LARGEST_FEW
    if is_few and not problem.model.cyclic:
        more = (balance, tolerance, linear_solver)
        yield "more harmonics, then fewer", lambda best: start_from_more_harmonics(problem, stepped(), *more, best)
    if balance.size <= LARGEST_TRACED:
        yield "rounded corners", partial(sharpen_corners, balance, tolerance)
    if problem.frequency and balance.size <= LARGEST_DAMPED:
        yield "falling damping", partial(trace_damping, balance, tolerance)
    fine = FINE_LEVELS, (sharpen_corners, trace_load), FINE_TOLERANCE
    yield "more sets of harmonics", lambda _: climb(balance, tolerance, linear_solver, *fine)
    if balance.size <= LARGEST_TRACED:
        yield "growing load", partial(trace_load, balance, tolerance)


def start_held(
    problem: ContactProblem, balance: HarmonicBalance, tolerance: float, linear_solver: LinearSolver
) -> Attempt:
    """Newton at rest from where springs hold pairs in place, which the rungs find more often."""
    held = solve(hold_in_place(problem), None, tolerance, linear_solver=linear_solver, raise_on_failure=False)
    found = run_newton(balance, balance.pack(held.forces, held.rigid), tolerance, linear_solver)
    return replace(found, iterations=found.iterations + held.iterations)


def step_coarsely(problem: ContactProblem) -> SteadyState | str:
    """Where some periods of time stepping end, coarse and damped; or why there are none."""
    from ewr_fenicsx.solver.time_integration import integrate  # only for those whom Newton fails

    try:
        steady = integrate(
            problem,
            steps=max(TIME_STEPS, TIME_STEPS_A_HARMONIC * max(problem.basis.orders)),
            periods=TIME_PERIODS,
            tolerance=TIME_TOLERANCE,
            theta=TIME_DAMPING,
            contact_tolerance=TIME_CONTACT,
            sweeps=TIME_SWEEPS,
            acceleration=True,
        )
    except (ModelError, ImportError) as refusal:
        return str(refusal).removesuffix("; use solve")
    return steady if np.all(np.isfinite(steady.contact_amplitudes[0])) else f"time stepping went {steady.reason}"


def start_from_time_stepping(
    steady: SteadyState | str,
    balance: HarmonicBalance,
    tolerance: float,
    linear_solver: LinearSolver,
    best: Attempt,
) -> Attempt:
    """Newton from where some coarse periods of time stepping end, which find their way however hard the contact.

    A long splitting leads on from there. Else two starts are worth trying, unless they are far off: the forces
    themselves, and a step of the laws linearised at forces and motions. Where Newton's method stalls, its path may
    arrive: from there, or from the starts, however far off they are.

    ``balance``: that of the problem that was stepped, or of the same with more harmonics.
    """
    if isinstance(steady, str):
        return replace(best, reason=steady)
    forces, motion = steady.scheme.contact_amplitudes(steady.last, balance.basis.orders)
    attempt, steps = best, 0
    if split := split_at_length(balance, forces, motion, tolerance, linear_solver):
        if split.converged:
            return split
        attempt, steps = min(best, split), split.iterations
    rigid = np.zeros(balance.rigid)
    if balance.rigid:
        unmoved = balance.compliance.motion(forces, rigid)[0].real
        rigid = np.linalg.lstsq(balance.compliance.rigid_motion, motion[0].real - unmoved, rcond=None)[0]
    starts = [balance.pack(forces, rigid), guide(balance, forces, motion, rigid)]
    left = np.array([balance.measure_residual(u) if np.all(np.isfinite(u)) else np.inf for u in starts])
    steps, far = steps + 1, ASTRAY if are_projections(balance) else np.inf
    for i in np.argsort(left)[: np.count_nonzero(left < far)]:
        found = run_newton(balance, starts[i], tolerance, linear_solver, TIME_NEWTON)
        steps += found.iterations
        attempt = min(attempt, found)
        if found.residual < GROSS:
            break
    if not attempt.decides:
        stalled = [attempt.unknowns] if attempt is not best else []
        begins = [*stalled, *(starts[i] for i in np.argsort(left))]
        paths = (follow_from_afar(balance, begin, tolerance) for begin in begins)
        if path := pick_first(path for path in paths if path is not None):
            attempt, steps = min(path, attempt), steps + path.iterations
    change = np.median(steady.changes[-LAST_PERIODS:])  # an aperiodic motion comes close to itself by chance
    much = f"by {change:.0%}" if change < 1 else "altogether"  # what an extrapolation starts may be far off
    told = f"from period to period its motion still changes {much} after {steady.periods}"
    doubtful = not steady.converged and change > APERIODIC
    return replace(attempt, iterations=steps, reason=f"{attempt.reason} ({told})" if doubtful else attempt.reason)


def start_from_more_harmonics(
    problem: ContactProblem,
    steady: SteadyState | str,
    balance: HarmonicBalance,
    tolerance: float,
    linear_solver: LinearSolver,
    best: Attempt,
) -> Attempt:
    """From where time stepping leads with more harmonics, down to those of the problem."""
    if isinstance(steady, str):
        return replace(best, reason=steady)
    try:
        above = HarmonicBalance(add_harmonics(problem, MORE_HARMONICS).system)
    except ModelError as refusal:  # as where one of them hits a mode without damping
        return replace(best, reason=f"with more harmonics: {refusal}")
    found = start_from_time_stepping(steady, above, tolerance, linear_solver, begin_at_full_stick(above))
    if not found.converged:
        reason = f"harmonics up to {above.basis.orders[-1]}: {found.reason}"
        return replace(best, iterations=found.iterations, reason=reason)
    attempt = come_down(balance, above, found, tolerance, linear_solver)
    return replace(attempt, iterations=found.iterations + attempt.iterations)


def split_from_full_stick(
    balance: HarmonicBalance, tolerance: float, linear_solver: LinearSolver, best: Attempt
) -> Attempt:
    """Newton from where a long splitting leads that begins at full stick; the best attempt where it leads nowhere."""
    forces, rigid = balance.full_stick
    split = split_at_length(balance, forces, balance.compliance.motion(forces, rigid), tolerance, linear_solver)
    return split or replace(best, reason="no splitting came near a solution")


def solve_linear(balance: HarmonicBalance, tolerance: float) -> Attempt:
    """The solution where no law has a kink or a curve: nothing to iterate on."""
    unknowns = np.zeros(balance.size)
    if balance.size:
        step = balance.linearise(unknowns)
        try:
            unknowns = -step.solve(step.residual)
        except np.linalg.LinAlgError:
            return Attempt(unknowns, float(np.linalg.norm(step.residual)), 0, "the linear problem is singular", False)
    residual = balance.measure_residual(unknowns)
    if residual <= tolerance:
        return Attempt(unknowns, residual, 0, "linear", True)
    names = " and ".join(dict.fromkeys(type(law).__name__ for law in balance.system.laws))
    return Attempt(unknowns, residual, 0, f"one linear solve does not do: is linear = True right of {names}?", False)


def leave_default_weights(
    problem: ContactProblem,
    balance: HarmonicBalance,
    start: PeriodicSolution | None,
    tolerance: float,
    linear_solver: LinearSolver,
) -> Attempt:
    """Solve with the default weights, then follow the solution to the problem's own; stay where that leads nowhere."""
    usual = use_default_weights(problem)
    solution = solve(usual, start, tolerance, linear_solver=linear_solver, raise_on_failure=False)
    unknowns = balance.pack(solution.forces, solution.rigid)
    known = solution.residual, solution.iterations, solution.reason, solution.converged
    found = Attempt(unknowns, *known, detour=solution.fallbacks)
    if not found.converged:
        residual = balance.measure_residual(unknowns)
        return replace(found, residual=residual, reason=f"not solved with the default weights: {found.reason}")
    last = approach_weights(balance, solution, tolerance, linear_solver)
    last = replace(last, iterations=found.iterations + last.iterations, detour=found.detour)
    if last.converged:
        return last
    return replace(found, iterations=last.iterations, usual=True, reason=f"solved with these only: {last.reason}")


def wrap(
    problem: ContactProblem,
    balance: HarmonicBalance | None,
    attempts: list[Attempt],
    fallbacks: tuple[str, ...],
    seconds: float,
) -> PeriodicSolution:
    """The best attempt as a solution; a problem without a balance is linear and needed none."""
    best = min(attempts, default=Attempt(np.zeros(0), 0.0, 0, "linear", True))
    forces, rigid = np.zeros((len(problem.basis.orders), 0), dtype=complex), np.zeros(0)
    if balance is not None:
        forces, rigid = balance.unpack(best.unknowns)
    return PeriodicSolution(
        problem=problem,
        forces=forces,
        rigid=rigid,
        converged=best.converged,
        reason=best.reason,
        iterations=sum(a.iterations for a in attempts),
        fallbacks=fallbacks,
        residual=best.residual,
        seconds=seconds,
        unknowns=best.unknowns.size,
    )
