"""Hard cases in other units take exactly the same steps, fallbacks included.

The new units are powers of four of the old, so that a change of units rounds nothing: any difference would come from a
number in the code that has a unit. (tests/unit/test_newton.py has millimetres and tonnes, on easy cases.)
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from changed_units import change_units
from hard_cases import DEGENERATE, draw_cases, pose_case

from ewr_fenicsx import ContactProblem, solve
from ewr_fenicsx.solution.solution import PeriodicSolution

# length, mass and time in new units, over those in old ones: about mm, t, s; mm, kg, ms; and something silly
UNITS = {"mm, t, s": (1024.0, 1 / 1024, 1.0), "mm, kg, ms": (1024.0, 1.0, 1024.0), "silly": (4.0**-9, 4.0**6, 4.0**4)}


def compare(problem: ContactProblem, first: PeriodicSolution, units: tuple[float, float, float]) -> None:
    length, mass, time = units
    second = solve(change_units(problem, *units), raise_on_failure=False)
    assert (second.iterations, second.converged, second.reason) == (first.iterations, first.converged, first.reason)
    assert second.fallbacks == first.fallbacks
    assert second.residual == pytest.approx(first.residual, rel=1e-6)
    force = mass * length / time**2
    np.testing.assert_allclose(
        second.forces, force * first.forces, atol=1e-9 * force * np.abs(first.forces).max(initial=0)
    )
    np.testing.assert_allclose(
        second.output("tip"), length * first.output("tip"), atol=1e-9 * length * np.abs(first.output("tip")).max()
    )


@lru_cache
def solve_cases(model: str, seed: int) -> list[tuple[ContactProblem, PeriodicSolution]]:
    cases = [replace(case, harmonics=min(case.harmonics, 9)) for case in draw_cases(model, 6, seed)]
    problems = [pose_case(case) for case in cases]
    return [(problem, solve(problem, raise_on_failure=False)) for problem in problems]


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize(("model", "seed"), [("dovetail", 11), ("lap joint", 12)])
def test_sampled_hard_cases(model, seed, units):
    for problem, first in solve_cases(model, seed):
        compare(problem, first, UNITS[units])


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize(
    "name",
    [
        "a pair just touches at rest",
        "friction limit met exactly",
        "zero preload, body held, barely shaken",
        "redundant pairs",
        "compliance condition 1e10",
    ],
)
def test_degenerate_cases(name, units):
    problem = DEGENERATE[name]()
    compare(problem, solve(problem, raise_on_failure=False), UNITS[units])
