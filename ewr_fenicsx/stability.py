"""What the sign of the Jacobian's determinant tells of a periodic solution: the side of the folds, and instability.

Along a branch the sign changes at every simple fold, where a real Floquet multiplier crosses one, and else only where
branches cross. High harmonics enter the determinant as a complex number a row, that is by a square: solutions with more
and fewer of them can be compared. Each rigid coordinate turns it once, as the multiplier of a constraint does.

Source: Seydel (2010), Practical Bifurcation and Stability Analysis, doi:10.1007/978-1-4419-1740-9.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.given import RealArray

MOST_UNKNOWNS = 3000  # of a Jacobian whose determinant is looked at: seconds
SINGULAR = 1e-12  # smallest pivot over the largest, below which rounding decides the sign: redundant pairs


def find_side(balance: HarmonicBalance, unknowns: RealArray) -> int:
    """Side of the folds that a solution is on.

    Args:
        balance: The balance.
        unknowns: Its solution, scaled, ``(size,)``.

    Returns:
        -1: an odd number of real Floquet multipliers are above one, and the solution is unstable. 1: an even number of
        them is, mostly none; it may be unstable in other ways. 0: there are too many unknowns to look, or the Jacobian
        is singular.
    """
    if balance.size > MOST_UNKNOWNS:
        return 0
    lu, rows, _ = scipy.linalg.lapack.dgetrf(balance.linearise(unknowns).matrix())
    pivots = np.diagonal(lu)
    if np.abs(pivots).min() <= SINGULAR * np.abs(pivots).max():
        return 0
    turned = np.count_nonzero(pivots < 0) + np.count_nonzero(rows != np.arange(rows.size)) + balance.rigid
    return (-1) ** int(turned)
