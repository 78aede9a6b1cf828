"""A body that friction alone holds, shaken at the resonance of the stuck joint: what its pairs creep must not damp it.

A block of 1 kg is pressed on two massless contact nodes on springs. A moment shifts the normal force from one to the
other and back, 50 N each on average; a force along the ground shakes the block. Sideways and upright motion are
uncoupled, so friction acts under given normal forces and the oscillation is unique. Stuck throughout, with mean
friction forces of a few newtons, one in each direction, all laws hold: the amplitude is that of the linear joint.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, Scene, integrate, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.structure.chain import build_chain

BUSH = Path(__file__).parents[1] / "geometry" / "bush.py"

STIFFNESS, ARM, FRICTION, SIDEWAYS = 1e7, 0.05, 0.3, 25.0  # N/m, m, -, N


def shaken_block(damping: float, suspension: float = 0.0) -> tuple[ContactProblem, float]:
    """The joint, by the damping ratio of its stuck mode, and the exact amplitude of the block [m]."""
    k = STIFFNESS
    omega = np.sqrt(2 * k + suspension)
    dashpot = 2 * damping / omega  # over the stiffness
    normal, tangential = np.zeros((2, 2, 7))  # x, y, rotation; per node along and across
    for i, arm in enumerate((-ARM, ARM)):
        normal[i, [1, 2, 4 + 2 * i]] = 1, arm, -1
        tangential[i, [0, 3 + 2 * i]] = 1, -1
    amplitude = SIDEWAYS / (2 * k)
    force = amplitude * (2 * k * (1 + 1j * omega * dashpot) + suspension - omega**2)
    model = ReducedModel(
        mass=np.diag([1, 1, 1e-3, 0, 0, 0, 0]),
        damping=dashpot * np.diag([0, 0, 0, k, k, k, k]),
        stiffness=np.diag([suspension, 0, 0, k, k, k, k]),
        normal=normal,
        tangential=tangential,
        load={0: [0, -100, 0, 0, 0, 0, 0], 1: [force, 0, 1.6, 0, 0, 0, 0]},
        outputs={"x": np.eye(7)[0]},
    )
    return ContactProblem(model, ContactLaws(friction=FRICTION), omega / (2 * np.pi)), amplitude


@pytest.mark.parametrize("damping", [2e-3, 2e-4])
@pytest.mark.parametrize("harmonics", [5, 15])
def test_pairs_that_stick_with_a_mean_force_do_not_damp_a_resonance(damping, harmonics):
    """With a hundred times the share of the mean force in its equation 4 and 22 % of the amplitude were lost."""
    problem, amplitude = shaken_block(damping)
    solution = solve(replace(problem, harmonics=harmonics))
    assert np.any(solution.problem.system.laws[-1].static_displacement_row > 0), "it hangs on friction"
    assert abs(solution.output("x")[1]) == pytest.approx(amplitude, rel=1e-6 / damping)
    assert abs(np.mean(solution.history("friction_force")[:, 0])) > 4.0, "without a mean force its pairs would slip"
    assert solution.merit["friction_dissipation"] < 1e-6 / damping * solution.merit["excitation_work"]
    assert solution.cautions == ()


@pytest.mark.parametrize("damping", [2e-3, 2e-4])
def test_an_accuracy_of_such_a_body_is_true(damping):
    """The weight that an accuracy raises made pairs creep more: 1 % was "reached" where 13 and 36 % were lost."""
    problem, amplitude = shaken_block(damping)
    solution = solve(problem, accuracy=0.01)
    assert not solution.short and solution.estimated_error <= 0.01
    assert abs(solution.output("x")[1]) == pytest.approx(amplitude, rel=0.01)


@pytest.mark.parametrize("suspension", [1e2, 1e4, 1e6])
def test_a_soft_suspension_does_not_weigh_friction(suspension):
    """The default weight went by the static flexibility, here that of a spring a thousand times as soft as contact.

    At 5 Hz of suspension under 712 Hz of vibration 44 % of the amplitude were lost, at any number of harmonics.
    """
    problem, amplitude = shaken_block(1e-3, suspension)
    solution = solve(problem)
    assert abs(solution.output("x")[1]) == pytest.approx(amplitude, rel=3e-3)
    assert not solution.fallbacks


def test_a_pin_in_a_part_of_a_bore_hangs_on_friction_whatever_its_mesh():
    """The normal at the last node was askew: the pin turned until that jammed, and sank a tenth more or less."""
    sunk, shaken = {}, {}
    for around, order in ((16, 1), (16, 2), (32, 2)):
        scene = Scene(
            geometry={"source": BUSH, "parameters": {"around": around, "order": order, "quarters": 2}},
            elasticity={"degree": order},
            contact={"flanks": ["joint"], "friction": 0.3},
            loads={
                "press": {"boundary": "tip", "force": [0.0, 1000.0]},
                "shake": {"boundary": "tip", "force": [200.0, 0.0], "harmonic": 1},
            },
            outputs={axis: {"boundary": "tip", "direction": way} for axis, way in (("x", [1, 0]), ("y", [0, 1]))},
            excitation={"frequency": 3000.0},
        )
        solution = solve(build_chain(scene).pose())
        sunk[around, order] = solution.output("y")[0].real
        shaken[around, order] = abs(solution.output("x")[1])
    assert sunk[16, 1] == pytest.approx(sunk[32, 2], rel=0.03) and sunk[16, 2] == pytest.approx(sunk[32, 2], rel=0.01)
    assert shaken[16, 2] == pytest.approx(shaken[32, 2], rel=0.03)


def stuck_node(damping: float = 1e-3) -> tuple[ContactProblem, float]:
    """A mass on a spring whose other end, without mass, sticks to a wall: at its resonance, and the amplitude [m]."""
    omega = np.sqrt(STIFFNESS)
    model = ReducedModel(
        mass=np.diag([1.0, 0.0]),
        damping=np.diag([2 * damping * omega, 0.0]),
        stiffness=STIFFNESS * np.array([[1.0, -1.0], [-1.0, 1.0]]),
        tangential=[[0.0, 1.0]],
        load={1: [1.0, 0.0]},
        outputs={"x": [1.0, 0.0]},
    )
    laws = ContactLaws("prescribed", normal_force=1e6, friction=FRICTION)
    return ContactProblem(model, laws, omega / (2 * np.pi)), 1 / (2 * damping * STIFFNESS)


def test_time_stepping_adds_no_damping_where_massless_nodes_stick():
    """Their modes follow by a theta of their own, and crept: 28 % of the amplitude were lost with 800 steps."""
    (problem, exact), error = stuck_node(), {}
    for steps in (400, 800):
        steady = integrate(problem, solve(problem), steps, 2000, tolerance=1e-7)
        assert steady.converged
        error[steps] = abs(abs(steady.output("x")[1]) / exact - 1)
    assert error[800] < 2e-4 and error[800] < error[400] / 3.5, "of second order"
    assert np.ptp(steady.history("slip")) < 1e-4 * exact, "it sticks"


@pytest.mark.parametrize(("steps", "error"), [(400, 1e-3), (800, 3e-4)])
def test_time_stepping_keeps_a_body_that_friction_holds(steps, error):
    """It lost 16 % with 1600 steps a period."""
    problem, amplitude = shaken_block(2e-3)
    steady = integrate(problem, solve(problem), steps, 2000)
    assert steady.converged and abs(steady.output("x")[1]) == pytest.approx(amplitude, rel=error)


def test_the_first_stage_of_a_solve_shares_a_load_as_the_last_one_does():
    """It takes more of the mean force in its equations; with no more of the springs, the second stage crept."""
    problem, _ = shaken_block(2e-3)
    balance = HarmonicBalance(replace(problem, load={**problem.loads, 0: np.array([5.0, -100, 0, 0, 0, 0, 0])}).system)
    held = balance.static_displacement_row > 0
    for stage in (balance, balance.firm):
        share = stage.static_displacement_row[held] * balance.system.flexibility[held]
        np.testing.assert_allclose(share, stage.static_force_row[held], rtol=1e-12)
    assert np.all(balance.firm.static_force_row[held] > 50 * balance.static_force_row[held])
