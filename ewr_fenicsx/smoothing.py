"""Contact laws with rounded corners, to walk to a solution that Newton does not find on the sharp ones.

``max(0, x)`` becomes ``(x + sqrt(x^2 + e^2)) / 2`` and ``|x|`` becomes ``sqrt(x^2 + e^2)``: both continuously
differentiable, and the exact law as the width ``e`` goes to zero. Solutions on rounded laws are starts only; none of
them is ever returned.

Source: Chen & Mangasarian (1996), doi:10.1007/BF00249052.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ewr_fenicsx.contact_laws import Coulomb, Law, Motion, Partial, Response, Signorini
from ewr_fenicsx.contact_problem import ContactSystem
from ewr_fenicsx.reduced_model import RealArray


def round_corners(system: ContactSystem, width: float) -> ContactSystem:
    """The same system with its unilateral and friction laws rounded over forces of about ``width`` [N]."""
    rounded = {Signorini: RoundedSignorini, Coulomb: RoundedCoulomb}
    laws = tuple(rounded[type(law)](law, width) if type(law) in rounded else law for law in system.laws)
    return replace(system, laws=laws)


@dataclass(frozen=True, eq=False)
class _Rounded:
    """A law that differs from the exact one only in ``evaluate``."""

    exact: Law
    width: float

    def __getattr__(self, name: str):
        return getattr(self.exact, name)


class RoundedSignorini(_Rounded):
    """``lam_N - max(0, lam_N - rho g) = 0``, rounded."""

    def evaluate(self, motion: Motion) -> Response:
        """Residual and derivatives at every sample."""
        law, force = self.exact, motion.force["normal"]
        pressing = force - law.rho * (motion.displacement["normal"] + law.initial_gap)
        value, slope = round_positive_part(pressing, self.width)
        return Response(
            force - value,
            (Partial("force", "normal", 1 - slope), Partial("displacement", "normal", law.rho * slope)),
        )


class RoundedCoulomb(_Rounded):
    """``lam_T - clip(lam_T - v / rho, -mu c, mu c) = 0`` with ``c = max(0, lam_N)``, both rounded."""

    def evaluate(self, motion: Motion) -> Response:
        """Residual and derivatives at every sample."""
        law, force = self.exact, motion.force["tangential"]
        cone, opening = round_positive_part(motion.force["normal"], self.width)
        trial, limit = force - motion.velocity["tangential"] / law.rho, law.friction * cone
        above, below = np.hypot(trial + limit, self.width), np.hypot(trial - limit, self.width)
        # clip(x, -a, a) = (|x + a| - |x - a|) / 2
        by_trial = 0.5 * ((trial + limit) / above - (trial - limit) / below)
        by_limit = 0.5 * ((trial + limit) / above + (trial - limit) / below)
        return Response(
            force - 0.5 * (above - below),
            (
                Partial("force", "tangential", 1 - by_trial),
                Partial("velocity", "tangential", by_trial / law.rho),
                Partial("force", "normal", -by_limit * law.friction * opening),
            ),
        )


def round_positive_part(x: RealArray, width: float) -> tuple[RealArray, RealArray]:
    """``max(0, x)`` with a rounded corner of a positive width, and its slope."""
    radius = np.hypot(x, width)
    return 0.5 * (x + radius), 0.5 * (1 + x / radius)
