"""A periodic solution: histories, coordinates, recovered bond forces and figures of merit."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checked_solutions import slide_behind_dashpots
from small_models import dovetail, friction_oscillator, lift_off_oscillator, random_structure

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve
from ewr_fenicsx.accuracy.estimates import estimate_at_once
from ewr_fenicsx.balance.periodic_motion import HISTORIES
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.solution.contact_state import OPEN, SLIP, STICK, classify_contact, sample_friction_limit
from ewr_fenicsx.solution.indicators import (
    measure_cone_violation,
    measure_rms,
    measure_separation,
    measure_sliding,
    measure_work,
)
from ewr_fenicsx.solution.solution import COARSE_ENERGY, COARSE_TENSION, FINE, PeriodicSolution

SAMPLES = 96


@pytest.fixture(scope="module")
def rubbing() -> PeriodicSolution:
    """A pair that lifts off, sticks and slips, with an initial gap."""
    solution = solve(
        ContactProblem(lift_off_oscillator(excitation=4.0), ContactLaws(friction=0.3, initial_gap=0.02), 0.2, 5)
    )
    assert solution.history("gap", 64).max() > 0.3 and solution.history("normal_force", 64).max() > 1.0
    return solution


@pytest.fixture(scope="module")
def floating() -> PeriodicSolution:
    return solve(ContactProblem(dovetail(), ContactLaws(friction=0.2), 200.0, 5), tolerance=1e-11)


def series(solution: PeriodicSolution, amplitudes: np.ndarray, samples: int = SAMPLES) -> np.ndarray:
    tau = 2 * np.pi * np.arange(samples) / samples
    return np.real(sum(np.exp(1j * h * tau)[:, None] * a for h, a in zip(solution.orders, amplitudes, strict=True)))


@pytest.mark.parametrize("name", HISTORIES)
def test_histories_have_their_shape(rubbing, floating, name):
    assert rubbing.history(name).shape == (1024, 1)
    assert floating.history(name, 50).shape == (50, 6)
    coarse, fine = floating.history(name, 64), floating.history(name, 256)
    np.testing.assert_allclose(coarse, fine[::4], atol=1e-12 * np.abs(fine).max())


@pytest.mark.parametrize("which", ["rubbing", "floating"])
def test_histories_agree_with_each_other(which, request):
    solution = request.getfixturevalue(which)
    model, omega = solution.problem.model, solution.problem.omega
    gap, slip = solution.history("gap", SAMPLES), solution.history("slip", SAMPLES)
    initial = 0.02 if which == "rubbing" else 0.0
    x = series(solution, solution.coordinates)
    np.testing.assert_allclose(gap, x @ model.normal.T + initial, atol=1e-12 * np.abs(x).max())
    np.testing.assert_allclose(slip, x @ model.tangential.T, atol=1e-12 * np.abs(x).max())
    velocity = solution.history("slip_velocity", SAMPLES)
    spectrum = np.fft.rfft(slip, axis=0) * 1j * omega * np.arange(SAMPLES // 2 + 1)[:, None]
    np.testing.assert_allclose(velocity, np.fft.irfft(spectrum, SAMPLES, axis=0), atol=1e-11 * np.abs(velocity).max())
    np.testing.assert_allclose(
        x @ model.outputs["tip"], series(solution, solution.output("tip")[:, None])[:, 0], atol=1e-12 * np.abs(x).max()
    )


@pytest.mark.parametrize("which", ["rubbing", "floating"])
def test_coordinates_meet_the_equation_of_motion(which, request):
    """M x'' + D x' + K x = B^T lam + f at every harmonic kept, the mean of a floating body included."""
    solution = request.getfixturevalue(which)
    model = solution.problem.model
    for j, h in enumerate(solution.orders):
        w, x = h * solution.problem.omega, solution.coordinates[j]
        inner = model.stiffness @ x + 1j * w * (model.damping @ x) - w**2 * (model.mass @ x)
        outer = (
            model.normal.T @ solution.pair_forces["normal"][j]
            + model.tangential.T @ solution.pair_forces["tangential"][j]
        )
        outer = outer + model.load.get(h, 0)
        scale = max((np.abs(model.stiffness) @ np.abs(x)).max(), np.abs(outer).max())
        np.testing.assert_allclose(inner, outer, atol=1e-11 * scale)


