"""An accuracy asked for under loads far apart, and under normal forces that are given at harmonics of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import friction_oscillator, lift_off_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import measure_distance
from ewr_fenicsx.errors import ModelError

FREQUENCY = 0.7 / (2 * np.pi)


def test_harmonics_of_given_normal_forces_are_kept():
    """As those of loads: they act on the bodies, and are what the limit of friction follows."""
    laws = ContactLaws("prescribed", normal_force={0: 0.5, 6: 0.2}, friction=0.3)
    posed = ContactProblem(lift_off_oscillator(), laws, FREQUENCY)
    found = solve_to_accuracy(posed, 0.01)
    assert found.reached and 6 in found.solution.orders
    truth = solve(replace(posed, harmonics=80, samples=2048))
    assert measure_distance(found.solution, truth) <= 0.01
    with pytest.raises(ModelError, match="highest = 5; loads act at harmonic 6: allow at least that"):
        solve_to_accuracy(posed, 0.01, highest=5)
    assert max(solve_to_accuracy(posed, 0.01, highest=6).solution.orders) == 6


@pytest.mark.parametrize("accuracy", [0.01, 0.001])
def test_a_given_force_that_moves_nothing_needs_no_harmonic_of_its_own(accuracy):
    """A normal row of zeros: what swings at harmonic 2 is the limit of friction only, and forces there are small."""
    model = ReducedModel(
        mass=np.diag([1.0, 0.0]),
        damping=np.diag([0.1, 0.0]),
        stiffness=[[3.0, -2.0], [-2.0, 2.0]],
        normal=[[0.0, 0.0]],
        tangential=[[0.0, 1.0]],
        load={1: [1.0, 0.0], 3: [0.5, 0.0]},
        outputs={"tip": [1.0, 0.0]},
    )
    laws = ContactLaws("prescribed", normal_force={0: 1.0, 2: 0.5j}, friction=0.5)
    found, without = (
        solve_to_accuracy(ContactProblem(each, laws, 0.2, 9), accuracy) for each in (model, replace(model, normal=None))
    )
    assert found.reached and without.reached
    assert measure_distance(found.solution, without.solution) <= 2 * accuracy


def test_loads_far_above_the_lowest_are_kept_without_being_asked_for():
    """Harmonic 70 is beyond 63 times the lowest load."""
    model = friction_oscillator()
    load = {1: model.load[1], 70: 10 * model.load[1]}
    posed = ContactProblem(model, ContactLaws("prescribed", normal_force=1.0, friction=0.4), 0.1, 70, load=load)
    found = solve_to_accuracy(posed, 0.03)
    assert found.reached and 70 in found.solution.orders


def test_a_limit_of_friction_that_swings_is_sampled_from_the_first_solve_on():
    """By a normal force that does not act on the model: 64 samples could not tell its harmonic 40 from a lower one."""
    laws = ContactLaws("prescribed", normal_force={0: 1.0, 40: 0.5}, friction=0.4)
    posed = ContactProblem(friction_oscillator(), laws, 0.1)
    found = solve_to_accuracy(posed, 0.03)
    truth = solve(replace(posed, harmonics=160, samples=4096))
    assert found.reached and measure_distance(found.solution, truth) <= 0.03
