"""Prescribed normal force: a load on both bodies. It costs no unknown and knows no gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.law_kinds import ComplexArray, LawKind, MeanBound, RealArray, register_law


@register_law("normal", "prescribed")
@dataclass(frozen=True, eq=False)
class Prescribed(LawKind):
    """A given normal force.

    Args:
        normal_force: [N], scalar or ``(K,)``, or harmonic -> such amplitudes (complex).
    """

    normal_force: float | RealArray | Mapping[int, float | ComplexArray] = 0.0
    histories = ("normal_force",)
    effect = "prescribed preload"
    odd = blind_to_mean = True

    def give_force(self, count: int) -> Mapping[int, ComplexArray]:
        given = self.normal_force if isinstance(self.normal_force, Mapping) else {0: self.normal_force}
        return {int(h): np.broadcast_to(np.asarray(a), (count,)) for h, a in given.items()}

    def bound_mean(self, spread) -> MeanBound:
        mean = self.normal_force.get(0, 0.0) if isinstance(self.normal_force, Mapping) else self.normal_force
        given = spread(np.real(mean))
        return MeanBound(given, given)