def test_residual_in_time_is_that_of_the_laws(rubbing):
    """The projected laws vanish: all harmonics kept of force minus admissible force are zero."""
    friction, admissible = rubbing.history("friction_force", 256), rubbing.history("admissible_friction_force", 256)
    spectrum = np.fft.rfft(friction - admissible, axis=0)[1:6] / 256
    assert np.abs(spectrum).max() < 1e-7 * np.abs(friction).max()
    limit = 0.3 * np.maximum(0.0, rubbing.history("normal_force", 256))
    assert np.all(np.abs(admissible) <= limit + 1e-14)
    assert np.abs(friction - admissible).max() > 1e-4, "truncation leaves the cone a little"


@pytest.mark.parametrize("samples", [1, 8, 32, 100])
@pytest.mark.parametrize("closure", ["dashpot", "spring"])
def test_what_happens_at_an_instant_does_not_depend_on_how_many_are_asked_for(closure, samples):
    """Friction closed by springs remembers what happened between those instants."""
    problem = ContactProblem(dovetail(excitation=300.0), ContactLaws(friction=0.2), 481.0, 5, 800, closure=closure)
    solution = solve(problem)
    every = 800 // samples
    for name in HISTORIES:
        fine = solution.history(name, 800)
        np.testing.assert_allclose(solution.history(name, samples), fine[::every], rtol=0, atol=1e-9 * abs(fine).max())
    np.testing.assert_array_equal(classify_contact(solution, samples), classify_contact(solution, 800)[::every])
    fine = solution.sliding_speed(800)
    np.testing.assert_allclose(solution.sliding_speed(samples), fine[::every], rtol=0, atol=1e-9 * fine.max())


@pytest.mark.parametrize("which", ["rubbing", "floating"])
def test_states_are_those_that_the_forces_and_motions_show(which, request):
    solution = request.getfixturevalue(which)
    state, limit = classify_contact(solution, 512), sample_friction_limit(solution, 512)
    friction, gap = solution.history("admissible_friction_force", 512), solution.history("gap", 512)
    velocity = solution.history("slip_velocity", 512)
    assert np.all(np.abs(friction[state == STICK]) < limit[state == STICK])
    np.testing.assert_allclose(np.abs(friction[state == SLIP]), limit[state == SLIP], rtol=1e-8)
    assert {STICK, SLIP} <= set(np.unique(state)) and (np.any(state == OPEN) == (which == "rubbing"))
    assert np.abs(velocity[state == SLIP]).mean() > 3 * np.abs(velocity[state == STICK]).mean()
    if which == "rubbing":
        assert gap[state == OPEN].mean() > 10 * np.abs(gap[state != OPEN]).mean()


def test_a_frictionless_joint_has_no_friction():
    solution = solve(ContactProblem(lift_off_oscillator(), ContactLaws(tangential="frictionless"), 0.1, 3))
    assert np.all(solution.history("friction_force", 32) == 0) and np.all(
        solution.history("admissible_friction_force", 32) == 0
    )
    assert np.abs(solution.history("slip", 32)).max() > 0


def test_unknown_names_are_hinted_at(rubbing):
    with pytest.raises(ModelError, match=r'no history "slip_velocty"; choose one of .*; did you mean "slip_velocity"'):
        rubbing.history("slip_velocty")
    with pytest.raises(ModelError, match=r'no output "tipp"; the model has \[\'tip\'\]; did you mean "tip"'):
        rubbing.output("tipp")


