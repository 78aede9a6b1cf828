"""A sweep on disk, a file for each block or group of points as it ends: from these an interrupted run goes on."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

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
class BlockStore:
    """Finished blocks of one sweep.

    Args:
        folder: That of the sweep.
        stated: Fingerprint of all that decides on the result.
    """

    folder: Path
    stated: str

    def find_path(self, block: Block) -> Path:
        """Where a block is or will be."""
        return self.folder / FILES.replace("*", f"{block.curve:03d}_{block.number:04d}")

    def write(self, block: Block, records: list[Record], jumps: list[Jump]) -> None:
        """Write the solutions of a block and where its curve is broken.

        Raises:
            UnwritableFile: It cannot be written.
        """
        with replace_file(self.find_path(block)) as file:
            file.attrs["format"], file.attrs["stated"] = FORMAT, self.stated
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


@dataclass(frozen=True)
class GroupStore:
    """Finished groups of points that are as accurate as asked; what others have left in the folder is not looked at.

    Args:
        folder: That of the sweep.
        stated: Fingerprint of all that decides on the result.
    """

    folder: Path
    stated: str

    def find_path(self, group: int) -> Path:
        """Where a group is or will be."""
        return self.folder / FILES.replace("*", f"accurate_{self.stated[:16]}_{group:04d}")

    def write(self, group: int, found: list[tuple[Record, AccurateSolution]]) -> None:
        """Write the solutions of a group, and how accurate they are.

        Raises:
            UnwritableFile: It cannot be written.
        """
        with replace_file(self.find_path(group)) as file:
            file.attrs["format"], file.attrs["stated"] = FORMAT, self.stated
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
