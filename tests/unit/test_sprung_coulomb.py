"""The stop operator behind springs that close the truncation, and what the springs are good for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from small_models import dovetail, friction_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.laws.inertial_coulomb import InertialCoulomb
from ewr_fenicsx.laws.sprung_coulomb import SprungCoulomb, run_stop
from ewr_fenicsx.problem.harmonics import select_basis
from ewr_fenicsx.solver import ladder

seeds = st.integers(0, 2**32 - 1)


def draw_period(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A drive and a limit of three pairs, which is zero at times."""
    rng = np.random.default_rng(seed)
    samples = int(rng.integers(2, 40))
    drive = rng.normal(size=(samples, 3)).cumsum(axis=0)
    limit = rng.uniform(0.0, 3.0) * rng.random((samples, 3)) * (rng.random((samples, 3)) < 0.8)
    return drive, limit


@given(seeds)
def test_a_stop_is_stepped_from_sample_to_sample(seed):
    drive, limit = draw_period(seed)
    force = drive[-1].copy()  # as far from the drive as what never slips shall be
    for _ in range(2):
        period = []
        for i, cone in enumerate(limit):
            force = np.clip(force + drive[i] - drive[i - 1], -cone, cone)
            period.append(force)
    np.testing.assert_allclose(run_stop(drive, limit).force, period, atol=1e-12 * np.abs(drive).max())


@given(seeds)
def test_a_stop_remembers_its_last_slip(seed):
    """``f_i = u_i - u_s + sign c_s`` with the sample ``s`` of the last slip, and ``f = u`` where there was none."""
    drive, limit = draw_period(seed)
    force, since, sign = run_stop(drive, limit)
    assert np.all(np.abs(force) <= limit + 1e-12 * np.abs(drive).max())
    slipped = since >= 0
    at = lambda signal: np.take_along_axis(signal, since, axis=0)  # noqa: E731
    remembered = np.where(slipped, drive - at(drive) + sign * at(limit), drive)
    np.testing.assert_allclose(force, remembered, atol=1e-12 * np.abs(drive).max())
    assert np.all(np.abs(sign[slipped]) == 1) and np.all(sign[~slipped] == 0)


def test_what_never_slips_follows_the_drive():
    drive = np.sin(np.linspace(0.0, 2 * np.pi, 16, endpoint=False))[:, None]
    force, since, _ = run_stop(drive, np.full((16, 1), 1.1))
    np.testing.assert_array_equal(force, drive)
    assert np.all(since == -1)


def test_a_stop_shakes_down():
    """A drive about a mean beyond the limit slips once and then never again: just within the limit."""
    drive = 2.0 + 0.5 * np.sin(np.linspace(0.0, 2 * np.pi, 16, endpoint=False))[:, None]
    force, _, _ = run_stop(drive, np.ones((16, 1)))
    np.testing.assert_allclose(force, drive - drive.max() + 1.0, atol=1e-15)


@given(seeds)
def test_matrices_of_earlier_samples(seed):
    rng = np.random.default_rng(seed)
    basis = select_basis((0, 1, 3), 16)
    weights, since = rng.normal(size=(16, 2)), np.repeat(rng.integers(-1, 16, size=(4, 2)), 4, axis=0)
    found = basis.recollection(weights, since)
    for k in range(2):
        for j, unit in enumerate(np.eye(basis.coefficients)):
            product = weights[:, k] * basis.synthesise(basis.to_amplitudes(unit[:, None]))[:, 0]
            held = np.where(since[:, k] >= 0, product[since[:, k]], 0.0)
            np.testing.assert_allclose(found[k][:, j], basis.project(held[:, None])[:, 0], atol=1e-13)


def test_springs_are_for_pairs_that_bend():
    """The nodes of a dovetail have a flexibility of their own at high harmonics; a mass on a spring has none."""
    tangential = lambda problem: [law for law in problem.system.laws if law.direction == "tangential"]  # noqa: E731
    rub = ContactLaws("prescribed", normal_force=0.3, friction=1.0)
    (alone,) = tangential(ContactProblem(friction_oscillator(), rub, 0.2, 9, closure="spring"))
    assert isinstance(alone, InertialCoulomb)
    joint = ContactProblem(dovetail(), ContactLaws(), 900.0, 9, closure="spring")
    (law,) = tangential(joint)
    assert isinstance(law, SprungCoulomb) and law.pairs.size == 6
    share = law.flexibility / joint.system.flexibility[joint.system.index["tangential"]]
    assert np.all((share > 0.1) & (share < 10.0))
    given_ones = np.array([1e-9, 0.0, 2e-9, 0.0, 0.0, 1e-9])
    dashed, sprung = tangential(replace(joint, closure=given_ones))
    np.testing.assert_array_equal(dashed.pairs, [1, 3, 4])
    np.testing.assert_array_equal(sprung.pairs, [0, 2, 5])
    np.testing.assert_array_equal(sprung.flexibility, [1e-9, 2e-9, 1e-9])


