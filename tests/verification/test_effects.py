"""Only the effects that a scene calls for: unknowns by formula, no stage that is not needed, and the same results.

Each scene is compared with the same physics written with more effects than it calls for, made inert
(``benchmarks/effects.py`` says which, and measures the times): 1e-8 of the largest motion and normal force.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ewr_fenicsx import evolve_wear, solve
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.model import compliance
from ewr_fenicsx.solution.contact_state import OPEN, SLIP, classify_contact

ROOT = Path(__file__).parents[2]
from effects import (  # noqa: E402
    ALL,
    BONDED,
    CASES,
    LEFT,
    RIGHT,
    STAGES,
    WEAR_CYCLES,
    compare,
    count_calls,
    pose,
    pose_full_wear,
    pose_wear,
)

every_case = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


@every_case
def test_unknowns_equal_the_formula_and_only_the_stages_called_for_run(case):
    with count_calls() as counts:
        solution = solve(case.problem(), tolerance=1e-11)
    assert solution.unknowns == case.unknowns
    assert {stage for stage in STAGES if counts[stage]} == case.runs
    assert ("newton" in solution.stages) == bool(case.runs), "the stage timer knows"


@pytest.mark.parametrize("case", [c for c in CASES if c.full], ids=lambda case: case.name)
def test_results_equal_those_of_the_fullest_formulation_made_inert(case):
    found, full = solve(case.problem(), tolerance=1e-11), solve(case.full(), tolerance=1e-11)
    assert full.unknowns > found.unknowns or full.problem.system.rows.shape == found.problem.system.rows.shape
    assert compare(found, full, case.first) < 1e-8


def test_the_comparison_has_something_to_compare():
    """The scenes with friction or separation slip, and those that can open do."""
    states = {c.name: classify_contact(solve(c.problem()), 256) for c in CASES}
    for case in CASES:
        state = states[case.name]
        if "Coulomb" in case.runs and case.name != "at rest":
            assert (state == SLIP).mean() > 0.05, case.name
    for name in ("separation, frictionless", "separation and friction", "left absent, right both"):
        assert (states[name] == OPEN).any(), name


def test_two_formulations_that_differ_are_told_apart():
    """Of the test itself: a friction of 0.01 in place of none is seen."""
    case = next(c for c in CASES if c.name == "separation, frictionless")
    other = case.full()
    other = replace(other, laws=replace(other.laws, friction=0.01))
    assert compare(solve(case.problem()), solve(other)) > 1e-4


def test_wear_where_it_is_called_for_equals_wear_everywhere_made_inert():
    """Friction, separation and wear on the right flank, the left bonded; against one that could open, slip and wear."""
    problem, coefficient = pose_wear()
    full_problem, everywhere = pose_full_wear()
    worn = evolve_wear(problem, WEAR_CYCLES, coefficient, tolerance=1e-11)
    full = evolve_wear(full_problem, WEAR_CYCLES, everywhere, tolerance=1e-11)
    assert worn.solutions[-1].unknowns == 2 * len(RIGHT) * ALL
    assert full.solutions[-1].unknowns == (len(LEFT) + 2 * len(RIGHT)) * ALL
    assert worn.depth[-1][RIGHT].min() > 0 and not np.any(worn.depth[:, LEFT])
    assert np.abs(worn.depth - full.depth).max() < 1e-8 * full.depth.max()
    assert compare(worn.solutions[-1], full.solutions[-1]) < 1e-8


def test_a_wear_coefficient_of_zero_is_no_wear():
    """On some pairs: they do not wear. On all: that is said. A worn depth of zero is the unworn problem, to the bit."""
    problem, _ = pose_wear()
    only = evolve_wear(problem, 3, 1e-9 * (np.arange(7) == 5))
    assert only.depth[-1][5] > 0 and not np.any(np.delete(only.depth, 5, axis=1))
    with pytest.raises(ModelError, match="no pair can wear"):
        evolve_wear(problem, 3, 0.0)
    unworn = solve(replace(problem, wear=np.zeros(7)))
    np.testing.assert_array_equal(unworn.forces, solve(problem).forces)


def test_a_linear_scene_is_one_solve_a_harmonic(monkeypatch):
    """Of the model's equations at each harmonic: not two, and none of contact rows; where modes do not uncouple it."""
    taken = []
    original = compliance.solve_directly

    def counted(model, omega, forces, *rest):
        taken.append((omega, forces.shape[1]))
        return original(model, omega, forces, *rest)

    problem = pose(BONDED)
    dashpot = np.diag(problem.model.damping.diagonal() * np.linspace(0.0, 1.0, problem.model.size))
    problem = replace(problem, model=replace(problem.model, damping=problem.model.damping + dashpot))
    monkeypatch.setattr(compliance, "solve_directly", counted)
    solution = solve(problem)
    assert [columns for _, columns in taken] == [1] * len({h for h, f in problem.loads.items() if np.any(f)})
    assert solution.reason == "linear" and solution.iterations == 0


def test_a_pair_that_never_changes_status_costs_no_dense_row():
    """Stuck and closed throughout: nothing is left for the dense solve."""
    from ewr_fenicsx.balance.balance import HarmonicBalance

    problem = pose(next(c for c in CASES if c.name == "separation and friction").problem().laws, press=range(7))
    solution = solve(problem)
    balance = HarmonicBalance(problem.system)
    assert balance.linearise(balance.pack(solution.forces, solution.rigid)).steady.all()


@pytest.mark.parametrize("excitation", [0.0, 15.0])
def test_no_module_is_imported_that_a_linear_or_static_solve_does_not_need(excitation):
    script = (
        "import sys; sys.path.insert(0, 'benchmarks')\n"
        "from effects import BONDED, pose; from ewr_fenicsx import solve\n"
        f"solve(pose(BONDED, excitation={excitation}))\n"
        "print(*sorted(name for name in sys.modules if name.startswith('ewr_fenicsx.')))"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    loaded = {name.split(".")[-1] for name in run.stdout.split()}
    assert {"newton", "contact_problem"} <= loaded
    assert not loaded & {"wear", "frequency_sweep", "time_integration", "time_stepping", "contact_state", "scene"}


def test_problems_share_nothing_but_their_model():
    """The same model under other laws, one after the other: no effect of one is left in the next."""
    first = solve(CASES[-1].problem())
    for case in CASES[:3]:
        solve(case.problem())
    again = solve(CASES[-1].problem())
    np.testing.assert_array_equal(again.forces, first.forces)
