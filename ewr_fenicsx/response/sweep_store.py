"""A sweep on disk, a file for each block or group of points: from these an interrupted run goes on.

Files are written as points are found, and not more often than is worth it. So it does not matter how a run is ended.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypeVar

import h5py
import numpy as np

from ewr_fenicsx.accuracy.accuracy import AccurateSolution, Level
from ewr_fenicsx.accuracy.estimates import ErrorEstimate
from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.response.following import Jump
from ewr_fenicsx.response.solution_store import Record, read_records, write_records
from ewr_fenicsx.whole_files import open_file, replace_file

FORMAT = "ewr_fenicsx frequency response, 6"
FILES = "blocks/*.h5"  # of all blocks and groups, in the folder of their sweep
WORTH, WORTH_A_POINT = 1.0, 0.1  # seconds of work that are worth a file: of several points, and of one

State = TypeVar("State")


@dataclass(frozen=True)
class Block:
    """A task: follow one curve from the first of some frequencies [Hz] to the last.

    Attributes:
        curve: Number of the curve.
        number: Of the block along its curve.
        frequencies: Rising; the last one is the first of the next block.
    """

    curve: int
    number: int
    frequencies: tuple[float, ...]

    def count(self, passed: int) -> int:
        """How many of its first frequencies are in no block before it."""
        return passed if self.number == 0 else max(0, passed - 1)


@dataclass(frozen=True, eq=False)
class BlockState:
    """How far a block is solved.

    Attributes:
        passed: Frequencies done, with a solution or without.
        records: Solutions so far.
        jumps: Where their curve is broken.
        stand: Where the branch stands: its last solution and the one before, as far as there are these.
        reach: Longest step from there [Hz].
    """

    passed: int = 0
    records: tuple[Record, ...] = ()
    jumps: tuple[Jump, ...] = ()
    stand: tuple[Record, ...] = ()
    reach: float = np.inf


def keep(states: Iterable[State], write: Callable[[State], None]) -> Iterator[State]:
    """Hands on the states of a piece of work, and writes those that are worth it and the last one."""
    state = kept = None
    since = time.monotonic()
    for state in states:
        if time.monotonic() - since >= WORTH:
            write(state)
            kept, since = state, time.monotonic()
        yield state
    if state is not kept:
        write(state)


@dataclass(frozen=True)
class _Store:
    """Pieces of one sweep, a file each.

    Args:
        folder: That of the sweep.
        stated: Fingerprint of all that decides on the result.
    """

    folder: Path
    stated: str

    def _place(self, name: str) -> Path:
        return self.folder / FILES.replace("*", name)

    @contextmanager
    def _create(self, path: Path) -> Iterator[h5py.File]:
        with replace_file(path) as file:
            file.attrs["format"], file.attrs["stated"] = FORMAT, self.stated
            yield file


class BlockStore(_Store):
    """Blocks as far as they are solved; those of another sweep are refused."""

    def find_path(self, block: Block) -> Path:
        """Where a block is or will be."""
        return self._place(f"{block.curve:03d}_{block.number:04d}")

    def write(self, block: Block, state: BlockState) -> None:
        """Write how far a block is solved.

        Raises:
            UnwritableFile: It cannot be written.
        """
        with self._create(self.find_path(block)) as file:
            for name, records in (("points", state.records), ("stand", state.stand)):
                if records:
                    write_records(file.create_group(name), records)
            file["jumps"] = np.array([jump.frequency for jump in state.jumps]).reshape(-1, 2)
            file.attrs["jumps"] = [jump.why for jump in state.jumps]
            file.attrs["passed"], file.attrs["reach"] = state.passed, state.reach

    def read(self, block: Block) -> BlockState:
        """What ``write`` wrote last; where it has not, a block that nothing is done of.

        Raises:
            OutputError: The file belongs to another sweep, or cannot be read.
        """
        path = self.find_path(block)
        with open_file(path) as file:
            if file is None:
                return BlockState()
            if file.attrs.get("stated") != self.stated:
                raise OutputError(
                    f"{path} belongs to a run with another model, laws, frequencies or settings; give another folder "
                    "or remove it"
                )
            points, stand = (tuple(read_records(file[n])) if n in file else () for n in ("points", "stand"))
            jumps = [Jump(tuple(f), str(w)) for f, w in zip(file["jumps"][()], file.attrs["jumps"], strict=True)]
            return BlockState(int(file.attrs["passed"]), points, tuple(jumps), stand, float(file.attrs["reach"]))


class GroupStore(_Store):
    """Groups of points that are as accurate as asked, as far as they are solved; of another sweep, not looked at."""

    def find_path(self, group: int) -> Path:
        """Where a group is or will be."""
        return self._place(f"accurate_{self.stated[:16]}_{group:04d}")

    def write(self, group: int, found: list[tuple[Record, AccurateSolution]]) -> None:
        """Write the solutions of a group so far, and how accurate they are.

        Raises:
            UnwritableFile: It cannot be written.
        """
        with self._create(self.find_path(group)) as file:
            write_records(file.create_group("points"), [record for record, _ in found])
            file["accuracy"] = [json.dumps(asdict(replace(accurate, solution=None))) for _, accurate in found]

    def read(self, group: int) -> list[tuple[Record, AccurateSolution]]:
        """What ``write`` wrote last, without solutions; nothing where it has not.

        Raises:
            OutputError: The file cannot be read.
        """
        with open_file(self.find_path(group)) as file:
            if file is None or file.attrs.get("stated") != self.stated:
                return []
            told = [_read_accuracy(json.loads(text)) for text in file["accuracy"][()]]
            return list(zip(read_records(file["points"]), told, strict=True))


class StabilityStore(_Store):
    """Which points of a curve are unstable, a file each; those of another curve are not looked at."""

    def find_path(self, point: int) -> Path:
        """Where a point is or will be."""
        return self._place(f"stability_{self.stated[:16]}_{point:04d}")

    def write(self, point: int, unstable: bool) -> None:
        """Write whether a point is unstable.

        Raises:
            UnwritableFile: It cannot be written.
        """
        with self._create(self.find_path(point)) as file:
            file.attrs["unstable"] = unstable

    def read(self, count: int) -> dict[int, bool]:
        """What ``write`` wrote of the first ``count`` points, by their numbers.

        Raises:
            OutputError: A file cannot be read.
        """
        known = {}
        for point in range(count):
            with open_file(self.find_path(point)) as file:
                if file is not None and file.attrs.get("stated") == self.stated:
                    known[point] = bool(file.attrs["unstable"])
        return known


def _read_accuracy(told: dict) -> AccurateSolution:
    def read_level(level: dict) -> Level:
        named = {"orders": tuple(level["orders"]), "estimate": ErrorEstimate(**level["estimate"])}
        return Level(**level | named)

    named = {"estimate": ErrorEstimate(**told["estimate"]), "levels": tuple(map(read_level, told["levels"]))}
    return AccurateSolution(**told | named)
