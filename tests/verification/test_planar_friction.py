"""Friction with two tangents a pair: closed forms, the law along a line, time stepping, and no preferred direction.

A mass that a rotating load drives moves in a circle, ``P^2 = ((k - m w^2) r)^2 + (c w r + F)^2``. Time stepping is first
order in the step where the direction of sliding turns, so that two runs extrapolate to a reference.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_models import friction_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve, time_stepping
from ewr_fenicsx.accuracy import solve_to_accuracy
from ewr_fenicsx.archard import measure_wear_rate
from ewr_fenicsx.balance import HarmonicBalance
from ewr_fenicsx.contact_state import OPEN, SLIP, STICK, classify_contact, list_histories
from ewr_fenicsx.errors import ModelError, NotConverged, UnheldBody
from ewr_fenicsx.estimates import match_mobility
from ewr_fenicsx.interface import Interface
from ewr_fenicsx.law_kinds import Motion
from ewr_fenicsx.output import contact_fields, write_pairs
from ewr_fenicsx.planar_coulomb import PLANE, PlanarCoulomb
from ewr_fenicsx.smoothing import round_corners
from ewr_fenicsx.solution import PeriodicSolution
from ewr_fenicsx.time_integration import SteadyState


def sled(load: dict[int, object], damping: float = 0.1, stiffness: tuple[float, float] = (1.0, 1.0)) -> ReducedModel:
    """A mass on springs in a plane, rubbing in both directions."""
    return ReducedModel(
        mass=np.eye(2),
        damping=damping * np.eye(2),
        stiffness=np.diag(stiffness),
        normal=np.zeros((1, 2)),
        tangential=np.eye(2),
        load=load,
        outputs={"x": [1.0, 0.0], "y": [0.0, 1.0]},
    )


def limited(limit: float | dict, **other) -> ContactLaws:
    """Friction under a given normal force, with a coefficient of one."""
    return ContactLaws("prescribed", normal_force=limit, friction=1.0, **other)


def foot_on_the_ground(excitation: complex = 2.0) -> ReducedModel:
    """A mass on an oblique spring; its massless foot is pressed on the ground, rubs in a plane and lifts off.

    Coordinates ``(x, y, z)`` of the mass, then of the foot.
    """
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    spring = turn @ np.diag([0.8, 1.0, 1.4]) @ turn.T
    stiffness = np.block([[spring, -spring], [-spring, spring]]) + np.diag([1.0, 1.2, 1.5, 0.1, 0.15, 0.2])
    mass, each = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), np.eye(6)
    return ReducedModel(
        mass=mass,
        damping=0.03 * (stiffness + mass),
        stiffness=stiffness,
        normal=each[5:],
        tangential=each[3:5],
        load={0: -each[5], 1: excitation * np.array([0.8, 0.4j, 0.5j, 0.0, 0.0, 0.0])},
        outputs={"x": each[0], "y": each[1], "z": each[2]},
    )


def block_on_feet(load: dict[int, object], pairs: int = 3) -> ReducedModel:
    """A rigid block that floats in space, with massless feet on springs: only contact holds it.

    Coordinates: the block's motion ``(x, y, z)`` and its turn about each axis, then ``(x, y, z)`` of each foot. ``load``
    acts on the block, ``(6,)`` a harmonic.
    """
    rng, size = np.random.default_rng(4), 6 + 3 * pairs
    stiffness = np.zeros((size, size))
    for k in range(pairs):
        x, y, z = np.cos(2 * np.pi * k / pairs), np.sin(2 * np.pi * k / pairs), -0.4
        ride = np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]])
        stretch = np.zeros((3, size))
        stretch[:, :6], stretch[:, 6 + 3 * k : 9 + 3 * k] = ride, -np.eye(3)
        stiffness += stretch.T @ np.diag(rng.uniform(30.0, 60.0, 3)) @ stretch
    mass = np.diag([1.0, 1.0, 1.0, 0.3, 0.35, 0.5, *np.zeros(3 * pairs)])
    each = np.eye(size)
    feet = each[6:].reshape(pairs, 3, size)
    return ReducedModel(
        mass=mass,
        damping=0.02 * mass + 0.01 * stiffness,
        stiffness=stiffness,
        normal=feet[:, 2],
        tangential=feet[:, :2].reshape(2 * pairs, size),
        load={h: np.concatenate([np.asarray(f), np.zeros(3 * pairs)]) for h, f in load.items()},
        outputs={"x": each[0], "y": each[1], "turn": each[5]},
    )


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
    solution = solve(ContactProblem(sled({1: [P, -1j * P]}, c), limited(F), frequency, 3), tolerance=1e-11)
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
    np.testing.assert_allclose(np.hypot(solution.history("slip", 64), solution.history("second_slip", 64)), r, rtol=1e-9)


def test_a_rotating_load_below_the_limit_moves_nothing():
    solution = solve(ContactProblem(sled({1: [0.39, -0.39j]}), limited(0.4), 0.15, 3))
    assert np.all(classify_contact(solution, 64) == STICK)
    assert solution.merit["J_T"] == 0 and abs(solution.output("x")[1]) < 1e-9
    size = np.hypot(solution.history("friction_force", 64), solution.history("second_friction_force", 64))
    np.testing.assert_allclose(size, 0.39, rtol=1e-8)


@pytest.mark.parametrize("angle", [0.0, 37.0, 90.0])
@pytest.mark.parametrize("static_friction", ["resolved", "zero"])
def test_along_a_line_it_is_the_law_of_one_tangent(angle, static_friction):
    """In whatever direction the load points, with a mean load and a normal force that varies: all figures and states."""
    direction = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    load, laws = {0: 0.2, 1: 1.0, 2: 0.3j}, limited({0: 0.5, 1: 0.2j}, static_friction=static_friction)
    plane = solve(ContactProblem(sled({h: f * direction for h, f in load.items()}), laws, 0.15, 7))
    line = solve(ContactProblem(friction_oscillator(damping=0.1, load=load), laws, 0.15, 7))
    found = np.array([plane.output("x"), plane.output("y")])
    np.testing.assert_allclose(found, np.outer(direction, line.output("tip")), atol=1e-8)
    states = classify_contact(line, 512)
    assert {STICK, SLIP} == set(np.unique(states))
    assert np.mean(classify_contact(plane, 512) != states) < 0.005, "but for samples on the border"
    for name in ("cone_violation", "friction_dissipation", "excitation_work", "J_T"):
        assert plane.merit[name] == pytest.approx(line.merit[name], rel=2e-3 if name == "J_T" else 1e-6), name
    forces = np.array([plane.pair_forces[d][:, 0] for d in PLANE])
    np.testing.assert_allclose(forces, np.outer(direction, line.pair_forces["tangential"][:, 0]), atol=1e-7)
    if static_friction == "zero":
        assert np.all(forces[:, 0] == 0)


def test_time_stepping_tends_to_the_circle_at_first_order():
    P, F, c, w = 1.0, 0.4, 0.1, 2 * np.pi * 0.15
    off = []
    for steps in (100, 200, 400):
        steady = integrate(
            ContactProblem(sled({1: [P, -1j * P]}, c), limited(F), 0.15, 3), "rest", steps, 100, tolerance=1e-9
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
    assert off[0] < 0.02 and off[1] == pytest.approx(off[0] / 2, rel=0.2) and off[2] == pytest.approx(off[1] / 2, rel=0.1)


@pytest.mark.parametrize(
    "load, limit, sticks, tolerance",
    [
        ({1: [1.0, -0.5j]}, 0.4, False, 1e-4),
        ({1: [1.0, 0.3 - 0.2j], 2: [0.3j, 0.1]}, 0.4, True, 8e-4),
        ({1: [1.0, 0.5j]}, 0.8, True, 4e-3),
    ],
)
def test_an_elliptic_load_against_two_time_steppers(load, limit, sticks, tolerance):
    """On unequal springs: the direction of sliding turns all the time, and in the last case the mass sticks for long."""
    model = sled(load, stiffness=(1.0, 2.0))
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
