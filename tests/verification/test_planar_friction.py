"""Friction with two tangents a pair: closed forms, the law along a line, time stepping, and no preferred direction.

A mass that a rotating load drives moves in a circle, ``P^2 = ((k - m w^2) r)^2 + (c w r + F)^2``. Time stepping is
first order in the step where the direction of sliding turns, so that two runs extrapolate to a reference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from law_checks import lift_foot, ride_in_grooves
from small_models import block_on_feet, friction_oscillator, sled_in_a_plane

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.accuracy.accuracy import solve_to_accuracy
from ewr_fenicsx.errors import ModelError, NotConverged, UnheldBody
from ewr_fenicsx.laws.law_kinds import TANGENTS
from ewr_fenicsx.problem.dashpots import match_mobility
from ewr_fenicsx.solution.contact_state import OPEN, SLIP, STICK, classify_contact
from ewr_fenicsx.wear.archard import measure_wear_rate


def limited(limit: float | dict, **other) -> ContactLaws:
    """Friction under a given normal force, with a coefficient of one."""
    return ContactLaws("prescribed", normal_force=limit, friction=1.0, **other)


def turn_tangents(model: ReducedModel, angles: np.ndarray) -> ReducedModel:
    """The same structure with each pair's tangents turned in their plane."""
    first, second = model.rows("tangential"), model.rows("second_tangential")
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    turned = np.stack([cos * first + sin * second, cos * second - sin * first], axis=1)
    return replace(model, tangential=turned.reshape(model.tangential.shape))


