"""Calls of PETSc that call back: what ends them comes out as it was raised."""

from __future__ import annotations

from collections.abc import Callable
from traceback import clear_frames

from petsc4py import PETSc


def call_petsc(call: Callable[..., object], *arguments: object) -> None:
    """Calls what runs code of ours within PETSc, and raises what that raises, such as Ctrl-C or a mistake in a law.

    PETSc 3.18 hands it on as it is, 3.22 as the cause of an error of its own, whatever it is. Frames are cleared: they
    hold what PETSc must not find alive when it ends, a crash at exit.
    """
    ended: BaseException | None = None
    try:
        call(*arguments)
    except BaseException as error:
        ended = error
        clear_frames(error.__traceback__)
        while isinstance(ended, PETSc.Error) and ended.__cause__ is not None:
            ended = ended.__cause__
            clear_frames(ended.__traceback__)
    if ended is not None:  # out here, or PETSc's error would be the context of what led to it
        raise ended