def test_figures_of_merit_are_those_of_the_histories(rubbing):
    merit, count = rubbing.merit, rubbing.problem.basis.samples
    h = {name: rubbing.history(name, max(count, 1024))[:, 0] for name in HISTORIES}
    assert merit["penetration"] == pytest.approx(max(0.0, -h["gap"].min()), rel=1e-12) and merit["penetration"] > 0
    assert merit["tension"] == pytest.approx(max(0.0, -h["normal_force"].min()), rel=1e-12)
    assert merit["largest_normal_force"] == h["normal_force"].max()
    limit = 0.3 * np.maximum(0, h["normal_force"])
    assert merit["cone_violation"] == pytest.approx(
        (np.abs(h["friction_force"]) - limit).max() / limit.max(), rel=1e-12
    )
    h = {name: rubbing.history(name, count)[:, 0] for name in HISTORIES}
    dt = 1 / rubbing.problem.frequency / count
    rubbed = -np.sum(h["admissible_friction_force"] * h["slip_velocity"]) * dt
    assert merit["friction_dissipation"] == pytest.approx(rubbed, rel=1e-12) and rubbed > 0
    speed = slide_behind_dashpots(rubbing, FINE)[classify_contact(rubbing, FINE) != STICK]
    assert merit["J_T"] == pytest.approx(np.sum(speed) / FINE / rubbing.problem.frequency, rel=1e-12)
    assert merit["J_N"] == pytest.approx(h["gap"].mean(), rel=1e-12)
    model = rubbing.problem.model
    x, tau = series(rubbing, rubbing.coordinates, count), 2 * np.pi * np.arange(count) / count
    rate = series(rubbing, 1j * rubbing.problem.omega * np.arange(6)[:, None] * rubbing.coordinates, count)
    force = model.load[0].real + np.real(np.exp(1j * tau)[:, None] * model.load[1])
    assert merit["excitation_work"] == pytest.approx(np.sum(force * rate) * dt, rel=1e-10)
    assert merit["viscous_dissipation"] == pytest.approx(np.sum(rate @ model.damping * rate) * dt, rel=1e-10)
    assert merit["rms_tip"] == pytest.approx(np.std(x @ model.outputs["tip"]), rel=1e-10)
    work, lost = merit["excitation_work"], merit["viscous_dissipation"] + rubbed
    assert merit["energy_error"] == pytest.approx((work - lost) / max(work, lost), abs=1e-12)


def test_every_figure_is_defined_in_the_method(rubbing):
    page = (Path(__file__).parents[2] / "docs" / "method.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| `(\w+)` \| (.+?) \| .+ \|$", page.split("## Figures of merit")[1].split("\n## ")[0], re.M)
    assert [name.replace("NAME", "tip") for name, _ in table] == list(rubbing.merit)
    page_limits = f"{COARSE_ENERGY:.0%} of the energy, {COARSE_TENSION:.0%} of the largest force".replace("%", " %")
    assert page_limits in page and f"at {FINE} samples" in page


def test_violations_between_the_samples_are_seen(rubbing):
    """Just enough samples, at which the laws are enforced: the figures are those of a continuous look."""
    few = solve(replace(rubbing.problem, samples=11))
    h = {name: few.history(name, 20_000)[:, 0] for name in HISTORIES}
    limit = 0.3 * np.maximum(0, h["normal_force"])
    expected = {
        "penetration": -h["gap"].min(),
        "tension": -h["normal_force"].min(),
        "cone_violation": (np.abs(h["friction_force"]) - limit).max() / limit.max(),
    }
    for name, value in expected.items():
        assert few.merit[name] == pytest.approx(value, rel=0.02) and value > 0, name


def test_figures_of_several_pairs_are_means_over_them(floating):
    """Pairs that slide unequally, so that a mean is neither a sum nor any one of them."""
    count, dt = floating.problem.basis.samples, 1 / 200.0 / FINE
    moves = classify_contact(floating, FINE) != STICK
    slid = (moves * slide_behind_dashpots(floating, FINE)).sum(axis=0) * dt
    assert slid.max() > 1.5 * slid.min()
    assert floating.merit["J_T"] == pytest.approx(slid.sum() / 6, rel=1e-12)
    assert floating.merit["J_N"] == pytest.approx(floating.history("gap", count).mean(axis=0).sum() / 6, rel=1e-9)


def test_damping_that_feeds_a_motion_is_told():
    """As in flutter: friction takes what the damping matrix gives."""
    model = friction_oscillator(damping=-0.02)
    fed = solve(ContactProblem(model, ContactLaws("prescribed", normal_force=1.0, friction=0.3), 0.15, 5))
    assert fed.merit["viscous_dissipation"] < 0 < fed.merit["friction_dissipation"]
    assert any("the damping matrix feeds" in line for line in fed.cautions)
    usual = solve(replace(fed.problem, model=friction_oscillator(damping=0.02)))
    assert not any("damping" in line for line in usual.cautions)