def extrapolate(coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """What a first-order scheme tends to, from results with steps and with twice as many."""
    return 2 * fine - coarse


def step_sled(model: ReducedModel, limit: float, frequency: float, steps: int, periods: int) -> np.ndarray:
    """Amplitudes ``(4, 2)`` of a sled's steady motion, harmonics 0 to 3, by leapfrog steps of their own."""
    dt = 1 / (frequency * steps)
    tau = 2 * np.pi * (np.arange(steps) + 0.5) / steps
    pushes = np.real(sum(np.outer(np.exp(1j * h * tau), f) for h, f in model.load.items()))
    damping, springs = model.damping[0, 0], np.diag(model.stiffness)
    x, v = np.zeros(2), np.zeros(2)
    for _ in range(periods):
        way = []
        for push in pushes:
            x = x + 0.5 * dt * v
            way.append(x)
            free = v + 0.5 * dt * (push - springs * x)
            speed = np.hypot(*free)
            middle = free * max(0.0, 1 - 0.5 * dt * limit / speed) / (1 + 0.5 * dt * damping)
            v = 2 * middle - v
            x = x + 0.5 * dt * v
    orders = np.arange(4)
    return np.where(orders == 0, 1, 2)[:, None] * np.exp(-1j * np.outer(orders, tau)) @ np.array(way) / steps


@pytest.mark.parametrize("frequency", [0.1, 0.15, 0.25])
def test_under_a_rotating_load_it_is_a_circle(frequency):
    """Friction of constant size F against the speed, in every figure and history."""
    P, F, c, w = 1.0, 0.4, 0.1, 2 * np.pi * frequency
    sled = replace(sled_in_a_plane({1: [P, -1j * P]}, c), pair_area=[1.0])
    solution = solve(ContactProblem(sled, limited(F), frequency, 3), tolerance=1e-11)
    x, y = (solution.output(name)[1] for name in ("x", "y"))
    r = abs(x)
    assert ((1 - w**2) * r) ** 2 + (c * w * r + F) ** 2 == pytest.approx(P**2, rel=1e-9)
    assert y == pytest.approx(-1j * x, rel=1e-9), "a circle"
    assert solution.unknowns == 2 * 5, "two directions at harmonics 0, 1 and 3"
    np.testing.assert_allclose(solution.output("x")[2:], 0.0, atol=1e-9)
    merit = solution.merit
    assert merit["friction_dissipation"] == pytest.approx(2 * np.pi * r * F, rel=1e-9)
    assert merit["J_T"] == pytest.approx(2 * np.pi * r, rel=1e-9)
    assert abs(merit["energy_error"]) < 1e-9 and merit["cone_violation"] < 1e-9
    np.testing.assert_allclose(measure_wear_rate(solution, 1e-3), 1e-3 * F * 2 * np.pi * r, rtol=1e-9)
    assert np.all(classify_contact(solution, 64) == SLIP)
    for name in ("friction_force", "admissible_friction_force"):
        size = np.hypot(solution.history(name, 64), solution.history(f"second_{name}", 64))
        np.testing.assert_allclose(size, F, rtol=1e-9)
    np.testing.assert_allclose(
        np.hypot(solution.history("slip", 64), solution.history("second_slip", 64)), r, rtol=1e-9
    )


def test_a_rotating_load_below_the_limit_moves_nothing():
    solution = solve(ContactProblem(sled_in_a_plane({1: [0.39, -0.39j]}), limited(0.4), 0.15, 3))
    assert np.all(classify_contact(solution, 64) == STICK)
    assert solution.merit["J_T"] == 0 and abs(solution.output("x")[1]) < 1e-9
    size = np.hypot(solution.history("friction_force", 64), solution.history("second_friction_force", 64))
    np.testing.assert_allclose(size, 0.39, rtol=1e-8)


@pytest.mark.parametrize("angle", [0.0, 37.0, 90.0])
@pytest.mark.parametrize("static_friction", ["resolved", "zero"])
def test_along_a_line_it_is_the_law_of_one_tangent(angle, static_friction):
    """In whatever direction the load points, with a mean load and a normal force that varies: figures and states."""
    direction = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    load, laws = {0: 0.2, 1: 1.0, 2: 0.3j}, limited({0: 0.5, 1: 0.2j}, static_friction=static_friction)
    plane = solve(ContactProblem(sled_in_a_plane({h: f * direction for h, f in load.items()}), laws, 0.15, 7))
    line = solve(ContactProblem(friction_oscillator(damping=0.1, load=load), laws, 0.15, 7, closure="dashpot"))
    found = np.array([plane.output("x"), plane.output("y")])
    np.testing.assert_allclose(found, np.outer(direction, line.output("tip")), atol=1e-8)
    states = classify_contact(line, 512)
    assert {STICK, SLIP} == set(np.unique(states))
    assert np.mean(classify_contact(plane, 512) != states) < 0.005, "but for samples on the border"
    for name in ("cone_violation", "friction_dissipation", "excitation_work", "J_T"):
        assert plane.merit[name] == pytest.approx(line.merit[name], rel=2e-3 if name == "J_T" else 1e-6), name
    forces = np.array([plane.pair_forces[d][:, 0] for d in TANGENTS])
    np.testing.assert_allclose(forces, np.outer(direction, line.pair_forces["tangential"][:, 0]), atol=1e-7)
    if static_friction == "zero":
        assert np.all(forces[:, 0] == 0)


@pytest.mark.parametrize("limit", [0.2, 0.6])
def test_a_pair_that_a_guide_keeps_on_a_line_needs_a_first_tangent_that_sees_it(limit):
    """As in a plane of symmetry: a first tangent across the line is refused, and turned as told it is the law of one.

    A second tangent across the line is no tangent at all.
    """
    oscillator = friction_oscillator(damping=0.1, load={1: 1.0, 2: 0.5})
    at = lambda model: ContactProblem(model, limited(limit), 0.12, 9, rho_tangential=0.4)  # noqa: E731
    guided = replace(oscillator, normal=np.zeros((1, 1)), tangential=[[1.0], [0.0]])
    with pytest.raises(ModelError, match=r"the tangential row of pair 0 moves .* turn both tangents of the pair"):
        solve(at(replace(guided, tangential=[[0.0], [1.0]])))
    one, along = solve(at(oscillator)), solve(at(guided))
    np.testing.assert_allclose(along.forces, one.forces, atol=1e-9)
    turned = solve(at(turn_tangents(guided, np.array([np.pi / 4]))))
    np.testing.assert_allclose(turned.output("tip"), one.output("tip"), atol=1e-7 * abs(one.output("tip")[1]))
    across = turned.history("friction_force") + turned.history("second_friction_force")
    np.testing.assert_allclose(across, 0.0, atol=1e-6 * limit)


def test_time_stepping_tends_to_the_circle_at_first_order():
    P, F, c, w = 1.0, 0.4, 0.1, 2 * np.pi * 0.15
    off = []
    for steps in (100, 200, 400):
        steady = integrate(
            ContactProblem(sled_in_a_plane({1: [P, -1j * P]}, c), limited(F), 0.15, 3),
            "rest",
            steps,
            100,
            tolerance=1e-9,
        )
        assert steady.converged
        r = abs(steady.output("x")[1])
        assert steady.output("y")[1] == pytest.approx(-1j * steady.output("x")[1], rel=1e-8)
        np.testing.assert_allclose(np.hypot(*steady.last.impulses.T) / steady.scheme.dt, F, rtol=1e-8)
        forces = [steady.history(name) for name in ("friction_force", "second_friction_force")]
        np.testing.assert_allclose(np.hypot(*forces), F, rtol=1 - np.cos(np.pi / steps) + 1e-9)  # linear between steps
        off.append(((1 - w**2) * r) ** 2 + (c * w * r + F) ** 2 - P**2)
        work = steady.measure_energy()
        assert sum(work[name] for name in ("stored", "viscous", "friction")) == pytest.approx(work["excitation"])
    assert (
        off[0] < 0.02 and off[1] == pytest.approx(off[0] / 2, rel=0.2) and off[2] == pytest.approx(off[1] / 2, rel=0.1)
    )


@pytest.mark.parametrize(
    "load, limit, sticks, tolerance",
    [
        ({1: [1.0, -0.5j]}, 0.4, False, 1e-4),
        ({1: [1.0, 0.3 - 0.2j], 2: [0.3j, 0.1]}, 0.4, True, 8e-4),
        ({1: [1.0, 0.5j]}, 0.8, True, 4e-3),
    ],
)
def test_an_elliptic_load_against_two_time_steppers(load, limit, sticks, tolerance):
    """On unequal springs: the direction of sliding turns all the time, and in the last case the mass often sticks."""
    model = sled_in_a_plane(load, stiffness=(1.0, 2.0))
    problem = ContactProblem(model, limited(limit), 0.15, 63)
    few, solution = solve(replace(problem, harmonics=15)), solve(problem)
    assert np.any(classify_contact(solution, 512) == STICK) == sticks
    coarse, fine = (integrate(problem, solution, steps, 200, tolerance=1e-8) for steps in (800, 1600))
    read = lambda run: np.array([run.output(name)[:4] for name in ("x", "y")]).T  # noqa: E731
    stepped, extrapolated = step_sled(model, limit, 0.15, 800, 25), extrapolate(read(coarse), read(fine))
    size = np.abs(stepped).max()
    assert np.abs(extrapolated - stepped).max() < 2.5e-4 * size, "the references agree"
    assert np.abs(read(solution) - stepped).max() < tolerance * size
    assert np.abs(read(solution) - stepped).max() < 0.4 * np.abs(read(few) - stepped).max()
    assert abs(solution.merit["energy_error"]) < 1e-7
    assert solution.merit["friction_dissipation"] == pytest.approx(fine.measure_energy()["friction"], rel=4e-3)


@pytest.mark.parametrize(
    "pose, states, few, tolerance", [(lift_foot, {OPEN, SLIP}, 5, 5e-5), (ride_in_grooves, {STICK, SLIP}, 7, 1.5e-4)]
)
def test_under_a_normal_force_that_varies_against_time_stepping(pose, states, few, tolerance):
    """Contact that opens, and a floating body that its preload holds: outputs, forces in both directions, works."""
    rough, solution = pose(few), pose(31)
    assert not solution.fallbacks and set(np.unique(classify_contact(solution, 512))) == states
    coarse, fine = (integrate(solution.problem, solution, steps, 300, tolerance=1e-8) for steps in (800, 1600))
    assert coarse.converged and fine.converged
    names = list(solution.problem.model.outputs)
    read = lambda run: np.array([run.output(name)[:6] for name in names])  # noqa: E731
    expected = extrapolate(read(coarse), read(fine))
    size = np.abs(expected[:, 1:]).max()
    assert np.abs(read(solution) - expected).max() < tolerance * size
    assert np.abs(read(solution) - expected).max() < 0.3 * np.abs(read(rough) - expected).max()
    for name in ("friction_force", "second_friction_force", "second_slip", "second_slip_velocity", "normal_force"):
        ours, theirs = solution.history(name, 400), fine.history(name, 400)
        assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.01 * np.abs(theirs).max(), name
    merit, work = solution.merit, fine.measure_energy()
    assert merit["friction_dissipation"] == pytest.approx(work["friction"] + work["impact"], rel=3e-3)
    assert merit["J_T"] * solution.problem.frequency == pytest.approx(fine.sliding_speed().mean(), rel=3e-3)
    assert abs(merit["energy_error"]) < 1e-6


@settings(max_examples=12, deadline=None)
@given(st.lists(st.floats(0, 2 * np.pi), min_size=6, max_size=6), st.sampled_from(["resolved", "zero"]))
def test_no_direction_is_preferred(angles, static_friction):
    """Each pair's tangents turned by an angle of its own: the same motion, figures and states, and turned forces."""
    angles, plain = np.array(angles), ride_in_grooves(5).problem
    plain = replace(plain, laws=ContactLaws(friction=0.2, static_friction=static_friction))
    turned = replace(plain, model=turn_tangents(plain.model, angles))
    np.testing.assert_allclose(match_mobility(turned), match_mobility(plain), rtol=1e-9)
    here, there = solve(plain, tolerance=1e-11), solve(turned, tolerance=1e-11)
    for name in plain.model.outputs:
        np.testing.assert_allclose(there.output(name), here.output(name), atol=1e-8 * abs(here.output("x")[1]))
    forces, expected = (s.pair_forces["tangential"] + 1j * 0 for s in (there, here))
    second = here.pair_forces["second_tangential"]
    np.testing.assert_allclose(forces, np.cos(angles) * expected + np.sin(angles) * second, atol=1e-7)
    for name, value in here.merit.items():  # J_T counts samples, of which one may be on the border
        assert there.merit[name] == pytest.approx(value, rel=1e-2 if name == "J_T" else 1e-6, abs=1e-8), name


@pytest.mark.parametrize("angle", [0.0, 0.8, np.pi / 2])
def test_what_friction_carries_at_rest_is_told_whichever_way_it_points(angle):
    """A pair held in place takes nearly all of a mean load: 7 % of its limit are worth a word, 2 % are not."""
    way = np.array([np.cos(angle), np.sin(angle)])
    told, silent = (
        [line for line in solve(ContactProblem(model, limited(1.0), 0.0, 0)).cautions if "throughout" in line]
        for model in (sled_in_a_plane({0: share * way}) for share in (0.07, 0.02))
    )
    assert len(told) == 1 and "friction holds pair 0" in told[0] and "where they rest" in told[0]
    assert not silent


@pytest.mark.parametrize("stiffness", [(1.0, 2.0), (1e3, 1.0), (1.0, 0.0), (0.0, 0.0)])
def test_no_direction_is_preferred_whatever_bends_in_each(stiffness):
    """Springs in both directions, also far firmer in one, in one only, and in none: there the mass resists."""
    plain = ContactProblem(sled_in_a_plane({1: [1.0, 0.3 - 0.5j]}, stiffness=stiffness), limited(0.4), 0.15, 5)
    turned = replace(plain, model=turn_tangents(plain.model, np.array([0.5])))
    here, there = solve(plain, tolerance=1e-11), solve(turned, tolerance=1e-11)
    for name in ("x", "y"):
        np.testing.assert_allclose(there.output(name), here.output(name), atol=1e-8)
    for problem in (plain, turned):
        assert problem.system.laws[0].rho == problem.system.laws[1].rho


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, 2.0])
def test_a_body_hangs_on_friction_up_to_the_limit_in_every_direction(angle):
    """At rest on a plane under a mean load of up to ``mu`` times its weight, whichever way that points."""
    pull = 0.4 * 3.0 * np.array([np.cos(angle), np.sin(angle)])
    pose = lambda share: ContactProblem(  # noqa: E731
        block_on_feet({0: [*(share * pull), -3.0, 0.4 * share * pull[1], -0.4 * share * pull[0], 0.0]}),
        ContactLaws(friction=0.4), 0.6, 3,
    )  # fmt: skip
    held = solve(pose(0.98))
    model = held.problem.model
    on_feet = sum(model.rows(d).T @ held.pair_forces[d][0].real for d in ("normal", *TANGENTS))[6:].reshape(6, 3)
    np.testing.assert_allclose(on_feet.sum(axis=0), [*(-0.98 * pull), 3.0], atol=1e-6)
    with pytest.raises(UnheldBody, match=r"nothing holds a floating body: .* rigid motion that slides along pair"):
        pose(1.02).system  # noqa: B018
    with pytest.raises(UnheldBody, match="move without any contact noticing"):
        replace(pose(0.5), laws=ContactLaws(friction=0.4, static_friction="zero")).system  # noqa: B018


def test_a_body_that_slides_in_a_plane_under_a_mean_load_walks():
    model = block_on_feet({0: [0.1, 0.1, -3.0, 0.0, 0.0, 0.0], 1: [1.2, 0.8j, 0.2, 0.0, 0.0, 0.3]})
    problem = ContactProblem(model, ContactLaws(friction=0.4), 0.6, 5)
    with pytest.raises(NotConverged, match="a body that hangs on friction walks"):
        solve(problem)
    steady = integrate(problem, steps=400, periods=30)
    assert not steady.converged and "a body walks" in steady.reason


def test_an_accuracy_is_reached_in_a_plane():
    model = sled_in_a_plane({1: [1.0, 0.5j]}, stiffness=(1.0, 2.0))
    found = solve_to_accuracy(ContactProblem(model, limited(0.8), 0.15, 5), 0.005)
    stepped = step_sled(model, 0.8, 0.15, 800, 25)
    for j, name in enumerate(("x", "y")):
        assert np.abs(found.solution.output(name)[:4] - stepped[:, j]).max() < 0.01 * np.abs(stepped[:, j]).max()
