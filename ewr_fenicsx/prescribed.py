"""Prescribed normal force: a load on both bodies. It costs no unknown and knows no gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.law_kinds import ComplexArray, LawKind, MeanBound, RealArray, register_law


@register_law("normal", "prescribed")
@dataclass(frozen=True, eq=False)
class Prescribed(LawKind):
    """A given normal force.

    Args:
        normal_force: [N], scalar or ``(K,)``, or harmonic -> such amplitudes (complex). Presses where positive.

    Raises:
        ModelError: The mean force pulls the bodies apart, is complex or not finite.
    """

    normal_force: float | RealArray | Mapping[int, float | ComplexArray] = 0.0
    histories = ("normal_force",)
    effect = "prescribed preload"
    odd = blind_to_mean = True

    def __post_init__(self) -> None:
        mean = np.asarray(self._mean)
        if np.any(np.imag(mean) != 0) or not np.all(np.isfinite(mean)) or np.any(np.real(mean) < 0):
            raise ModelError(
                f"normal_force has the mean {self._mean}; it must be real, finite and not negative: positive presses "
                "the bodies together"
            )

    @property
    def _mean(self) -> float | RealArray:
        return self.normal_force.get(0, 0.0) if isinstance(self.normal_force, Mapping) else self.normal_force

    def give_force(self, count: int) -> Mapping[int, ComplexArray]:
        given = self.normal_force if isinstance(self.normal_force, Mapping) else {0: self.normal_force}
        return {int(h): np.broadcast_to(np.asarray(a), (count,)) for h, a in given.items()}

    def bound_mean(self, spread) -> MeanBound:
        given = spread(np.real(self._mean))
        return MeanBound(given, given)
