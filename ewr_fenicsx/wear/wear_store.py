"""The state of a wear calculation, and its file: complete at any moment, and the same however often it was resumed."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.problem.contact_problem import ContactProblem
from ewr_fenicsx.response.solution_store import read_records, restore, strip, write_records
from ewr_fenicsx.solution.solution import PeriodicSolution
from ewr_fenicsx.whole_files import open_file, replace_file

_FORMAT = "ewr_fenicsx wear, 8"


@dataclass(frozen=True, eq=False)
class WearStep:
    """A moment of the slow time.

    Attributes:
        cycle: Cycles done.
        depth: ``(K_c,)`` worn by them [m].
        rate: ``(K_c,)`` depth that the next cycle wears [m].
        solution: Periodic solution with that depth.
        estimate: Its estimated error, where an accuracy was asked for and the step was kept; else NaN.
    """

    cycle: int
    depth: RealArray
    rate: RealArray
    solution: PeriodicSolution
    estimate: float = np.nan


@dataclass(frozen=True)
class Leap:
    """Where no solution was found near the last one: wear goes on from that of a fallback, maybe of another motion.

    Attributes:
        cycle: Cycles done before.
        found_by: The fallback.
        change: Of the outputs' oscillation, over the larger one.
    """

    cycle: int
    found_by: str
    change: float


@dataclass(frozen=True, eq=False)
class WearState:
    """All that a wear calculation needs to go on.

    Attributes:
        latest, earlier: The last two steps.
        jump: Length of the next jump to try [cycles].
        solves: Periodic solves so far.
        rough: Single cycles so far that were further off than the tolerance allows.
        steps: Steps kept so far.
        stopped: Why it ended before its last cycle, or None.
        leaps: Where solutions so far were found by a fallback only.
    """

    latest: WearStep
    earlier: WearStep | None
    jump: int
    solves: int
    rough: int
    steps: tuple[WearStep, ...]
    stopped: str | None
    leaps: tuple[Leap, ...] = ()


class TriedModels:
    """The models on which a wear calculation solves: that it begins with, and those with more modes, as they are tried.

    Args:
        problem: The unworn problem.
        modes: Which coordinates of its model are modal.
        more: As ``more_modes`` of ``solve_to_accuracy``, of the unworn problem; None: there are no more.
    """

    def __init__(
        self,
        problem: ContactProblem,
        modes: Sequence[int] = (),
        more: Callable[[int], tuple[ContactProblem, Sequence[int]]] | None = None,
    ):
        self.tried, self.more = [(problem, modes)], more
        self.counts: list[int] = []  # asked of ``more``, for all tried but the first

    def keep_more(self, count: int) -> tuple[ContactProblem, Sequence[int]]:
        """The unworn problem on a model with so many modes, and which of its coordinates are modal."""
        found = self.more(count)
        if all(found[0].model is not problem.model for problem, _ in self.tried):
            self.tried.append(found)
            self.counts.append(count)
        return found

    def place(self, model: ReducedModel) -> int:
        """Which one of those tried a model is."""
        return next(k for k, (problem, _) in enumerate(self.tried) if problem.model is model)

    def modes_of(self, model: ReducedModel) -> Sequence[int]:
        """Which coordinates of a model are modal."""
        return self.tried[self.place(model)][1]


class WearFile:
    """The HDF5 file of a wear calculation.

    Args:
        path: Where it is or will be.
        stated: Fingerprint of all that decides on the result.
        models: Those of its solutions; one that goes on tries those anew that the file knows of.
    """

    def __init__(self, path: Path, stated: str, models: TriedModels):
        self.path, self.stated, self.models = path, stated, models

    def write(self, state: WearState) -> None:
        """Replace the file by one with this state."""
        with replace_file(self.path) as file:
            file.attrs["format"], file.attrs["stated"] = _FORMAT, self.stated
            file.attrs["jump"], file.attrs["solves"], file.attrs["rough"] = state.jump, state.solves, state.rough
            file.attrs["stopped"] = state.stopped or ""
            file["leaps"] = [json.dumps(asdict(leap)) for leap in state.leaps]
            file["modes_tried"] = np.array(self.models.counts, dtype=int)
            file["pair_area"] = self.models.tried[0][0].model.areas
            self._write_steps(file.create_group("steps"), state.steps)
            self._write_steps(file.create_group("last"), [s for s in (state.earlier, state.latest) if s is not None])

    def read(self) -> WearState | None:
        """The state in the file, None where there is no file.

        Raises:
            OutputError: The file holds another calculation, or none that can be read.
        """
        with open_file(self.path) as file:
            if file is None:
                return None
            if file.attrs.get("format") != _FORMAT or file.attrs.get("stated") != self.stated:
                raise OutputError(
                    f"{self.path} holds another calculation (model, laws, cycles or settings differ); give another "
                    "file or remove it"
                )
            for count in file["modes_tried"][()]:
                self.models.keep_more(int(count))
            *earlier, latest = self._read_steps(file["last"])
            return WearState(
                latest=latest,
                earlier=earlier[0] if earlier else None,
                jump=int(file.attrs["jump"]),
                solves=int(file.attrs["solves"]),
                rough=int(file.attrs["rough"]),
                steps=tuple(self._read_steps(file["steps"])),
                stopped=str(file.attrs["stopped"]) or None,
                leaps=tuple(Leap(**json.loads(text)) for text in file["leaps"][()]),
            )

    def _write_steps(self, group: h5py.Group, steps: list[WearStep] | tuple[WearStep, ...]) -> None:
        group["cycle"] = np.array([s.cycle for s in steps])
        group["depth"], group["rate"] = np.array([s.depth for s in steps]), np.array([s.rate for s in steps])
        group["estimate"] = np.array([s.estimate for s in steps])
        group["model"] = np.array([self.models.place(s.solution.problem.model) for s in steps])
        # wall times would tell a resumed run from an unbroken one
        write_records(group.create_group("solutions"), [replace(strip(s.solution), seconds=0.0) for s in steps])

    def _read_steps(self, group: h5py.Group) -> list[WearStep]:
        columns = [group[name][()] for name in ("cycle", "depth", "rate", "estimate", "model")]
        return [
            WearStep(int(n), d, r, restore(replace(self.models.tried[k][0], wear=d), record), float(e))
            for n, d, r, e, k, record in zip(*columns, read_records(group["solutions"]), strict=True)
        ]