def test_separation_is_that_of_pairs_that_may_part():
    """Relative motion of the others is no gap."""
    model = replace(random_structure(), load={0: np.ones(9), 1: np.arange(9.0) * 1j})
    groups = [([0], ContactLaws("prescribed", "frictionless", normal_force=1.0)), ([1, 2], ContactLaws(friction=0.3))]
    mixed = solve(ContactProblem(model, groups, 0.2, 5))
    gap = mixed.history("gap", mixed.problem.basis.samples).mean(axis=0)
    assert mixed.merit["J_N"] == pytest.approx(gap[1:].mean(), rel=1e-12) and abs(gap[0]) > 1e-3
    pressed = solve(ContactProblem(model, ContactLaws("prescribed", normal_force=1.0, friction=0.3), 0.2, 5))
    assert pressed.merit["J_N"] == 0.0


def test_energy_is_balanced_to_the_tolerance_where_pairs_stay_closed(floating):
    """The friction force and the velocity share their harmonics: no truncation is left in the balance."""
    assert floating.merit["friction_dissipation"] > 0.2 * floating.merit["excitation_work"]
    assert abs(floating.merit["energy_error"]) < 1e-9


def test_an_oscillating_normal_force_that_is_given_does_work():
    """On a model with normal rows it moves the structure, like a load; against time stepping's balance of energies."""
    model = replace(random_structure(), load={0: np.ones(9), 1: np.arange(9.0) * 1j})
    pressed = {0: 4.0, 1: 2.0 * np.exp(0.5j), 2: 0.5j}
    problem = ContactProblem(model, ContactLaws("prescribed", normal_force=pressed, friction=0.3), 0.2, 15)
    solution = solve(problem)
    loads = np.array([problem.loads.get(h, np.zeros(9)) for h in solution.orders])
    merit, by_loads = solution.merit, measure_work(loads, solution.coordinates, solution.orders)
    assert abs(merit["excitation_work"] - by_loads) > 0.1 * abs(by_loads), "the given force does its share"
    assert abs(merit["energy_error"]) < 1e-6 and merit["friction_dissipation"] > 0.05 * merit["excitation_work"]
    steady = integrate(problem, solution, steps=1000, tolerance=1e-7)
    assert steady.converged
    assert merit["excitation_work"] == pytest.approx(steady.measure_energy()["excitation"], rel=0.01)


def test_errors_of_lift_off_fall_with_the_harmonics():
    """Normal forces do a little work on the truncated gap, and all truncated histories leave their sets a little."""
    model, laws = lift_off_oscillator(excitation=4.0, damping=0.1), ContactLaws(friction=0.3)
    merits = [solve(ContactProblem(model, laws, 0.2, n)).merit for n in (3, 9, 27)]
    energy = [abs(m["energy_error"]) for m in merits]
    assert energy[0] < 1e-4 and energy[1] < energy[0] / 5 and energy[2] < energy[1] / 5, energy
    for name in ("penetration", "tension", "cone_violation"):
        values = [m[name] for m in merits]
        assert values[1] < values[0] / 1.4 and values[2] < values[1] / 1.4, (name, values)


def test_indicators_by_hand():
    tau = 2 * np.pi * np.arange(4000) / 4000
    velocity = np.column_stack([3.0 * np.cos(tau), np.zeros(4000)])
    np.testing.assert_allclose(measure_sliding(np.abs(velocity), 2.0), [2.0 * 3.0 * 2 / np.pi, 0.0], rtol=1e-5)
    np.testing.assert_allclose(
        measure_separation(np.column_stack([1 + np.sin(tau), tau])), [1.0, tau.mean()], rtol=1e-12
    )
    assert measure_rms(np.array([9.0, 3.0, 4.0j]), (0, 1, 2)) == pytest.approx(5 / np.sqrt(2))
    assert measure_rms(np.array([3.0, 4.0j]), (1, 3)) == pytest.approx(5 / np.sqrt(2))
    force, motion = np.array([[2.0], [1.0 + 1j]]), np.array([[5.0], [0.5 - 2j]])
    f, rate = np.real((1 + 1j) * np.exp(2j * tau)), np.real(2j * (0.5 - 2j) * np.exp(2j * tau))
    assert measure_work(force, motion, (0, 2)) == pytest.approx(np.mean(f * rate) * 2 * np.pi)
    assert measure_cone_violation(
        np.array([[3.0], [-1.0]]), np.array([[4.0], [-2.0]]), np.array([0.5])
    ) == pytest.approx(0.5)
    assert measure_cone_violation(np.array([[1.0]]), np.array([[-1.0]]), np.array([0.5])) == 0.0


