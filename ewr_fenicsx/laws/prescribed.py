"""Prescribed normal force: a load on both bodies. It costs no unknown and knows no gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.given import ComplexArray, RealArray, read_harmonic, read_numbers
from ewr_fenicsx.laws.law_kinds import LawKind, MeanBound, register_law


@register_law("normal", "prescribed")
@dataclass(frozen=True, eq=False)
class Prescribed(LawKind):
    """A given normal force.

    Args:
        normal_force: [N], scalar or ``(K,)``, or harmonic -> such amplitudes (complex). Presses where positive.

    Raises:
        ModelError: Not numbers by harmonics, not finite; or the mean force pulls the bodies apart or is complex.
    """

    normal_force: float | RealArray | Mapping[int, float | ComplexArray] = 0.0
    histories = ("normal_force",)
    effect = "prescribed preload"
    odd = blind_to_mean = True

    def __post_init__(self) -> None:
        for h, amplitude in self._by_harmonic.items():
            read_harmonic("normal_force", h)
            if not np.all(np.isfinite(read_numbers(f"normal_force[{h}]", amplitude, complex))):
                raise ModelError(f"normal_force has the amplitude {amplitude} at harmonic {h}; it must be finite")
        mean = np.asarray(self._mean)
        if np.any(np.imag(mean) != 0) or np.any(np.real(mean) < 0):
            raise ModelError(
                f"normal_force has the mean {self._mean}; it must be real, finite and not negative: positive presses "
                "the bodies together"
            )

    @property
    def _by_harmonic(self) -> Mapping[int, float | ComplexArray]:
        return self.normal_force if isinstance(self.normal_force, Mapping) else {0: self.normal_force}

    @property
    def _mean(self) -> float | RealArray:
        return self._by_harmonic.get(0, 0.0)

    def give_force(self, spread) -> Mapping[int, ComplexArray]:
        return {int(h): spread(amplitude) for h, amplitude in self._by_harmonic.items()}

    def bound_mean(self, spread) -> MeanBound:
        given = spread(np.real(self._mean))
        return MeanBound(given, given)
