"""Files that are complete or not there: they are written under another name and take their place in one move.

What the system says of a file becomes an error that names the file and what to do. A digest follows the HDF5
data, which HDF5 passes over: of damaged data it may read other numbers, or never come to an end.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from errno import EISDIR
from hashlib import sha256
from pathlib import Path
from tempfile import NamedTemporaryFile

import h5py
import numpy as np

from ewr_fenicsx.errors import OutputError, UnwritableFile

_MARK = b"ewr_fenicsx sha256\n"  # between the data of a file and their digest
_UNWRITABLE = (UnwritableFile, "cannot be written", "give a place where files can be, or make room")


@contextmanager
def replace_file(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file to write that takes the place of ``path`` when the block ends well: complete or not at all.

    Raises:
        UnwritableFile: It cannot be written.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    with _naming(path, _UNWRITABLE):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with h5py.File(draft, "w", driver="core", backing_store=False) as file:  # on a full disk HDF5 would crash
                yield file
                file.flush()
                image = file.id.get_file_image()
            with draft.open("wb") as written:
                written.write(image + _MARK + sha256(image).digest())
                written.flush()
                os.fsync(written.fileno())
            draft.replace(path)
        finally:
            draft.unlink(missing_ok=True)


@contextmanager
def open_file(path: Path) -> Iterator[h5py.File | None]:
    """A file that ``replace_file`` wrote, to read; None where there is none.

    Raises:
        OutputError: It is no such file, damaged, or may not be read.
    """
    with _naming(path, (OutputError, "cannot be read", "give another place, or remove it to begin anew")):
        if not path.is_file():
            yield None
            return
        check_whole(path)
        with h5py.File(path, "r") as file:
            try:
                yield file
            except KeyError as lacking:  # a reader asked for what every such file has
                raise OSError(f"it is damaged: {lacking.args[0]}") from lacking


def check_whole(path: Path) -> None:
    """Checks that a file is as ``replace_file`` wrote it, where it ends as one: not those of earlier versions.

    Raises:
        OSError: It is damaged, or cannot be read.
    """
    content, size = path.read_bytes(), len(_MARK) + sha256().digest_size
    image, end = content[:-size], content[-size:]
    if end.startswith(_MARK) and end != _MARK + sha256(image).digest():
        raise OSError("it is damaged")


def check_place(path: Path) -> None:
    """Checks, before any work is done, that a file can be written; makes its folder.

    Raises:
        OutputError: It cannot.
    """
    with _naming(path, _UNWRITABLE):
        if path.is_dir():
            raise IsADirectoryError(EISDIR, "it is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        with NamedTemporaryFile(prefix=f".{path.name}.", dir=path.parent):
            pass


@contextmanager
def _naming(path: Path, failure: tuple[type[OutputError], str, str]) -> Iterator[None]:
    """Makes what the system says of a file an error that names the file, what failed and the remedy."""
    kind, what, remedy = failure
    try:
        yield
    except OSError as error:
        raise kind(f"{path} {what}: {error.strerror or error}; {remedy}") from error


def write_table(path: str | Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns ``(n,)`` of numbers or texts as CSV with a header, floats to the last digit.

    Raises:
        OutputError: The file cannot be written.
    """
    with _naming(Path(path), _UNWRITABLE), Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True))
