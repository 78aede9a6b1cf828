"""One run at a time writes to a folder: a lock on a hidden file beside it, freed by the system however a run ends."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ewr_fenicsx.errors import OutputError


@dataclass(frozen=True)
class FolderLock:
    """A lock that this process holds until ``free_folder``.

    Attributes:
        file: The hidden file.
        handle: Of the file, open.
        made: Folders that were made for it, the innermost first.
        held: Whether others are kept out: False where the file system knows no locks.
    """

    file: Path
    handle: int
    made: tuple[Path, ...]
    held: bool = True


def lock_folder(folder: Path) -> FolderLock:
    """Takes the lock of a folder, which need not exist; where the file system knows no locks, nobody is kept out.

    Links are followed, so that all names of a folder have one lock.

    Raises:
        OutputError: Another run, or another caller in this process, has it.
        OSError: The hidden file cannot be made.
    """
    place = Path(os.path.realpath(folder))
    file = place.with_name(f".{place.name}.lock")
    while True:  # again where a run that ends has removed the file, or the folder it made, in the meantime
        made = tuple(parent for parent in place.parents if not parent.exists())
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock = FolderLock(file, os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), made)
        except FileNotFoundError:
            continue
        try:
            fcntl.flock(lock.handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock.handle)
            raise OutputError(f"another run writes to {folder}; wait for it, or give another --out") from None
        except OSError:  # no locks here
            return replace(lock, held=False)
        if _is_still_there(lock):
            return lock
        os.close(lock.handle)


def free_folder(lock: FolderLock) -> None:
    """Removes the hidden file, and folders made for it in which nothing else is, and lets others in."""
    with suppress(OSError):  # results are there: none of this is worth an error
        lock.file.unlink()  # while it is locked: nobody can hold a lock on a file of this name but us
        for parent in lock.made:
            parent.rmdir()
    os.close(lock.handle)


def _is_still_there(lock: FolderLock) -> bool:
    """Whether the file that is locked is the one that others will find by its name."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(lock.handle), os.stat(lock.file))
    return False
