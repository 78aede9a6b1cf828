"""What the laws make of a solution: which histories mean something, the friction limit, and open, stick or slip."""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.balance.periodic_motion import SECOND, PeriodicMotion
from ewr_fenicsx.given import RealArray
from ewr_fenicsx.problem.harmonics import FourierBasis
from ewr_fenicsx.solution.solution import PeriodicSolution

OPEN, STICK, SLIP = 0, 1, 2


def list_histories(solution: PeriodicSolution) -> tuple[str, ...]:
    """Names of the histories that the laws of a solution call for; the others are zero by construction."""
    called = {name for _, laws in solution.problem.groups for kind in laws.kinds for name in kind.histories}
    called |= {SECOND + name for name in called}
    return tuple(name for name in solution.histories if name in called)


def find_pairs_with(solution: PeriodicSolution, name: str) -> np.ndarray:
    """``(K_c,)`` at which pairs a history means something: where a law calls for it."""
    found = np.zeros(solution.problem.model.pairs, dtype=bool)
    for pairs, laws in solution.problem.groups:
        found[pairs] = any(name in kind.histories for kind in laws.kinds)
    return found


def list_figures(solution: PeriodicSolution) -> tuple[str, ...]:
    """Names of the figures of merit that the laws of a solution call for; the others are zero by construction."""
    histories = list_histories(solution)
    calls = {
        "largest_normal_force": "normal_force",
        "penetration": "gap",
        "tension": "gap",
        "J_N": "gap",
        "J_T": "slip",
        "cone_violation": "admissible_friction_force",
        "friction_dissipation": "admissible_friction_force",
    }
    return tuple(name for name in solution.merit if name not in calls or calls[name] in histories)


def changes_state(solution: PeriodicSolution) -> bool:
    """Whether some pair may open or slip."""
    return bool({"gap", "slip"} & set(list_histories(solution)))


def sample_along_tangents(motion: PeriodicMotion, name: str, samples: int) -> RealArray:
    """A tangential history of a solution or steady state along each tangent, ``(1 or 2, samples, K_c)``."""
    names = (name, SECOND + name) if motion.problem.model.tangents == 2 else (name,)
    return np.array([motion.history(along, samples) for along in names])


def sample_friction_limit(solution: PeriodicSolution, samples: int) -> RealArray:
    """``mu max(0, lam_N)`` over one period, ``(samples, K_c)`` [N]; zero for pairs without Coulomb friction."""
    return solution.problem.friction * np.maximum(0.0, solution.history("normal_force", samples))


def classify_contact(solution: PeriodicSolution, samples: int) -> np.ndarray:
    """OPEN, STICK or SLIP for every pair over one period, ``(samples, K_c)`` int.

    The decisions are those of the laws themselves at the samples. Where no law decides, pairs stick when bonded and
    slip when frictionless.
    """
    basis = FourierBasis(solution.orders, samples)
    decided = solution.law_fields(basis)
    state = np.where(solution.find_slipping(basis, decided), SLIP, STICK)
    for law, fields in decided:
        if "open" in fields:  # a pair that is open does nothing else
            state[:, law.pairs] = np.where(fields["open"], OPEN, state[:, law.pairs])
    return state
