"""Whether a motion in time is steady, and how far it is from that."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from small_models import stop_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.in_time.time_stepping import State


@pytest.mark.parametrize("acceleration", [False, True])
@pytest.mark.parametrize("start", ["rest", State(np.array([0.01, 0.01]), np.zeros(2))])
def test_what_comes_to_rest_is_steady_and_nowhere_else(start, acceleration):
    """Relative to the rounding that alone still moved, it was some way off, and for ever where it was accelerated."""
    springs, pulled = [[2e3, -1e3], [-1e3, 1e3]], {0: [5.0, 0.0]}
    model = ReducedModel(np.diag([1.0, 0.0]), np.diag([3.0, 0.0]), springs, [[0.0, 1.0]], load=pulled)
    problem = ContactProblem(model, ContactLaws(tangential="frictionless", initial_gap=-1e-3), 5.0, 0)
    resting = integrate(problem, start, steps=400, periods=100, acceleration=acceleration)
    assert resting.converged and resting.distance < 1e-3
    assert resting.end.position[0] == pytest.approx(5e-3, rel=1e-6)


@pytest.mark.parametrize("outputs", [{}, {"contact": [0.0, 1.0]}])
def test_masses_behind_pairs_that_hold_are_followed_without_an_output(outputs):
    """Steady after two periods they were, for no pair moves; the force on it was to grow by a factor of sixteen."""
    springs, loads = [[2e3, -1e3], [-1e3, 2e3]], {0: [0.0, -40.0], 1: [1.0, 0.0]}
    model = ReducedModel(np.diag([1.0, 0.1]), 0.6 * np.eye(2), springs, [[0.0, 1.0]], load=loads, outputs=outputs)
    problem = ContactProblem(model, ContactLaws(tangential="frictionless"), np.sqrt(2e3) / (2 * np.pi), 3)
    begun = integrate(problem, "rest", steps=400, periods=20)
    assert not begun.converged and "falls steadily" in begun.reason
    settled = integrate(problem, "rest", steps=400, periods=300)
    swing = np.ptp(solve(problem).history("normal_force", 400))
    assert settled.converged and np.ptp(settled.history("normal_force")) == pytest.approx(swing, rel=2e-3)


@pytest.mark.parametrize(
    ("frequency", "damping", "factor"), [(0.2, 0.05, 0.88), (0.34, 0.5, 0.48), (0.38, 0.05, -1.59), (0.42, 0.5, -1.31)]
)
def test_a_motion_that_others_leave_is_found_by_extrapolation_and_told(frequency, damping, factor):
    """A mass on a springy stop, whose deviations grow by a factor a period: steady, it was called, and no more."""
    model = stop_oscillator(excitation=1.0, damping=damping, stop_stiffness=5.0)
    problem = ContactProblem(model, ContactLaws(tangential="frictionless"), frequency, 9)
    steady = integrate(problem, "rest", steps=512, periods=100, theta=0.52, acceleration=True)
    assert steady.converged
    assert steady.unstable == ("unstable" in steady.summary()) == (abs(factor) > 1)
    assert integrate(problem, "rest", steps=512, periods=150, theta=0.52).converged != steady.unstable


def test_extrapolation_ends_on_the_branch_between_two_folds_and_says_so():
    """Begun near it; without extrapolation the motion falls to the branch that touches no more."""
    taps = ContactLaws(tangential="frictionless", initial_gap=1.0)
    problem = ContactProblem(stop_oscillator(), taps, 0.16657, 9)
    near = State(np.array([-0.97, -0.97]), np.array([0.83, 0.83]))
    onto, away = (integrate(problem, near, 512, theta=0.52, acceleration=fast) for fast in (True, False))
    assert onto.converged and onto.unstable and away.converged and not away.unstable
    assert abs(onto.output("tip")[1]) > 1.2 and abs(away.output("tip")[1]) < 0.8


def hit_both_sides() -> ReducedModel:
    """Two masses that whirl, and hit a springy stop on either side."""
    way, stop, none = np.array([0.64, 0.77]), 5.0, np.zeros((2, 2))
    reach = np.hstack([np.outer([1.0, -1.0], way), -np.eye(2)])
    springs = stop * reach.T @ reach
    springs[:2, :2] += [[0.62, 0.18], [0.18, 0.47]]
    loads = {1: [-0.14 + 0.32j, 0.61 - 0.42j, 0.0, 0.0], 2: [-1.24 - 0.74j, 0.58 + 0.35j, 0.0, 0.0]}
    damping = block_diag([[0.04, 0.17], [-0.08, -0.02]], none)
    return ReducedModel(block_diag(np.diag([1.7, 3.0]), none), damping, springs, -np.eye(4)[2:], load=loads)


def slide_beside_a_stop() -> ReducedModel:
    """A mass that hits a springy stop and there slides through a spring; no mass turns where friction holds it."""
    springs = [[12.46, 10.0, -2.0], [10.0, 10.0, 0.0], [-2.0, 0.0, 2.0]]
    loads = {0: [1.17, 0.0, 0.0], 1: [0.03 + 0.17j, 0.0, 0.0], 2: [-0.14 - 0.086j, 0.0, 0.0]}
    mass, damping, (_, stop, slider) = np.diag([1.03, 0.0, 0.0]), np.diag([0.024, 0.0, 0.0]), np.eye(3)
    return ReducedModel(mass, damping, springs, [-stop], [slider], loads)


@pytest.mark.parametrize(
    ("model", "laws", "omega"),
    [
        (hit_both_sides(), ContactLaws(tangential="frictionless", initial_gap=[-0.3, 0.0]), 0.66),
        (hit_both_sides(), ContactLaws(tangential="frictionless", initial_gap=[-0.3, 0.0]), 0.70),
        (slide_beside_a_stop(), ContactLaws(friction=0.26, initial_gap=0.3), 0.332),
    ],
)
def test_what_leaves_slowly_or_not_far_is_told_where_extrapolation_met_little_of_it(model, laws, omega):
    """Of what grows by some five per cent a period the way there told nothing; what doubles stays within some more."""
    problem, stepping = ContactProblem(model, laws, omega / (2 * np.pi), 5), {"steps": 512, "theta": 0.505}
    steady = integrate(problem, "rest", tolerance=1e-6, acceleration=True, **stepping)
    assert steady.converged
    beside = State(steady.end.position + 1e-3 * model.mass.any(axis=0), steady.end.velocity)
    gone = integrate(problem, beside, tolerance=1e-6, **stepping)
    assert not gone.converged and gone.changes[-1] > 10 * gone.changes[1]
    assert steady.unstable


def test_where_a_mass_rubs_a_small_deviation_is_not_what_steps_make_of_it():
    """It turns within a step: others were to leave a motion beside which all decays by five per cent a period."""
    stops = np.array([1.01, 7.26])
    stiffness = np.diag([3.16 + stops.sum(), 1.95, *stops])
    stiffness[0, 1] = stiffness[1, 0] = -1.51
    stiffness[0, 2:] = stiffness[2:, 0] = -stops
    damping = np.zeros((4, 4))
    damping[:2, :2] = [[0.01, -0.003], [-0.003, 0.006]]
    loads = {0: [0.2, 0.0, 0.0, 0.0], 1: [-0.12 + 0.74j, 0.39 + 0.29j, 0.0, 0.0]}
    normal, tangential = np.zeros((2, 3, 4))
    normal[0, 2] = normal[1, 3] = -1.0
    tangential[2, 1] = 1.0
    model = ReducedModel(np.diag([1.91, 1.3, 0.0, 0.0]), damping, stiffness, normal, tangential, loads)
    taps = ContactLaws(tangential="frictionless", initial_gap=[1.76, 0.0])
    rubs = ContactLaws("prescribed", normal_force=0.53, friction=0.34)
    problem = ContactProblem(model, [([0, 1], taps), ([2], rubs)], 3.39 / (2 * np.pi), 9)
    steady = integrate(problem, "rest", steps=1024, periods=150, theta=0.505, acceleration=True)
    assert steady.converged and not steady.unstable


def test_what_alternates_and_decays_is_said_to_decay():
    """A mass that vibrates three times in two periods: next to steady, every second one was to be the same."""
    frequency, decay = 1.0, 0.97
    damping, swings = -2 * np.log(decay) * frequency, 3 * np.pi * frequency
    stiffness = swings**2 + damping**2 / 4
    model = ReducedModel([[1.0]], [[damping]], [[stiffness]], [[1.0]], load={1: [1.0]}, outputs={"mass": [1.0]})
    given = ContactLaws("prescribed", "frictionless", normal_force=1.0)
    problem = ContactProblem(model, given, frequency, 1)
    whole = integrate(problem, "rest", steps=100, periods=400, tolerance=1e-4)
    early = integrate(problem, "rest", steps=100, periods=whole.periods - 3, tolerance=1e-4)
    assert whole.converged and not early.converged
    assert "every second one" not in early.reason and "some 3 more may do" in early.reason
