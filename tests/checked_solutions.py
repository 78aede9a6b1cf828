"""What tests ask of solutions, and of curves of them."""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solution.solution import PeriodicSolution


def measure_residual(solution: PeriodicSolution) -> float:
    """Norm of the residual that its problem's balance leaves, evaluated anew."""
    balance = HarmonicBalance(solution.problem.system)
    return float(np.linalg.norm(balance.residual(balance.pack(solution.forces, solution.rigid))))


def find_turns(frequencies: np.ndarray) -> np.ndarray:
    """Where a curve turns round: the points with the highest and the lowest frequencies of its folds."""
    return np.flatnonzero(np.diff(np.sign(np.diff(frequencies)))) + 1
