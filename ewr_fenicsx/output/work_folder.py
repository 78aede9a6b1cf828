"""Work in progress: from what an interrupted sweep or wear calculation goes on, in a folder beside its results.

What is kept there belongs to one reduced model, whose rounding is not the same from run to run where ranks share the
mesh. So the model is kept as well, and the work goes on with it where the scene gives the same one but for rounding.
Another number of ranks cuts the mesh elsewhere, and now and then comes to other modes, in which fields would be wrong:
that number is kept to be told.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ewr_fenicsx.errors import ModelError, NotConverged, OutputError, UnwritableFile
from ewr_fenicsx.model.reduced_model import ARRAYS, ReducedModel, read_reduced_model
from ewr_fenicsx.output.result_folder import do_with_files

MODEL = "reduced_model.h5"  # marks the folder as one of these
RANKS = "ranks.txt"  # how many the work was begun on
ROUNDING = 1e-8  # largest difference of a matrix that is the same, over its largest entry


def name_work_folder(results: Path) -> Path:
    """Where the work is kept on the way to a result folder."""
    return results.parent / f"{results.name}.partial"


def holds_work(folder: Path, comm: MPI.Comm) -> bool:
    """Whether a folder holds work to go on from; collective."""
    return do_with_files(lambda: _holds_work(folder), comm)


def take_up_model(folder: Path, model: ReducedModel, comm: MPI.Comm, own: str) -> ReducedModel:
    """The model that the work in a folder was begun with; where there is none, the work begins with this one.

    Args:
        folder: The folder.
        model: That of the scene.
        comm: Ranks that call.
        own: Pattern of the files, below the folder, from which this kind of study goes on.

    Raises:
        OutputError: On every rank. The folder holds another scene's work, that of another number of ranks, or files
            that no run wrote; or it cannot be made.
    """
    begun = do_with_files(lambda: _take_up(folder, model, own, comm.size), comm, folder)
    return model if begun is None else begun


@contextmanager
def refuse_other_work(folder: Path | None) -> Iterator[None]:
    """Says, where a store finds work of another scene in a folder, what to do about it.

    Raises:
        OutputError: With the longer message.
    """
    try:
        yield
    except OutputError as error:
        if folder is None or isinstance(error, UnwritableFile):  # the work is worth keeping
            raise
        raise OutputError(f"{error}. {_say_remedy(folder)}") from None


@contextmanager
def keep_work(folder: Path | None, comm: MPI.Comm) -> Iterator[None]:
    """Removes a folder when the block has ended, or has left nothing worth going on with; else says where it is.

    Raises:
        KeyboardInterrupt, UnwritableFile: With words on where the work is, where there is any.
    """
    try:
        yield
    except BaseException as error:  # other ranks may be anywhere: nothing collective here
        if folder is not None and (isinstance(error, NotConverged) or not _holds_work(folder)):
            _remove(folder)  # the same command would end there again
        elif folder is not None and isinstance(error, (KeyboardInterrupt, UnwritableFile)):
            kept = f"the work so far is in {folder}, and the same command goes on from there"
            raise type(error)("; ".join([*error.args, kept])) from error.__cause__
        raise
    if folder is not None:
        do_with_files(lambda: _remove(folder), comm)


def _holds_work(folder: Path) -> bool:
    return (folder / MODEL).is_file() and any(p.is_file() and p.name != MODEL for p in folder.rglob("*.h5"))


def _remove(folder: Path) -> None:
    if not (folder / MODEL).is_file():
        with suppress(OSError):  # it is not empty, or not there
            folder.rmdir()
        return
    if folder.is_symlink():  # to another disk: it stays, and so does the folder there
        for entry in folder.iterdir():
            shutil.rmtree(entry, ignore_errors=True)  # which leaves files
            with suppress(OSError):
                entry.unlink()
    shutil.rmtree(folder, ignore_errors=True)  # which leaves links


def _take_up(folder: Path, model: ReducedModel, own: str, ranks: int) -> ReducedModel | None:
    if not (folder / MODEL).is_file():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise OutputError(f"{folder} is where work in progress goes, and no run wrote it; {_say_remedy(folder)}")
        folder.mkdir(parents=True, exist_ok=True)
        model.save(folder / MODEL)
        (folder / RANKS).write_text(f"{ranks}\n", encoding="utf-8")
        return None
    try:
        begun = read_reduced_model(folder / MODEL)
    except (OSError, KeyError, ModelError) as error:
        raise OutputError(f"{folder / MODEL} cannot be read: {error}. {_say_remedy(folder)}") from None
    if not _is_same(model, begun):
        raise OutputError(_tell_difference(folder, ranks))
    if _holds_work(folder) and not any(folder.glob(own)):  # at its end, this study would remove it
        raise OutputError(f"{folder} holds interrupted work of another kind of study. {_say_remedy(folder)}")
    order = {"load": {h: begun.load[h] for h in model.load}, "outputs": {n: begun.outputs[n] for n in model.outputs}}
    return replace(model, **{name: getattr(begun, name) for name in ARRAYS}, **order, cyclic=begun.cyclic)


def _tell_difference(folder: Path, ranks: int) -> str:
    """Why work was begun with another model: by another number of ranks, as far as can be seen, or of another scene."""
    try:
        begun = int((folder / RANKS).read_text(encoding="utf-8"))
    except (OSError, ValueError):  # its run was killed before it wrote this
        begun = ranks
    if begun == ranks:
        return f"{folder} holds interrupted work of another model. {_say_remedy(folder)}"
    counted = [f"{number} rank{'s' if number > 1 else ''}" for number in (begun, ranks)]
    return (
        f"{folder} holds work begun on {counted[0]}, and this run has {counted[1]}: go on with `mpirun -n {begun}`, or "
        "remove the folder to begin anew"
    )


def _is_same(model: ReducedModel, begun: ReducedModel) -> bool:
    if model.load.keys() != begun.load.keys() or model.outputs.keys() != begun.outputs.keys():
        return False
    rings = [(r.sectors, r.engine_order, *r.arrays) if r else None for r in (model.cyclic, begun.cyclic)]
    if rings[0] != rings[1]:
        return False
    pairs = [(getattr(model, name), getattr(begun, name)) for name in ARRAYS]
    if model.cyclic:
        pairs += [(value, begun.cyclic.arrays[name]) for name, value in model.cyclic.arrays.items()]
        if model.cyclic.outputs.keys() != begun.cyclic.outputs.keys():
            return False
        pairs += [(row, begun.cyclic.outputs[name]) for name, row in model.cyclic.outputs.items()]
    pairs += [(model.load[h], begun.load[h]) for h in model.load]
    pairs += [(model.outputs[name], begun.outputs[name]) for name in model.outputs]
    return all(_agree(a, b) for a, b in pairs)


def _agree(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    if a is None or b is None:
        return a is b
    return a.shape == b.shape and bool(np.all(np.abs(a - b) <= ROUNDING * np.abs(b).max(initial=0.0)))


def _say_remedy(folder: Path) -> str:
    return f"Remove the folder {folder} if you do not need it, or give another --out"
