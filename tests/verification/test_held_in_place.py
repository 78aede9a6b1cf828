"""``static_friction = "held"``: pairs that stick throughout carry what a slow loading from rest leaves them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, Tolerance, evolve_wear, integrate, solve
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.in_time.time_stepping import State
from ewr_fenicsx.response.following import agree, solve_from
from ewr_fenicsx.solution.loading_history import find_stuck
from ewr_fenicsx.solver import initial_states, snes

PULL, NORMAL, ALONG, CLAMP = 200.0, 1e6, 2e6, 1e6  # N; stiffness of the flank, along it, and of the clamp [N/m]
GROUND = 2e5
LIMIT = 0.3


def clamped_flank(shake: float) -> ReducedModel:
    """A mass pulled onto a flank across x, on which it rubs along y, and clamped along x by friction.

    Coordinates: the mass in x and y, then massless surfaces: the flank's, across and along, and the clamp's.
    """
    stiffness = np.zeros((5, 5))
    for at, k in (([0], GROUND), ([1], 1e6), ([0, 2], NORMAL), ([1, 3], ALONG), ([0, 4], CLAMP)):
        row = np.zeros(5)
        row[at] = [1.0, -1.0][: len(at)]
        stiffness += k * np.outer(row, row)
    return ReducedModel(
        mass=np.diag([1.0, 1.0, 0, 0, 0]),
        damping=np.diag([60.0, 20.0, 0, 0, 0]),
        stiffness=stiffness,
        normal=[[0, 0, 1.0, 0, 0], [0, 0, 0, 0, 0]],
        tangential=[[0, 0, 0, 1.0, 0], [0, 0, 0, 0, 1.0]],
        load={0: [-PULL, 0, 0, 0, 0], 1: [0, shake, 0, 0, 0]},
        outputs={"y": [0, 1.0, 0, 0, 0]},
        pair_area=[1e-4, 1e-4],
    )


def held_mass(pull: float, shake: float, harmonics: int = 5, closure: str = "mass") -> ContactProblem:
    """A mass of 1 kg on a spring of 1 N/m that rubs on a wall with ``LIMIT`` [N] at most, pulled and shaken [N]."""
    model = ReducedModel(
        [[1.0]], [[0.05]], [[1.0]], tangential=[[1.0]], load={0: [pull], 1: [shake]}, outputs={"tip": [1.0]}
    )
    laws = ContactLaws("prescribed", normal_force=1.0, friction=LIMIT, static_friction="held")
    return ContactProblem(model, laws, 0.1, harmonics, closure=closure)


def clamp(static_friction: str = "held", tangential: str = "coulomb", squeeze: float = 1000.0) -> list:
    """The laws of the flank, on which all the loads act, and of the clamp, whose limit is half of its squeeze."""
    flank = ContactLaws(friction=0.4, static_friction=static_friction)
    given = {"normal": "prescribed", "normal_force": squeeze, "tangential": tangential}
    return [([0], flank), ([1], ContactLaws(friction=0.5, static_friction=static_friction, **given))]


def pose(shake: float, laws: list, harmonics: int = 15) -> ContactProblem:
    return ContactProblem(clamped_flank(shake), laws, 170.0, harmonics)


def swing(solution) -> float:
    return float(np.abs(solution.output("y")[1]))


@pytest.mark.parametrize("shake", [20.0, 40.0, 60.0, 100.0])
def test_a_clamp_that_sticks_is_as_good_as_bonded(shake):
    held, bonded = solve(pose(shake, clamp())), solve(pose(shake, clamp(tangential="bonded")))
    firm = solve(pose(shake, clamp(squeeze=1e6)))
    for solution in (held, firm):
        assert swing(solution) == pytest.approx(swing(bonded), rel=1e-3)
        assert solution.history("friction_force")[:, 1].mean() == pytest.approx(PULL * CLAMP / 2.2e6, rel=1e-3)
    assert held.history("normal_force")[:, 0].mean() == pytest.approx(PULL * NORMAL / 2.2e6, rel=1e-3)
    assert held.merit["friction_dissipation"] == pytest.approx(bonded.merit["friction_dissipation"], rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("shake", [40.0, 60.0, 100.0])
def test_it_is_where_time_stepping_comes_to_from_rest(shake):
    problem = pose(shake, clamp())
    loaded = np.zeros(5)
    loaded[0] = -PULL / (GROUND + NORMAL + CLAMP)
    for start in ("rest", State(loaded, np.zeros(5))):
        steady = integrate(problem, start, periods=400, tolerance=1e-6)
        assert steady.converged
        assert swing(solve(problem, accuracy=0.01)) == pytest.approx(float(np.abs(steady.output("y")[1])), rel=0.01)


def test_without_it_the_answer_is_another_and_says_that_it_is_open():
    least = solve(pose(60.0, clamp("resolved")))
    assert swing(solve(pose(60.0, clamp()))) > 9 * swing(least)
    (told,) = (line for line in least.cautions if "depends on how the loads came" in line)
    assert "friction holds pair 1 throughout" in told and "normal forces" in told and 'static_friction = "held"' in told
    assert not any("how the loads came" in line for line in solve(pose(60.0, clamp())).cautions)


def test_of_pairs_that_rest_along_a_second_tangent_as_many_are_named():
    """At those no row of the second tangent tells what they carry."""
    problem = pose(10.0, clamp("resolved"))
    rows = np.stack([problem.model.tangential, np.zeros_like(problem.model.tangential)], axis=1)
    solid = replace(problem.model, tangential=rows.reshape(-1, problem.model.size))
    one, other = (solve(posed).cautions for posed in (problem, replace(problem, model=solid)))
    assert any("friction holds pair 1 throughout" in line for line in one)
    assert other == one


def test_what_a_pair_may_carry_is_its_least_limit_over_the_period():
    """Under 100 N and 40 N that come and go it rubs with 30 N to 70 N."""
    problem = shaken_node(0.01, 10.0)
    varying = ContactLaws("prescribed", normal_force={0: 100.0, 1: 40.0}, friction=0.5)
    found = solve(replace(problem, laws=varying))
    pairs, limit = find_stuck(found.pose()[0], found)
    assert pairs.tolist() == [0] and limit == pytest.approx([30.0], rel=1e-12)


def test_it_is_open_as_well_where_a_lightly_pressed_pair_slides_otherwise():
    """A pair that sticks under a large interference decides how two others slide, of which one is far lighter pressed.

    The largest normal force is another pair's, and hardly changes. Two masses, and springs along the directions of
    their contact rows: normals of three pairs, then their tangents.
    """
    to_rows = 1e3 * np.array(
        [[293.2, 52.8, 264.4, -176.2, 157.9, 235.2], [-187.8, 446.3, 155.5, -275.1, -18.7, -399.9]]
    )
    at_rows = 1e3 * np.array([348.2, 449.5, 306.8, 326.7, 159.0, 463.9])
    of_masses = 1e3 * np.array([[954.9, -45.4], [-45.4, 1308.7]])
    stiffness = np.block([[of_masses, to_rows], [to_rows.T, np.diag(at_rows)]])
    mass, damping = np.zeros((2, 8, 8))
    mass[:2, :2], damping[:2, :2] = np.diag([1.583, 0.569]), [[52.2, -0.2], [-0.2, 32.7]]
    load = {0: np.zeros(8), 3: np.zeros(8, dtype=complex)}
    load[0][:2], load[3][:2] = [56.7, 95.3], [16.4 - 44.3j, 33.3 - 82.4j]
    rows = np.eye(8)
    model = ReducedModel(mass, damping, stiffness, normal=rows[2:5], tangential=rows[5:], load=load)
    work, told = {}, {}
    for static_friction in ("resolved", "held"):
        rubs = {"friction": 0.505, "static_friction": static_friction}
        pressed = ContactLaws(initial_gap=-8.6e-4, **rubs)
        laws = [([0, 2], ContactLaws("bonded", "coulomb", **rubs)), ([1], pressed)]
        solution = solve(ContactProblem(model, laws, 31.2, harmonics=15, closure="spring"))
        work[static_friction] = solution.merit["friction_dissipation"]
        told[static_friction] = [line for line in solution.cautions if "friction holds pair 1 throughout" in line]
    assert work["held"] > 1.5 * work["resolved"] > 0
    assert len(told["resolved"]) == 1 and not told["held"]


def test_one_whose_pairs_all_slip_is_not_open():
    slips = solve(ContactProblem(dovetail(excitation=400.0), ContactLaws(friction=0.05), 900.0))
    assert not any("how the loads came" in line for line in slips.cautions)
    sticks = solve(ContactProblem(dovetail(excitation=10.0), ContactLaws(friction=0.3), 900.0))
    assert any("how the loads came" in line for line in sticks.cautions)


@pytest.mark.parametrize("squeeze, place", [(1000.0, 0.0), (200.0, 4e-5), (0.0, 1e-4)])
def test_a_static_load_moves_what_friction_does_not_hold(squeeze, place):
    model = ReducedModel([[1.0]], [[20.0]], [[1e6]], None, [[1.0]], {0: [100.0]}, outputs={"x": [1.0]})
    laws = ContactLaws("prescribed", normal_force=squeeze, friction=0.3, static_friction="held")
    found = solve(ContactProblem(model, laws, 0.0))
    assert found.output("x")[0].real == pytest.approx(place, rel=1e-5, abs=1e-10)
    least = solve(replace(found.problem, laws=replace(laws, static_friction="resolved")))
    assert least.output("x")[0].real == pytest.approx(1e-4)
    assert any("where they rest" in line for line in least.cautions) == (squeeze > 0)


@pytest.mark.parametrize("friction", [1e-4, 1e-3, 5e-3])
def test_a_blade_under_next_to_no_friction_comes_to_rest_as_without(friction):
    """It slides far beside what friction could draw out, which was taken for a body that walks."""
    glides = solve(ContactProblem(dovetail(excitation=0.0), ContactLaws(tangential="frictionless"), 0.0))
    found = solve(replace(glides.problem, laws=ContactLaws(friction=friction, static_friction="held")))
    normal, rubbing = (found.history(name, 1)[0] for name in ("normal_force", "friction_force"))
    assert normal == pytest.approx(glides.history("normal_force", 1)[0], rel=2 * friction)
    assert rubbing == pytest.approx(friction * normal * np.repeat([-1.0, 1.0], 3), rel=2e-3)


def shaken_node(damping: float, mean: float) -> ContactProblem:
    """A mass at its resonance with a surface that sticks: its force swings by 20 N of a limit of 50 N."""
    ground, spring = 1e5, 9e5
    omega = np.sqrt(ground + spring)
    stiffness = np.array([[ground + spring, -spring], [-spring, spring]])
    shake = 20.0 * 2 * damping * (ground + spring) / spring
    model = ReducedModel(
        np.diag([1.0, 0.0]),
        2 * damping / omega * stiffness,
        stiffness,
        None,
        [[0.0, 1.0]],
        {0: [mean, 0.0], 1: [shake, 0.0]},
        outputs={"x": [1.0, 0.0]},
    )
    laws = ContactLaws("prescribed", normal_force=100.0, friction=0.5, static_friction="held")
    return ContactProblem(model, laws, omega / 2 / np.pi, 15)


@pytest.mark.parametrize("closure", ["mass", "dashpot", "spring"])
@pytest.mark.parametrize("mean, carried, place", [(20.0, 18.0, 2e-5), (60.0, 30.0, 3e-4)])
def test_vibration_shakes_down_what_the_limit_does_not_allow(mean, carried, place, closure):
    """Of 60 N friction would hold 54 N. Beside the 20 N of the vibration its limit allows 30 N.

    Nothing slips any more in the steady state: the amplitude is that of the stuck joint, at any damping.
    """
    found = solve(replace(shaken_node(1e-3, mean), closure=closure))
    assert found.history("friction_force").mean() == pytest.approx(-carried, rel=2e-3)
    assert found.output("x")[0].real == pytest.approx(place, rel=2e-3)
    assert np.abs(found.output("x")[1]) == pytest.approx(20.0 / 9e5, rel=2e-3)


@pytest.mark.parametrize("damping, lost", [(1e-2, 2e-4), (1e-3, 2e-3), (2e-4, 1e-2)])
def test_creep_of_pairs_at_their_limit_takes_next_to_nothing(damping, lost):
    found = solve(shaken_node(damping, 60.0))
    assert 1 - np.abs(found.output("x")[1]) / (20.0 / 9e5) == pytest.approx(lost / 2, abs=lost / 2)


@pytest.mark.parametrize("frequency", [600.0, 900.0])
def test_starts_lead_to_the_same_state(frequency):
    laws = ContactLaws(friction=0.2, static_friction="held")
    problem = ContactProblem(dovetail(excitation=100.0), laws, frequency, 5)
    cold = solve(problem)
    near = solve(replace(problem, laws=replace(laws, static_friction="resolved")))
    warm = solve(problem, start=near)
    np.testing.assert_allclose(warm.forces, cold.forces, atol=1e-5 * np.abs(cold.forces).max())
    assert np.linalg.norm(near.forces[0] - cold.forces[0]) > 0.03 * np.linalg.norm(cold.forces[0])


@pytest.mark.parametrize("frequency", [800.0, 950.0, 1050.0])
def test_a_neighbour_knows_where_springs_hold_its_pairs(frequency):
    """Firmer springs, from which a cold start begins, moved them: ten Newton steps more, and curves that crept."""
    laws = ContactLaws(friction=0.3, static_friction="held")
    begun = solve(ContactProblem(dovetail(excitation=400.0), laws, frequency, 15))
    found = solve_from(replace(begun.problem, frequency=frequency + 1.0), begun)
    assert found.converged and found.iterations < 4
    assert agree(found, solve(found.problem))


def test_a_pair_that_holds_takes_over_what_another_wears_off():
    """The flank stops to wear when the clamp carries all that the ground does not: by a closed form."""
    worn = evolve_wear(pose(100.0, clamp(), 9), 2000, 3e-10, Tolerance(share=0.02), progress=False)
    spent = PULL / (GROUND + CLAMP)  # approach at which the flank carries nothing [m]
    assert worn.depth[-1][0] == pytest.approx(spent, rel=0.01)
    assert worn.solutions[-1].history("friction_force")[:, 1].mean() == pytest.approx(CLAMP * spent, rel=0.01)


@pytest.mark.parametrize("harmonics", [3, 25])
@pytest.mark.parametrize("closure", ["mass", "dashpot"])
def test_a_motion_from_rest_begins_where_friction_leaves_a_static_load(harmonics, closure):
    """With more than five harmonics the static solution was not found, and it began at full stick, without a word."""
    problem = held_mass(1.0, 0.05, harmonics, closure)
    for start in ("rest", None):
        steady = integrate(problem, start)
        assert steady.transient("tip")[0] == pytest.approx(1.0 - LIMIT, rel=1e-6)
        assert steady.converged and steady.output("tip")[0].real == pytest.approx(1.0 - LIMIT, rel=0.1)


def test_no_rest_is_made_up_where_friction_holds(monkeypatch):
    monkeypatch.setattr(initial_states, "find_rest", lambda problem: (None, 0))
    with pytest.raises(ModelError, match="no static solution of the laws was found; give"):
        integrate(held_mass(1.0, 0.05), "rest", steps=100, periods=1)


def test_a_mass_that_friction_holds_still_does_not_walk():
    """Its rounding ended elsewhere each period, with the same velocities, which was told as a body that walks."""
    steady = integrate(held_mass(0.2, 0.05), "rest", steps=2000, periods=300, tolerance=1e-8)
    assert "walks" not in steady.reason and np.abs(steady.output("tip")).max() < 1e-9


def test_a_softened_balance_that_is_solved_is_said_to_be(monkeypatch):
    """The run before it, of a firmer one, may have left as little: that passed for the best, and for no solution."""
    rng = np.random.default_rng(332)
    rough = rng.normal(size=(3, 3))
    stiffness, along = rough @ rough.T + 0.1 * np.eye(3), rng.normal(size=(3, 3))
    load = {0: 3 * rng.normal(size=3), 1: rng.normal(size=3)}
    model = ReducedModel(0.05 * np.eye(3), 0.02 * stiffness, stiffness, tangential=along, load=load)
    limits = rng.uniform(0.1, 2, 3)
    laws = ContactLaws("prescribed", normal_force=limits, friction=0.3, static_friction="held")
    ended = []
    soften = snes._soften
    monkeypatch.setattr(snes, "_soften", lambda *given: ended.append(soften(*given)) or ended[-1])
    assert solve(ContactProblem(model, laws, 0.2, 5, closure="dashpot"), tolerance=1e-5).converged
    (attempts,) = ended
    left = sorted(attempt.residual for attempt in attempts)
    assert left[0] == left[1], "the case that this is about"
    assert min(attempts).converged
