"""A bar pressed on a rigid wall, driven at its far end: exact waves, and a contact force that jumps.

``E = A = rho = L = c = 1``. At the far end acts ``F(t) = P + Q cos(omega t)`` on a dashpot of the bar's impedance,
which absorbs what the wall sends back: the wave toward the wall carries half of F whatever the contact does. At the
wall,

    closed:  lam(t) = F(t - 1)              (the wave is doubled)
    open:    the end moves at F(t - 1), the gap closes where the integral of F since it opened is back at zero.

For ``Q > P`` the end lifts off when F turns negative and lands while F is positive: ``lam`` jumps from 0 to ``F >
0``. The bar floats: only the mean contact force, exactly P, holds it.

Rates: in the root mean square, the Fourier sum of a force that jumps errs like N^(-1/2), and that of a gap whose
velocity jumps like N^(-3/2). The force is that of the truncated law, so the gap is a little worse than its own
Fourier sum.

Without the dashpot nothing is absorbed, and the end's compliance is ``-cot(omega) / omega``: with poles and zeros at
any order, so that more harmonics need not be more accurate. That is a case for stability; where ``cot`` vanishes at the
first harmonic, the end's first harmonic is known, whatever the contact does.

Source: d'Alembert's solution, derived here.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from checked_solutions import measure_residual
from scipy.optimize import brentq
from small_models import bar_against_wall

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.solution.solution import PeriodicSolution

MEAN, RIPPLE, OMEGA, SAMPLES = 1.0, 1.8, 0.7, 4096


@lru_cache
def press(highest: int, elements: int = 120, ripple: float = RIPPLE, mean: float = MEAN) -> PeriodicSolution:
    model = bar_against_wall(elements=elements, mean=mean, amplitude=ripple)
    laws = ContactLaws(tangential="frictionless")
    return solve(ContactProblem(model, laws, OMEGA / (2 * np.pi), highest, 64 * highest))


def exact_histories() -> tuple[np.ndarray, np.ndarray]:
    """Gap and contact force over a period, ``(SAMPLES,)`` each."""
    moved = lambda tau: (MEAN * tau + RIPPLE * np.sin(tau)) / OMEGA  # noqa: E731
    lift_off = np.arccos(-MEAN / RIPPLE)
    landing = brentq(lambda tau: moved(tau) - moved(lift_off), 2 * np.pi - lift_off, lift_off + 2 * np.pi)
    local = (2 * np.pi * np.arange(SAMPLES) / SAMPLES - OMEGA - lift_off) % (2 * np.pi) + lift_off
    open_now = local < landing
    gap = np.where(open_now, moved(lift_off) - moved(local), 0.0)
    return gap, np.where(open_now, 0.0, MEAN + RIPPLE * np.cos(local))


def root_mean_square(error: np.ndarray, scale: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2) / np.mean(scale**2)))


def errors(solution: PeriodicSolution) -> tuple[float, float]:
    gap, force = exact_histories()
    return (
        root_mean_square(solution.history("gap", SAMPLES)[:, 0] - gap, gap),
        root_mean_square(solution.history("normal_force", SAMPLES)[:, 0] - force, force),
    )


def test_the_exact_solution_is_one():
    """Of the test itself: Signorini's conditions, the mean force, and the end's velocity where it is open."""
    gap, force = exact_histories()
    assert gap.min() > -1e-12 and force.min() >= 0 and np.all(gap * force == 0)
    assert force.mean() == pytest.approx(MEAN, abs=2e-3)
    tau = 2 * np.pi * np.arange(SAMPLES) / SAMPLES - OMEGA
    velocity = np.gradient(gap, 2 * np.pi / SAMPLES / OMEGA)
    inside = (gap > 0) & (np.roll(gap, 1) > 0) & (np.roll(gap, -1) > 0)
    inside[[0, -1]] = False
    np.testing.assert_allclose(velocity[inside], -(MEAN + RIPPLE * np.cos(tau))[inside], atol=1e-3)


def test_while_it_stays_closed_the_wave_is_doubled():
    """No lift-off: a linear problem with the exact answer lam_1 = Q exp(-i omega), up to the mesh."""
    for elements, allowed in ((30, 3e-4), (60, 0.8e-4)):
        solution = press(3, elements, ripple=0.5)
        np.testing.assert_allclose(solution.forces[:, 0], [MEAN, 0.5 * np.exp(-1j * OMEGA), 0, 0], atol=0.5 * allowed)
        assert np.abs(solution.history("gap", 64)).max() < 1e-12


def test_the_mean_contact_force_is_the_mean_load():
    for highest in (3, 9, 27):
        assert press(highest).forces[0, 0] == pytest.approx(MEAN, abs=1e-8)


def test_histories_converge():
    """The errors themselves are in docs/verification.md."""
    orders = np.array([5, 9, 17, 33])
    found = np.array([errors(press(n)) for n in orders])
    gap, force = (-np.polyfit(np.log(orders), np.log(found[:, i]), 1)[0] for i in range(2))
    assert 1.1 < gap < 1.6 and 0.4 < force < 0.6, (found, gap, force)
    assert found[-1, 0] < 0.0095 and found[-1, 1] < 0.060, found


def test_the_force_is_close_to_its_own_fourier_sum():
    """No truncated series can be nearer: the distance is at most a third above it at N = 33."""
    _, force = exact_histories()
    best = np.fft.rfft(force)
    best[34:] = 0
    smallest = root_mean_square(np.fft.irfft(best, SAMPLES) - force, force)
    assert smallest < errors(press(33))[1] < 1.35 * smallest


def test_lift_off_lasts_as_long_as_it_should():
    gap, _ = exact_histories()
    opened = np.mean(press(33).history("gap", SAMPLES)[:, 0] > 0.02)
    assert opened == pytest.approx(np.mean(gap > 0.02), abs=0.01)
    assert 0.2 < opened < 0.8


def pose_undamped(omega: float, highest: int) -> ContactProblem:
    model = bar_against_wall(elements=60, mean=MEAN, amplitude=RIPPLE)
    model = replace(model, damping=np.zeros_like(model.damping))
    return ContactProblem(model, ContactLaws(tangential="frictionless"), omega / (2 * np.pi), highest, 64 * highest)


@lru_cache
def press_undamped(omega: float, highest: int) -> PeriodicSolution:
    return solve(pose_undamped(omega, highest))


def find_swing(solution: PeriodicSolution) -> float:
    """Amplitude of the end's first harmonic."""
    return abs(solution.output("contact_end")[1])


