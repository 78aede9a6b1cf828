"""``solve`` with an accuracy: the solution of ``solve_to_accuracy``, with its error beside it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from small_models import PROBLEMS

from ewr_fenicsx import ContactLaws, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import measure_distance
from ewr_fenicsx.errors import ModelError, NotConverged
from ewr_fenicsx.solver import newton

JOINT = PROBLEMS["lift-off"]


def test_an_accuracy_chooses_the_harmonics_and_tells_the_error():
    found, solution = solve_to_accuracy(JOINT, 0.03), solve(JOINT, accuracy=0.03)
    assert solution.orders == found.solution.orders != JOINT.basis.orders
    np.testing.assert_array_equal(solution.forces, found.solution.forces)
    assert solution.estimated_error == found.estimate.total <= 0.03 and not solution.short
    assert f"estimated error {solution.estimated_error:.1g}" in solution.summary()
    assert "NOT as accurate" not in solution.summary()


def test_without_an_accuracy_the_harmonics_are_those_of_the_problem_and_only_the_summary_estimates():
    solution, plain = solve(JOINT, tolerance=1e-10), newton.solve(JOINT, tolerance=1e-10)
    np.testing.assert_array_equal(solution.forces, plain.forces)
    assert np.isnan(solution.estimated_error) and "estimated" not in plain.summary()


def pose_with(harmonics):
    """Outputs are off by 3 % with one harmonic, by 0.5 with five, by 0.03 with 31."""
    return replace(JOINT, harmonics=harmonics)


@pytest.mark.parametrize("harmonics", [1, 5, 31])
def test_a_summary_tells_the_error_within_a_factor_of_five_and_a_remedy_where_it_is_large(harmonics):
    solution, exact = solve(pose_with(harmonics)), solve(pose_with(127))
    error = measure_distance(solution, exact)
    (line,) = [line for line in solution.summary().splitlines() if "error" in line]
    told = float(re.match(r"  (?:NOT accurate: )?estimated error of the outputs (\S+)", line)[1].rstrip(";"))
    assert error / 5 <= told <= 5 * error
    assert ("solve(problem, accuracy=0.01) takes" in line) == (told > 0.02)
    assert np.isnan(solution.estimated_error)


def test_without_outputs_it_is_the_pairs_whose_error_is_told():
    silent = replace(JOINT, model=replace(JOINT.model, outputs={}))
    assert "estimated error of motions and forces at the pairs " in solve(silent).summary()


def test_what_cannot_be_estimated_is_said_and_nothing_is_said_of_what_is_exact(monkeypatch):
    bonded = replace(JOINT, laws=ContactLaws(normal="bonded", tangential="bonded"))
    assert "error" not in solve(bonded).summary()

    def fail(solution, figure):
        raise MemoryError

    monkeypatch.setattr("ewr_fenicsx.accuracy.solving.estimate_at_once", fail)
    solution = solve(JOINT)
    assert "its error is not known: out of memory" in solution.summary()
    assert "error" not in replace(solution, converged=False, reason="as if").summary()


def test_an_output_that_is_zero_by_symmetry_is_compared_with_what_could_move_it():
    """What solves leave of it differs altogether from one to the next."""
    twins = solve(replace(JOINT, model=pair_up(JOINT.model)))
    assert np.abs(twins.output("difference")).max() < 1e-12 * np.abs(twins.output("tip")).max()
    left = np.random.default_rng(1).normal(size=twins.forces.shape) * (np.array(twins.orders) > 0)[:, None]
    other = replace(twins, forces=twins.forces * (1 + 1e-8 * left))
    assert np.abs(other.output("difference")).max() > 1e-9 * np.abs(twins.output("tip")).max()
    assert measure_distance(other, twins) < 1e-7


def pair_up(model):
    """The model twice, side by side, and how far the outputs of the two are apart."""
    (tip,) = model.outputs.values()
    twice = {name: np.kron(np.eye(2), getattr(model, name)) for name in ("mass", "damping", "stiffness")}
    rows = {name: np.kron(np.eye(2), getattr(model, name)) for name in ("normal", "tangential")}
    load = {h: np.tile(f, 2) for h, f in model.load.items()}
    outputs = {"tip": np.append(tip, 0.0 * tip), "difference": np.append(tip, -tip)}
    return ReducedModel(**twice, **rows, load=load, outputs=outputs)


def test_what_falls_short_says_why(monkeypatch):
    monkeypatch.setattr("ewr_fenicsx.accuracy.accuracy.MOST_HARMONICS", 5)
    solution = solve(JOINT, accuracy=1e-6)
    assert solution.converged and solution.estimated_error > 1e-6
    assert solution.short == "harmonic 5 is the highest allowed; ask for less, or allow more in solve_to_accuracy"
    assert f"NOT as accurate as asked: {solution.short}" in solution.summary()


def test_a_solve_that_fails_raises_or_returns_the_best_iterate(monkeypatch):
    best = solve(JOINT)

    def fail(*_, **__):
        raise NotConverged("as if", best=replace(best, converged=False))

    monkeypatch.setattr("ewr_fenicsx.accuracy.levels.solve", fail)
    with pytest.raises(NotConverged, match="as if"):
        solve(JOINT, accuracy=0.1)
    assert not solve(JOINT, accuracy=0.1, raise_on_failure=False).converged


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"accuracy": 1.0}, "accuracy = 1.0; give a relative error between 0 and 1"),
        ({"accuracy": 0.1, "linear_solver": "dense"}, "linear_solver and fallbacks: an accuracy, .* leave them out"),
        ({"accuracy": 0.1, "fallbacks": False}, "linear_solver and fallbacks: an accuracy, .* leave them out"),
        ({"accuracy": 0.1, "fallbacks": 2}, "linear_solver and fallbacks: an accuracy, .* leave them out"),
    ],
)
def test_what_an_accuracy_does_not_take_is_refused(choice, message):
    with pytest.raises(ModelError, match=message):
        solve(JOINT, **choice)


@pytest.mark.parametrize("rungs", [-1, None, 0.5, np.inf, "all"])
def test_what_is_no_number_of_fallbacks_is_refused(rungs):
    """With minus one no way at all was taken, and nothing passed for a solution."""
    with pytest.raises(ModelError, match=f"fallbacks = {rungs!r}; give True for all further rungs, False for none"):
        solve(JOINT, fallbacks=rungs)


@pytest.mark.parametrize(("given", "meant"), [(np.True_, True), (np.False_, 0), (2.0, 2), (np.int8(1), 1)])
def test_fallbacks_may_be_of_any_type_of_number(monkeypatch, given, meant):
    taken = []

    def note(*_, **choice):
        taken.append(choice["fallbacks"])
        raise NotConverged("as if", best=None)

    monkeypatch.setattr(newton, "solve", note)
    with pytest.raises(NotConverged):
        solve(JOINT, fallbacks=given)
    assert taken == [meant] and type(taken[0]) is type(meant)
