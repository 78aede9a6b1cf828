"""Points of a curve solved again, each as accurate as asked: harmonics, samples and weights point by point.

A curve of few harmonics says which solutions there are and how they hang together. Each of its points is where the
solve to an accuracy starts, with about as many harmonics as the point before it took. Groups of points know nothing of
each other: ranks share them, and the result does not depend on how many there are. Solutions that fell off their branch
are told from the others by their neighbours, and next to a fold by the side of it that they are on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from mpi4py import MPI

from ewr_fenicsx.accuracy.accuracy import AccurateSolution, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import FIRST_ORDER, estimate_errors, measure_distance, read_response
from ewr_fenicsx.accuracy.levels import GROWTH
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.progress import count_progress
from ewr_fenicsx.response.following import LARGEST_SURPRISE, Curve, Follower, Jump, compare_states
from ewr_fenicsx.response.solution_store import Record, fingerprint, restore, strip
from ewr_fenicsx.response.sweep_store import FORMAT, GroupStore, keep
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solver.newton import solve
from ewr_fenicsx.solver.weights import adopt_weights
from ewr_fenicsx.task_sharing import do_on_rank_zero, share_steps

GROUP = 6  # points a group
PLENTY = 0.5  # share of the accuracy asked for below which a point's estimate leaves room for fewer harmonics
# Points of a fold are left out that lie so close to the last one, in outputs and in frequency over its range.
CLOSE, APART = 0.05, 0.01
_Done = list[tuple[Record, AccurateSolution]]  # points of a group; the latter without their solutions
SAME = 2.0  # accuracies that two solutions of one problem may lie apart


def refine_points(
    problem: ContactProblem,
    points: Sequence[PeriodicSolution],
    accuracy: float,
    tolerance: float = 1e-8,
    *,
    modes: Sequence[int] = (),
    folder: Path | None = None,
    comm: MPI.Comm = MPI.COMM_SELF,
    progress: bool = False,
) -> list[AccurateSolution]:
    """Solves every point of a curve again, as accurate as asked; collective, with the same result on every rank.

    Args:
        problem: What is to be solved, at any frequency; its model may have other modes than that of the points.
        points: Where to start: a solution for each frequency, in the order of the curve.
        accuracy, tolerance, modes: As in ``solve_to_accuracy``.
        folder: Where points are kept as they are found, so that an interrupted run goes on from there; None: nowhere.
        comm: Ranks that share the work.
        progress: Whether rank 0 shows how far it is.

    Returns:
        A solution a point. One without a solution of more harmonics keeps its own, and says so in its ``limit``.
    """
    accuracy = float(accuracy)
    groups = [points[start : start + GROUP] for start in range(0, len(points), GROUP)]
    store, begun = None, [[] for _ in groups]
    if folder is not None:
        own = [(p.problem.frequency, p.problem.harmonics, p.forces, p.rigid) for p in points]
        store = GroupStore(Path(folder), fingerprint(FORMAT, problem, own, accuracy, tolerance, list(modes)))
        begun = do_on_rank_zero(lambda: [store.read(GROUP * k) for k in range(len(groups))], comm)

    def go_on(k: int, done: _Done) -> Iterator[_Done]:
        states = _refine_group(problem, groups[k], done, accuracy, tolerance, modes)
        return keep(states, partial(store.write, GROUP * k)) if store else states

    with count_progress("accuracy, points", len(points), progress and comm.rank == 0) as report:
        sizes = [len(group) for group in groups]
        results = share_steps(range(len(groups)), begun, go_on, lambda _, done: len(done), sizes, comm, report)
        report(len(points))
    return [
        replace(found, solution=restore(replace(problem, frequency=record.frequency), record))
        for group in results
        for record, found in group
    ]


def _refine_group(
    problem: ContactProblem,
    group: Sequence[PeriodicSolution],
    done: _Done,
    accuracy: float,
    tolerance: float,
    modes: Sequence[int],
) -> Iterator[_Done]:
    """What is done of a group after each of its points, from the first one that is not done."""
    first = group[0].orders[-1] or FIRST_ORDER
    for _, found in done:
        first = begin_next(found, first)
    for point in group[len(done) :]:
        posed = replace(problem, frequency=point.problem.frequency)
        found = refine_point(posed, point, accuracy, tolerance, first, modes)
        first = begin_next(found, first)
        done = [*done, (strip(found.solution), replace(found, solution=None))]
        yield done


def leave_out_close(points: Sequence[PeriodicSolution], frequencies: Sequence[float]) -> list[PeriodicSolution]:
    """The points of a curve that are worth solving again: where a solution is wanted, and others that lie apart.

    With few harmonics a curve may wriggle, and following it round each of its corners takes many points.
    """
    apart = APART * (max(frequencies) - min(frequencies))
    kept: list[PeriodicSolution] = []
    for point in points:
        here = point.problem.frequency
        wanted = not kept or here in frequencies or abs(here - kept[-1].problem.frequency) > apart
        if wanted or measure_gap(kept[-1], point) > CLOSE:
            kept.append(point)
    return kept


def refine_point(
    problem: ContactProblem,
    point: PeriodicSolution,
    accuracy: float,
    tolerance: float,
    first: int,
    modes: Sequence[int] = (),
) -> AccurateSolution:
    """A solution as accurate as asked, from a point of the curve; where none is found, with its harmonics, and why."""
    try:
        return solve_to_accuracy(problem, accuracy, point, tolerance, first=first, modes=modes)
    except NotConverged as error:
        why = f"no solution found with harmonics up to {error.best.orders[-1]}: {error.best.reason}"
    stated = adopt_weights(problem, point.problem)  # its model may have other modes than the point's
    stated = replace(stated, harmonics=point.problem.harmonics, samples=point.problem.samples)
    kept = solve(stated, point, tolerance, fallbacks=False, raise_on_failure=False)
    return AccurateSolution(kept, estimate_errors(kept), accuracy, False, why, (), kept.seconds)


def begin_next(found: AccurateSolution, first: int) -> int:
    """Highest harmonic of the next point's first solve: that of the last one here, fewer where one solve was plenty."""
    tops = [level.orders[-1] for level in found.levels]
    if not tops:
        return first
    plenty = len(tops) == 1 and found.estimate.total < PLENTY * found.accuracy
    return max(FIRST_ORDER, round(tops[-1] / GROWTH[0])) if plenty else tops[-1]


