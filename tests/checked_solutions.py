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


def slide_behind_dashpots(solution: PeriodicSolution, samples: int) -> np.ndarray:
    """Speed ``(samples, K_c)`` of the surfaces behind the dashpots of friction's laws, by its definition [m/s]."""
    model, found = solution.problem.model, []
    rho = np.ones(model.pairs)
    for law in solution.problem.system.laws:
        if law.direction == "tangential":
            rho[law.pairs] = law.rho
    for which in ("", "second_")[: model.tangents]:
        read = lambda name: solution.history(which + name, samples)  # noqa: B023, E731
        found.append(read("slip_velocity") + rho * (read("admissible_friction_force") - read("friction_force")))
    return np.hypot.reduce([np.zeros((samples, model.pairs)), *found])
