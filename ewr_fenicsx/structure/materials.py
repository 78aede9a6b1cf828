"""Elastic materials, and the ways to state damping."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ewr_fenicsx.errors import SceneError


@dataclass(frozen=True)
class Material:
    """An isotropic elastic material: ``young`` [Pa], ``poisson``, ``density`` [kg/m^3].

    Raises:
        SceneError: A value out of its range.
    """

    young: float
    poisson: float
    density: float

    def __post_init__(self) -> None:
        for name in ("young", "density"):
            if not getattr(self, name) > 0:
                raise SceneError(f"material: {name} is {getattr(self, name)}; give a positive number")
        if not -1 < self.poisson < 0.5:
            raise SceneError(f"material: poisson is {self.poisson}; give a number between -1 and 0.5")


TITANIUM = Material(113.8e9, 0.342, 4430.0)  # Ti-6Al-4V


@dataclass(frozen=True)
class Rayleigh:
    """``D = alpha M + beta K``; ``alpha`` [1/s], ``beta`` [s].

    Raises:
        SceneError: One of them is negative.
    """

    alpha: float = 0.0
    beta: float = 0.0

    def __post_init__(self) -> None:
        if self.alpha < 0 or self.beta < 0:
            raise SceneError(
                f"damping: alpha = {self.alpha} 1/s and beta = {self.beta} s; neither may be negative, "
                "or some mode would gain energy"
            )


@dataclass(frozen=True)
class RayleighRatios:
    """Rayleigh damping with the given ratio of critical damping at two frequencies [Hz]."""

    frequencies: tuple[float, float]
    ratios: tuple[float, float]

    def rayleigh(self) -> Rayleigh:
        """The coefficients: ``ratio = alpha / (2 omega) + beta omega / 2`` at both frequencies.

        Raises:
            SceneError: Frequencies not positive and distinct, or ratios so far apart that a coefficient is negative.
        """
        first, second = self.frequencies
        if not (first > 0 and second > 0 and first != second):
            raise SceneError(f"damping: frequencies are {first} Hz and {second} Hz; give two different positive ones")
        omega = 2 * math.pi * np.array(self.frequencies)
        alpha, beta = np.linalg.solve(np.column_stack([1 / (2 * omega), omega / 2]), np.array(self.ratios))
        # equal products or quotients give exact zeros that round-off may push below
        alpha, beta = (
            0.0 if abs(c) < 1e-14 * s else float(c) for c, s in ((alpha, omega.max()), (beta, 1 / omega.min()))
        )
        if alpha < 0 or beta < 0:
            low, high = sorted((first / second, second / first))
            raise SceneError(
                f"damping: ratios {self.ratios} at {self.frequencies} Hz give alpha = {alpha:.3g} 1/s, "
                f"beta = {beta:.3g} s; the second ratio over the first must lie between {low:.3g} and "
                f"{high:.3g} for both to be non-negative"
            )
        return Rayleigh(alpha, beta)


@dataclass(frozen=True)
class PerMode:
    """The same ``ratio`` of critical damping for each mode of the reduced model with its joint open.

    So have, where the joint holds bodies that float without it, as many of the lowest modes of full stick as there are
    rigid motions. Others have somewhat less while the joint is closed. What that takes drags the rigid motions as well,
    where the joint slides far or opens, and gives the open joint's lowest elastic modes up to half as much again.

    Raises:
        SceneError: The ratio is not from 0 to below 1.
    """

    ratio: float

    def __post_init__(self) -> None:
        if not 0 <= self.ratio < 1:
            raise SceneError(f"damping: the ratio per mode is {self.ratio}; give a number from 0 to below 1")


Damping = Rayleigh | RayleighRatios | PerMode
