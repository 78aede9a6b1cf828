"""Friction with two tangents a pair: derivatives, corners, figures of merit, histories, files, steps in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from checked_solutions import slide_behind_dashpots
from hypothesis import given
from hypothesis import strategies as st
from law_checks import check_rounded_corners, lift_foot, ride_in_grooves
from small_models import block_on_feet, friction_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, integrate, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.in_time import compiled_loop
from ewr_fenicsx.laws.law_kinds import TANGENTS, Motion
from ewr_fenicsx.laws.planar_coulomb import PlanarCoulomb
from ewr_fenicsx.output.output import contact_fields, write_pairs
from ewr_fenicsx.solution.contact_state import SLIP, classify_contact, list_histories
from ewr_fenicsx.structure.interface import Interface


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
    speed = slide_behind_dashpots(solution, 1024)[classify_contact(solution, 1024) == SLIP]
    assert merit["J_T"] == pytest.approx(np.sum(speed) / 1024 / problem.frequency / 6, rel=1e-12)


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
    balance = HarmonicBalance(ContactProblem(model, ContactLaws(friction=0.4), 0.6, 3).system).firm
    assert np.all(balance.static_displacement_row[6:] > 0)
    compare_derivatives(balance, None)
    laws = [
        replace(law, static_displacement_row=0.5) if law.direction in TANGENTS else law for law in balance.system.laws
    ]
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
    laws = [PlanarCoulomb(np.arange(1), np.array([friction]), np.array([rho]), direction=d) for d in TANGENTS]
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
    check_rounded_corners(ContactProblem(model, ContactLaws(friction=0.4), 0.1, 3))


def test_dashpots_close_the_truncation_whatever_is_asked_for():
    """Springs are for the law along a line; given flexibilities that have no say are told of."""
    plain = lift_foot(5)
    for closure, told in (("spring", ()), (0.1, ("closure is ignored where pairs have two tangents",))):
        solution = solve(replace(plain.problem, closure=closure))
        np.testing.assert_allclose(solution.forces, plain.forces, atol=1e-9 * np.abs(plain.forces).max())
        assert [line.split(":")[0] for line in solution.cautions] == list(told)
    assert not plain.cautions


def test_the_compiled_loop_is_the_loop_that_is_read_in_a_plane_too(monkeypatch):
    problem = ride_in_grooves(7).problem
    compiled = integrate(problem, steps=20, periods=2, tolerance=0)
    monkeypatch.setattr("ewr_fenicsx.in_time.time_stepping.compile_loop", lambda: compiled_loop.step_through_period)
    plain = integrate(problem, steps=20, periods=2, tolerance=0)
    assert plain.last.sweeps == compiled.last.sweeps
    np.testing.assert_allclose(plain.last.impulses, compiled.last.impulses, rtol=1e-9, atol=1e-12)


def test_every_time_step_obeys_coulomb_s_law_in_the_plane():
    problem = ride_in_grooves(7).problem
    result = integrate(problem, "rest", steps=100, periods=2, tolerance=0, contact_tolerance=1e-13)
    assert result.unsolved == 0
    pressed, *rubs = (result.last.impulses[:, problem.system.row_of(d, np.arange(6))] for d in ("normal", *TANGENTS))
    names = ("slip_velocity", "second_slip_velocity")
    slips = [np.roll(result.history(name), -1, axis=0)[2:-1] for name in names]  # at the ends of steps
    pressed, *rubs = (impulse[2:-1] for impulse in (pressed, *rubs))  # the first ones follow the period before
    limit, size, speed = 0.2 * pressed, np.hypot(*rubs), np.hypot(*slips)
    assert np.all(size <= limit * (1 + 1e-9)) and np.all(pressed >= 0)
    sliding = speed > 1e-8 * speed.max()
    assert 0.5 < sliding.mean() < 1
    np.testing.assert_allclose(size[sliding], limit[sliding], rtol=1e-8)
    work = rubs[0] * slips[0] + rubs[1] * slips[1]
    np.testing.assert_allclose(work[sliding], -(size * speed)[sliding], rtol=1e-6)


@pytest.mark.parametrize("seed", [3, 25, 26])
def test_what_is_held_at_rest_in_a_plane_is_where_a_tighter_tolerance_has_it(seed):
    """The weak springs that hold a pair also tell which way it slides."""
    joint, rng = random_structure(size=12, pairs=3, tangents=2, seed=seed), np.random.default_rng(seed)
    joint = replace(joint, load={0: -20 * joint.normal.sum(axis=0) + 5 * rng.normal(size=12)})
    problem = ContactProblem(joint, ContactLaws(friction=0.3, static_friction="held"), 0.0)
    found, closer = (solve(replace(problem), tolerance=tolerance) for tolerance in (1e-8, 1e-13))
    moved, expected = found.coordinates[0].real, closer.coordinates[0].real
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_names_of_second_histories_are_known_in_space_alone():
    plane, space = (
        solve(ContactProblem(friction_oscillator(), ContactLaws("prescribed", normal_force=1.0), 0.1, 1)),
        ride_in_grooves(7),
    )
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
        ("seat",), np.zeros(6, dtype=int), np.zeros((6, 2)), np.zeros((6, 2)), np.zeros((6, 1, 2)), 2.0 * each,
        np.arange(6), np.arange(6), None, None, ("seat",), np.zeros(6, dtype=bool), np.zeros((6, 2)),
        np.zeros(6),
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
