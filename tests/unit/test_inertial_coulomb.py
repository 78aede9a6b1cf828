"""Masses that rub: their periodic slide, its derivatives, and where they close the truncation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_models import dovetail, friction_oscillator, one_pressed_of_two

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.laws.coulomb import Coulomb
from ewr_fenicsx.laws.inertial_coulomb import InertialCoulomb, slide
from ewr_fenicsx.problem.closure import find_masses
from ewr_fenicsx.problem.harmonics import FourierBasis, select_basis

seeds = st.integers(0, 2**32 - 1)


def draw_period(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A drive and a limit of three masses, which is zero at times; the mean drive is within the mean limit."""
    rng = np.random.default_rng(seed)
    samples = int(rng.integers(8, 60))
    tau = 2 * np.pi * np.arange(samples)[:, None] / samples
    drive = sum(rng.normal(size=3) * np.cos(h * tau + rng.uniform(0, 6, 3)) for h in (1, 2, 3))
    limit = rng.uniform(0.1, 2.0, 3) * (1 + rng.uniform(0, 1.5, 3) * np.cos(tau + rng.uniform(0, 6, 3)))
    limit = np.maximum(0.0, limit)
    return drive + rng.uniform(-0.9, 0.9) * limit.mean(axis=0), limit


def march(drive: np.ndarray, limit: np.ndarray, steps: int, periods: int) -> tuple[np.ndarray, np.ndarray]:
    """Momentum after each sample's interval and mean friction during it, by ``steps`` implicit steps an interval."""
    momentum, periodic = np.zeros(3), []
    for _ in range(periods):
        periodic = []
        for g, c in zip(drive, limit, strict=True):
            begin = momentum
            for _ in range(steps):
                free = momentum + g / steps
                momentum = np.sign(free) * np.maximum(0.0, np.abs(free) - c / steps)
            periodic.append((momentum, momentum - begin - g))
    return tuple(np.array(part) for part in zip(*periodic, strict=True))


@pytest.mark.parametrize("seed", range(6))
def test_a_slide_is_where_many_small_steps_end(seed):
    drive, limit = draw_period(seed)
    found = slide(drive, limit)
    momentum, friction = march(drive, limit, 60, 25)
    size = np.abs(drive).max()
    np.testing.assert_allclose(found.momentum, momentum, atol=0.03 * size)
    force = found.momentum - np.roll(found.momentum, 1, axis=0) - drive
    np.testing.assert_allclose(force, friction, atol=0.03 * size)


@given(seeds)
def test_friction_is_within_its_limit_and_against_the_slide(seed):
    drive, limit = draw_period(seed)
    found = slide(drive, limit)
    after = found.momentum
    before, rounding = np.roll(after, 1, axis=0), 1e-10 * np.abs(drive).max()
    force = after - before - drive
    assert np.all(np.abs(force) <= limit + rounding)
    slides = before * after > 0
    np.testing.assert_allclose(force[slides], (-np.sign(after) * limit)[slides], atol=rounding)
    rests = (before == 0) & (after == 0)
    np.testing.assert_allclose(force[rests], -drive[rests], atol=rounding)


@pytest.mark.parametrize("push", [1.0, 1.3])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_what_is_pushed_as_hard_as_friction_holds_slides_one_way(push, way):
    """It is stopped where it is slowest, and so has a mean momentum: no motion that slides so is a solution."""
    drive, limit = way * (push + np.sin(0.1 + 2 * np.pi / 32 * np.arange(32))[:, None]), np.ones((32, 1))
    momentum = way * slide(drive, limit).momentum[:, 0]
    stopped = np.flatnonzero(momentum == 0)
    assert stopped.size == 1 and momentum.min() == 0 and momentum.mean() > 1.0
    gathered = np.cumsum(np.roll(way * drive - limit, -1 - stopped[0]))[:-1]
    np.testing.assert_allclose(np.delete(np.roll(momentum, -1 - stopped[0]), -1), gathered, atol=1e-12)
    held = slide(0.5 * drive / push, limit).momentum
    assert np.count_nonzero(held == 0) > 1, "pushed less hard it rests for a while"


