"""A contact system: only the rows, laws and unknowns that a contact problem calls for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ewr_fenicsx.given import ComplexArray, RealArray
from ewr_fenicsx.laws.law_kinds import Law
from ewr_fenicsx.model.compliance import DynamicCompliance
from ewr_fenicsx.problem.harmonics import FourierBasis, select_basis
from ewr_fenicsx.problem.layout import Layout


@dataclass(frozen=True, eq=False)
class ContactSystem(Layout):
    """What a problem calls for, and no more: the rows of its joint, and what they need.

    Attributes:
        load: Harmonic -> ``(n',)`` amplitudes with the prescribed normal forces included [N].
        prescribed: Harmonic -> ``(K_c,)`` amplitudes of the normal forces that are given, zero at other pairs [N].
        laws: The laws; each row belongs to exactly one.
        flexibility: ``(m,)`` flexibility of each row, the unit of its weights [m/N].
        basis: Fourier basis.
        compliance: Dynamic compliance of the rows.
    """

    load: Mapping[int, ComplexArray]
    prescribed: Mapping[int, ComplexArray]
    laws: tuple[Law, ...]
    flexibility: RealArray
    basis: FourierBasis
    compliance: DynamicCompliance

    @property
    def closures(self) -> tuple[str, ...]:
        """What closes the truncation at any pair, but for weights: ``"masses"``, ``"springs"``, both or neither."""
        return tuple(sorted({law.closes for law in self.laws} - {""}))

    @property
    def stick_flexibility(self) -> RealArray:
        """``(m,)`` how much the law of each row gives way by itself before it slips or opens [m/N]."""
        own = np.zeros(len(self.rows))
        for law in self.laws:
            own[self.row_of(law.direction, law.pairs)] = law.stick_flexibility
        return own

    @property
    def highest_given(self) -> int:
        """The highest harmonic of normal forces that are given, which samples have to tell as well; 0 without any."""
        return max(self.prescribed, default=0)

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
