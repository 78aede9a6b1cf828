"""What differs between dolfinx 0.5 and 0.9, probed by feature, never by version."""

from __future__ import annotations

import ctypes
import importlib.util
import inspect
import logging
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from errno import EDQUOT, ENOSPC

import cffi
import dolfinx
import dolfinx.fem.petsc
import dolfinx.jit
import gmsh
import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from ewr_fenicsx.errors import EwrError

# gmsh 4.8 takes Ctrl-C away as it is imported, until it is finalized
if (
    getattr(gmsh, "oldsig", None)
    and threading.current_thread() is threading.main_thread()
    and signal.getsignal(signal.SIGINT) is signal.SIG_DFL
):
    signal.signal(signal.SIGINT, gmsh.oldsig)


class _Clock:
    """Adds up the time spent in ``compiling``."""

    seconds = 0.0


@contextmanager
def compiling(what: str) -> Iterator[None]:
    """Around everything that makes dolfinx call the C compiler.

    Silences the compiler driver's ``INFO:root`` lines and turns a failed compilation into an error that helps.

    Args:
        what: What is compiled, for the message.

    Raises:
        EwrError: No C compiler, or a cache that cannot be written or was left unusable by an interrupted compilation.
    """
    root = logging.getLogger()
    level, handlers, disabled = root.level, list(root.handlers), root.manager.disable
    begin = time.perf_counter()
    logging.disable(max(disabled, logging.INFO))
    try:
        with _put_off_interruptions():
            yield
    except (TimeoutError, ImportError, OSError, RuntimeError, cffi.VerificationError) as error:
        cache = jit_cache()
        remedy = f"If an earlier run was killed, clear the cache: rm -r {cache}"
        if isinstance(error, OSError) and (error.filename or error.errno in (ENOSPC, EDQUOT)):  # no name on a full disk
            remedy = f"The cache is {cache}; if it cannot be written, set XDG_CACHE_HOME to a folder that can"
        elif not isinstance(error, TimeoutError):
            remedy = f"Is there a C compiler (apt-get install gcc)? {remedy}"
        raise EwrError(f"cannot compile {what}: {type(error).__name__}: {error}\n{remedy}") from error
    finally:
        logging.disable(disabled)
        root.setLevel(level)
        root.handlers[:] = handlers
        _Clock.seconds += time.perf_counter() - begin


