"""Friction with two tangents a pair: closed forms, the law along a line, time stepping, and no preferred direction.

A mass that a rotating load drives moves in a circle, ``P^2 = ((k - m w^2) r)^2 + (c w r + F)^2``. Time stepping is
first order in the step where the direction of sliding turns, so that two runs extrapolate to a reference.
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


def block_on_feet(load: dict[int, object], slope: float = 0.0) -> ReducedModel:
    """A rigid block that floats in space, with six massless feet on springs: only contact holds it.

    On a plane (``slope = 0``) it takes friction to hold the block; in three V-grooves, whose flanks have a ``slope``
    [degrees], it does not. Coordinates: the block's motion ``(x, y, z)`` and its turn about each axis, then
    ``(x, y, z)`` of each foot. ``load`` acts on the block, ``(6,)`` a harmonic.
    """
    rng, each = np.random.default_rng(4), np.eye(24)
    stiffness, normal, tangential = np.zeros((24, 24)), [], []
    for k in range(6):
        at = 2 * np.pi * (k // 2 / 3 + k % 2 / 20)
        x, y, z = np.cos(at), np.sin(at), -0.4
        ride = np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]])
        foot = each[6 + 3 * k : 9 + 3 * k]
        stretch = ride @ each[:6] - foot
        stiffness += stretch.T @ np.diag(rng.uniform(30.0, 60.0, 3)) @ stretch
        lean = np.radians(slope) * (-1) ** k
        outward, around = np.array([x, y, 0.0]), np.array([-y, x, 0.0])
        inward = np.cos(lean) * np.array([0.0, 0.0, 1.0]) + np.sin(lean) * around
        normal.append(inward @ foot)
        tangential += [outward @ foot, np.cross(inward, outward) @ foot]
    mass = np.diag([1.0, 1.0, 1.0, 0.3, 0.35, 0.5, *np.zeros(18)])
    return ReducedModel(
        mass=mass,
        damping=0.02 * mass + 0.01 * stiffness,
        stiffness=stiffness,
        normal=normal,
        tangential=tangential,
        load={h: np.concatenate([np.asarray(f), np.zeros(18)]) for h, f in load.items()},
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
    np.testing.assert_allclose(
        np.hypot(solution.history("slip", 64), solution.history("second_slip", 64)), r, rtol=1e-9
    )


def test_a_rotating_load_below_the_limit_moves_nothing():
    solution = solve(ContactProblem(sled({1: [0.39, -0.39j]}), limited(0.4), 0.15, 3))
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


@lru_cache
def ride_in_grooves(harmonics: int) -> PeriodicSolution:
    """A floating block that its weight holds in three V-grooves, shaken so that its feet slide and stick."""
    model = block_on_feet({0: [0.0, 0.0, -3.0, 0.0, 0.0, 0.0], 1: [1.2, 0.8j, 0.2, 0.0, 0.0, 0.3]}, slope=40.0)
    return solve(ContactProblem(model, ContactLaws(friction=0.2), 0.6, harmonics))


@lru_cache
def lift_foot(harmonics: int, friction: float = 0.3) -> PeriodicSolution:
    return solve(ContactProblem(foot_on_the_ground(), ContactLaws(friction=friction), 0.2, harmonics))


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


def test_figures_of_merit_are_those_of_both_components():
    solution = ride_in_grooves(7)
    problem, merit, count = solution.problem, solution.merit, solution.problem.basis.samples
    read = lambda name, samples: np.array([solution.history(prefix + name, samples) for prefix in ("", "second_")])  # noqa: E731
    limit = 0.2 * np.maximum(0.0, solution.history("normal_force", 1024))
    excess = np.linalg.norm(read("friction_force", 1024), axis=0) - limit
    assert merit["cone_violation"] == pytest.approx(excess.max() / limit.max(), rel=1e-12)
    assert merit["cone_violation"] > 1.5 * np.max(np.abs(read("friction_force", 1024)) - limit) / limit.max()
    admissible, limit = (
        read("admissible_friction_force", 512),
        0.2 * np.maximum(0.0, solution.history("normal_force", 512)),
    )
    assert np.all(np.linalg.norm(admissible, axis=0) <= limit * (1 + 1e-12))
    slips = classify_contact(solution, 512) == SLIP
    np.testing.assert_allclose(np.linalg.norm(admissible, axis=0)[slips], limit[slips], rtol=1e-9)
    velocity, dt = read("slip_velocity", count), 1 / (problem.frequency * count)
    rubbed = -np.sum(read("admissible_friction_force", count) * velocity) * dt
    assert merit["friction_dissipation"] == pytest.approx(rubbed, rel=1e-12) and rubbed > 0
    slides = np.where(classify_contact(solution, count) == SLIP, np.linalg.norm(velocity, axis=0), 0.0)
    assert merit["J_T"] == pytest.approx(np.sum(slides) * dt / 6, rel=1e-12)


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


@pytest.mark.parametrize("stiffness", [(1.0, 2.0), (1.0, 0.0), (0.0, 0.0)])
def test_no_direction_is_preferred_where_nothing_bends_in_some(stiffness):
    """Springs in both directions, in one and in none: where there is none, the mass resists."""
    plain = ContactProblem(sled({1: [1.0, 0.3 - 0.5j]}, stiffness=stiffness), limited(0.4), 0.15, 5)
    turned = replace(plain, model=turn_tangents(plain.model, np.array([0.5])))
    here, there = solve(plain, tolerance=1e-11), solve(turned, tolerance=1e-11)
    for name in ("x", "y"):
        np.testing.assert_allclose(there.output(name), here.output(name), atol=1e-8)
    for problem in (plain, turned):
        assert problem.system.laws[0].rho == problem.system.laws[1].rho


@pytest.mark.parametrize(
    "laws, mixed",
    [
        (ContactLaws(friction=0.4), True),
        (ContactLaws("prescribed", normal_force=[0.1, 1.0, 1e3], friction=1.0), [True, True, False] * 2),
        (ContactLaws("prescribed", normal_force=[0.1, 1.0, 1e3], friction=1.0, static_friction="zero"), None),
        (ContactLaws("bonded", friction=0.4), None),
    ],
)
def test_each_derivative_is_exact(laws, mixed):
    """Jacobian against finite differences, elimination against the full one: open, stuck and sliding pairs mixed."""
    model = replace(random_structure(size=12, pairs=3, tangents=2), load={0: -9 * np.ones(12), 1: 3 * np.ones(12)})
    compare_derivatives(HarmonicBalance(ContactProblem(model, laws, 0.1, 3).system), mixed)


def test_each_derivative_is_exact_where_springs_hold_a_body():
    """The springs of the mean friction see a row's own displacement alone, not that of the other direction as well."""
    model = block_on_feet({0: [0.1, 0.1, -3.0, 0.0, 0.0, 0.0], 1: [0.9, 0.5j, 0.2, 0.0, 0.0, 0.3]})
    balance = HarmonicBalance(ContactProblem(model, ContactLaws(friction=0.4), 0.6, 3).system)
    assert np.all(balance.static_displacement_row[6:] > 0)
    compare_derivatives(balance, None)
    laws = [replace(law, static_displacement_row=0.5) if law.direction in PLANE else law for law in balance.system.laws]
    compare_derivatives(HarmonicBalance(replace(balance.system, laws=tuple(laws))), None)  # as strong as the law
    quiet = block_on_feet({0: [0.1, 0.1, -3.0, 0.0, 0.0, 0.0], 1: [0.1, 0.05j, 0.02, 0.0, 0.0, 0.03]})
    balance = HarmonicBalance(ContactProblem(quiet, ContactLaws(friction=0.4), 0.6, 3).system)
    compare_derivatives(balance, False, balance.pack(*balance.full_stick))  # stuck throughout: eliminated, all of them


