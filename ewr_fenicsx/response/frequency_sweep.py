"""``frequency_response``: periodic solutions over a range of frequencies, round the folds where the curve has any.

The given frequencies are cut into blocks. Each block starts cold at its first frequency and follows its branch to the
first frequency of the next one. Blocks know nothing of each other: ranks share them, and what is solved stays on disk.
Where the end of a block and the start of the next are two solutions (a fold lies between), the branch is followed on
from the former. So the curve is the one that a single sweep would give, however many ranks made it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from inspect import signature
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ewr_fenicsx.accuracy.accuracy import check_accuracy, read_modes
from ewr_fenicsx.errors import ModelError, NotConverged, nearest
from ewr_fenicsx.given import is_positive, read_numbers
from ewr_fenicsx.laws.contact_laws import JointLaws
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.progress import count_progress
from ewr_fenicsx.response.following import Curve, Follower, Stand, agree
from ewr_fenicsx.response.refining import join_points, leave_out_close, refine_points
from ewr_fenicsx.response.response_curve import RESULTS, FrequencyResponse, write_curves
from ewr_fenicsx.response.solution_store import fingerprint, restore, strip
from ewr_fenicsx.response.sweep_store import FORMAT, Block, BlockState, BlockStore, keep
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solution.symmetry import include_idle, leave_out_idle
from ewr_fenicsx.solver.newton import solve
from ewr_fenicsx.solver.weights import adopt_weights, went_back
from ewr_fenicsx.task_sharing import do_on_rank_zero, do_together, share_steps
from ewr_fenicsx.whole_files import check_place

BLOCK = 6  # given frequencies a block


def _read_frequencies(given: float | Sequence[float]) -> tuple[float, ...]:
    frequencies = np.atleast_1d(read_numbers("frequencies", given))
    if frequencies.ndim > 1 or not frequencies.size:
        raise ModelError(f"frequencies have the shape {frequencies.shape}; give a list of at least one [Hz]")
    if not np.isfinite(frequencies).all() or frequencies[0] <= 0 or np.any(np.diff(frequencies) <= 0):
        raise ModelError(f"frequencies {frequencies[:5].tolist()} ...; give positive, finite ones that rise [Hz]")
    return tuple(frequencies.tolist())


def frequency_response(
    model: ReducedModel,
    laws: JointLaws | Mapping[object, JointLaws],
    frequencies: Sequence[float],
    harmonics: int | Sequence[int] = 5,
    progress: bool = True,
    *,
    refine: float | None = None,
    tolerance: float = 1e-8,
    accuracy: float | None = None,
    modes: Sequence[int] = (),
    folder: str | Path | None = None,
    work: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    **settings: object,
) -> FrequencyResponse | dict[object, FrequencyResponse]:
    """Frequency response of a joint; collective, with the same result on every rank whatever their number.

    Args:
        model: The structure, the same on every rank.
        laws: Laws at the pairs; or several by the value of a parameter, ``{mu: ContactLaws(friction=mu), ...}``.
        frequencies: Rising [Hz]; a single number will do. The curve has a solution at each and, where it folds, those
            of the fold as well.
        harmonics: As in ``ContactProblem``.
        progress: Whether rank 0 shows how far it is and how long the rest will take; so does what the curve is
            asked for later.
        refine: Adaptive frequencies: largest change of the contact's state between neighbouring points, relative, of a
            linear joint that of its motion; points are inserted between the given ones until it holds. None: none are.
        tolerance: As in ``solve``.
        accuracy: As in ``solve_to_accuracy``, of every solution. The curve is followed with ``harmonics``, then each of
            its points is solved again with as many as it takes. None: ``harmonics`` are what is used.
        modes: As in ``solve_to_accuracy``.
        folder: Where results go: ``frequency_response.h5``, whose groups have the keys of ``laws`` as labels, a CSV
            file a curve, numbered in the order of ``laws``, and ``blocks/`` as points are found. A run that was
            interrupted goes on from these, with the same result. None: nothing is written.
        work: Where ``blocks/`` go in place of ``folder``; results do not, and their stability is not looked at.
        comm: Ranks that share the work.
        settings: Further arguments of ``ContactProblem``: samples, weights, closure, loads, wear.

    Returns:
        The curve; with several laws a dictionary of curves by the same keys.

    Raises:
        ModelError: Frequencies do not rise, ``refine`` is not positive, or the problem makes no sense.
        OutputError: ``folder`` cannot be written, which is looked at first; or holds blocks of another run.
    """
    targets = _read_frequencies(frequencies)
    if refine is not None and not is_positive(refine):
        raise ModelError(f"refine = {refine!r}; give a positive change from point to point such as 0.1, or None")
    if accuracy is not None:
        check_accuracy(accuracy)
    family = dict(laws) if isinstance(laws, Mapping) else {None: laws}
    if not family:
        raise ModelError("laws = {}; give ContactLaws, or a dictionary with a value of a parameter for each curve")
    taken = {*signature(ContactProblem).parameters, *signature(frequency_response).parameters}
    taken -= {"frequency", "settings"}
    for name in settings.keys() - taken:
        raise ModelError(f"{name}: no argument of frequency_response{nearest(name, taken)}")
    common = ContactProblem(model, next(iter(family.values())), targets[0], harmonics, **settings)
    read_modes(modes, common.model.size)  # the points are solved again when the curve is there: too late for mistakes

    asked = {label: replace(common, laws=own) for label, own in family.items()}  # what makes no sense is told here
    posed = [leave_out_idle(problem) for problem in asked.values()]
    store, work = None, folder if work is None else work
    if work is not None:
        ordered = [*family.items()]  # by their order blocks are numbered
        store = BlockStore(Path(work), fingerprint(FORMAT, common, ordered, targets, refine, tolerance))
        places = [*([] if folder is None else [Path(folder) / RESULTS]), store.find_path(Block(0, 0, targets))]
        do_together(lambda: [check_place(place) for place in places], comm)
    curves = {}
    joined = _follow_curves(posed, targets, refine, tolerance, store, comm, progress)
    for curve, small, (label, problem) in zip(joined, posed, asked.items(), strict=True):
        missing = find_missing(targets, curve.points)
        whole = [adopt_weights(replace(problem, frequency=s.problem.frequency), s.problem) for s in curve.points]
        points = tuple(map(include_idle, curve.points, whole))
        curves[label] = FrequencyResponse(points, tuple(curve.jumps), missing, progress=progress)
        if accuracy is not None:
            begun = curves[label] if refine else thin_out(curves[label], targets)
            shared = {"comm": comm, "progress": progress, "folder": work}
            curves[label] = refine_response(begun, small, targets, accuracy, tolerance, modes=modes, **shared)
    if folder is not None:
        for curve in curves.values():  # most of the time of a sweep: not to be left to rank 0, which writes
            curve.look_at_stability(comm, progress, Path(work))
        do_on_rank_zero(lambda: write_curves(Path(folder), curves), comm)
    return curves if isinstance(laws, Mapping) else curves[None]


def _follow_curves(
    problems: Sequence[ContactProblem],
    targets: tuple[float, ...],
    refine: float | None,
    tolerance: float,
    store: BlockStore | None,
    comm: MPI.Comm,
    progress: bool,
) -> list[Curve]:
    """The curve of each problem, whose blocks all ranks share; collective."""
    pieces = [targets[i : i + BLOCK + 1] for i in range(0, max(1, len(targets) - 1), BLOCK)]
    blocks = [Block(k, n, piece) for k in range(len(problems)) for n, piece in enumerate(pieces)]
    total = len(problems) * len(targets)
    with count_progress("frequency response", total, progress and comm.rank == 0) as report:

        def make_follower(problem: ContactProblem) -> Follower:
            problem_at = lambda f: replace(problem, frequency=float(f))  # noqa: E731
            return Follower(problem_at, targets[0], targets[-1], refine, tolerance, lambda note: report(note=note))

        followers = [make_follower(problem) for problem in problems]
        solved = _solve_blocks(followers, blocks, store, comm, lambda done: report(min(done, total - 1)))
        report(note="joining blocks")  # which may take long: the last frequency is counted when it is done
        joined = []
        for k, follower in enumerate(followers):
            own = [state for block, state in zip(blocks, solved, strict=True) if block.curve == k]
            joined.append(_join([_rebuild(follower.problem_at, state) for state in own], pieces, follower))
        report(total)
    return joined


def find_missing(frequencies: Sequence[float], solutions: Sequence[PeriodicSolution]) -> tuple[float, ...]:
    """Frequencies at which there is no solution."""
    known = {s.problem.frequency for s in solutions}
    return tuple(f for f in frequencies if f not in known)


def thin_out(curve: FrequencyResponse, frequencies: Sequence[float]) -> FrequencyResponse:
    """The curve without points of its folds that lie close to others; those at ``frequencies`` stay."""
    return replace(curve, solutions=tuple(leave_out_close(curve.solutions, frequencies)))


def refine_response(
    curve: FrequencyResponse,
    problem: ContactProblem,
    frequencies: Sequence[float],
    accuracy: float,
    tolerance: float = 1e-8,
    *,
    modes: Sequence[int] = (),
    folder: Path | None = None,
    comm: MPI.Comm = MPI.COMM_SELF,
    progress: bool = False,
) -> FrequencyResponse:
    """A curve whose every solution is as accurate as asked; collective. What could not be reached, ``accurate`` says.

    Frequencies at which no solution was found on the problem's model are among those ``missing``.

    Args:
        curve: Solutions from which to start.
        problem: What they solve, at any frequency; its model may have more modes than theirs.
        frequencies: Where a solution is wanted [Hz]. Others, of a fold, are left out where they fell off their branch.
        accuracy, tolerance, modes: As in ``solve_to_accuracy``.
        folder, comm, progress: As in ``frequency_response``.

    Raises:
        ModelError: The accuracy is not between 0 and 1.
    """
    points = curve.solutions
    found = refine_points(
        problem, points, accuracy, tolerance, modes=modes, folder=folder, comm=comm, progress=progress
    )
    before = [f.levels for f in curve.accurate] or [()] * len(points)  # of a curve that is refined again
    found = [replace(f, levels=f.levels and levels + f.levels) for f, levels in zip(found, before, strict=True)]
    found, jumps = join_points(points, found, frequencies, tolerance)
    jumps = [*curve.jumps, *(jump for jump in jumps if jump not in curve.jumps)]
    solutions = tuple(f.solution for f in found)
    return FrequencyResponse(solutions, tuple(jumps), find_missing(frequencies, solutions), tuple(found), progress)


def _solve_blocks(
    followers: Sequence[Follower],
    blocks: Sequence[Block],
    store: BlockStore | None,
    comm: MPI.Comm,
    report: Callable[[int], None],
) -> list[BlockState]:
    """Every block, solved from how far it is on disk, and kept on the way; collective."""
    begun = do_on_rank_zero(lambda: [store.read(b) for b in blocks], comm) if store else [BlockState()] * len(blocks)

    def go_on(block: Block, state: BlockState) -> Iterator[BlockState]:
        states = _solve_block(followers[block.curve], block, state)
        return keep(states, partial(store.write, block)) if store else states

    sizes = [block.count(len(block.frequencies)) for block in blocks]
    return share_steps(blocks, begun, go_on, lambda block, state: block.count(state.passed), sizes, comm, report)


def _solve_block(follower: Follower, block: Block, state: BlockState) -> Iterator[BlockState]:
    """How far a block is after each of its frequencies, from the first one that a state has not passed."""
    stand = None
    if state.stand:
        stand = Stand(*(restore(follower.problem_at(r.frequency), r) for r in state.stand), reach=state.reach)
    for f in block.frequencies[state.passed :] if stand is None else ():
        try:
            stand = Stand(solve(follower.problem_at(f), tolerance=follower.tolerance))
        except NotConverged:
            state = replace(state, passed=state.passed + 1)
            yield state  # f will be among the missing; the block begins at the next frequency
            continue
        state = _extend(state, Curve([stand.here]), stand)
        yield state
        break
    for piece, stand in follower.go_on(stand, block.frequencies[state.passed :]) if stand else ():  # noqa: B020
        state = _extend(state, piece, stand)
        yield state


def _extend(state: BlockState, piece: Curve, stand: Stand) -> BlockState:
    """The state one frequency further: a piece of the curve, and where that ends."""
    ends = [stand.here] if stand.before is None else [stand.here, stand.before]
    return BlockState(
        state.passed + 1,
        (*state.records, *map(strip, piece.points)),
        (*state.jumps, *piece.jumps),
        tuple(map(strip, ends)),
        stand.reach,
    )


def _rebuild(problem_at: Callable[[float], ContactProblem], state: BlockState) -> Curve:
    return Curve([restore(problem_at(record.frequency), record) for record in state.records], list(state.jumps))


def _join(parts: Sequence[Curve], pieces: Sequence[Sequence[float]], follower: Follower) -> Curve:
    """One curve of all blocks: where two do not meet, the branch of the former is followed until they do.

    So it is through a block in which no cold start found a solution, and down from the first that one did find.
    """
    curve = Curve()
    for part, targets in zip(parts, pieces, strict=True):
        if not curve.points:
            curve.extend(part)
            continue
        if not part.points:
            ahead = [target for target in targets if target > curve.points[-1].problem.frequency]
            curve.extend(follower.follow(curve.points[-2:], ahead))
            continue
        for k, target in enumerate(targets):
            if k:
                curve.extend(follower.follow(curve.points[-2:], [target]))
            here = curve.points[-1]
            same = [i for i, s in enumerate(part.points) if s.problem.frequency == here.problem.frequency]
            usual = went_back(here.problem)  # one curve has either what was asked for or what was gone back to
            meets = [i for i in same if agree(part.points[i], here) and went_back(part.points[i].problem) == usual]
            if meets:
                ahead = [jump for jump in part.jumps if jump.frequency[1] > target]
                curve.extend(Curve(part.points[meets[-1] + 1 :], ahead))
                break
    lowest = curve.points[0].problem.frequency if curve.points else -np.inf
    below = sorted({f for targets in pieces for f in targets if f < lowest}, reverse=True)
    if below:
        curve.points[:0] = reversed(follower.descend(curve.points[0], below))
    return curve
