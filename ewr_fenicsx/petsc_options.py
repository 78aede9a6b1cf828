"""Options for PETSc, checked before the work: a solver of the work would meet a wrong one after minutes or hours."""

from __future__ import annotations

from petsc4py import PETSc

from ewr_fenicsx.errors import OptionError

_SOLVERS = ((PETSc.SNES, "ewr_"), (PETSc.KSP, "ewr_inexact_"))  # that take options, and their prefixes


def check_options() -> None:
    """Has solvers with the package's prefixes take their options, and throws them away.

    Options that they take still count as asked for by nobody, until a solver of the work does.

    Raises:
        OptionError: PETSc refuses one.
    """
    options, given = PETSc.Options(), _list_options()
    try:
        for kind, prefix in _SOLVERS:
            solver = kind().create(PETSc.COMM_SELF)
            solver.setOptionsPrefix(prefix)
            solver.setFromOptions()
            solver.destroy()
    except PETSc.Error as error:
        shown = " ".join(f"-{name}" if value is None else f"-{name} {value}" for name, value in given.items())
        why = str(error).rstrip().splitlines()[-1].split("] ", 1)[-1]
        raise OptionError(f"PETSc refuses an option: {why.strip()}; options given: {shown}") from error
    finally:
        for name, value in given.items():
            options.delValue(name)
            options.setValue(name, value)


def _list_options() -> dict[str, str | None]:
    """Options under the package's prefixes, from wherever PETSc has them; None is no value."""
    options = PETSc.Options()
    names = {name: value for name, value in options.getAll().items() if name.startswith("ewr_")}
    return {name: None if value is None else options.getString(name) for name, value in names.items()}
