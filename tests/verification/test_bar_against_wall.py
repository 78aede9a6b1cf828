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

Source: d'Alembert's solution, derived here.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import brentq
from small_models import bar_against_wall

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.solution import PeriodicSolution

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
