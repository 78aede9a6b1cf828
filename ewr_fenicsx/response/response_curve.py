"""``FrequencyResponse``: what a sweep returns; its stability, which all ranks look at, its tables and its files."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
from mpi4py import MPI

from ewr_fenicsx.accuracy.accuracy import AccurateSolution
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.progress import count_progress
from ewr_fenicsx.response.following import Jump
from ewr_fenicsx.response.solution_store import fingerprint, strip, write_records
from ewr_fenicsx.response.sweep_store import FORMAT, WORTH_A_POINT, StabilityStore
from ewr_fenicsx.solution.contact_state import list_figures
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.solution.solution_series import SolutionSeries
from ewr_fenicsx.task_sharing import do_on_rank_zero, share_tasks
from ewr_fenicsx.whole_files import replace_file, write_table

RESULTS = "frequency_response.h5"


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(SolutionSeries):
    """Periodic solutions along a curve.

    Attributes:
        solutions: In the order of the curve: where it folds, frequencies run back for a while.
        jumps: Where the curve is broken because no branch led on; empty as a rule.
        missing: Given frequencies without a solution [Hz]; empty as a rule.
        accurate: Where an accuracy was asked for: the solutions with their estimated errors, and how they came about.
        progress: Whether what is looked at later (``unstable``, which ``table`` has too) shows how far it is.
    """

    solutions: tuple[PeriodicSolution, ...]
    jumps: tuple[Jump, ...]
    missing: tuple[float, ...]
    accurate: tuple[AccurateSolution, ...] = ()
    progress: bool = False

    def __repr__(self) -> str:
        at = self.frequencies
        span = f" from {at[0]:g} to {at[-1]:g} Hz" if at.size else ""
        return f"FrequencyResponse({at.size} solutions{span}, {len(self.jumps)} jumps, {len(self.missing)} missing)"

    @property
    def frequencies(self) -> RealArray:
        """``(n,)`` [Hz]."""
        return np.array([s.problem.frequency for s in self.solutions])

    @property
    def breaks(self) -> tuple[int, ...]:
        """Solutions after which the curve is broken by a jump, by their number."""
        found, frequencies = set(), self.frequencies
        for jump in self.jumps:
            begin, end = jump.frequency
            around = [
                i
                for i, (here, there) in enumerate(pairwise(frequencies))
                if i not in found and (begin - here) * (end - begin) >= 0 and (there - end) * (end - begin) >= 0
            ]
            at = [i for i in around if frequencies[i] == begin]  # or that point was only passed, and is not kept
            found.update((at or around)[:1])
        return tuple(sorted(found))

    @cached_property
    def unstable(self) -> np.ndarray:
        """``(n,)`` solutions that motions in time leave: between two folds, alternating, or in a spiral.

        Only on a curve whose frequencies run back somewhere is there a side of folds to look at: its sign changes
        there, and else only where branches cross (``PeriodicSolution.side``).
        """
        return self._find_unstable(progress=self.progress)

    def look_at_stability(self, comm: MPI.Comm, progress: bool = False, work: Path | None = None) -> None:
        """Finds ``unstable``, its points shared by all ranks; collective. Else each rank does so when it needs it.

        Args:
            comm, progress, work: As in ``frequency_response``.
        """
        vars(self)["unstable"] = self._find_unstable(comm, progress, work)

    def _find_unstable(
        self, comm: MPI.Comm = MPI.COMM_SELF, progress: bool = False, work: Path | None = None
    ) -> np.ndarray:
        back = np.diff(self.frequencies) < 0
        back[list(self.breaks)] = False
        folds = bool(np.any(back))
        store, known = None, {}
        if work is not None and self.solutions:
            own = [replace(strip(s), seconds=0.0) for s in self.solutions]  # wall times are not theirs alone
            store = StabilityStore(work, fingerprint(FORMAT, self.solutions[0].problem, own, folds))
            known = do_on_rank_zero(lambda: store.read(len(own)), comm)
        left = [k for k in range(len(self.solutions)) if k not in known]

        def look(k: int) -> bool:
            solution, since = self.solutions[k], time.monotonic()
            leaves = bool(solution.alternates or solution.multiplier != 0 or (folds and solution.grows))
            if store and time.monotonic() - since >= WORTH_A_POINT:
                store.write(k, leaves)
            return leaves

        with count_progress("stability", len(self.solutions), progress and comm.rank == 0) as report:
            found = share_tasks(left, look, comm, lambda done: report(len(known) + done))
            report(len(self.solutions))
        found = known | dict(zip(left, found, strict=True))
        return np.array([found[k] for k in range(len(found))], dtype=bool)

    def _check_solved(self) -> None:
        if not self.solutions:
            asked = f" from {min(self.missing):g} to {max(self.missing):g} Hz" if self.missing else ""
            raise ModelError(f"no solution was found{asked}: solve(...) at one of these frequencies says why")

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


def write_curves(folder: Path, curves: Mapping[object, FrequencyResponse]) -> None:
    """Write curves to one HDF5 file, labelled by their keys, and to a CSV file each.

    Raises:
        UnwritableFile: A file cannot be written.
    """
    with replace_file(folder / RESULTS) as file:
        file.attrs["format"] = FORMAT
        for number, (label, curve) in enumerate(curves.items()):
            group = file.create_group(f"curve_{number}")
            group.attrs["label"] = "" if label is None else str(label)
            if curve.solutions:
                curve.write(group)
    for number, curve in enumerate(curves.values()):
        name = "frequency_response.csv" if len(curves) == 1 else f"frequency_response_{number}.csv"
        curve.write_csv(folder / name)