def test_a_resonance_beyond_the_harmonics_decides_no_spring():
    """A node of little mass on a light chain; one of the harmonics left out may meet a mode, damped or not."""
    K = np.diag([3.0, 2.0, 2.0, 1.0]) - np.diag(np.ones(3), 1) - np.diag(np.ones(3), -1)
    M = np.diag([1.0, 0.01, 1.0, 1.0])
    rub = ContactLaws("prescribed", normal_force=0.3, friction=1.0)
    mode = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[1])
    chosen = {}
    for damping in (0.0, 2e-4):
        model = ReducedModel(M, damping * K, K, None, np.eye(4)[[1]], {1: np.eye(4)[3]})
        for share in (1.0, 0.97, 1.03):
            frequency = share * mode / (2 * np.pi) / 6  # one more than the highest harmonic kept
            laws = ContactProblem(model, rub, frequency, 5, closure="spring").system.laws
            chosen[damping, share] = [law.flexibility[0] for law in laws if isinstance(law, SprungCoulomb)]
    at, *beside = (chosen[2e-4, share][0] for share in (1.0, 0.97, 1.03))
    assert max(beside) < at < 20 * max(beside), chosen


@pytest.mark.parametrize(
    ("closure", "told"),
    [
        ("sprung", 'closure = "sprung"; choose one of mass, dashpot, spring, or flexibilities.*spring'),
        (-1e-9, "closure = -1e-09; flexibilities must be finite and not negative"),
        (np.inf, "closure = inf; flexibilities must be finite"),
        ([1e-9, 1e-9], "closure has 2 values for 6 pairs"),
    ],
)
def test_what_is_no_closure_is_named(closure, told):
    with pytest.raises(ModelError, match=told):
        ContactProblem(dovetail(), ContactLaws(), 900.0, closure=closure)


def test_a_stuck_joint_is_the_linear_one():
    problem = ContactProblem(dovetail(excitation=0.5), ContactLaws(friction=0.5), 500.0, 5)
    springs, dashpots = solve(replace(problem, closure="spring")), solve(problem)
    np.testing.assert_allclose(springs.output("tip"), dashpots.output("tip"), rtol=1e-8)
    assert springs.iterations == 0


def test_springs_climb_through_fewer_and_looser_harmonics(monkeypatch):
    """Each set is started at what the one before found, and only the last is solved to the end."""
    climbed = []

    def record(run):
        def recorded(balance, unknowns, goal, *rest, **options):
            climbed.append((balance.basis.orders[-1], goal))
            return run(balance, unknowns, goal, *rest, **options)

        return recorded

    for name in ("run_newton", "run_and_follow"):
        monkeypatch.setattr(ladder, name, record(getattr(ladder, name)))
    monkeypatch.setattr(ladder, "can_split", lambda _: False)
    problem = ContactProblem(dovetail(excitation=300.0), ContactLaws(friction=0.2), 700.0, harmonics=15)
    tips = {}
    for closure, sets in (("dashpot", [(5, 1e-3), (15, 1e-8)]), ("spring", [(3, 1e-2), (7, 1e-2), (15, 1e-8)])):
        climbed.clear()
        solution = solve(replace(problem, closure=closure))
        assert climbed == sets and not solution.fallbacks
        tips[closure] = solution.output("tip")[1]
    assert 1e-6 < abs(tips["spring"] / tips["dashpot"] - 1) < 0.02


def test_a_pair_that_is_open_throughout_costs_springs_no_steps():
    """What it would remember is nothing; counted, its force fell by half a step only, to the ladder's second rung."""
    laws = ContactLaws(friction=0.3, initial_gap=[1e-3, 0, 0, 0, 0, 0])
    solution = solve(ContactProblem(dovetail(), laws, 360.0, 5, closure="spring"))
    assert solution.problem.system.closures == ("springs",) and solution.history("gap")[:, 0].min() > 0
    assert solution.fallbacks == () and solution.iterations <= 20
