"""The contact solve of a step: where sweeps alone close in slowly, what they tend to is found in few."""

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate
from ewr_fenicsx.in_time import compiled_loop
from ewr_fenicsx.in_time.compiled_loop import SLOW, WINDOW, extrapolate


def press_a_strip(pairs: int, friction: float) -> ContactProblem:
    """Light nodes on a line, joined by springs so stiff that in a step a push on one moves all, pressed and shaken."""
    line = 2 * np.eye(pairs) - np.eye(pairs, k=1) - np.eye(pairs, k=-1)
    line[0, 0] = line[-1, -1] = 1.05
    stiffness = 1e6 * np.kron(np.eye(2), line)
    normal, tangential = np.eye(2 * pairs)[:pairs], np.eye(2 * pairs)[pairs:]
    sideways = np.zeros(2 * pairs)
    sideways[-1] = 10.0
    model = ReducedModel(
        mass=1e-2 * np.eye(2 * pairs),
        stiffness=stiffness,
        damping=1e-4 * stiffness,
        normal=normal,
        tangential=tangential,
        load={0: -np.repeat([5.0, 0.0], pairs), 1: sideways},
    )
    return ContactProblem(model, ContactLaws(friction=friction), frequency=20.0, harmonics=1)


def test_extrapolation_solves_a_linear_map_once_it_looks_back_on_its_dimension():
    rng = np.random.default_rng(3)
    m = WINDOW - 2
    slow = np.diag(np.linspace(-0.6, 0.95, m)) + 0.02 * rng.normal(size=(m, m))
    offset, moves = rng.normal(size=m), rng.normal(size=(m, m))
    exact = np.linalg.solve(np.eye(m) - slow, offset)
    last, differences, overlap = np.zeros((3, m)), np.zeros((3, WINDOW, m)), np.zeros((WINDOW, WINDOW))
    p, known = np.zeros(m), -1
    for _ in range(m + 1):
        swept = slow @ p + offset
        changed, p, u = swept - p, swept.copy(), moves @ swept
        known = extrapolate(known, changed, p, u, last, differences, overlap)
        assert u == pytest.approx(moves @ p, rel=1e-6, abs=1e-6 * np.abs(u).max())
    before, after = (np.abs(values - exact).max() / np.abs(exact).max() for values in (swept, p))
    assert after < 1e-4 < 1e-2 < before


@pytest.mark.parametrize("size", [1.0, 1e-200, 1e150])
def test_extrapolation_leaves_what_changes_evenly_or_grows_without_bound(size):
    m = 4
    last, differences, overlap = np.zeros((3, m)), np.zeros((3, WINDOW, m)), np.zeros((WINDOW, WINDOW))
    known, even = -1, size == 1.0
    for k in range(1, 4):
        p, u = np.full(m, k * size), np.full(m, -k * size)
        known = extrapolate(known, np.full(m, size if even else k * size), p, u, last, differences, overlap)
        assert np.all(p == k * size) and np.all(u == -k * size)
    assert known == 2


def test_extrapolation_does_not_run_after_what_drifts_on():
    last, differences, overlap = np.zeros((3, 2)), np.zeros((3, WINDOW, 2)), np.zeros((WINDOW, WINDOW))
    known = -1
    for k, change in enumerate([1.0, 1.0 - 1e-6, 1.0 - 2e-6]):  # sweeps would end after a million
        p, u = np.full(2, float(k)), np.zeros(2)
        known = extrapolate(known, np.full(2, change), p, u, last, differences, overlap)
        assert np.all(p == k)


def test_pairs_that_stick_and_move_one_another_take_few_sweeps():
    """Their impulses are known: those that hold all pairs where they are."""
    result = integrate(press_a_strip(30, 5.0), steps=50, periods=1, tolerance=0, contact_tolerance=1e-11)
    scheme, last = result.scheme, result.last
    free = scheme.keep * last.velocities[:-1] + scheme.pull * last.positions[:-1] + scheme.velocity_of_load
    held = np.linalg.solve(scheme.delassus_columns.T, -(free @ scheme.rows.T).T).T
    assert last.impulses == pytest.approx(held, abs=1e-6 * np.abs(held).max())
    assert result.unsolved == 0 and result.sweeps < 70  # sweeps alone: 100


def test_compiled_extrapolation_is_the_one_that_is_read(monkeypatch):
    problem = press_a_strip(12, 0.3)
    compiled = integrate(problem, steps=20, periods=1, tolerance=0, contact_tolerance=1e-12)
    monkeypatch.setattr("ewr_fenicsx.in_time.time_stepping.compile_loop", lambda: compiled_loop.step_through_period)
    plain = integrate(problem, steps=20, periods=1, tolerance=0, contact_tolerance=1e-12)
    assert plain.sweeps == pytest.approx(compiled.sweeps, rel=0.1) and compiled.sweeps > SLOW
    assert plain.last.impulses == pytest.approx(compiled.last.impulses, abs=1e-7 * np.abs(compiled.last.impulses).max())


def test_impulses_that_slide_in_a_plane_meet_the_tolerance():
    """Beside what pairs would take to stick, far beyond their limits, any change is small: these are not to be met."""
    pairs = 4
    line = 2 * np.eye(pairs) - np.eye(pairs, k=1) - np.eye(pairs, k=-1)
    stiffness = 1e4 * np.kron(np.eye(3), line) + 1e2 * np.eye(3 * pairs)
    rows = np.eye(3 * pairs)
    model = ReducedModel(
        mass=1e-2 * np.eye(3 * pairs),
        damping=1e-4 * stiffness,
        stiffness=stiffness,
        normal=rows[:pairs],
        tangential=rows[pairs:],
        load={0: -np.repeat([1.0, 0.0, 0.0], pairs), 1: np.linspace(0.0, 2000.0, pairs) @ rows[pairs : 2 * pairs]},
    )
    problem = ContactProblem(model, ContactLaws(friction=0.1), frequency=20.0, harmonics=1)
    runs = [integrate(problem, steps=60, periods=1, tolerance=0, contact_tolerance=c) for c in (1e-6, 1e-12)]
    rough, fine = (run.last.impulses for run in runs)
    assert np.abs(rough - fine).max() < 1e-5 * np.abs(fine).max()
