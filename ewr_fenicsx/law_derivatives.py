"""Derivatives of the contact laws: sample by sample, as the laws give them, and projected on the harmonics.

Projected, a derivative is a small dense matrix a pair, on the real Fourier coefficients of a force or a motion. All
derivatives of a law's rows by the same forces or motions (by displacements, velocities and what is remembered of both)
add up to one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.harmonics import FourierBasis
from ewr_fenicsx.law_kinds import Variable
from ewr_fenicsx.reduced_model import RealArray


@dataclass(frozen=True, eq=False)
class Derivative:
    """Derivative of one law's rows by one variable at the columns paired with them."""

    rows: np.ndarray  # (K,)
    columns: np.ndarray  # (K,)
    variable: Variable
    values: RealArray  # (n_t, K)
    since: np.ndarray | None = None  # (n_t, K) sample of which value times variable counts, -1: none; None: its own

    @property
    def by_force(self) -> bool:
        """By a force or its rate, else by a motion."""
        return self.variable in ("force", "force_rate")

    @property
    def by_rate(self) -> bool:
        """By a derivative in time."""
        return self.variable in ("velocity", "force_rate")

    @property
    def blind_to_mean(self) -> bool:
        """By a motion without its mean."""
        return self.variable in ("velocity", "oscillation")

    @property
    def changes(self) -> np.ndarray:
        """``(K,)`` whether the derivative differs from sample to sample, or reaches back to another."""
        if self.since is not None:
            return np.any(self.since >= 0, axis=0)
        return np.any(self.values != self.values[0], axis=0)

    def project(self, basis: FourierBasis, omega: float) -> RealArray:
        """``(K, n_c, n_c)`` matrices on the coefficients of the forces or motions at ``columns``."""
        changes, n_c = self.changes, basis.coefficients
        matrices = np.zeros((self.rows.size, n_c, n_c))
        if self.since is None:
            matrices[:, np.arange(n_c), np.arange(n_c)] = self.values[0][:, None]
            matrices[changes] = basis.multiplication(self.values[:, changes])
        else:
            matrices[changes] = basis.recollection(self.values[:, changes], self.since[:, changes])
        if self.by_rate:
            return basis.differentiate_columns(matrices, omega)
        if self.blind_to_mean and basis.has_mean:
            matrices[:, :, 0] = 0.0
        return matrices


@dataclass(frozen=True, eq=False)
class ProjectedDerivative:
    """Derivative of one law's projected rows by the coefficients of what is at the columns paired with them."""

    rows: np.ndarray  # (K,)
    columns: np.ndarray  # (K,)
    by_force: bool
    matrices: RealArray  # (K, n_c, n_c)


def project_derivatives(
    derivatives: Sequence[Derivative], basis: FourierBasis, omega: float, static_row: RealArray
) -> list[ProjectedDerivative]:
    """One projected derivative for all by the same forces or motions.

    Args:
        derivatives: Of all laws.
        basis: The harmonics.
        omega: Angular frequency of the first harmonic [rad/s].
        static_row: ``(m,)`` weight of each row's mean equation.
    """
    sums: dict[tuple[bool, bytes, bytes], ProjectedDerivative] = {}
    for d in derivatives:
        matrices = d.project(basis, omega)
        if basis.has_mean:
            matrices[:, 0] *= static_row[d.rows, None]
        same = d.by_force, d.rows.tobytes(), d.columns.tobytes()
        if same in sums:
            sums[same].matrices[:] += matrices
        else:
            sums[same] = ProjectedDerivative(d.rows, d.columns, d.by_force, matrices)
    return list(sums.values())
