"""Where a motion in time begins on a solution, bodies that a truncated series lets overlap are moved apart first."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.in_time.lifting import lift_out
from ewr_fenicsx.in_time.time_stepping import State, TimeScheme


def chain(frequency: float, phase: float) -> ContactProblem:
    """Four equal masses in a row, of which two are pressed on stops."""
    stiffness = 1e4 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    shaken = np.exp(1j * phase) * np.array([10.0, 0.0, 0.0, 80.0])
    load, outputs = {0: [-20.0, -20.0, -10.0, 0.0], 1: shaken}, {"first": np.eye(4)[0]}
    model = ReducedModel(np.eye(4), 2e-3 * stiffness, stiffness, normal=np.eye(4)[:2], load=load, outputs=outputs)
    return ContactProblem(model, ContactLaws(tangential="frictionless"), frequency, harmonics=9)


@pytest.mark.parametrize("steps", [400, 6400])
def test_masses_pressed_on_stops_are_not_thrown_off_by_what_a_solution_overlaps(steps):
    """By ten times their swing they were at 6400 steps a period, and with more steps the further.

    There are several solutions, and rounding decides which is found: in one of them the first mass is off its stop.
    """
    found = solve(chain(8.9, 3.7))
    gap = found.problem.model.normal @ found.coordinates.sum(axis=0).real
    overlap = -gap.min()
    moved = integrate(found.problem, found, steps, periods=1, tolerance=0)
    assert overlap > 1e-6, "else there is nothing to look at"
    apart = moved.history("gap", steps)[: steps // 8].max(axis=0)
    assert np.all(apart < 1.01 * np.maximum(0.0, gap) + 0.1 * overlap)


def test_where_no_way_apart_is_found_a_motion_begins_as_it_is(monkeypatch):
    def give_up(*_):
        raise RuntimeError("too many iterations")

    monkeypatch.setattr("ewr_fenicsx.in_time.lifting.nnls", give_up)
    given = State(np.array([-1e-3, 2e-4, -3e-3, 1e-3]), np.ones(4))
    assert lift_out(TimeScheme(chain(8.9, 0.0), 400), given) is given


def test_they_are_moved_as_little_as_will_do():
    """By the inertia of a step, against a general minimiser; what lies apart, or in no way can, is left as it is."""
    scheme = TimeScheme(chain(8.9, 0.0), 400)
    given = State(np.array([-1e-3, 2e-4, -3e-3, 1e-3]), np.ones(4))
    there = lift_out(scheme, given)
    inertia = scheme.contraction.T @ scheme.contraction
    nearest = minimize(
        lambda y: (y - 1e3 * given.position) @ inertia @ (y - 1e3 * given.position),
        np.ones(4),
        bounds=[(0, None), (0, None), (None, None), (None, None)],
        tol=1e-14,
    )
    assert there.position == pytest.approx(1e-3 * nearest.x, abs=1e-8)
    assert np.array_equal(there.velocity, given.velocity)
    assert lift_out(scheme, there) is there

    between = ReducedModel(np.eye(1), np.eye(1), np.eye(1), normal=[[1.0], [-1.0]])
    squeezed = ContactProblem(between, ContactLaws(tangential="frictionless", initial_gap=-1e-3), 1.0, 3)
    nowhere = State(np.array([1e-4]), np.zeros(1))
    assert lift_out(TimeScheme(squeezed, 100), nowhere) is nowhere