@pytest.mark.parametrize("harmonics", [8, 9, 15])
@pytest.mark.parametrize("friction", [1e-4, 3e-4])
def test_little_friction_is_not_all_given_to_a_mean_force(harmonics, friction):
    """A mean force of the whole limit leaves no more of the laws than the tolerance; it rubs nothing, and is wrong."""
    model = ReducedModel(
        mass=[[1.5]],
        damping=[[1.14]],
        stiffness=[[2.97]],
        tangential=[[1.0]],
        load={1: [1.42], 2: [0.267 - 0.13j]},
        outputs={"x": [1.0]},
    )
    laws = ContactLaws("prescribed", normal_force=friction, friction=1.0)
    problem = ContactProblem(model, laws, 0.2816 / (2 * np.pi), harmonics)
    work = {c: solve(replace(problem, closure=c)).merit["friction_dissipation"] for c in ("mass", "dashpot")}
    assert work["mass"] == pytest.approx(work["dashpot"], rel=0.02)
    swing = np.ptp(solve(replace(problem, laws=replace(laws, friction=0.0))).history("slip"))
    assert work["mass"] == pytest.approx(2 * friction * swing, rel=0.15)  # it turns twice a period, or a little more


@pytest.mark.parametrize("seed", [189, 507, 778, 1024, 2285])
def test_a_momentum_comes_back_also_where_nothing_rubs_as_it_turns(seed):
    """Then nothing of a change is lost, and the search has to stride: one period a round was not enough for these."""
    rng = np.random.default_rng(seed)
    tau = 2 * np.pi * np.arange(64)[:, None] / 64
    limit = np.maximum(0.0, rng.uniform(-0.8, 0.3) + np.cos(tau)) * 10 ** rng.uniform(-2, 0)
    drive = np.sin(tau + 0.3 * rng.normal()) + rng.uniform(0, 0.3) * np.cos(2 * tau + rng.uniform(0, 6))
    drive += rng.uniform(-0.9, 0.9) * limit.mean() - drive.mean()
    after = slide(drive, limit).momentum
    force = after - np.roll(after, 1, axis=0) - drive
    assert np.all(np.abs(force) <= limit + 1e-10)


def test_a_pair_that_is_open_throughout_has_no_friction():
    """Whatever its mean: a mass that another load holds off the ground, and shakes."""
    model = ReducedModel(
        mass=np.eye(2),
        damping=0.05 * np.eye(2),
        stiffness=np.eye(2),
        normal=[[0.0, 1.0]],
        tangential=[[1.0, 0.0]],
        load={0: [0.4, 1.0], 1: [1.0, 0.2]},
        outputs={"x": [1.0, 0.0]},
    )
    problem = ContactProblem(model, ContactLaws(friction=0.5), 0.3, 5)
    assert problem.system.closures == ("masses",)
    found = solve(problem)
    np.testing.assert_allclose(found.forces, 0.0, atol=1e-7)
    assert found.output("x")[0] == pytest.approx(0.4, abs=1e-7)


def test_a_pair_that_rounding_alone_presses_has_no_friction():
    """Its momentum was found in rounding: 3 Newton steps were 20, and surfaces slid four times as far a step ahead."""
    drive, limit = draw_period(5)
    found, free, pressed = (slide(drive, limit * [1.0, 1.0, share]) for share in (1e-17, 0.0, 1e-6))
    assert list(found.free) == [False, False, True] and not np.any(pressed.free)
    np.testing.assert_allclose(found.momentum, free.momentum, atol=1e-12)
    solution = solve(ContactProblem(one_pressed_of_two(), ContactLaws(friction=1.0, initial_gap=[0.0, 10.0]), 0.19))
    assert solution.problem.system.closures == ("masses",) and solution.iterations <= 5
    assert "may be off" not in solution.summary()


@given(seeds)
def test_matrices_of_a_gathered_momentum(seed):
    rng = np.random.default_rng(seed)
    basis = select_basis((0, 1, 3), 16)
    weights = rng.normal(size=(16, 2))
    kept = np.where(rng.random((16, 2)) < 0.3, rng.random((16, 2)), 1.0)
    kept[rng.integers(16)] = 0.0
    found = basis.accumulation(weights, kept)
    for k in range(2):
        for j, unit in enumerate(np.eye(basis.coefficients)):
            product = weights[:, k] * basis.synthesise(basis.to_amplitudes(unit[:, None]))[:, 0]
            gathered, total = [], 0.0
            for i in range(2 * 16):
                total = kept[i % 16, k] * total + product[i % 16]
                gathered.append(total)
            once = np.array(gathered[16:])
            counts = once - np.roll(once, 1) + 2 * np.pi / 16 * once.mean()
            np.testing.assert_allclose(found[k][:, j], basis.project(counts[:, None])[:, 0], atol=1e-12)


