"""What the laws make of a solution: which histories mean something, the friction limit, and open, stick or slip."""

from __future__ import annotations

import numpy as np

from ewr_fenicsx.contact_laws import spread_over_pairs
from ewr_fenicsx.harmonics import FourierBasis
from ewr_fenicsx.reduced_model import RealArray
from ewr_fenicsx.solution import PeriodicSolution

OPEN, STICK, SLIP = 0, 1, 2


def list_histories(solution: PeriodicSolution) -> tuple[str, ...]:
    """Names of the histories that the laws of a solution call for; the others are zero by construction."""
    laws = [laws for _, laws in solution.problem.groups]
    calls = {
        "normal_force": True,
        "friction_force": any(law.tangential != "frictionless" for law in laws),
        "admissible_friction_force": any(law.tangential == "coulomb" for law in laws),
        "gap": any(law.normal == "unilateral" for law in laws),
        "slip": any(law.tangential != "bonded" for law in laws),
        "slip_velocity": any(law.tangential != "bonded" for law in laws),
    }
    return tuple(name for name, called in calls.items() if called)


def sample_friction_limit(solution: PeriodicSolution, samples: int) -> RealArray:
    """``mu max(0, lam_N)`` over one period, ``(samples, K_c)`` [N]; zero for pairs without Coulomb friction."""
    friction = np.zeros(solution.problem.model.pairs)
    for pairs, laws in solution.problem.groups:
        if laws.tangential == "coulomb":
            friction[pairs] = spread_over_pairs(laws.friction, pairs, friction.size)
    return friction * np.maximum(0.0, solution.history("normal_force", samples))


def classify_contact(solution: PeriodicSolution, samples: int) -> np.ndarray:
    """OPEN, STICK or SLIP for every pair over one period, ``(samples, K_c)`` int.

    The decisions are those of the laws themselves at the samples: a pair is open where its admissible normal force is
    zero, and slips where its admissible friction force is at the limit. Frictionless pairs slip when closed, bonded
    ones stick.
    """
    limit = sample_friction_limit(solution, samples)
    friction = np.abs(solution.history("admissible_friction_force", samples))
    state = np.full(limit.shape, STICK)
    for pairs, laws in solution.problem.groups:
        if laws.tangential == "frictionless":
            state[:, pairs] = SLIP
        elif laws.tangential == "coulomb":
            # clip() returns the limit itself, up to the rounding of two syntheses
            state[:, pairs] = np.where(friction[:, pairs] >= limit[:, pairs] * (1 - 1e-9), SLIP, STICK)
    for law, fields in solution.law_fields(FourierBasis(solution.orders, samples)):
        if "admissible_normal_force" in fields:
            state[:, law.pairs] = np.where(fields["admissible_normal_force"] > 0, state[:, law.pairs], OPEN)
    return state
