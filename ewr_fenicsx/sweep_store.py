"""A sweep on disk, a file for each block or group of points as it ends: from these an interrupted run goes on."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from ewr_fenicsx.accuracy import AccurateSolution, Level
from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.estimates import ErrorEstimate
from ewr_fenicsx.following import Jump
from ewr_fenicsx.solution_store import Record, read_records, write_records
from ewr_fenicsx.whole_files import open_file, replace_file

FORMAT = "ewr_fenicsx frequency response, 5"
FILES = "blocks/*.h5"  # of all blocks and groups, in the folder of their sweep


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


@dataclass(frozen=True)
class _Store:
    """Finished pieces of one sweep, a file each.

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
    """Finished blocks; those of another sweep are refused."""

    def find_path(self, block: Block) -> Path:
        """Where a block is or will be."""
        return self._place(f"{block.curve:03d}_{block.number:04d}")

    def write(self, block: Block, records: list[Record], jumps: list[Jump]) -> None:
        """Write the solutions of a block and where its curve is broken.

        Raises:
            UnwritableFile: It cannot be written.
        """
        with self._create(self.find_path(block)) as file:
            if records:
                write_records(file.create_group("points"), records)
            file["jumps"] = np.array([jump.frequency for jump in jumps]).reshape(-1, 2)
            file.attrs["jumps"] = [jump.why for jump in jumps]

    def read(self, block: Block) -> tuple[list[Record], list[Jump]] | None:
        """What ``write`` wrote, None where it has not.

        Raises:
            OutputError: The file belongs to another sweep, or cannot be read.
        """
        path = self.find_path(block)
        with open_file(path) as file:
            if file is None:
                return None
            if file.attrs.get("stated") != self.stated:
                raise OutputError(
                    f"{path} belongs to a run with another model, laws or settings; give another folder or remove it"
                )
            records = read_records(file["points"]) if "points" in file else []
            jumps = [Jump(tuple(f), str(w)) for f, w in zip(file["jumps"][()], file.attrs["jumps"], strict=True)]
            return records, jumps


class GroupStore(_Store):
    """Finished groups of points that are as accurate as asked; those of another sweep are not looked at."""

    def find_path(self, group: int) -> Path:
        """Where a group is or will be."""
        return self._place(f"accurate_{self.stated[:16]}_{group:04d}")

    def write(self, group: int, found: list[tuple[Record, AccurateSolution]]) -> None:
        """Write the solutions of a group, and how accurate they are.

        Raises:
            UnwritableFile: It cannot be written.
        """
        with self._create(self.find_path(group)) as file:
            write_records(file.create_group("points"), [record for record, _ in found])
            file["accuracy"] = [json.dumps(asdict(replace(accurate, solution=None))) for _, accurate in found]

    def read(self, group: int) -> list[tuple[Record, AccurateSolution]] | None:
        """What ``write`` wrote, without solutions, None where it has not.

        Raises:
            OutputError: The file cannot be read.
        """
        with open_file(self.find_path(group)) as file:
            if file is None or file.attrs.get("stated") != self.stated:
                return None
            told = [_read_accuracy(json.loads(text)) for text in file["accuracy"][()]]
            return list(zip(read_records(file["points"]), told, strict=True))


def _read_accuracy(told: dict) -> AccurateSolution:
    def read_level(level: dict) -> Level:
        named = {"orders": tuple(level["orders"]), "estimate": ErrorEstimate(**level["estimate"])}
        return Level(**level | named)

    named = {"estimate": ErrorEstimate(**told["estimate"]), "levels": tuple(map(read_level, told["levels"]))}
    return AccurateSolution(**told | named)
