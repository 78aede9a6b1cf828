"""Floquet multipliers of linear joints against closed forms: exponentials of their rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_floquet import FRICTIONLESS

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, frequency_response, solve

GIVEN = ContactLaws("prescribed", "frictionless", normal_force=0.1)


def gyroscope(damping: np.ndarray) -> ReducedModel:
    """Two masses, the first held by a pair that is pressed for good: linear where that stays closed."""
    stiffness = [[3.0, -1.0, -1.0], [-1.0, 2.0, 0.0], [-1.0, 0.0, 1.1]]
    return ReducedModel(
        mass=np.diag([1.0, 1.0, 0.0]),
        damping=np.pad(damping, (0, 1)),
        stiffness=stiffness,
        normal=[[0.0, 0.0, 1.0]],
        load={0: [0.0, 0.0, -5.0], 1: [0.2, 0.0, 0.0]},
        outputs={"tip": [1.0, 0.0, 0.0]},
    )


def rate_of_gyroscope(model: ReducedModel) -> np.ndarray:
    """Of deviations of its two masses and of their velocities: the matrix that these are multiplied by."""
    return np.block([[np.zeros((2, 2)), np.eye(2)], [-model.stiffness[:2, :2], -model.damping[:2, :2]]])


@pytest.mark.parametrize(
    ("damping", "grows"),
    [([[0.3, 1.6], [-1.6, -0.32]], True), ([[-0.2, 0], [0, 0.1]], True), ([[0.1, 0.5], [-0.5, 0.1]], False)],
)
def test_a_closed_pair_leaves_the_multipliers_of_a_linear_system(damping, grows):
    model = gyroscope(np.array(damping))
    found = solve(ContactProblem(model, FRICTIONLESS, 0.11, 9))
    exact = max(np.exp(np.linalg.eigvals(rate_of_gyroscope(model)) / 0.11), key=lambda m: (abs(m), m.imag))
    assert (abs(exact) > 1.1) == grows
    assert found.multiplier == pytest.approx(exact if grows else 0.0, rel=1e-9)
    assert found.unstable == grows


@pytest.mark.parametrize("mass", [1.0, 0.0])
@pytest.mark.parametrize("damping", [-0.05, 0.05])
@pytest.mark.parametrize("laws", [ContactLaws("bonded", "frictionless"), GIVEN])
def test_a_linear_joint_has_the_multipliers_of_its_free_vibrations(laws, damping, mass):
    """A third coordinate may have no mass, whose exponents are infinite."""
    model = ReducedModel(
        mass=np.diag([1.0, 1.0, mass]),
        damping=np.diag([0.1, damping, 0.0]),
        stiffness=np.diag([1.0, 2.0, 5.0]),
        normal=[[-1.0, 0.0, 0.0]],
        load={0: [0.5, 0.0, 0.0], 1: [0.1, 0.0, 0.0]},
        outputs={"tip": [1.0, 0.0, 0.0]},
    )
    found = solve(ContactProblem(model, laws, 0.1, 5))
    assert found.unknowns == 0 and found.unstable == (damping < 0)
    exact = np.exp(complex(-damping / 2, np.sqrt(2 - damping**2 / 4)) / 0.1)
    exact = complex(exact.real, abs(exact.imag)) if damping < 0 else 0.0
    assert found.multiplier == pytest.approx(exact, rel=1e-9)
    curve = frequency_response(model, laws, [0.1, 0.2], 5, progress=False)
    assert curve.unstable.tolist() == [damping < 0] * 2
    at_rest = solve(replace(found.problem, frequency=0.0, load={0: model.load[0]}, harmonics=0))
    assert at_rest.multiplier == 0 and not at_rest.unstable


@pytest.mark.parametrize(("mass", "exponent"), [(1.0, (5 + np.sqrt(21)) / 2), (0.0, 1 / 5)])
def test_a_linear_joint_may_run_away_without_vibrating(mass, exponent):
    """A dashpot of -5 on a spring of 1, with a mass and without."""
    model = ReducedModel(
        mass=np.diag([1.0, mass]),
        damping=np.diag([0.1, -5.0]),
        stiffness=np.diag([2.0, 1.0]),
        tangential=[[1.0, 0.0]],
        load={1: [0.1, 0.0]},
        outputs={"tip": [1.0, 0.0]},
    )
    found = solve(ContactProblem(model, GIVEN, 0.1, 5))
    assert found.multiplier == pytest.approx(np.exp(exponent / 0.1), rel=1e-9)


@pytest.mark.parametrize("ratio", [2.3, 6.3, 20.3])
def test_modes_above_the_harmonics_are_seen(ratio):
    """One that grows threefold a period, of a linear system; nine harmonics."""
    model = gyroscope(np.zeros((2, 2)))
    stiffness = model.stiffness[:2, :2]
    fastest = np.sqrt(np.linalg.eigvalsh(stiffness)[-1])
    frequency = fastest / ratio / (2 * np.pi)
    shape = np.linalg.eigh(stiffness)[1][:, -1]
    damping = np.pad(-2 * np.log(3.0) * frequency * np.outer(shape, shape), (0, 1))
    model = replace(model, damping=damping)
    found = solve(ContactProblem(model, FRICTIONLESS, frequency, 9))
    exact = max(np.exp(np.linalg.eigvals(rate_of_gyroscope(model)) / frequency), key=lambda m: (abs(m), m.imag))
    assert abs(exact) == pytest.approx(3.0, rel=0.01)
    assert found.multiplier == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("ratio", [25.0, 35.0, 200.0])
def test_a_linear_joint_is_unstable_however_far_above_its_harmonics_a_mode_is_fed(ratio):
    """Flutter far above a load: along a sweep, points were called unstable only from where five harmonics came near."""
    model = ReducedModel(
        mass=np.eye(2),
        damping=np.diag([0.05, -0.004 * ratio]),
        stiffness=np.diag([2.0, ratio**2]),
        normal=[[1.0, 0.0]],
        load={1: [1.0, 0.0]},
    )
    found = solve(ContactProblem(model, ContactLaws("bonded", "frictionless"), 1 / (2 * np.pi), 5))
    assert abs(found.multiplier) == pytest.approx(np.exp(0.002 * ratio * 2 * np.pi), rel=1e-5)
    assert found.unstable


def test_a_dashpot_in_line_with_a_spring_has_the_multipliers_of_a_linear_system():
    model = ReducedModel(
        mass=np.diag([1.0, 0.0, 0.0]),
        damping=np.diag([-0.1, 5.0, 0.0]),
        stiffness=[[3.0, -1.0, -1.0], [-1.0, 1.001, 0.0], [-1.0, 0.0, 1.0]],
        normal=[[0.0, 0.0, 1.0]],
        load={0: [0.0, 0.0, -5.0], 1: [0.2, 0.0, 0.0]},
    )
    state = [[0.0, 1.0, 0.0], [-3.0, 0.1, 1.0], [0.2, 0.0, -1.001 / 5]]  # position, velocity, between the two
    exact = max(np.exp(np.linalg.eigvals(state) / 0.2), key=lambda m: (abs(m), m.imag))
    assert abs(exact) > 1.08
    assert solve(ContactProblem(model, FRICTIONLESS, 0.2, 9)).multiplier == pytest.approx(exact, rel=1e-9)
