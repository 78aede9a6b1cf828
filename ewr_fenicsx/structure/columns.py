"""Direct solves with sparse matrices; dense columns beside them, many at once, so that matrices are read but once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

_BLOCK = 32  # columns at once; more take more memory, and little less time


def factorise(matrix: PETSc.Mat) -> Callable[[np.ndarray], np.ndarray]:
    """Factorises a matrix; returns ``X = matrix^-1 F`` as a function of ``F (rows, k)``, this rank's rows.

    Raises:
        MemoryError: The factors do not fit into memory.
    """
    solver = PETSc.KSP().create(matrix.comm)
    solver.setOperators(matrix)
    use_mumps(solver)
    with finding_memory(matrix.getSize()[0]):
        solver.setUp()
    factors = solver.getPC().getFactorMatrix()

    def solve(forces: np.ndarray) -> np.ndarray:
        responses = np.empty_like(forces, order="F")
        if forces.shape[1]:
            with _wrap(matrix, forces) as right, _wrap(matrix, responses) as found:
                factors.matSolve(right, found)
        return responses

    return solve


def use_mumps(solver: PETSc.KSP) -> None:
    """Makes a Krylov solver a direct one."""
    solver.setType(PETSc.KSP.Type.PREONLY)
    solver.getPC().setType(PETSc.PC.Type.LU)
    solver.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)


@contextmanager
def finding_memory(size: int) -> Iterator[None]:
    """Around a factorisation of ``size`` rows: tells a lack of memory from a singular matrix.

    Raises:
        MemoryError: MUMPS could not allocate what it needs.
    """
    try:
        yield
    except PETSc.Error as error:
        if "INFOG(1)=-13" in str(error):
            raise MemoryError(f"the factors of a matrix of {size} rows do not fit") from error
        raise


def multiply(matrix: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Distributed sparse matrix times this rank's rows of dense columns."""
    with _wrap(matrix, columns) as right:
        product = matrix.matMult(right)
        array = product.getDenseArray().copy(order="F")
        product.destroy()
    return array


@contextmanager
def _wrap(matrix: PETSc.Mat, columns: np.ndarray) -> Iterator[PETSc.Mat]:
    """This rank's rows of dense columns as PETSc takes them, distributed like the columns of a square matrix."""
    size = (matrix.getSizes()[1], (None, columns.shape[1]))
    dense = PETSc.Mat().createDense(size, array=np.asfortranarray(columns), comm=matrix.comm)
    dense.assemble()
    yield dense
    dense.destroy()


def stack_columns(vectors: Iterable[np.ndarray], rows: int) -> np.ndarray:
    """Vectors side by side, ``(rows, k)``; k may be zero."""
    return np.array([*vectors]).reshape(-1, rows).T


def blocks(count: int) -> Iterator[slice]:
    """Ranges of at most ``_BLOCK`` columns."""
    return (slice(start, min(start + _BLOCK, count)) for start in range(0, count, _BLOCK))