def test_without_the_dashpot_the_compliance_is_a_cotangent():
    """Of the test itself: to what the mesh leaves, at 60 elements to the bar."""
    omega = 1.0 * np.arange(1, 6)
    found = pose_undamped(1.0, 5).system.compliance.flexibility[1:, 0, 0]
    np.testing.assert_allclose(found, -1 / (omega * np.tan(omega)), rtol=6e-3)


@pytest.mark.parametrize("highest", [3, 5, 7, 9, 13, 17])
@pytest.mark.parametrize(
    "omega, allowed",
    [
        (0.7, 0.015),
        (1.0, 0.007),
        (2.0, 0.015),
        (1.01 * np.pi / 3, 0.011),  # the third harmonic next to a pole, then on it but for 1e-4
        ((1 + 1e-4) * np.pi / 3, 0.01),
        ((1 + 1e-3) * np.pi / 5, 0.027),
    ],
)
def test_an_undamped_bar_is_solved_however_close_a_harmonic_is_to_a_pole(omega, allowed, highest):
    """The end swings as with 33 harmonics within 0.7 to 2.7 %."""
    solution = press_undamped(omega, highest)
    assert measure_residual(solution) <= 1e-8
    assert all(np.isfinite(solution.history(name)).all() for name in ("gap", "normal_force"))
    assert solution.forces[0, 0] == pytest.approx(MEAN, abs=1e-8)
    assert find_swing(solution) == pytest.approx(find_swing(press_undamped(omega, 33)), rel=allowed)


def test_more_harmonics_need_not_be_more_accurate_without_damping():
    """Measured: the largest gap with 3, 5 and 33 harmonics is 4.95, 5.20 and 4.95."""
    few, more, many = (press_undamped(1.01 * np.pi / 3, n).history("gap").max() for n in (3, 5, 33))
    assert abs(more - many) > 10 * abs(few - many)


@pytest.mark.parametrize("highest", [3, 5, 9, 17])
def test_where_the_end_does_not_yield_at_the_first_harmonic_its_swing_is_the_free_one(highest):
    """``cot(pi / 2) = 0``: the load alone moves the end, by ``Q / (omega sin(omega))``."""
    solution = press_undamped(np.pi / 2, highest)
    assert solution.history("gap").max() > 2.0, "it lifts off"
    assert find_swing(solution) == pytest.approx(RIPPLE / (np.pi / 2), rel=2e-4)
