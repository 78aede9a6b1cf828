"""Floating bodies that nothing presses: where they lie is open."""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.balance.periodic_motion import PeriodicMotion
from ewr_fenicsx.errors import name_pairs
from ewr_fenicsx.problem.composition import list_unpressed

UNTOUCHED = 1e-6  # normal force over the largest, below which a solution may have none


def tell_unpressed(motion: PeriodicMotion) -> list[str]:
    """A line where the bodies may lie anywhere, since nothing presses their pairs."""
    normal = np.abs(motion.pair_forces["normal"]).max(axis=0, initial=0.0)
    pressed = normal > UNTOUCHED * normal.max(initial=0.0)
    if not motion.rigid.size or np.all(pressed):
        return []
    if not (loose := list_unpressed(motion.problem, motion.problem.system, pressed)):
        return []
    return [
        f"nothing presses {name_pairs(loose)}: the bodies that float on them may lie anywhere that they do not touch"
    ]
