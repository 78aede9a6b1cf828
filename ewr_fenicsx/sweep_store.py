"""The blocks of a sweep on disk, a file each as they are finished: from these an interrupted run goes on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ewr_fenicsx.errors import OutputError
from ewr_fenicsx.following import Jump
from ewr_fenicsx.solution_store import Record, read_records, write_records
from ewr_fenicsx.whole_files import open_file, replace_file

FORMAT = "ewr_fenicsx frequency response, 5"
FILES = "blocks/*.h5"  # of all blocks, in the folder of their sweep


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
