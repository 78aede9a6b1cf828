"""``frequency_response``: periodic solutions over a range of frequencies, round the folds where the curve has any.

The given frequencies are cut into blocks. Each block starts cold at its first frequency and follows its branch to the
first frequency of the next one. Blocks know nothing of each other: ranks share them, and finished ones stay on disk.
Where the end of a block and the start of the next are two solutions (a fold lies between), the branch is followed on
from the former. So the curve is the one that a single sweep would give, however many ranks made it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from inspect import signature
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
from mpi4py import MPI

from ewr_fenicsx.accuracy import AccurateSolution, check_accuracy, read_modes
from ewr_fenicsx.contact_laws import JointLaws
from ewr_fenicsx.contact_problem import ContactProblem
from ewr_fenicsx.contact_state import list_figures
from ewr_fenicsx.errors import ModelError, NotConverged, nearest
from ewr_fenicsx.following import Curve, Follower, Jump, agree
from ewr_fenicsx.given import ComplexArray, RealArray, is_positive, read_numbers
from ewr_fenicsx.newton import solve
from ewr_fenicsx.progress import Report, count_progress
from ewr_fenicsx.reduced_model import ReducedModel
from ewr_fenicsx.refining import join_points, leave_out_close, refine_points
from ewr_fenicsx.solution import PeriodicSolution
from ewr_fenicsx.solution_store import (
    Record,
    fingerprint,
    gather_figure,
    gather_output,
    list_orders,
    restore,
    strip,
    write_records,
)
from ewr_fenicsx.sweep_store import FORMAT, Block, BlockStore
from ewr_fenicsx.symmetry import find_idle_harmonics, include_idle, leave_out_idle
from ewr_fenicsx.task_sharing import do_on_rank_zero, do_together, share_tasks
from ewr_fenicsx.weights import adopt_weights, went_back
from ewr_fenicsx.whole_files import check_place, replace_file, write_table

BLOCK = 6  # given frequencies a block
_RESULTS = "frequency_response.h5"


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse:
    """Periodic solutions along a curve.

    Attributes:
        solutions: In the order of the curve: where it folds, frequencies run back for a while.
        jumps: Where the curve is broken because no branch led on; empty as a rule.
        missing: Given frequencies without a solution [Hz]; empty as a rule.
        accurate: Where an accuracy was asked for: the solutions with their estimated errors, and how they came about.
    """

    solutions: tuple[PeriodicSolution, ...]
    jumps: tuple[Jump, ...]
    missing: tuple[float, ...]
    accurate: tuple[AccurateSolution, ...] = ()

    def __repr__(self) -> str:
        at = self.frequencies
        span = f" from {at[0]:g} to {at[-1]:g} Hz" if at.size else ""
        return f"FrequencyResponse({at.size} solutions{span}, {len(self.jumps)} jumps, {len(self.missing)} missing)"

    @cached_property
    def frequencies(self) -> RealArray:
        """``(n,)`` [Hz]."""
        return np.array([s.problem.frequency for s in self.solutions])

    @cached_property
    def orders(self) -> tuple[int, ...]:
        """Harmonics that any of the solutions has, ``n_h`` of them."""
        return list_orders(self.solutions)

    @property
    def breaks(self) -> tuple[int, ...]:
        """Solutions after which the curve is broken by a jump, by their number."""
        found = set()
        for jump in self.jumps:
            begin, end = jump.frequency
            around = [
                i
                for i, (here, there) in enumerate(pairwise(self.frequencies))
                if i not in found and (begin - here) * (end - begin) >= 0 and (there - end) * (end - begin) >= 0
            ]
            at = [i for i in around if self.frequencies[i] == begin]  # or that point was only passed, and is not kept
            found.update((at or around)[:1])
        return tuple(sorted(found))

    @cached_property
    def unstable(self) -> np.ndarray:
        """``(n,)`` solutions that motions in time leave: between two folds, alternating, or in a spiral.

        Only where frequencies run back is there a side of folds to look at: its sign changes there, and else only
        where branches cross (``PeriodicSolution.side``).
        """
        return self._find_unstable()

    def look_at_stability(self, comm: MPI.Comm, progress: bool = False) -> None:
        """Finds ``unstable``, its points shared by all ranks; collective. Else each rank does so when it needs it.

        Args:
            comm, progress: As in ``frequency_response``.
        """
        vars(self)["unstable"] = self._find_unstable(comm, progress)

    def _find_unstable(self, comm: MPI.Comm = MPI.COMM_SELF, progress: bool = False) -> np.ndarray:
        back = np.diff(self.frequencies) < 0
        back[list(self.breaks)] = False
        near = (np.append(back, False) | np.insert(back, 0, False))[: len(self.solutions)]
        leaves = lambda s, near: bool(s.alternates or s.multiplier != 0 or (near and s.grows))  # noqa: E731
        points = list(zip(self.solutions, near, strict=True))
        with count_progress("stability", len(points), progress and comm.rank == 0) as report:
            found = share_tasks(points, lambda point: leaves(*point), comm, report)
            report(len(points))
        return np.array(found, dtype=bool)

    def output(self, name: str) -> ComplexArray:
        """One-sided complex amplitudes ``(n, n_h)`` of a named output at ``orders``; zero where a solution has none.

        Raises:
            ModelError: The model has no such output.
        """
        return gather_output(self.solutions, name, self.orders)

    def figure(self, name: str) -> RealArray:
        """``(n,)`` a figure of merit of every solution, such as ``"J_T"``, ``"J_N"`` or ``"rms_tip"``.

        Raises:
            ModelError: There is no such figure.
        """
        return gather_figure(self.solutions, name)

    def table(self) -> dict[str, RealArray]:
        """Column -> ``(n,)``: frequency, figures of merit, instability, Newton steps, and every output's harmonics.

        Figures that none of the laws concerns are left out. Harmonic h of an output is
        ``Re((re + i im) exp(i h omega t))``.
        """
        columns = {"frequency [Hz]": self.frequencies}
        if self.solutions:
            columns |= {name: self.figure(name) for name in list_figures(self.solutions[0])}
        columns["unstable"] = self.unstable.astype(int)
        columns["Newton steps"] = np.array([s.iterations for s in self.solutions])
        columns["residual"] = np.array([s.residual for s in self.solutions])
        if self.accurate:
            columns["estimate"] = np.array([found.estimate.total for found in self.accurate])
            columns["highest_harmonic"] = np.array([s.orders[-1] for s in self.solutions])
        for name in self.solutions[0].problem.model.outputs if self.solutions else ():
            for h, amplitude in zip(self.orders, self.output(name).T, strict=True):
                columns[f"|{name}| harmonic {h}"] = np.abs(amplitude)
                columns[f"re {name} harmonic {h}"] = amplitude.real
                columns[f"im {name} harmonic {h}"] = amplitude.imag
        return columns

    def write_csv(self, path: str | Path) -> None:
        """Write ``table`` as CSV, a row a solution."""
        write_table(path, self.table())

    def write(self, group: h5py.Group) -> None:
        """Write forces, rigid coordinates, table and breaks to an HDF5 group."""
        write_records(group, [strip(s) for s in self.solutions])
        table = group.create_group("table")
        for name, values in self.table().items():
            table[name.replace("/", " per ")] = values
        group["missing"] = np.array(self.missing)
        group["jumps"] = np.array([jump.frequency for jump in self.jumps]).reshape(-1, 2)
        group.attrs["jumps"] = [jump.why for jump in self.jumps]


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
        progress: Whether rank 0 shows how far it is and how long the rest will take.
        refine: Adaptive frequencies: largest change of the contact's state between neighbouring points, relative;
            points are inserted between the given ones until it holds. None: none are.
        tolerance: As in ``solve``.
        accuracy: As in ``solve_to_accuracy``, of every solution. The curve is followed with ``harmonics``, then each of
            its points is solved again with as many as it takes. None: ``harmonics`` are what is used.
        modes: As in ``solve_to_accuracy``.
        folder: Where results go: ``frequency_response.h5``, a CSV file a curve, and ``blocks/`` as they are finished. A
            run that was interrupted goes on from the blocks that it finds. None: nothing is written.
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
    taken = {*signature(ContactProblem).parameters, *signature(frequency_response).parameters} - {"frequency"}
    for name in settings.keys() - taken:
        raise ModelError(f"{name}: no argument of frequency_response{nearest(name, taken)}")
    common = ContactProblem(model, next(iter(family.values())), targets[0], harmonics, **settings)
    read_modes(modes, common.model.size)  # the points are solved again when the curve is there: too late for mistakes

    asked = {label: replace(common, laws=own) for label, own in family.items()}  # what makes no sense is told here

    def make_follower(problem: ContactProblem, report: Report) -> Follower:
        posed = leave_out_idle(problem)
        problem_at = lambda f: replace(posed, frequency=float(f))  # noqa: E731
        tell = lambda note: report(note=note)  # noqa: E731
        return Follower(problem_at, targets[0], targets[-1], refine, tolerance, tell)

    cuts = [*range(0, max(1, len(targets) - 1), BLOCK)]
    pieces = [targets[i : i + BLOCK + 1] for i in cuts]
    blocks = [Block(k, n, piece) for k in range(len(asked)) for n, piece in enumerate(pieces)]
    store = None
    if folder is not None:
        store = BlockStore(Path(folder), fingerprint(FORMAT, common, family, targets, refine, tolerance))
        do_together(lambda: [check_place(p) for p in (store.folder / _RESULTS, store.find_path(blocks[0]))], comm)

    def work(block: Block) -> tuple[list[Record], list[Jump]]:
        known = store.read(block) if store else None
        return known or _solve_block(followers[block.curve], block, store)

    with count_progress("frequency response", len(blocks), progress and comm.rank == 0) as report:
        followers = [make_follower(problem, report) for problem in asked.values()]
        results = share_tasks(blocks, work, comm, report)
        joined = []
        for k, follower in enumerate(followers):
            own = [r for block, r in zip(blocks, results, strict=True) if block.curve == k]
            joined.append(_join([_rebuild(follower.problem_at, *r) for r in own], pieces, follower))
        report(len(blocks))
    curves = {}
    for curve, follower, (label, problem) in zip(joined, followers, asked.items(), strict=True):
        missing = find_missing(targets, curve.points)
        points = curve.points
        if find_idle_harmonics(problem).orders:
            whole = [adopt_weights(replace(problem, frequency=s.problem.frequency), s.problem) for s in points]
            points = [include_idle(s, posed) for s, posed in zip(points, whole, strict=True)]
        curves[label] = FrequencyResponse(tuple(points), tuple(curve.jumps), missing)
        if accuracy is not None:
            begun = curves[label] if refine else thin_out(curves[label], targets)
            posed, shared = follower.problem_at(targets[0]), {"comm": comm, "progress": progress, "folder": folder}
            curves[label] = refine_response(begun, posed, targets, accuracy, tolerance, modes=modes, **shared)
    if store:
        do_on_rank_zero(lambda: _write_results(store.folder, curves), comm)
    return curves if isinstance(laws, Mapping) else curves[None]


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
    found, jumps = join_points(points, found, frequencies, tolerance)
    jumps = [*curve.jumps, *(jump for jump in jumps if jump not in curve.jumps)]  # of a curve that is refined again
    solutions = tuple(f.solution for f in found)
    return FrequencyResponse(solutions, tuple(jumps), find_missing(frequencies, solutions), tuple(found))


def _solve_block(follower: Follower, block: Block, store: BlockStore | None) -> tuple[list[Record], list[Jump]]:
    curve = Curve()
    for i, f in enumerate(block.frequencies):
        try:
            curve.points.append(solve(follower.problem_at(f), tolerance=follower.tolerance))
        except NotConverged:
            continue  # it will be among the missing; the block begins at the next frequency
        curve.extend(follower.follow(curve.points, block.frequencies[i + 1 :]))
        break
    result = [strip(s) for s in curve.points], curve.jumps
    if store:
        store.write(block, *result)
    return result


def _rebuild(problem_at: Callable[[float], ContactProblem], records: list[Record], jumps: list[Jump]) -> Curve:
    return Curve([restore(problem_at(record.frequency), record) for record in records], list(jumps))


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


def _write_results(folder: Path, curves: Mapping[object, FrequencyResponse]) -> None:
    with replace_file(folder / _RESULTS) as file:
        file.attrs["format"] = FORMAT
        for number, (label, curve) in enumerate(curves.items()):
            group = file.create_group(f"curve_{number}")
            group.attrs["label"] = "" if label is None else str(label)
            if curve.solutions:
                curve.write(group)
    for number, curve in enumerate(curves.values()):
        name = "frequency_response.csv" if len(curves) == 1 else f"frequency_response_{number}.csv"
        curve.write_csv(folder / name)