@contextmanager
def _put_off_interruptions() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait until the block has ended.

    An unfinished compilation stays in the cache, where the next run would wait for its end, and then fail.
    """
    came: list[int] = []
    mine = threading.current_thread() is threading.main_thread()  # no other may set what is done on a signal
    usual = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM) if mine}
    usual = {number: handler for number, handler in usual.items() if handler is not None}  # that are Python's own
    for number in usual:
        signal.signal(number, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


def measure_compilation() -> float:
    """Seconds that this process has spent so far on compiling forms and spaces, or on finding them compiled."""
    return _Clock.seconds


def jit_cache() -> str:
    """The folder in which dolfinx keeps compiled forms."""
    probe = "get_options" if hasattr(dolfinx.jit, "get_options") else "get_parameters"
    return str(getattr(dolfinx.jit, probe)()["cache_dir"])


def function_space(mesh: dolfinx.mesh.Mesh, family: str, degree: int, shape: tuple[int, ...] = ()):
    """A scalar (``shape=()``) or vector (``shape=(2,)``) finite-element space."""
    with compiling(f"the {family} space of degree {degree}"):
        if hasattr(dolfinx.fem, "functionspace"):
            return dolfinx.fem.functionspace(mesh, (family, degree, shape) if shape else (family, degree))
        if shape:
            return dolfinx.fem.VectorFunctionSpace(mesh, (family, degree), dim=shape[0])
        return dolfinx.fem.FunctionSpace(mesh, (family, degree))


def compile_form(form: ufl.Form, what: str):
    """A UFL form, compiled."""
    with compiling(what):
        return dolfinx.fem.form(form)


def assemble_matrix(form) -> PETSc.Mat:
    """The sparse matrix of a compiled bilinear form, with no boundary condition."""
    matrix = dolfinx.fem.petsc.assemble_matrix(form)
    matrix.assemble()
    return matrix


def assemble_vector(form) -> PETSc.Vec:
    """The vector of a compiled linear form, shared entries summed on their owner."""
    vector = dolfinx.fem.petsc.assemble_vector(form)
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return vector


def free_matrices(comm: PETSc.Comm) -> None:
    """Frees the PETSc objects of a communicator that Python has let go of; collective.

    From PETSc 3.18 on nothing else does: a rank that collects garbage cannot destroy what other ranks still use.
    """
    if hasattr(PETSc, "garbage_cleanup"):
        PETSc.garbage_cleanup(comm)


def list_unused_options() -> list[str]:
    """Names of the options given to PETSc, without their dash, that nothing has asked for so far."""
    petsc = ctypes.CDLL(PETSc.__file__)  # petsc4py has no call for it, and the C library's may be reached through it
    count, names, values = ctypes.c_int64(0), ctypes.POINTER(ctypes.c_char_p)(), ctypes.POINTER(ctypes.c_char_p)()
    table = [None, *(ctypes.byref(part) for part in (count, names, values))]
    petsc.PetscOptionsLeftGet(*table)
    unused = [names[i].decode() for i in range(count.value)]
    petsc.PetscOptionsLeftRestore(*table)
    return unused


def cell_dofs(space, cells: Sequence[int]) -> np.ndarray:
    """Local block numbers of the given cells, cell after cell."""
    return np.array([dof for cell in cells for dof in space.dofmap.cell_dofs(cell)], dtype=np.int64)


@contextmanager
def gmsh_model(name: str) -> Iterator[None]:
    """A fresh, silent gmsh model that is removed in the end; gmsh is started, and then stopped, if it was not running.

    Args:
        name: Of the model, which becomes the current one.
    """
    running = gmsh_is_running()
    if not running:
        # A program's own arguments are not gmsh's, a user's gmsh options must not change meshes, and Ctrl-C stays ours.
        newer = "interruptible" in inspect.signature(gmsh.initialize).parameters
        gmsh.initialize([], readConfigFiles=False, **({"interruptible": False} if newer else {}))
    models, current = gmsh.model.list(), gmsh.model.getCurrent()
    with _keep_options():
        gmsh.option.setNumber("General.Terminal", 0)
        try:
            gmsh.model.add(name)
            yield
        finally:
            if not gmsh_is_running():
                pass  # what ran inside has ended it
            elif not running:
                gmsh.finalize()
            else:
                for added in [model for model in gmsh.model.list() if model not in models]:
                    gmsh.model.setCurrent(added)
                    gmsh.model.remove()
                gmsh.model.setCurrent(current)


@contextmanager
def _keep_options() -> Iterator[None]:
    """Gives gmsh, if it runs on, the options back that are set inside: they would change the meshes made after it.

    gmsh 4.8 can list neither its options nor those that differ from the defaults, so calls that set one are noted.
    """
    before: dict[tuple[str, str], tuple] = {}
    setters = {kind: getattr(gmsh.option, f"set{kind}") for kind in ("Number", "String", "Color")}

    def note(kind: str) -> staticmethod:
        def note_and_set(name: str, *value: object, **named: object) -> None:
            found = getattr(gmsh.option, f"get{kind}")(name)
            before.setdefault((kind, name), tuple(found) if kind == "Color" else (found,))
            setters[kind](name, *value, **named)

        return staticmethod(note_and_set)

    for kind in setters:
        setattr(gmsh.option, f"set{kind}", note(kind))
    try:
        yield
    finally:
        for kind, setter in setters.items():
            setattr(gmsh.option, f"set{kind}", staticmethod(setter))
        for (kind, name), value in before.items() if gmsh_is_running() else ():
            setters[kind](name, *value)


def gmsh_is_running() -> bool:
    """Whether gmsh has been started, and not stopped since.

    Nothing of gmsh 4.8 may be called to find out: before its first start it looks up what to do about errors in memory
    that it has not set, and at times that says to end the process, without a word. Its client for parameters is there
    exactly while it runs.
    """
    if hasattr(gmsh, "isInitialized"):
        return bool(gmsh.isInitialized())
    return bool(ctypes.c_void_p.in_dll(gmsh.lib, "_ZN3Msg13_onelabClientE"))


def distribute_gmsh_model(comm: MPI.Comm, dimension: int) -> tuple:
    """The current gmsh model of rank 0 as ``(mesh, cell tags, facet tags)`` on all ranks."""
    if importlib.util.find_spec("dolfinx.io.gmsh"):
        converter = importlib.import_module("dolfinx.io.gmsh")
    else:
        converter = importlib.import_module("dolfinx.io.gmshio")
    return tuple(converter.model_to_mesh(gmsh.model, comm, 0, gdim=dimension))[:3]


def element_degree(space) -> int:
    """Polynomial degree of a space."""
    degree = space.ufl_element().degree
    return degree() if callable(degree) else degree


def write_meshtags(file: dolfinx.io.XDMFFile, tags, mesh: dolfinx.mesh.Mesh) -> None:
    """Write tags into an XDMF file that already holds their mesh."""
    if inspect.isfunction(type(file).write_meshtags):  # the older one is compiled, and finds the mesh itself
        file.write_meshtags(tags, mesh.geometry)
    else:
        file.write_meshtags(tags)
