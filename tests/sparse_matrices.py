"""PETSc's matrices as scipy's."""

from __future__ import annotations

import scipy.sparse
from petsc4py import PETSc


def to_scipy(matrix: PETSc.Mat) -> scipy.sparse.csr_matrix:
    rows, columns, values = matrix.getValuesCSR()
    return scipy.sparse.csr_matrix((values, columns, rows), shape=matrix.getSize())
