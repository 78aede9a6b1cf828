"""The folder of a run's results: there complete or not at all, and never in place of something that no run wrote."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from errno import EEXIST, ENOTEMPTY
from pathlib import Path
from typing import TypeVar

from mpi4py import MPI

from ewr_fenicsx.errors import OutputError, UnwritableFile
from ewr_fenicsx.output.folder_lock import free_folder, lock_folder
from ewr_fenicsx.task_sharing import do_on_rank_zero

SUMMARY = "summary.json"  # its key "files" names all files of the folder
DRAFT = ".ewr-draft."  # in the hidden names of folders on their way, between the folder's own and a random one

T = TypeVar("T")


def check_target(
    folder: Path, *, overwrite: bool = False, comm: MPI.Comm = MPI.COMM_SELF, own: Sequence[str] = ()
) -> None:
    """Checks, before any work is done, that a result folder can be written.

    Args:
        folder: The folder.
        overwrite: Whether results that it holds may be replaced.
        comm: Ranks that call.
        own: Names of the files that may be replaced; none: those that the folder's summary lists.

    Raises:
        OutputError: On every rank. The folder exists, holds files that are no results, or cannot be made.
    """
    do_with_files(lambda: _check_target(Path(folder), overwrite, own), comm)


@contextmanager
def hold_target(
    folder: Path, *, overwrite: bool = False, comm: MPI.Comm = MPI.COMM_SELF, own: Sequence[str] = ()
) -> Iterator[None]:
    """Keeps other runs from a result folder, and so from the work on the way to it, while the block runs.

    Args:
        folder, overwrite, comm, own: As in ``check_target``, which is done before the block.

    Raises:
        OutputError: On every rank. As ``check_target``; or another run has the folder.
    """
    check_target(folder, overwrite=overwrite, comm=comm, own=own)
    lock = do_with_files(lambda: lock_folder(Path(folder)), comm)
    try:
        check_target(folder, overwrite=overwrite, comm=comm, own=own)  # a run may have ended just before
        if comm.rank == 0 and lock.held:
            _remove_drafts(_follow_links(Path(folder)))
        yield
    finally:
        if comm.rank == 0:
            free_folder(lock)


@contextmanager
def result_folder(folder: Path, *, overwrite: bool = False, comm: MPI.Comm = MPI.COMM_SELF) -> Iterator[Path]:
    """A temporary folder beside ``folder`` that takes its place when the block ends, and vanishes when it fails.

    Raises:
        OutputError: As ``check_target``; or the temporary folder cannot be made, filled or moved.
    """
    check_target(folder, overwrite=overwrite, comm=comm)
    folder = _follow_links(Path(folder))
    draft = do_with_files(lambda: _make_draft(folder), comm)
    try:
        with _name_failure(folder):
            yield draft
        comm.barrier()
        do_with_files(lambda: _move_into_place(draft, folder, overwrite), comm, folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def read_summary(folder: Path) -> dict:
    """The summary of the run that filled a folder.

    Raises:
        OSError, ValueError: There is none, or it is no JSON.
    """
    return json.loads((folder / SUMMARY).read_text(encoding="utf-8"))


def read_times(folder: Path, scene: Mapping) -> dict[str, float] | None:
    """Seconds by stage of the run that filled a folder; None where there is none, or it was one of another scene."""
    try:
        summary = read_summary(folder)
        return dict(summary["seconds"]) if summary["scene"] == scene else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def do_with_files(action: Callable[[], T], comm: MPI.Comm, folder: Path | str = "") -> T:
    """Does something with files on rank 0 alone; its value, or what it raises, is that of every rank.

    Args:
        action: What to do.
        comm: Ranks that call.
        folder: Named where the system does not say which file it was, as on a full disk.

    Raises:
        OutputError: ``action`` raised it, or an ``OSError``.
    """
    return do_on_rank_zero(_name_failure(folder)(action), comm)


@contextmanager
def _name_failure(folder: Path | str = "") -> Iterator[None]:
    """Makes what the system says of files an error with a remedy."""
    try:
        yield
    except OSError as error:
        where, why = error.filename or folder, error.strerror or error
        raise UnwritableFile(f"cannot write results: {where}: {why}; make room, or give another --out") from error


def _check_target(folder: Path, overwrite: bool, own: Sequence[str]) -> None:
    place = _follow_links(folder)
    if Path.cwd().is_relative_to(place):  # it is replaced as a whole
        raise OutputError(f"result folder {place} holds the folder that this runs in; give another --out")
    if folder.is_dir() and any(folder.iterdir()):
        if not overwrite:
            raise OutputError(
                f"result folder {folder} exists and is kept; give --overwrite to replace it, or another --out"
            )
        if foreign := sorted(_find_foreign_files(folder, own)):
            raise OutputError(
                f"result folder {folder} holds {foreign[0]!r}{f' and {len(foreign) - 1} more' if foreign[1:] else ''}, "
                f"which {'this command does not write' if own else 'no run wrote'}; move it away, or give another --out"
            )
    if (place.exists() or place.is_symlink()) and not place.is_dir():
        raise OutputError(f"result folder {folder} is a file; give another --out")
    if missing := [at for at in (folder, *folder.parents) if at.name == ".." and not at.exists()]:
        raise OutputError(f"result folder {folder}: there is no {missing[-1].parent} to go up from; give another --out")
    ancestor = next(parent for parent in place.parents if parent.exists())
    try:
        with tempfile.TemporaryDirectory(prefix=f".{place.name}{DRAFT}", dir=ancestor):  # a name as long as it will be
            pass
    except OSError as error:
        raise OutputError(
            f"result folder {folder} cannot be made: {ancestor}: {error.strerror}; give another --out"
        ) from None


def _follow_links(folder: Path) -> Path:
    """Where a folder is, or would be made: a link to it stays, and so do results on the disk that it leads to."""
    return Path(os.path.realpath(folder))  # which, unlike resolve, has no quarrel with links that lead round


def _find_foreign_files(folder: Path, own: Sequence[str]) -> set[str]:
    found = {path.name for path in folder.iterdir()}
    if own:
        return found - set(own)
    try:
        return found - set(read_summary(folder)["files"])
    except (OSError, ValueError, KeyError, TypeError):
        return found


def _make_draft(folder: Path) -> Path:
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}{DRAFT}", dir=folder.parent))
    mask = os.umask(0)
    os.umask(mask)
    draft.chmod(0o777 & ~mask)  # mkdtemp makes folders private
    return draft


def _remove_drafts(folder: Path) -> None:
    """Removes what runs that were killed as they wrote have left beside a folder, which the caller has locked."""
    with suppress(OSError):  # no reason not to run
        for draft in folder.parent.iterdir():
            if draft.name.startswith(f".{folder.name}{DRAFT}"):
                shutil.rmtree(draft, ignore_errors=True)


def _move_into_place(draft: Path, folder: Path, overwrite: bool) -> None:
    try:
        draft.rename(folder)  # which takes the place of an empty folder, and of nothing else
    except OSError as error:
        if error.errno not in (ENOTEMPTY, EEXIST):
            raise
        _check_target(folder, overwrite, ())  # it was free to take before: another run has filled it since
        old = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old.", dir=folder.parent))
        folder.rename(old / folder.name)
        try:
            draft.rename(folder)
        except BaseException:
            (old / folder.name).rename(folder)
            old.rmdir()
            raise
        shutil.rmtree(old)