def compare_derivatives(balance: HarmonicBalance, mixed: object, point: np.ndarray | None = None) -> None:
    """A step's products, matrix and solution, at a random point or where told, and which rows change status there."""
    rng = np.random.default_rng(1)
    point = rng.normal(size=balance.size) if point is None else point
    step = balance.linearise(point)
    if mixed is not None:
        assert np.all(~step.steady == mixed)
    change, h = rng.normal(size=balance.size), 1e-7
    finite = (balance.residual(point + h * change) - balance.residual(point - h * change)) / (2 * h)
    np.testing.assert_allclose(step.multiply(change), finite, atol=2e-6 * np.abs(finite).max())
    np.testing.assert_allclose(step.matrix() @ change, step.multiply(change), atol=1e-11 * np.abs(finite).max())
    np.testing.assert_allclose(step.solve(step.multiply(change)), change, atol=1e-8 * np.abs(change).max())


def test_elimination_and_the_dense_jacobian_lead_to_the_same_solution():
    dense = solve(lift_foot(5).problem, linear_solver="dense")
    np.testing.assert_allclose(dense.forces, lift_foot(5).forces, atol=1e-7 * np.abs(dense.forces).max())


@given(*[st.floats(-5, 5)] * 5, st.floats(0.01, 10), st.floats(0, 2))
def test_it_vanishes_on_coulomb_s_set_and_only_there(pressed, x, y, along, across, rho, friction):
    """Admissible forces are in the disk and nearest to the trial force; at the limit, sliding opposes the force."""
    laws = [PlanarCoulomb(np.arange(1), d, np.array([friction]), np.array([rho]), 1.0, 0.0) for d in PLANE]
    seen = lambda **values: {name: np.array([[value]]) for name, value in values.items()}  # noqa: E731
    limit = friction * max(0.0, pressed)
    motion = Motion(
        seen(normal=pressed, tangential=x, second_tangential=y), {}, seen(tangential=along, second_tangential=across)
    )
    force, velocity = np.array([x, y]), np.array([along, across])
    admissible = np.array([law.fields(motion)["admissible_friction_force"][0, 0] for law in laws])
    residual = np.array([law.evaluate(motion).residual[0, 0] for law in laws])
    np.testing.assert_allclose(residual, force - admissible, atol=1e-12 * (1 + limit))
    assert np.hypot(*admissible) <= limit * (1 + 1e-12) + 1e-300
    trial = force - velocity / rho
    nearest = trial if np.hypot(*trial) <= limit else limit * trial / np.hypot(*trial)
    np.testing.assert_allclose(admissible, nearest, atol=1e-12 * (1 + limit))
    slides = np.hypot(*velocity)
    obeys = -limit * velocity / slides if slides else np.zeros(2)  # on the set: sliding against it, or stuck at zero
    motion = motion._replace(force=seen(normal=pressed, tangential=obeys[0], second_tangential=obeys[1]))
    for law in laws:
        assert abs(law.evaluate(motion).residual[0, 0]) <= 1e-12 * (1 + limit)
    if slides > 1e-3 and limit > 1e-3:  # turned, it slides across its own force: not on the set
        turned = motion._replace(force=seen(normal=pressed, tangential=-obeys[1], second_tangential=obeys[0]))
        assert np.hypot(*(law.evaluate(turned).residual[0, 0] for law in laws)) > 1e-6 * limit


