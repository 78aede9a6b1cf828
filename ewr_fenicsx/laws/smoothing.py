"""Contact laws with rounded corners, to walk to a solution that Newton does not find on the sharp ones.

``max(0, x)`` becomes ``(x + sqrt(x^2 + e^2)) / 2`` and ``|x|`` becomes ``sqrt(x^2 + e^2)``: both continuously
differentiable, and the exact law as the width ``e`` goes to zero. Solutions on rounded laws are starts only; none of
them is ever returned. Each law says itself what it is with rounded corners.

Source: Chen & Mangasarian (1996), doi:10.1007/BF00249052.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.law_kinds import Law

System = TypeVar("System")


def round_corners(system: System, width: float) -> System:
    """The same system with its ``laws`` rounded over forces of about ``width`` [N]."""
    return replace(system, laws=tuple(law.rounded(width) for law in system.laws))


@dataclass(frozen=True, eq=False)
class Rounded:
    """A law that differs from the ``exact`` one only in ``evaluate``."""

    exact: Law
    width: float
    has_corners = False  # they are round now

    def __getattr__(self, name: str):
        return getattr(self.exact, name)


def round_positive_part(x: RealArray, width: float) -> tuple[RealArray, RealArray]:
    """``max(0, x)`` with a rounded corner of a positive width, and its slope."""
    radius = np.hypot(x, width)
    return 0.5 * (x + radius), 0.5 * (1 + x / radius)


def round_clip(x: RealArray, limit: RealArray, width: float) -> tuple[RealArray, RealArray, RealArray]:
    """``clip(x, -limit, limit) = (|x + limit| - |x - limit|) / 2`` rounded, its slopes by ``x`` and ``limit``."""
    above, below = np.hypot(x + limit, width), np.hypot(x - limit, width)
    by_above, by_below = 0.5 * (x + limit) / above, 0.5 * (x - limit) / below
    return 0.5 * (above - below), by_above - by_below, by_above + by_below
