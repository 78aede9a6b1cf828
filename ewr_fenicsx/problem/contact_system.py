"""A contact system: only the rows, laws and unknowns that a contact problem calls for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.law_kinds import Law
from ewr_fenicsx.model.compliance import DynamicCompliance
from ewr_fenicsx.model.reduced_model import ReducedModel
from ewr_fenicsx.problem.harmonics import FourierBasis, select_basis
from ewr_fenicsx.problem.layout import Layout


@dataclass(frozen=True, eq=False)
class ContactSystem:
    """What a problem calls for, and no more.

    Attributes:
        layout: Rows and the model that they belong to.
        load: Harmonic -> ``(n',)`` amplitudes with the prescribed normal forces included [N].
        prescribed: Harmonic -> ``(K_c,)`` amplitudes of the normal forces that are given, zero at other pairs [N].
        laws: The laws; each row belongs to exactly one.
        flexibility: ``(m,)`` flexibility of each row, the unit of its weights [m/N].
        basis: Fourier basis.
        compliance: Dynamic compliance of the rows.
    """

    layout: Layout
    load: Mapping[int, ComplexArray]
    prescribed: Mapping[int, ComplexArray]
    laws: tuple[Law, ...]
    flexibility: RealArray
    basis: FourierBasis
    compliance: DynamicCompliance

    @property
    def model(self) -> ReducedModel:
        """The model with bonded rows projected out."""
        return self.layout.model

    @property
    def expansion(self) -> RealArray:
        """``(n, n')`` from its coordinates to those of the problem's model."""
        return self.layout.expansion

    @property
    def rows(self) -> RealArray:
        """``(m, n')`` contact rows that carry an unknown force."""
        return self.layout.rows

    @property
    def index(self) -> Mapping[str, np.ndarray]:
        """Direction -> ``(K_c,)`` row of each pair, -1 where it has none."""
        return self.layout.index

    @property
    def closures(self) -> tuple[str, ...]:
        """What closes the truncation at any pair, but for weights: ``"masses"``, ``"springs"``, both or neither."""
        return tuple(sorted({law.closes for law in self.laws} - {""}))

    @property
    def highest_given(self) -> int:
        """The highest harmonic of normal forces that are given, which samples have to tell as well; 0 without any."""
        return max(self.prescribed, default=0)

    def row_of(self, direction: str, pairs: np.ndarray) -> np.ndarray:
        """Row of each of ``pairs`` in a direction, -1 where no unknown force acts in it."""
        return self.layout.row_of(direction, pairs)

    def rows_of(self, pairs: np.ndarray) -> dict[str, np.ndarray]:
        """Direction -> row of each of ``pairs``, for directions in which an unknown force acts at all of them."""
        return self.layout.rows_of(pairs)

    def restrict(self, orders: tuple[int, ...]) -> ContactSystem:
        """The same system with fewer harmonics; nothing is computed anew."""
        keep = [self.basis.orders.index(h) for h in orders]
        compliance = replace(
            self.compliance,
            flexibility=self.compliance.flexibility[keep],
            free_motion=self.compliance.free_motion[keep],
            outputs={name: rows[keep] for name, rows in self.compliance.outputs.items()},
        )
        needed = max(select_basis(orders).samples, 2 * self.highest_given + 1)
        samples = min(self.basis.samples, needed)
        return replace(self, basis=FourierBasis(orders, samples), compliance=compliance)

    def sample(self, samples: int) -> ContactSystem:
        """The same system with its laws seen at so many samples a period."""
        return replace(self, basis=replace(self.basis, samples=samples))
