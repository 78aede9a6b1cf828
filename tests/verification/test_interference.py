"""Interference, a negative initial gap: it presses like the mean load that would close the joint by as much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_models import dovetail, lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.solver.initial_states import choose_start


def solid_joint() -> ReducedModel:
    """Three pairs with two tangents on a held structure that is pressed together and shaken."""
    model = random_structure(tangents=2)
    push, shake = np.random.default_rng(5).normal(size=(2, model.size))
    pressing = np.linalg.lstsq(model.normal, -np.ones(3), rcond=None)[0]
    return replace(model, load={0: model.stiffness @ pressing, 1: 0.3 * shake + 0.2j * push})


def start_elsewhere(problem: ContactProblem, gap: np.ndarray) -> tuple[ContactProblem, np.ndarray]:
    """The same problem with other gaps: as seen from a position that opens the joint by the difference.

    Returns:
        The problem, and the position that its motion is counted from ``(n,)`` [m].
    """
    model = problem.model
    opened = gap - problem.clearance
    rows = np.vstack([model.normal, model.tangential])
    position = np.linalg.lstsq(rows, np.concatenate([opened, np.zeros(len(model.tangential))]), rcond=None)[0]
    load = {**model.load, 0: model.load.get(0, 0.0) - model.stiffness @ position}
    return replace(problem, model=replace(model, load=load), laws=replace(problem.laws, initial_gap=gap)), position


JOINTS = {
    "lift-off": (lift_off_oscillator, 0.1, 5, 1.0),
    "dovetail": (dovetail, 481.0, 5, 3e-5),
    "solid": (solid_joint, 0.15, 3, 0.5),
}


@pytest.mark.parametrize("joint", JOINTS)
@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_interference_is_a_mean_load(joint, seed):
    """Where a motion is counted from is the user's choice: gaps and mean loads that differ by it tell the same."""
    make, frequency, harmonics, size = JOINTS[joint]
    problem = ContactProblem(make(), ContactLaws(friction=0.3), frequency, harmonics)
    base = solve(problem, tolerance=1e-11)
    gap = size * np.random.default_rng(seed).uniform(-1.0, 0.2, problem.model.pairs)
    elsewhere, position = start_elsewhere(problem, gap)
    solution = solve(elsewhere, tolerance=1e-11)
    scale = np.abs(base.forces).max()
    np.testing.assert_allclose(solution.forces, base.forces, atol=1e-7 * scale)
    moved = base.output("tip").real - elsewhere.model.outputs["tip"] @ position * (np.arange(harmonics + 1) == 0)
    np.testing.assert_allclose(solution.output("tip").real, moved, atol=1e-7 * np.abs(moved).max())
    np.testing.assert_allclose(solution.history("gap"), base.history("gap"), atol=1e-7 * (size + scale))


@pytest.mark.parametrize("start", ["rest", None])
def test_time_stepping_sees_interference_as_a_mean_load(start):
    problem = ContactProblem(lift_off_oscillator(contact_mass=0.0), ContactLaws(friction=0.3), 0.1, 5)
    elsewhere, _ = start_elsewhere(problem, np.array([-0.7]))
    given = {"steps": 200, "periods": 60, "tolerance": 1e-6}
    base, found = integrate(problem, **given), integrate(elsewhere, start, **given)
    assert base.converged and found.converged
    np.testing.assert_allclose(
        found.history("normal_force"), base.history("normal_force"), atol=1e-4 * base.history("normal_force").max()
    )


def clamped_spring(push: complex) -> ReducedModel:
    """A mass of 1 kg on a spring of 4 N/m, which the ground keeps from moving down."""
    return ReducedModel(
        mass=[[1.0]], damping=[[0.4]], stiffness=[[4.0]], normal=[[1.0]], load={1: [push]}, outputs={"mass": [1.0]}
    )


def test_a_pressed_spring_carries_its_compression():
    """By 0.5 m: 2 N, and the whole of a load that does not lift it, at any frequency."""
    laws = ContactLaws(tangential="frictionless", initial_gap=-0.5)
    solution = solve(ContactProblem(clamped_spring(1.2 - 0.9j), laws, 0.7, 5), tolerance=1e-11)
    np.testing.assert_allclose(solution.pair_forces["normal"][:3, 0], [2.0, -1.2 + 0.9j, 0.0], atol=1e-9)
    np.testing.assert_allclose(solution.output("mass"), [0.5, 0, 0, 0, 0, 0], atol=1e-9)
    assert solution.history("gap") == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("push", "parts"), [(1.99, False), (2.01, True)])
def test_it_parts_where_the_load_exceeds_its_compression(push, parts):
    laws = ContactLaws(tangential="frictionless", initial_gap=-0.5)
    solution = solve(ContactProblem(clamped_spring(push), laws, 0.01, 15))
    assert bool(np.any(solution.history("gap", 512) > 1e-6)) is parts


def test_wear_takes_interference_away():
    """A gap that wear leaves is what it was and the depth."""
    laws = ContactLaws(tangential="frictionless", initial_gap=-0.5)
    worn = ContactProblem(clamped_spring(1.0), laws, 0.7, 5, wear=np.array([0.2]))
    assert solve(worn).pair_forces["normal"][0, 0] == pytest.approx(4.0 * 0.3, rel=1e-8)


def test_rest_is_where_interference_leaves_the_joint():
    """One pair's interference parts another: full stick, which would hold that one, is not where a motion starts."""
    problem = ContactProblem(solid_joint(), ContactLaws(friction=0.3, initial_gap=[0.0, -3.0, 0.0]), 0.15, 3)
    static = solve(replace(problem, frequency=0.0, load={0: problem.loads[0]}))
    assert static.history("gap").max() > 0.1
    start = choose_start(problem, "rest")
    np.testing.assert_allclose(start.position, static.coordinates[0].real, atol=1e-6)
