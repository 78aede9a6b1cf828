"""What a command begins with: standard streams that no run is lost for, and PETSc with the options meant for it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TextIO

import petsc4py

from ewr_fenicsx.errors import OptionError


@contextmanager
def settle_streams() -> Iterator[None]:
    """Standard streams while a command runs: closed ones take what they are given, and other letters are no error.

    What is told on the way need not be read: where standard error cannot be written, as on a full disk, the run goes
    on. What cannot be written by the end is dropped: Python would change the exit code for it.
    """
    sys.stdout, sys.stderr = (stream or open(os.devnull, "w") for stream in (sys.stdout, sys.stderr))  # noqa: SIM115
    streams = sys.stdout, sys.stderr
    if hasattr(sys.stdout, "reconfigure"):  # those of notebooks have none, and take all letters
        sys.stdout.reconfigure(errors="backslashreplace")  # as standard error has it
    sys.stderr = _Expendable(sys.stderr)
    try:
        yield
    finally:
        sys.stderr = streams[1]
        for stream in streams:
            try:
                stream.flush()
            except OSError:
                with suppress(OSError):  # a stream without a file
                    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _Expendable:
    """A stream that passes over what the system refuses to write; the next writing tries it again."""

    def __init__(self, stream: TextIO):
        self._stream = stream

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._stream.flush()


def start_petsc(options: Sequence[str]) -> None:
    """Starts PETSc, which nothing may have imported before, with options from the command line.

    Raises:
        OptionError: PETSc, which has told why, refuses one of these, or of those that it finds elsewhere.
    """
    try:
        petsc4py.init([sys.argv[0], *options])
    except RuntimeError as error:
        given = f"options given: {' '.join(options)}; " if options else ""
        raise OptionError(
            f"PETSc does not start, for the reason above; {given}it takes more from PETSC_OPTIONS and .petscrc"
        ) from error