def test_summary_is_for_people(rubbing):
    assert rubbing.summary().startswith("0.2 Hz, harmonics 0..5: converged in ")
    lost = replace(rubbing, converged=False, reason="too many Newton steps", fallbacks=("half the load",))
    assert "NOT converged (too many Newton steps)" in lost.summary() and "fallback: half the load" in lost.summary()
    assert repr(lost).startswith("PeriodicSolution(0.2 Hz, 1 pairs, harmonics up to 5, ")
    assert "too many Newton steps" in repr(lost) and "array" not in repr(lost)


def test_a_summary_says_where_truncation_is_coarse(rubbing):
    """Few harmonics pull; forces that are off leave energy over; where next to none is exchanged, that is rounding."""
    assert rubbing.cautions == () and "coarse" not in rubbing.summary()
    coarse = solve(replace(rubbing.problem, harmonics=1))
    assert "\n  truncation is coarse: contact pulls by up to 0.8" in coarse.summary()
    off = replace(rubbing, forces=1.2 * rubbing.forces)
    expected = f"truncation is coarse: energies are out of balance by {off.merit['energy_error']:.1%}"
    assert expected in off.summary() and "out of balance" not in coarse.summary()
    undamped = replace(dovetail(excitation=1.0), damping=np.zeros((26, 26)))
    stuck = solve(ContactProblem(undamped, ContactLaws(friction=5.0), 200.0, 3))
    (open_to_history,) = stuck.cautions  # and not a word on energies
    assert abs(stuck.merit["energy_error"]) > 0.01 and "depends on how the loads came" in open_to_history
    alone = ReducedModel(
        mass=np.eye(2),
        damping=20 * np.eye(2),
        stiffness=1e6 * np.eye(2),
        normal=[[0.0, 1.0]],
        tangential=[[1.0, 0.0]],
        load={0: [0.0, -100.0], 1: [20.0, 7j]},
    )
    at_rest = solve(ContactProblem(alone, ContactLaws(friction=0.5), 150.0, 5))
    assert abs(at_rest.merit["energy_error"]) > 0.01 and at_rest.cautions == (), "contact holds all that there is"


def test_what_dissipates_nothing_has_no_energies_to_be_out_of_balance():
    """All the work is what truncated forces do on a springy stop, a millionth of what swings; the motion is right."""
    model = ReducedModel(
        mass=np.diag([1.0, 0.0]), damping=np.zeros((2, 2)), stiffness=[[4.0, -3.0], [-3.0, 3.0]],
        normal=[[0.0, -1.0]], load={1: [1.0, 0.0], 2: [0.3j, 0.0]}, outputs={"mass": [1.0, 0.0]},
    )  # fmt: skip
    taps = ContactLaws(tangential="frictionless", initial_gap=0.3)
    few, many = (solve(ContactProblem(model, taps, 0.9 / (2 * np.pi), count)) for count in (15, 40))
    swing = np.abs([few.output("mass")[1], many.output("mass")[1]])
    assert swing[0] == pytest.approx(swing[1], rel=1e-4)
    assert abs(few.merit["energy_error"]) == 1 and "balance" not in few.summary()


def test_a_summary_says_that_a_fallback_may_have_found_one_of_many(rubbing):
    fallbacks = ("cold start: fell no further", "time stepping: residual below")
    late = replace(rubbing, fallbacks=fallbacks, tell_error=None)
    lines = late.summary().splitlines()
    assert lines[1] == "  fallback: cold start: fell no further"
    assert lines[3] == "  found by a fallback: there may be other solutions, and the stability of this one is not known"
    assert "other solutions" not in replace(late, converged=False).summary()
    assert "other solutions" not in rubbing.summary()


