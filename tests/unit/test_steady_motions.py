"""When a motion in time counts as steady: what rests or moves by rounding alone, and how far slow ones have to go."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel
from ewr_fenicsx.in_time.periodicity import Watch, count_missing
from ewr_fenicsx.in_time.time_stepping import Carried, Period
from ewr_fenicsx.solver.time_integration import integrate


@pytest.mark.parametrize("turn", [0.0, 0.1, 0.7, 1.2])
def test_an_output_that_symmetry_keeps_at_rest_is_no_motion_that_never_settles(turn):
    """It is the rounding of what moves across it, by which it is judged: 1e-21 m beside 1e-4 m."""
    along, across = np.cos(turn), np.sin(turn)
    model = ReducedModel(
        mass=np.eye(3),
        damping=20 * np.eye(3),
        stiffness=1e6 * np.eye(3),
        normal=[[0.0, 0.0, -1.0]],
        tangential=[[along, across, 0.0], [-across, along, 0.0]],
        load={0: [0.0, 0.0, 300.0], 1: [150.0, 0.0, 0.0]},
        outputs={"along": [1.0, 0.0, 0.0], "across": [0.0, 1.0, 0.0]},
    )
    steady = integrate(ContactProblem(model, ContactLaws(friction=0.3), 120.0, 9), steps=2000, theta=0.52)
    assert steady.converged and steady.periods < 20


@pytest.mark.parametrize("stiffness, mean", [(1.0, 0.0), (0.0, 0.0), (0.0, 0.1), (1.0, 0.1)])
@pytest.mark.parametrize("start", [None, "rest"])
def test_what_sticks_from_rest_is_steady(stiffness, mean, start):
    """It moves by rounding alone, which is no ringing."""
    load = {0: [mean], 1: [1.0]}
    stuck = ReducedModel([[1.0]], [[0.1]], [[stiffness]], tangential=[[1.0]], load=load, outputs={"tip": [1.0]})
    laws = ContactLaws("prescribed", normal_force=1.5, friction=1.0)
    result = integrate(ContactProblem(stuck, laws, 0.1, 3), start, steps=400)
    assert result.converged and result.periods == 2 and np.ptp(result.output_history("tip")) < 1e-12
    gliding = integrate(ContactProblem(stuck, replace(laws, friction=0.3), 0.1, 3), start, steps=400, periods=2)
    assert not gliding.converged, "the first periods of what moves are none of the steady state"


def test_a_joint_at_rest_is_steady_though_its_pairs_move_by_rounding():
    """Two bodies on springs, pressed on each other over four massless nodes: pairs ring by 1e-11 of where all is."""
    rng = np.random.default_rng(6)
    body = np.diag([1.0, 1.2, 0.8, 1.5, *np.zeros(8)])
    stiffness = 1e5 * np.diag([0.5, 0.7, 0.4, 0.9, *np.zeros(8)])
    normal, tangential = np.zeros((2, 4, 12))
    for pair, at in enumerate(range(4, 12, 2)):
        mount, turn = np.zeros((2, 12)), rng.normal(size=(2, 2))
        mount[:, :2], mount[:, at : at + 2] = -np.eye(2), np.eye(2)
        stiffness += mount.T @ (1e5 * (turn @ turn.T / 2 + 0.5 * np.eye(2))) @ mount
        normal[pair, [at, 2]], tangential[pair, [at + 1, 3]] = (-1, 1), (-1, 1)
    load = {0: np.array([20.0, 3.0, -60.0, 3.0, *np.zeros(8)])}
    pressed = ReducedModel(body, 3e-4 * stiffness + 8 * body, stiffness, normal, tangential, load)
    pressed = replace(pressed, outputs={f"x{i}": np.eye(12)[i] for i in range(12)})
    steady = integrate(ContactProblem(pressed, ContactLaws(friction=0.3), 37.0), "rest", 800, 50)
    assert steady.converged and steady.periods == 2, steady.summary()
    pairs = steady.history("normal_force")
    assert np.all(pairs > 0) and 0 < np.ptp(steady.output_history("x0")) < 1e-10 * abs(steady.output_history("x0")[0])


@pytest.mark.parametrize(("mean", "swing"), [(0.0, 1.0), (1e3, 0.0)], ids=["oscillations", "means"])
def test_what_modes_leave_where_they_cancel_is_judged_by_them(mean, swing):
    """Two modes that move a pair to and fro, or hold it, against each other: what is left changes in all its digits."""
    rng, noise, still = np.random.default_rng(0), 1e-5 if swing else 1e-9, np.zeros((33, 2))
    scheme = SimpleNamespace(
        problem=SimpleNamespace(model=SimpleNamespace(outputs={}), driven=(1,)),
        rows=np.ones((1, 2)), mass=np.ones(2), dt=0.1, velocity_of_load=still,
    )  # fmt: skip
    watch = Watch(scheme)
    for _ in range(2):
        moves = mean + swing * np.sin(np.linspace(0, 2 * np.pi, 33))
        positions = np.column_stack([moves, -moves]) + noise * rng.normal(size=(33, 2))
        change = watch.measure_change(Period(positions, still, still[1:, :1], 0, 0, Carried(still[0], still[0])))
    motion = positions.sum(axis=1)
    assert noise / 2 < motion.std() < 2 * noise and change < 0.05


@pytest.mark.parametrize(("periods", "missing"), [(11, 0), (12, 100), (40, 72)])
def test_missing_periods_are_told_from_ten_changes_that_fall_steadily(periods, missing):
    """The first period has none before it: its change is infinite, and tells nothing."""
    changes = [np.inf, *(0.9**k for k in range(periods - 1))]
    assert count_missing(changes, 1e-5) == missing