def rub_under_moving_forces(**settings) -> ContactProblem:
    """Two masses that a spring joins, each rubbing under a force that moves, with mean loads."""
    stiffness = np.array([[3.0, -1.0], [-1.0, 2.0]])
    model = ReducedModel(
        mass=np.diag([1.0, 2.0]),
        damping=0.05 * stiffness,
        stiffness=stiffness,
        tangential=np.eye(2),
        load={0: [0.3, -0.2], 1: [1.0, 0.4j], 2: [0.3, 0.1]},
        outputs={"first": [1.0, 0.0], "second": [0.0, 1.0]},
    )
    laws = ContactLaws("prescribed", friction=0.5, normal_force={0: [1.0, 0.8], 1: [0.9j, 0.3]})
    return ContactProblem(model, laws, settings.pop("frequency", 0.3), closure="spring", **settings)


def name_states(balance: HarmonicBalance, point: np.ndarray) -> set[str]:
    """What masses do at a point: come to rest and stay there, reverse, are stopped once by force."""
    forces, rigid = balance.unpack(point)
    found = set()
    seen = balance.sample(forces, balance.compliance.motion(forces, rigid))
    for law, motion in zip(balance.system.laws, seen, strict=True):
        run, _ = law.run(motion)
        reverses = (run.kept > 0) & (run.kept < 1)
        rests = run.momentum == 0
        stopped = rests & (np.count_nonzero(rests, axis=0) == 1) & ~run.free
        states = {"rest": rests & ~stopped, "reverse": reverses, "driven off": stopped}
        found |= {name for name, there in states.items() if np.any(there)}
    return found


