"""Bodies that hang on friction alone and walk: a little further every cycle, so that no motion is periodic.

Where pairs stick throughout, friction says nothing of the mean force that each of them carries: springs decide
(``static_displacement_row``), so weak that they take next to nothing from the law. Where the pairs slip and friction
cannot carry the mean load, the springs alone would hold the body, drawn out to no end.
"""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.given import RealArray

NOTICED = 1e-2  # share of the largest friction force; bodies that friction holds have 1e-4 or less
DOUBTFUL = 3e-4  # share above which a body that hangs on friction walks slowly, or few harmonics say so
UNSOLVED = 10.0  # times the residual: below, what is left over is the solver's, as where friction has nothing to carry
WALKS = (
    "a body that hangs on friction walks: while its pairs slip, friction does not carry the mean load, and no motion "
    "is periodic; add a support or friction, or take from the load"
)
MAY_WALK = (
    "a body that hangs on friction may walk slowly: friction does not carry all of the mean load, and where the body "
    "is on average means nothing; see what more harmonics change, and whether it moves on in integrate(problem)"
)


def walks(balance: HarmonicBalance, unknowns: RealArray, share: float | None = None) -> bool:
    """Whether springs carry a mean force that friction cannot, at a solution ``(size,)`` of the balance.

    ``share`` of the largest friction force is how much; ``NOTICED`` where none is given.
    """
    share = NOTICED if share is None else share
    held = balance.static_displacement_row > 0
    if not (balance.basis.has_mean and np.any(held)):
        return False
    forces, rigid = balance.unpack(unknowns)
    drawn = balance.compliance.motion(forces[:1], rigid)[0].real
    left_over = balance.static_force_row * forces[0].real + balance.static_displacement_row * drawn  # by the law
    largest = np.abs(balance.basis.synthesise(forces[:, held])).max()
    unsolved = UNSOLVED * np.linalg.norm(balance.residual(unknowns)) * balance.force_unit
    return bool(np.abs(left_over[held]).max() > max(share * largest, unsolved))
