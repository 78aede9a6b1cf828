"""A springy stop stepped in time: its massless end does not ring, and a motion from rest leaves its gap open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_models import PROBLEMS, stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.in_time.time_stepping import State, TimeScheme
from ewr_fenicsx.solver import initial_states
from ewr_fenicsx.solver.time_integration import integrate

STOP = ContactLaws(tangential="frictionless", initial_gap=1.0)


@pytest.mark.parametrize("start", [None, "rest", "solution"])
@pytest.mark.parametrize("steps", [400, 1024])
def test_a_stop_without_mass_does_not_ring(start, steps):
    """With theta = 1/2 for all, nothing would damp what contact excites at its end from step to step."""
    problem = ContactProblem(stop_oscillator(), STOP, 0.16, 21)
    found = solve(problem)
    steady = integrate(problem, found if start == "solution" else start, steps=steps, periods=120)
    assert steady.converged
    assert abs(steady.output("tip")[1]) == pytest.approx(abs(found.output("tip")[1]), rel=5e-4)
    assert np.abs(np.diff(steady.history("normal_force"), n=2, axis=0)).max() < 0.02, "or it does"


@pytest.mark.parametrize("coupled", [False, True])
def test_a_stop_without_mass_is_stepped_with_second_order(coupled):
    """Amplitude and phase against many harmonics: its end follows the contact force of its own time.

    Also beside a second mass, with a dashpot that couples all modes. (One on the stop's end itself leaves first order.)
    """
    model = stop_oscillator()
    if coupled:
        model = ReducedModel(
            mass=np.diag([1.0, 1.0, 0.0]),
            damping=np.diag([0.3, 0.01, 0.0]),
            stiffness=[[1.6, -0.6, 0.0], [-0.6, 2.6, -1.0], [0.0, -1.0, 1.0]],
            normal=[[0.0, 0.0, -1.0]],
            load={1: [0.0, 0.8, 0.0]},
            outputs={"tip": [0.0, 1.0, 0.0]},
        )
    problem = ContactProblem(model, replace(STOP, initial_gap=0.5), 0.16, 21)
    exact = solve(replace(problem, harmonics=101, samples=4096)).output("tip")[1]
    errors = []
    for steps in (200, 400, 800):
        steady = integrate(problem, steps=steps, tolerance=1e-7, acceleration=True)
        assert steady.scheme.is_diagonal != coupled
        errors.append(abs(steady.output("tip")[1] - exact) / abs(exact))
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15) == errors[1] / errors[2]


def test_an_end_without_mass_that_sticks_does_not_slide():
    """Its rate at the end of a step, which does not vanish, is what makes up for what was late in the step before."""
    steady = integrate(PROBLEMS["lift-off"], steps=200, tolerance=1e-6)
    normal, friction = steady.last.impulses.T
    sticks = (normal > 0) & (np.abs(friction) < (0.3 - 1e-6) * normal)
    speed = np.roll(steady.sliding_speed()[:, 0], -1)  # at the end of each step
    assert 5 < np.count_nonzero(sticks) < 50
    assert speed[sticks].max() < 1e-6 * speed.max() < speed[~sticks].min()


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_a_motion_begins_with_the_contact_force_that_its_start_has(damping):
    """Of modes without mass alone: the others' inertia is no contact force, also where damping couples all of them."""
    model = ReducedModel(
        mass=np.diag([1.0, 1.0, 0.0]),
        damping=np.diag([damping, 0.01, 0.0]),
        stiffness=[[1.6, -0.6, 0.0], [-0.6, 2.6, -1.0], [0.0, -1.0, 1.0]],
        normal=[[0.0, 0.0, -1.0]],
        load={0: [0.0, 9.0, 0.0], 1: [0.5, 0.8, 0.0]},
        outputs={"tip": [0.0, 1.0, 0.0]},
    )
    found = solve(ContactProblem(model, replace(STOP, initial_gap=0.5), 0.16, 21))
    scheme = TimeScheme(found.problem, 400)
    impulse = scheme.begin(State.of(found.problem, found.coordinates))[2].impulse
    assert impulse / scheme.dt == pytest.approx(found.history("normal_force", 8)[0], rel=1e-6)


@pytest.mark.parametrize("stop_mass", [0.0, 1e-6, 0.1])
def test_a_motion_from_rest_begins_with_open_gaps(stop_mass):
    """Not with bodies drawn together across a clearance; until the gap closes, against the equation without a stop."""
    model = stop_oscillator(excitation=0.05)
    model = replace(model, mass=np.diag([1.0, stop_mass]))
    problem = ContactProblem(model, STOP, 0.16, 5)
    exact = solve_ivp(
        lambda t, y: [y[1], (0.05 * np.cos(problem.omega * t) - 0.04 * y[1] - y[0]) / (1.0 + stop_mass)],
        (0.0, 1 / 0.16),
        [0.0, 0.0],
        rtol=1e-10,
        atol=1e-12,
    )
    for start in (None, "rest"):
        moved = integrate(problem, start, steps=2000, periods=1, tolerance=0)
        assert moved.history("normal_force").max() == 0.0
        assert moved.transient("tip")[0] == pytest.approx(0.0, abs=1e-12)
        assert moved.transient("tip")[-1] == pytest.approx(exact.y[0, -1], rel=1e-3 if stop_mass < 0.1 else 0.05)


def test_a_mean_load_closes_the_gap_at_rest():
    """The stop's end at the wall, the mass held by both springs."""
    model = replace(stop_oscillator(), load={0: [3.0, 0.0], 1: [0.01, 0.0]})
    moved = integrate(ContactProblem(model, STOP, 0.16, 5), "rest", steps=500, periods=1, tolerance=0)
    assert moved.transient("tip")[0] == pytest.approx(2.0, rel=1e-6)  # 3 = x + (x - 1)
    assert moved.history("normal_force")[0, 0] == pytest.approx(1.0, rel=0.02)


def test_a_given_normal_force_is_at_its_mean_at_rest():
    """What of it oscillates begins with the motion: 3 = x + (x - 1), as under a load."""
    model = replace(stop_oscillator(), normal=[[0.0, -1.0], [1.0, 0.0]], pair_area=None)
    pushed = ContactLaws("prescribed", "frictionless", normal_force={0: 3.0, 1: 2.0})
    problem = ContactProblem(model, [([0], STOP), ([1], pushed)], 0.16, 5)
    moved = integrate(problem, "rest", steps=500, periods=1, tolerance=0)
    assert moved.transient("tip")[0] == pytest.approx(2.0, rel=1e-6)


def test_where_no_rest_is_found_it_is_told_and_not_made_up(monkeypatch):
    """By default a motion then begins at full stick, which is a start as good as others."""
    problem = ContactProblem(stop_oscillator(), STOP, 0.16, 5)
    monkeypatch.setattr(initial_states, "find_rest", lambda problem: (None, 0))
    with pytest.raises(ModelError, match="no static solution of the laws was found; give"):
        integrate(problem, "rest", steps=100, periods=1)
    assert integrate(problem, steps=100, periods=1, tolerance=0).periods == 1


def test_a_light_contact_node_that_never_settles_is_told_with_a_remedy():
    heavy = replace(stop_oscillator(), mass=np.diag([1.0, 0.01]))
    ringing = integrate(ContactProblem(heavy, STOP, 0.16, 21), steps=1024, periods=40)
    assert not ringing.converged and "theta = 0.52 damps that" in ringing.reason
    assert "theta" not in integrate(ringing.problem, steps=64, periods=3, tolerance=0).reason, "a transient was asked"