@pytest.mark.parametrize(
    ("size", "loaded", "state"),
    [(0.1, 1.0, "reverse"), (2.0, 1.0, "reverse"), (8.0, 1.0, "driven off"), (0.02, 0.25, "rest")],
)
@pytest.mark.parametrize("harmonics", [5, (0, 1, 2, 5)])
def test_the_jacobian_is_that_of_finite_differences(harmonics, size, loaded, state):
    usual = rub_under_moving_forces(harmonics=harmonics, samples=80)
    problem = replace(usual, load={h: loaded * f for h, f in usual.loads.items()})
    balance = HarmonicBalance(problem.system, 1.0)
    assert all(isinstance(law, InertialCoulomb) for law in balance.system.laws)
    point = size * np.random.default_rng(0).normal(size=balance.size)
    assert state in name_states(balance, point)
    step = balance.linearise(point)
    matrix, small = step.matrix(), 1e-7
    moved = [balance.residual(point + small * e) - balance.residual(point - small * e) for e in np.eye(balance.size)]
    np.testing.assert_allclose(matrix, np.array(moved).T / (2 * small), atol=1e-6 * np.abs(matrix).max())
    right = np.linspace(-1.0, 1.0, balance.size)
    np.testing.assert_allclose(step.solve(right), np.linalg.solve(matrix, right), rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(step.multiply(right), matrix @ right, atol=1e-11 * np.abs(matrix).max())


def test_masses_are_those_of_pairs_that_move_by_themselves():
    mass = np.diag([2.0, 3.0])
    model = ReducedModel(
        mass, 0.01 * mass, np.array([[2.0, -1.0], [-1.0, 1.0]]), tangential=[[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]]
    )
    np.testing.assert_allclose(find_masses(model, model.tangential[:2], 1.0, 9), [2.0, 3.0], rtol=0.02)
    np.testing.assert_allclose(find_masses(model, model.tangential[2:], 1.0, 9), [1.2], rtol=0.02)
    for damping, counts in ((9.0, True), (11.0, False)):  # of m omega; the first harmonic left out is the tenth
        damped = replace(model, damping=damping * mass)
        assert np.all((find_masses(damped, model.tangential[:2], 1.0, 9) > 0) == counts)
    np.testing.assert_array_equal(find_masses(model, model.tangential[[0, 2]], 1.0, 9), 0.0)  # one moves the other
    np.testing.assert_array_equal(find_masses(model, model.tangential[:2], 1e-3, 9), 0.0)  # springs hold them there
    joint = dovetail()
    np.testing.assert_array_equal(find_masses(joint, joint.tangential, 3000.0, 9), 0.0)


def test_harmonics_left_out_may_hit_an_undamped_mode():
    """As the sixth does here, of which a solve with five knows nothing."""
    rub = ContactProblem(friction_oscillator(), ContactLaws("prescribed", normal_force=0.2), 1 / (12 * np.pi), 5)
    assert rub.system.closures == () and solve(rub).converged


@pytest.mark.parametrize("closure", ["mass", "spring"])
@pytest.mark.parametrize("highest", [3, 4, 5, 6])
def test_a_solution_solves_its_own_problem_whether_even_harmonics_are_left_out_or_not(highest, closure):
    rub = ContactLaws("prescribed", normal_force=0.7, friction=1.0)
    found = solve(ContactProblem(friction_oscillator(damping=0.02), rub, 0.1, highest, closure=closure))
    assert found.left_out and found.problem.basis.orders[-1] == highest
    balance = HarmonicBalance(found.problem.system)
    assert np.linalg.norm(balance.residual(balance.pack(found.forces, found.rigid))) < 1e-8


def test_a_block_that_rubs_at_several_pairs_keeps_its_dashpots():
    model = ReducedModel([[1.0]], [[0.01]], [[1.0]], tangential=[[1.0], [1.0]], load={1: [1.0]})
    laws = ContactLaws("prescribed", normal_force=0.2, friction=0.5)
    (law,) = ContactProblem(model, laws, 0.3, 9, closure="spring").system.laws
    assert isinstance(law, Coulomb)


def test_a_mass_that_sticks_is_at_rest_in_both_closures():
    problem = ContactProblem(
        friction_oscillator(), ContactLaws("prescribed", normal_force=2.0, friction=1.0), 0.3, 5, closure="spring"
    )
    masses, dashpots = solve(problem), solve(replace(problem, closure="dashpot"))
    np.testing.assert_allclose(masses.forces, dashpots.forces, atol=1e-12)
    assert masses.merit["J_T"] < 1e-12


def test_the_surface_of_a_mass_that_hardly_rubs_moves_with_it():
    """At the same instants: a sample late, it would lag by a 64th of a turn."""
    rub = ContactProblem(friction_oscillator(damping=0.1), ContactLaws("prescribed", normal_force=1e-4), 0.2, 5)
    found = solve(rub)
    ((law, fields),) = found.law_fields(FourierBasis(found.orders, 64))
    assert isinstance(law, InertialCoulomb)
    moved = 2 / 64 * np.fft.rfft(fields["surface_slip"][:, 0])[1]
    assert moved == pytest.approx(found.output("tip")[1], rel=2e-3)


def test_masses_close_the_truncation_unless_something_else_is_asked_for():
    rub = ContactProblem(friction_oscillator(), ContactLaws("prescribed", normal_force=0.7, friction=1.0), 0.2)
    assert rub.system.closures == replace(rub, closure="spring").system.closures == ("masses",)
    for other in ({"closure": "dashpot"}, {"rho_tangential": 0.1}, {"closure": np.zeros(1)}):
        assert replace(rub, **other).system.closures == ()
    assert replace(rub, closure=np.array([0.1])).system.closures == ("springs",)
    assert ContactProblem(dovetail(), ContactLaws(), 900.0, 9).system.closures == ()


def test_where_no_solution_is_found_with_masses_dashpots_take_their_place(monkeypatch):
    rub = ContactProblem(
        friction_oscillator(damping=0.02), ContactLaws("prescribed", normal_force=0.7, friction=1.0), 0.2
    )
    usual = solve(replace(rub, closure="dashpot"))
    evaluate, rng = InertialCoulomb.evaluate, np.random.default_rng(0)

    def lead_astray(law, motion):
        response = evaluate(law, motion)
        return response._replace(residual=response.residual + rng.normal(size=response.residual.shape))

    monkeypatch.setattr(InertialCoulomb, "evaluate", lead_astray)
    found = solve(rub)
    assert found.problem.closure == "dashpot" and "solved with these only" in found.summary()
    np.testing.assert_allclose(found.forces, usual.forces, atol=1e-8)
