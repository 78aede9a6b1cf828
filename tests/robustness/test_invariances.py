"""What a solve must not depend on: the origin of time, units, order of pairs, direction of tangents, coordinates."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_models import dovetail, friction_oscillator, lift_off_oscillator, transform_coordinates

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.errors import ModelError, UnheldBody
from ewr_fenicsx.solution.solution import PeriodicSolution

both = pytest.mark.parametrize("closure", ["dashpot", "spring"])


@lru_cache
def solve_base(closure: str) -> PeriodicSolution:
    laws = ContactLaws(friction=0.3, initial_gap=0.01)
    return solve(ContactProblem(lift_off_oscillator(), laws, 0.1, 5, closure=closure), tolerance=1e-12)


@lru_cache
def solve_joint(closure: str) -> PeriodicSolution:
    return solve(ContactProblem(dovetail(), ContactLaws(friction=0.3), 481.0, 3, closure=closure), tolerance=1e-12)


def shift_in_time(model: ReducedModel, phase: float) -> ReducedModel:
    return replace(model, load={h: f * np.exp(1j * h * phase) for h, f in model.load.items()})


@both
@settings(max_examples=12)
@given(st.integers(0, 255))
def test_shift_of_time_shifts_the_solution(closure, ticks):
    """By whole samples exactly; between samples the laws are evaluated elsewhere."""
    base = solve_base(closure)
    phase = 2 * np.pi * ticks / base.problem.basis.samples
    shifted = solve(replace(base.problem, model=shift_in_time(base.problem.model, phase)), tolerance=1e-12)
    turn = np.exp(1j * phase * np.arange(6))
    np.testing.assert_allclose(shifted.forces, turn[:, None] * base.forces, atol=1e-9 * np.abs(base.forces).max())


@both
@settings(max_examples=12)
@given(st.floats(-6, 6))
def test_loads_and_gaps_scale_everything(closure, exponent):
    """Contact and friction know no force of their own: c times the loads and gaps give c times the answer."""
    base = solve_base(closure)
    c, model = 10.0**exponent, base.problem.model
    scaled = replace(model, load={h: c * f for h, f in model.load.items()})
    solution = solve(
        replace(base.problem, model=scaled, laws=ContactLaws(friction=0.3, initial_gap=0.01 * c)), tolerance=1e-12
    )
    np.testing.assert_allclose(solution.forces, c * base.forces, atol=1e-9 * c * np.abs(base.forces).max())
    assert solution.iterations == base.iterations


@both
@settings(max_examples=12)
@given(st.permutations(range(6)))
def test_order_of_pairs_does_not_matter(closure, order):
    joint = solve_joint(closure)
    model = joint.problem.model
    moved = replace(
        model, normal=model.normal[order], tangential=model.tangential[order], pair_area=model.pair_area[order]
    )
    solution = solve(replace(joint.problem, model=moved), tolerance=1e-12)
    for direction in ("normal", "tangential"):
        before = joint.pair_forces[direction][:, order]
        np.testing.assert_allclose(solution.pair_forces[direction], before, atol=1e-7 * np.abs(joint.forces).max())


@both
@settings(max_examples=12)
@given(st.lists(st.sampled_from([-1.0, 1.0]), min_size=6, max_size=6))
def test_direction_of_tangents_does_not_matter(closure, signs):
    joint = solve_joint(closure)
    signs = np.array(signs)
    model = joint.problem.model
    turned = solve(
        replace(joint.problem, model=replace(model, tangential=signs[:, None] * model.tangential)), tolerance=1e-12
    )
    scale = np.abs(joint.forces).max()
    np.testing.assert_allclose(turned.pair_forces["normal"], joint.pair_forces["normal"], atol=1e-7 * scale)
    np.testing.assert_allclose(
        turned.pair_forces["tangential"], signs * joint.pair_forces["tangential"], atol=1e-7 * scale
    )


@both
@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1), st.floats(0, 3))
def test_coordinates_do_not_matter(closure, seed, spread):
    """Rotated axes, modal coordinates, other units among the coordinates: the joint does not know."""
    joint = solve_joint(closure)
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(26, 26)))[0]
    basis = turn @ np.diag(10.0 ** rng.uniform(-spread, spread, 26))
    solution = solve(replace(joint.problem, model=transform_coordinates(joint.problem.model, basis)), tolerance=1e-11)
    np.testing.assert_allclose(solution.forces, joint.forces, atol=1e-6 * np.abs(joint.forces).max())
    np.testing.assert_allclose(
        solution.output("tip"), joint.output("tip"), atol=1e-6 * np.abs(joint.output("tip")).max()
    )


def body_on_a_slide(degrees: float, *, held: bool) -> ReducedModel:
    """A mass on a spring along one axis and free along the other, pressed along the one that is ``held``, turned."""
    turn = np.radians(degrees)
    sprung, free = np.array([[np.sin(turn), np.cos(turn)], [np.cos(turn), -np.sin(turn)]])
    normal, tangent = (free, sprung) if held else (sprung, free)
    return ReducedModel(
        mass=np.eye(2),
        damping=0.1 * np.outer(sprung, sprung) + 0.1 * np.eye(2),
        stiffness=4.0 * np.outer(sprung, sprung),
        normal=[normal],
        tangential=[tangent],
        load={0: -normal, 1: 0.3 * sprung + 0.1 * free},
        outputs={"normal": normal},
    )


@pytest.mark.parametrize("turn", [np.eye(3), np.linalg.qr([[1.0, 2.0, 3.0], [0.5, -1.0, 1.0], [2.0, 0.0, 1.0]])[0]])
def test_bodies_that_float_as_one_are_told_that_no_pair_moves(turn):
    """In turned axes rounding slid along the pair, and the remedy was to bond it, as it was."""
    spring = 1e6 * np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    model = ReducedModel(
        mass=np.eye(3),
        damping=np.zeros((3, 3)),
        stiffness=turn.T @ spring @ turn,
        tangential=np.array([[0.0, 1.0, -1.0]]) @ turn,
        load={1: np.array([1.0, 0.0, 0.0]) @ turn},
    )
    laws = ContactLaws(normal="prescribed", normal_force=0.0, tangential="bonded")
    with pytest.raises(ModelError, match="one that they do not see moves no pair, so that no contact could hold it"):
        solve(ContactProblem(model, laws, 100.0, 3))


@pytest.mark.parametrize("degrees", [0, 10, 33, 45, 60, 77])
def test_a_motion_that_rounding_alone_moves_is_no_motion(degrees):
    """Turned axes leave roundings where zeros were: of what bonds and contact see of a rigid motion, and of stiffness.

    Pressed across its slide, nothing holds the body along it. Pressed along it and bonded across, contact does: the
    contact force is the load, and the body stays where it is.
    """
    with pytest.raises(ModelError, match=r"1 rigid motions of floating bodies, but .* tell only 0 of them apart"):
        solve(ContactProblem(body_on_a_slide(degrees, held=False), ContactLaws(tangential="frictionless"), 0.2, 3))
    with pytest.raises(UnheldBody, match="a floating body can move without any contact noticing"):
        solve(ContactProblem(body_on_a_slide(degrees, held=False), ContactLaws(static_friction="zero"), 0.2, 3))
    solution = solve(ContactProblem(body_on_a_slide(degrees, held=True), ContactLaws(tangential="bonded"), 0.2, 3))
    np.testing.assert_allclose(solution.pair_forces["normal"][:, 0], [1.0, -0.1, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(solution.output("normal"), 0.0, atol=1e-9)


@pytest.mark.parametrize("degrees", [0, 10, 33, 45, 60, 77])
def test_a_mass_that_bonds_leave_at_rest_is_none(degrees):
    """What is left of a bonded mass is its massless companion on a spring, whichever way the axes are turned."""
    model = ReducedModel(
        mass=np.diag([1.0, 0.0]), damping=np.zeros((2, 2)), stiffness=np.diag([4.0, 5.0]), normal=[[1.0, 0.0]],
        load={1: [1.0, 2.0]}, outputs={"companion": [0.0, 1.0]},
    )  # fmt: skip
    turn = np.radians(degrees)
    turned = transform_coordinates(model, np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))
    solution = solve(ContactProblem(turned, ContactLaws("bonded", "frictionless"), 0.2, 1))
    np.testing.assert_allclose(solution.output("companion"), [0.0, 0.4], atol=1e-12)


def test_shift_between_samples_only_moves_the_sampling():
    """Half a sample: the answer changes by the aliasing error, which falls with the samples."""
    errors = []
    for samples in (64, 1024):
        problem = ContactProblem(
            friction_oscillator(damping=0.1), ContactLaws("prescribed", normal_force=0.3, friction=1.0), 0.1, 5, samples
        )
        phase = np.pi / samples
        plain = solve(problem).output("tip")
        shifted = solve(replace(problem, model=shift_in_time(problem.model, phase))).output("tip")
        errors.append(np.abs(shifted - np.exp(1j * phase * np.arange(6)) * plain).max() / np.abs(plain).max())
    assert errors[1] < errors[0] / 8 < 1e-3, errors