@pytest.mark.parametrize("gap, touches", [(0.0, True), (100.0, False)])
def test_bodies_that_never_touch_are_told(gap, touches):
    solution = solve(ContactProblem(lift_off_oscillator(), ContactLaws(friction=0.3, initial_gap=gap), 0.1, 3))
    assert solution.converged and solution.touches == touches
    assert (np.abs(solution.forces).max() > 1e-12) == touches
    assert ("no pair ever touches" in solution.summary()) != touches
    assert touches or solution.cautions == (), "forces that are rounding pull no one"


def test_bodies_that_other_pairs_join_are_not_said_to_vibrate_apart():
    laws = [([0, 1, 2], ContactLaws("bonded", "bonded")), ([3, 4, 5], ContactLaws(initial_gap=1e-3))]
    summary = solve(ContactProblem(dovetail(), laws, 600.0, 3)).summary()
    assert "no pair that may part ever touches: the other pairs alone join the bodies;" in summary
    assert "apart;" not in summary


@pytest.mark.parametrize(
    "laws, wear, told",
    [
        (ContactLaws("bonded", initial_gap=1e-3), None, 'initial_gap is ignored at pair 0: normal = "bonded"'),
        (ContactLaws("prescribed", normal_force=1.0, initial_gap=[0.1]), None, 'at pair 0: normal = "prescribed"'),
        (ContactLaws("bonded"), [1e-3], "wear is ignored at pair 0"),
        (
            ContactLaws("prescribed", normal_force={0: 0.1, 1: 0.3j}),
            None,
            "normal_force of pair 0 pulls by up to 0.2 N",
        ),
        (ContactLaws("prescribed", normal_force={0: 0.3, 1: 0.3j}), None, None),
        (ContactLaws("prescribed", "frictionless", normal_force={0: 0.1, 1: 0.3j}), None, None),
        (ContactLaws("bonded"), [0.0], None),
        (ContactLaws(initial_gap=1e-3), [1e-3], None),
    ],
)
def test_what_the_laws_take_no_notice_of_is_told(laws, wear, told):
    solution = solve(ContactProblem(lift_off_oscillator(), laws, 0.1, 9, wear=wear))
    assert solution.converged
    if told:
        assert told in solution.summary()
    else:
        assert "ignored" not in solution.summary() and "pulls by" not in solution.summary()


def test_samples_may_be_a_float_that_is_whole(rubbing):
    for ask in (rubbing.sliding_speed, lambda samples: rubbing.history("slip", samples)):
        np.testing.assert_array_equal(ask(8.0), ask(8))


@pytest.mark.parametrize("samples", [0, -1, 2.5, "many"])
def test_histories_need_a_number_of_samples(rubbing, samples):
    with pytest.raises(ModelError, match=r"samples = .*give a whole number"):
        rubbing.history("slip", samples)
    with pytest.raises(ModelError, match=r"samples = .*give a whole number"):
        rubbing.sliding_speed(samples)


def test_where_nothing_may_part_nothing_is_told():
    for laws in (ContactLaws("bonded", "bonded"), ContactLaws("prescribed", normal_force=1.0)):
        assert "touches" not in solve(ContactProblem(lift_off_oscillator(), laws, 0.1, 3)).summary()


@pytest.mark.parametrize("closure", ["spring", "dashpot"])
def test_pairs_that_just_reach_the_limit_do_not_slide(closure):
    """Rounding was told as sliding, with an estimated error of more than a hundred per cent, and wore the joint."""
    problem = ContactProblem(dovetail(excitation=20.0), ContactLaws(friction=20.0), 600.0, 5, closure=closure)
    stuck = solve(problem)
    samples = problem.basis.samples
    share = np.abs(stuck.history("friction_force", samples)) / stuck.history("normal_force", samples)
    solution = solve(replace(problem, laws=ContactLaws(friction=float(share.max()))))
    assert np.any(classify_contact(solution, samples) == SLIP)
    assert not np.any(solution.sliding_speed()) and solution.merit["J_T"] == 0.0
    assert estimate_at_once(solution).sliding == 0.0
