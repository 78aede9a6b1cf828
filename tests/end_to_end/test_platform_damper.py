"""An under-platform damper: what its scene says of itself is borne out by time stepping."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from ewr_fenicsx import integrate, load_scene, solve
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
