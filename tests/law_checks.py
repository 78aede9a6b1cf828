"""What every contact law has to pass, whichever file its test is in; and solutions that several tests look at."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from small_models import PROBLEMS

from ewr_fenicsx import ContactProblem, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.laws.smoothing import round_corners
from ewr_fenicsx.solution.solution import PeriodicSolution


def check_rounded_corners(problem: ContactProblem) -> None:
    """Rounded corners tend to the exact law in proportion to their width, and have the derivatives that they state."""
    exact = HarmonicBalance(problem.system, 1.0)
    point = np.random.default_rng(1).normal(size=exact.size)
    far = [
        np.abs(HarmonicBalance(round_corners(exact.system, width), 1.0).residual(point) - exact.residual(point)).max()
        for width in (1e-1, 1e-2, 1e-3)
    ]
    assert far[2] < 0.15 * far[1] < 0.1 * far[0]
    rounded = HarmonicBalance(round_corners(exact.system, 0.1), 1.0)
    change, h = np.random.default_rng(2).normal(size=exact.size), 1e-6
    finite = (rounded.residual(point + h * change) - rounded.residual(point - h * change)) / (2 * h)
    np.testing.assert_allclose(rounded.linearise(point).multiply(change), finite, atol=1e-7 * np.abs(finite).max())


@lru_cache
def ride_in_grooves(harmonics: int) -> PeriodicSolution:
    """A floating block that its weight holds in three V-grooves, shaken so that its feet slide and stick."""
    return solve(replace(PROBLEMS["plane, floating"], harmonics=harmonics))


@lru_cache
def lift_foot(harmonics: int) -> PeriodicSolution:
    """A foot pressed on the ground that slides in all directions and lifts off."""
    return solve(replace(PROBLEMS["plane, lift-off"], harmonics=harmonics))
