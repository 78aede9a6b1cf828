"""An under-platform damper: what its scene says of itself is borne out by time stepping."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ewr_fenicsx import integrate, load_scene, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.problem.dashpots import use_mobility
from ewr_fenicsx.solver.faint_forces import attend_to_faint_forces, find_missed
from ewr_fenicsx.solver.snes import Attempt
from ewr_fenicsx.structure.chain import build_chain, pose_problem

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def problem():
    scene = load_scene(ROOT / "demos" / "platform_damper.toml")
    chain = build_chain(scene)
    return pose_problem(scene, chain.reduction.model, chain.interface)


@pytest.mark.parametrize(("frequency", "error"), [(735.0, 0.08), (790.0, 0.02)])
def test_motions_in_time_stay_where_a_solution_is_not_called_unstable(problem, frequency, error):
    """Pairs lift off and rub; truncated, deviations seem to grow at 735 Hz, as the determinant's sign tells."""
    found = solve(replace(problem, frequency=frequency, harmonics=9))
    assert not found.fallbacks and not found.unstable
    steady = integrate(found.problem, found, steps=1600, theta=0.51, tolerance=1e-4)
    assert steady.converged
    assert abs(steady.output("tip")[1] - found.output("tip")[1]) < error * abs(steady.output("tip")[1])


def test_the_determinant_alone_would_call_one_of_them_unstable(problem):
    assert solve(replace(problem, frequency=735.0, harmonics=9)).side == -1


def test_faint_forces_are_right_where_all_rows_together_leave_rounding(problem):
    """A step or two does: their residual norm stays above 1e-13 whatever is done, and ten steps went after it."""
    solution = solve(use_mobility(replace(problem, frequency=735.0, harmonics=13, closure="spring")))
    balance = HarmonicBalance(solution.problem.system)
    unknowns = balance.pack(solution.forces, solution.rigid)
    unknowns = unknowns + 1e-13 * np.random.default_rng(0).normal(size=unknowns.size)
    residual = float(np.linalg.norm(balance.residual(unknowns)))
    found = Attempt(unknowns, residual, 0, "residual below the tolerance", True)
    assert residual < 1e-8 and find_missed(balance, unknowns, 1e-8).size
    closer = attend_to_faint_forces(balance, found, 1e-8, "elimination")
    assert closer.converged and closer.iterations <= 3
    assert not find_missed(balance, closer.unknowns, 1e-8).size
