"""The mean friction force: what decides it where a pair sticks throughout, and Coulomb's law says nothing of it.

- ``"resolved"``: a small share of the force itself. The pair carries the least that its limits allow, mostly none.
- ``"held"``: a weak spring to where the pair is without any load. It is held there, as if the loads had been put on
  slowly from rest, and carries what that takes; friction at its limit where it would take more.
- ``"zero"``: no pair has any, as in the paper.

Where a pair slips the law decides, and share or spring are next to nothing beside it.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from ewr_fenicsx.given import RealArray
from ewr_fenicsx.laws.law_kinds import PairGroup, choose_friction_weight

StaticFriction = Literal["resolved", "held", "zero"]

# Share of the mean friction force added to its own equation: it decides the mean where a pair sticks throughout. A pair
# that sticks only with a mean creeps by about this share, times rho over the default; at a resonance with little
# damping a creep of a hundredth of a per cent takes a fifth of the amplitude. Less would be what the solve leaves over.
MEAN_FRICTION_REGULARISATION = 1e-7
HANGING = 1e-6  # the same where a body hangs on friction, whose pairs share a load, and rho is at most the default
HELD = 1e-7  # springs that hold pairs in place, over their own stiffness; they let pairs creep in the same way


class MeanEquation(NamedTuple):
    """Weights in the mean equation of some pairs' friction, as ``Law`` has them: of the law, the force, the motion."""

    static_row: float
    static_force_row: RealArray
    static_displacement_row: RealArray

    def of(self, picked: np.ndarray) -> MeanEquation:
        """The same of some of the pairs."""
        return self._replace(
            static_force_row=self.static_force_row[picked], static_displacement_row=self.static_displacement_row[picked]
        )


def choose_mean_equation(group: PairGroup, static_friction: StaticFriction) -> MeanEquation:
    """What decides the mean friction of some pairs; where a body hangs on it, they share it like springs."""
    stiffness = 1 / group.flexibility["tangential"]
    if static_friction == "zero":
        return MeanEquation(0.0, np.ones_like(stiffness), np.zeros_like(stiffness))
    if static_friction == "held":
        return MeanEquation(1.0, np.zeros_like(stiffness), HELD * stiffness)
    omega = 2 * np.pi / group.period if group.period else 1.0
    usual = choose_friction_weight(omega, group.flexibility["tangential"])  # with larger weights pairs creep
    share = HANGING * group.hangs_on_friction * np.minimum(1.0, usual / group.weight["tangential"])
    share = np.maximum(share, MEAN_FRICTION_REGULARISATION)
    return MeanEquation(1.0, share, share * stiffness * group.hangs_on_friction)
