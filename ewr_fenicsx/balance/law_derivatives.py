"""Derivatives of the contact laws: sample by sample, as the laws give them, and projected on the harmonics.

Projected, a derivative is a small dense matrix a pair, on the real Fourier coefficients of a force or a motion. All
derivatives of a law's rows by the same forces or motions (by displacements, velocities and what is remembered of both)
add up to one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.law_kinds import Variable
from ewr_fenicsx.problem.harmonics import FourierBasis


@dataclass(frozen=True, eq=False)
class Derivative:
    """Derivative of one law's rows by one variable at the columns paired with them."""

    rows: np.ndarray  # (K,)
    columns: np.ndarray  # (K,)
    variable: Variable
    values: RealArray  # (n_t, K)
    since: np.ndarray | None = None  # (n_t, K) sample of which value times variable counts, -1: none; None: its own
    kept: np.ndarray | None = None  # (n_t, K) share of a momentum that is kept, as in Partial

    @property
    def by_force(self) -> bool:
        """By a force or its rate, else by a motion."""
        return self.variable in ("force", "force_rate")

    @property
    def rates(self) -> int:
        """How often the force or motion is differentiated in time."""
        return {"velocity": 1, "force_rate": 1, "acceleration": 2}.get(self.variable, 0)

    @property
    def remembers(self) -> bool:
        """Whether it reaches back to other samples."""
        return self.since is not None or self.kept is not None

    @property
    def blind_to_mean(self) -> bool:
        """By a motion without its mean."""
        return self.variable in ("velocity", "oscillation", "acceleration")

    @cached_property
    def changes(self) -> np.ndarray:
        """``(K,)`` whether the derivative differs from sample to sample, or reaches back to another."""
        if self.since is not None:
            return np.any(self.since >= 0, axis=0)
        if self.kept is not None:
            return np.any(self.values != 0, axis=0)
        return np.any(self.values != self.values[0], axis=0)

    @property
    def constant(self) -> RealArray:
        """``(K,)`` its value where it does not change: none where it reaches back, but to nothing."""
        return np.zeros(self.rows.size) if self.remembers else self.values[0]


def find_steady(derivatives: Sequence[Derivative], rows: int) -> np.ndarray:
    """Which of so many rows have the same derivatives at every sample, ``(m,)``."""
    steady = np.ones(rows, dtype=bool)
    for d in derivatives:
        steady[d.rows[d.changes]] = False
    return steady


@dataclass(frozen=True, eq=False)
class ProjectedDerivative:
    """Derivative of one law's projected rows by the coefficients of what is at the columns paired with them."""

    rows: np.ndarray  # (K,)
    columns: np.ndarray  # (K,)
    by_force: bool
    matrices: RealArray  # (K, n_c, n_c)


def project_derivatives(
    derivatives: Sequence[Derivative], basis: FourierBasis, omega: float, static_row: RealArray, springs: RealArray
) -> list[ProjectedDerivative]:
    """One projected derivative for all by the same forces or motions.

    Args:
        derivatives: Of all laws.
        basis: The harmonics.
        omega: Angular frequency of the first harmonic [rad/s].
        static_row: ``(m,)`` weight of each row's mean equation.
        springs: ``(m,)`` derivative of each row's mean equation by its own mean motion, besides the law's [N/m].
    """
    sums: dict[tuple[bool, bytes, bytes], ProjectedDerivative] = {}
    for d, matrices in zip(derivatives, _project_products(derivatives, basis), strict=True):
        for _ in range(d.rates):
            matrices = basis.differentiate_columns(matrices, omega)
        if d.blind_to_mean and basis.has_mean:
            matrices[:, :, 0] = 0.0
        if basis.has_mean:
            matrices[:, 0] *= static_row[d.rows, None]
        same = d.by_force, d.rows.tobytes(), d.columns.tobytes()
        if same in sums:
            sums[same].matrices[:] += matrices
        else:
            sums[same] = ProjectedDerivative(d.rows, d.columns, d.by_force, matrices)
    for d in sums.values():
        if basis.has_mean and not d.by_force:
            d.matrices[:, 0, 0] += springs[d.rows] * (d.rows == d.columns)
    return list(sums.values())


def _project_products(derivatives: Sequence[Derivative], basis: FourierBasis) -> Iterator[RealArray]:
    """``(K, n_c, n_c)`` of each derivative: "multiply by it, then project". What changes over time is done at once."""
    changing = [d.values[:, d.changes] for d in derivatives if not d.remembers]
    products = basis.multiplication(np.concatenate([np.zeros((basis.samples, 0)), *changing], axis=1))
    first, order = 0, np.arange(basis.coefficients)
    for d in derivatives:
        matrices = np.zeros((d.rows.size, order.size, order.size))
        if not d.remembers:
            last = first + np.count_nonzero(d.changes)
            matrices[:, order, order] = d.values[0][:, None]
            matrices[d.changes] = products[first:last]
            first = last
        elif d.since is not None:
            matrices[d.changes] = basis.recollection(d.values[:, d.changes], d.since[:, d.changes])
        else:
            matrices[d.changes] = basis.accumulation(d.values[:, d.changes], d.kept[:, d.changes])
        yield matrices
