"""Options for PETSc, checked before the work: a solver of the work would meet a wrong one after minutes or hours."""

from __future__ import annotations

from petsc4py import PETSc

from ewr_fenicsx.errors import OptionError

# What PETSc takes and then fails with in the midst of the work, or what ends it in contradictions: name -> remedy
_TOLERANCE = "solver.tolerance in the scene decides where Newton's method ends"
_MATRIX = "the Newton matrix is exact; leave the option out, or compare it with differences by -ewr_snes_test_jacobian"
_REMEDIES = {f"ewr_snes_{name}": _TOLERANCE for name in ("atol", "rtol", "stol")}
_REMEDIES |= {f"ewr_snes_{name}": _MATRIX for name in ("mf", "mf_operator", "fd", "fd_color")}
# Kinds that work: on a dense matrix on one process, or on one that is a product only, without that of its transpose
_LINEAR = (
    *("preonly", "none", "richardson", "chebyshev", "gmres", "fgmres", "lgmres", "dgmres", "pgmres", "pipefgmres"),
    *("gcr", "pipegcr", "bcgs", "fbcgs", "fbcgsr", "bcgsl", "qmrcgs", "tfqmr", "tcqmr", "cgs", "cg", "fcg", "cr"),
    *("minres", "symmlq"),
)
_NEWTON = ("newtonls", "newtontr", "newtontrdc", "vinewtonrsls", "vinewtonssls", "ksponly", "python")
_KINDS = {
    "ewr_ksp_type": _LINEAR,
    "ewr_inexact_ksp_type": _LINEAR,
    "ewr_pc_type": ("lu", "qr", "svd", "none", "bjacobi", "gasm", "ilu", "jacobi", "ksp", "mat", "redundant"),
    "ewr_inexact_pc_type": ("none", "mat"),
    "ewr_snes_type": (*_NEWTON, "anderson", "fas", "ms", "ncg", "ngmres", "nrichardson", "qn"),
    "mat_type": ("aij",),  # dolfinx asks for it; others end in PETSc's errors, or in crashes
}
_STEPS = "ewr_snes_max_it"


def check_options() -> None:
    """Has solvers with the package's prefixes take their options, sets the linear ones up, and throws them away.

    Options that they take still count as asked for by nobody, until a solver of the work does.

    Raises:
        OptionError: PETSc refuses one, or it is known not to work here.
    """
    options, given = PETSc.Options(), _list_options()
    try:
        snes, inexact = PETSc.SNES().create(PETSc.COMM_SELF), PETSc.KSP().create(PETSc.COMM_SELF)
        exact = snes.getKSP()
        exact.setType(PETSc.KSP.Type.PREONLY)
        exact.getPC().setType(PETSc.PC.Type.LU)
        inexact.setPCSide(PETSc.PC.Side.RIGHT)
        inexact.getPC().setType(PETSc.PC.Type.NONE)
        for solver, prefix in ((snes, "ewr_"), (inexact, "ewr_inexact_")):
            solver.setOptionsPrefix(prefix)
            solver.setFromOptions()
        for name, value in given.items():
            _check_option(name, value)
        for solver in (exact, inexact):
            _set_up(solver)
        snes.destroy()
        inexact.destroy()
    except PETSc.Error as error:
        shown = " ".join(f"-{name}" if value is None else f"-{name} {value}" for name, value in given.items())
        why = str(error).rstrip().splitlines()[-1].split("] ", 1)[-1]
        raise OptionError(f"PETSc refuses an option: {why.strip()}; options given: {shown}") from error
    finally:
        for name, value in given.items():
            options.delValue(name)
            options.setValue(name, value)


def _set_up(ksp: PETSc.KSP) -> None:
    """Sets a linear solver up, on a small matrix: PETSc refuses no sooner what does not go together.

    Raises:
        PETSc.Error: Kinds, their parts or sides do not.
    """
    matrix = PETSc.Mat().createDense((2, 2), comm=PETSc.COMM_SELF)
    matrix.setUp()
    matrix.shift(1.0)
    ksp.setOperators(matrix)
    ksp.setUp()
    ksp.setUpOnBlocks()
    matrix.destroy()


def _check_option(name: str, value: str | None) -> None:
    """Refuses an option that PETSc takes and that does not work with the package's solvers.

    Raises:
        OptionError: With what to do instead.
    """
    if name in _REMEDIES:
        raise OptionError(f"-{name} does not work here: {_REMEDIES[name]}")
    if name in _KINDS and value not in _KINDS[name]:
        known = ", ".join(_KINDS[name])
        raise OptionError(f"-{name} {value} does not work here; choose one of {known}, or leave it out")
    if name == _STEPS and value is not None and PETSc.Options().getInt(name) < 0:
        raise OptionError(f"-{name} {value} does not work here; give a number of Newton steps, 0 or more")


def _list_options() -> dict[str, str | None]:
    """Options that are looked at here, from wherever PETSc has them; None is no value.

    Raises:
        OptionError: Some are not UTF-8, as which petsc4py reads all of them.
    """
    options = PETSc.Options()
    try:
        known = options.getAll()
    except UnicodeDecodeError as error:
        shown = error.object.decode(errors="backslashreplace").strip()
        raise OptionError(f"options for PETSc are not UTF-8: {shown}; see PETSC_OPTIONS and .petscrc") from error
    names = {name: value for name, value in known.items() if name.startswith("ewr_") or name in _KINDS}
    return {name: None if value is None else options.getString(name) for name, value in names.items()}