def join_points(
    points: Sequence[PeriodicSolution],
    found: Sequence[AccurateSolution],
    frequencies: Sequence[float],
    tolerance: float = 1e-8,
) -> tuple[list[AccurateSolution], list[Jump]]:
    """The curve of the accurate solutions: those that fell off their branch are left out, or a break is told.

    A branch with more harmonics may turn back before one with few does. Next to a fold, a solve then ends far from
    where it started, on another branch. Points without a solution on the model are left out everywhere.

    Args:
        points: The curve that the accurate solutions come from.
        found: The accurate solution of each of its points.
        frequencies: Where a solution is wanted [Hz]: there it stays, and elsewhere one that fell off is left out.
        tolerance: As in ``solve``.

    Returns:
        The solutions that stay, and where their curve is broken while that of the points is not.
    """
    kept: list[tuple[PeriodicSolution, AccurateSolution]] = []
    jumps = []
    for point, here in zip(points, found, strict=True):
        if not here.solution.converged:
            continue
        moved, wanted = measure_gap(point, here.solution), point.problem.frequency in frequencies
        fell = moved > LARGEST_SURPRISE
        other_side = moved > SAME * here.accuracy and point.side * here.solution.side < 0
        crossed = other_side and (point.grows or here.solution.grows)  # pairs that lift off turn the sign as well
        if crossed and not wanted:
            continue
        if kept and crossed and not fell:
            ends = kept[-1][1].solution.problem.frequency, point.problem.frequency
            jumps.append(Jump(ends, "with more harmonics the branch turns back earlier; this is beyond its fold"))
        elif kept:
            before, last = kept[-1]
            gap, may_go = measure_gap(last.solution, here.solution), fell and not wanted
            surprise = gap if may_go else gap - measure_gap(before, point)
            suspect = fell or measure_gap(before, last.solution) > LARGEST_SURPRISE
            if suspect and surprise > LARGEST_SURPRISE and not lie_on_one_branch(last, here, tolerance):
                if may_go:  # points between may have gone already: a wide gap in the first curve excuses nothing
                    continue
                ends = last.solution.problem.frequency, point.problem.frequency
                why = "with more harmonics no common branch was found"
                jumps.append(Jump(ends, f"{why}; one may be with a larger `harmonics`, of the first curve"))
        kept.append((point, here))
    return [here for _, here in kept], jumps


def measure_gap(a: PeriodicSolution, b: PeriodicSolution) -> float:
    """Distance of the outputs' oscillations at two frequencies over the larger one."""
    orders = sorted({*a.orders, *b.orders})
    return compare_states(*(read_response(s, orders) for s in (a, b)))


def lie_on_one_branch(a: AccurateSolution, b: AccurateSolution, tolerance: float) -> bool:
    """Whether small steps in frequency lead from the one at the lower frequency to the other; no folds are passed."""
    low, high = sorted((a, b), key=lambda found: found.solution.problem.frequency)
    ends = [found.solution.problem.frequency for found in (low, high)]
    stepper = _Stepper(lambda f: replace(low.solution.problem, frequency=float(f)), *ends, None, tolerance)
    curve = stepper.follow([low.solution], ends[1:])
    allowed = SAME * sum(max(found.accuracy, found.estimate.total) for found in (a, b))
    return bool(curve.points) and measure_distance(curve.points[-1], high.solution) <= allowed


class _Stepper(Follower):
    """Follows a branch as far as it does not turn back."""

    def _trace(self, *_: object) -> Curve:
        return Curve()