def test_its_corners_round_to_the_exact_law():
    model = replace(random_structure(size=12, pairs=3, tangents=2), load={0: -9 * np.ones(12)})
    exact = HarmonicBalance(ContactProblem(model, ContactLaws(friction=0.4), 0.1, 3).system, 1.0)
    point = np.random.default_rng(1).normal(size=exact.size)
    far = [
        np.abs(HarmonicBalance(round_corners(exact.system, width), 1.0).residual(point) - exact.residual(point)).max()
        for width in (1e-1, 1e-2, 1e-3)
    ]
    assert far[2] < 0.15 * far[1] < 0.1 * far[0]
    rounded = HarmonicBalance(round_corners(exact.system, 0.1), 1.0)
    change, h = np.random.default_rng(2).normal(size=exact.size), 1e-6
    finite = (rounded.residual(point + h * change) - rounded.residual(point - h * change)) / (2 * h)
    np.testing.assert_allclose(rounded.linearise(point).multiply(change), finite, atol=1e-7 * np.abs(finite).max())


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
    on_feet = sum(model.rows(d).T @ held.pair_forces[d][0].real for d in ("normal", *PLANE))[6:].reshape(6, 3)
    np.testing.assert_allclose(on_feet.sum(axis=0), [*(-0.98 * pull), 3.0], atol=1e-6)
    with pytest.raises(UnheldBody, match="nothing holds a floating body"):
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


def test_dashpots_close_the_truncation_whatever_is_asked_for():
    """Springs are for the law along a line; given flexibilities that have no say are told of."""
    plain = lift_foot(5)
    for closure, told in (("spring", ()), (0.1, ("closure is ignored where pairs have two tangents",))):
        solution = solve(replace(plain.problem, closure=closure))
        np.testing.assert_allclose(solution.forces, plain.forces, atol=1e-9 * np.abs(plain.forces).max())
        assert [line.split(":")[0] for line in solution.cautions] == list(told)
    assert not plain.cautions


def test_an_accuracy_is_reached_in_a_plane():
    model = sled({1: [1.0, 0.5j]}, stiffness=(1.0, 2.0))
    found = solve_to_accuracy(ContactProblem(model, limited(0.8), 0.15, 5), 0.005)
    stepped = step_sled(model, 0.8, 0.15, 800, 25)
    for j, name in enumerate(("x", "y")):
        assert np.abs(found.solution.output(name)[:4] - stepped[:, j]).max() < 0.01 * np.abs(stepped[:, j]).max()


def test_the_compiled_loop_is_the_loop_that_is_read_in_a_plane_too(monkeypatch):
    problem = ride_in_grooves(7).problem
    compiled = integrate(problem, steps=20, periods=2, tolerance=0)
    monkeypatch.setattr("ewr_fenicsx.time_stepping.compile_loop", lambda: time_stepping.step_through_period)
    plain = integrate(problem, steps=20, periods=2, tolerance=0)
    assert plain.last.sweeps == compiled.last.sweeps
    np.testing.assert_allclose(plain.last.impulses, compiled.last.impulses, rtol=1e-9, atol=1e-12)


def test_every_time_step_obeys_coulomb_s_law_in_the_plane():
    problem = ride_in_grooves(7).problem
    result = integrate(problem, "rest", steps=100, periods=2, tolerance=0, contact_tolerance=1e-13)
    assert result.unsolved == 0
    pressed, *rubs = (result.last.impulses[:, problem.system.row_of(d, np.arange(6))] for d in ("normal", *PLANE))
    u = result.last.velocities[1:] @ result.scheme.rows.T
    slips = [u[:, problem.system.row_of(d, np.arange(6))] for d in PLANE]
    limit, size, speed = 0.2 * pressed, np.hypot(*rubs), np.hypot(*slips)
    assert np.all(size <= limit * (1 + 1e-9)) and np.all(pressed >= 0)
    sliding = speed > 1e-8 * speed.max()
    assert 0.5 < sliding.mean() < 1
    np.testing.assert_allclose(size[sliding], limit[sliding], rtol=1e-8)
    work = rubs[0] * slips[0] + rubs[1] * slips[1]
    np.testing.assert_allclose(work[sliding], -(size * speed)[sliding], rtol=1e-6)


def test_names_of_second_histories_are_known_in_space_alone():
    plane, space = solve(ContactProblem(friction_oscillator(), limited(0.4), 0.1, 1)), ride_in_grooves(7)
    with pytest.raises(ModelError, match='no history "second_slip"; choose one of'):
        plane.history("second_slip")
    seconds = ("second_friction_force", "second_admissible_friction_force", "second_slip", "second_slip_velocity")
    assert set(seconds) <= set(list_histories(space)) and not set(seconds) & set(list_histories(plane))
    steady = integrate(plane.problem, steps=8, periods=1)
    with pytest.raises(ModelError, match='no history "second_slip"; choose one of'):
        steady.history("second_slip")


@pytest.mark.parametrize("tangential", ["frictionless", "bonded"])
def test_second_histories_of_the_other_laws(tangential):
    problem = replace(
        lift_foot(5).problem, laws=ContactLaws(tangential=tangential), load={0: -np.eye(6)[5], 1: np.ones(6)}
    )
    solution, steady = solve(problem), integrate(problem, steps=1600, tolerance=1e-7)
    for name in ("second_friction_force", "second_slip", "friction_force", "slip"):
        ours, theirs = solution.history(name, 64), steady.history(name, 64)
        np.testing.assert_allclose(ours, theirs, atol=0.02 * max(np.abs(theirs).max(), 1e-6))
        assert (np.abs(theirs).max() < 1e-9) == (("slip" in name) == (tangential == "bonded")), name


def test_results_tell_of_both_directions(tmp_path):
    solution, each = ride_in_grooves(7), np.ones(6)
    interface = Interface(
        ("seat",), np.zeros(6, dtype=int), np.zeros((6, 2)), np.zeros((6, 2)), np.zeros((6, 2)), 2.0 * each,
        np.arange(6), np.arange(6), None, None,
    )  # fmt: skip
    fields = contact_fields(interface, solution, 16)
    np.testing.assert_array_equal(fields["second_friction_traction"], solution.history("second_friction_force", 16) / 2)
    np.testing.assert_array_equal(fields["second_slip"], solution.history("second_slip", 16))
    assert not any(name.startswith("second_second") or name == "second_friction_force" for name in fields)
    write_pairs(tmp_path / "pairs.csv", interface, solution)
    names, *rows = (line.split(",") for line in (tmp_path / "pairs.csv").read_text().splitlines())
    largest = [float(row[names.index("second_friction_force_max [N]")]) for row in rows]
    np.testing.assert_allclose(largest, solution.history("second_friction_force").max(axis=0))
    assert "second_slip_mean [m]" in names and not any(name.startswith("second_admissible") for name in names)
