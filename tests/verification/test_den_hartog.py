"""One mass with dry friction: exact motion without stops.

``x'' + x + F sign(x') = cos(beta t)``, in the units ``m = k = P = 1``. With ``V = 1 / (1 - beta^2)`` and
``U = tan(pi / (2 beta)) / beta`` the amplitude is ``x0 = sqrt(V^2 - F^2 U^2)``, as long as the mass never stops:
``x0 >= F S``, ``S = max over 0 < tau < pi of [sin(tau/beta) + U beta (cos tau - cos(tau/beta))] / (beta sin tau)``.
The friction force is then a square wave, harmonics ``4 F / (m pi)``, m odd, and dissipates ``4 F x0`` a cycle.

Rate: the velocity lacks the tail of ``sum 4 F / (pi m^2)`` over m odd above N, about ``2 F / (pi N)`` at the instant
where it should vanish. Friction reverses where the truncated velocity does, so its phase, and with it the amplitude,
is off by a term in 1/N. The penalty ``1 / rho`` of the friction law adds to the ringing: a smaller rho is more
accurate. Where the mass itself closes the truncation (``inertial_coulomb.py``), friction reverses where the mass does,
and the error is that of the tail of the displacement, ``1 / N^2``.

Source: Den Hartog (1931), Trans. ASME 53, APM-53-9, "Forced vibrations with combined Coulomb and viscous friction".
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from small_models import friction_oscillator

from ewr_fenicsx import ContactLaws, ContactProblem, solve
from ewr_fenicsx.solution.contact_state import STICK, classify_contact
from ewr_fenicsx.solution.solution import PeriodicSolution

# beta, F, amplitude, largest F without stops, error allowed at N = 31 (measured: 0.25, 1.65, 0.11 and 0.10 %)
TABLE = [
    (0.8, 0.4, 2.50179, 0.81742, 0.0030),
    (0.8, 0.7, 1.80379, 0.81742, 0.0180),
    (1.25, 0.3, 1.61706, 0.69882, 0.0013),
    (0.6, 0.2, 1.55060, 0.53153, 0.0011),
]
rows = pytest.mark.parametrize("beta, friction, amplitude, boundary, allowed", TABLE)
EXACT_RHO = 0.1  # rho_T in units of omega times flexibility


@lru_cache
def rub(beta: float, friction: float, highest: int, rho: float | None = EXACT_RHO) -> PeriodicSolution:
    return solve(
        ContactProblem(
            friction_oscillator(),
            ContactLaws("prescribed", normal_force=friction, friction=1.0),
            beta / (2 * np.pi),
            tuple(range(1, highest + 1, 2)),
            samples=max(128, 64 * highest),
            rho_tangential=None if rho is None else rho * beta,
        )
    )


def rub_with_inertia(beta: float, friction: float, highest: int) -> PeriodicSolution:
    """The same with the truncation closed by the mass."""
    usual = rub(beta, friction, 7).problem
    kept = tuple(range(1, highest + 1, 2))
    return solve(replace(usual, harmonics=kept, samples=64 * highest, rho_tangential=None, closure="spring"))


def largest_slip(solution: PeriodicSolution) -> float:
    return solution.history("slip", 4096).max()


def amplitude_error(beta: float, friction: float, highest: int, rho: float | None = EXACT_RHO) -> float:
    return abs(largest_slip(rub(beta, friction, highest, rho)) / exact_amplitude(beta, friction) - 1)


def exact_amplitude(beta: float, friction: float) -> float:
    return np.sqrt((1 / (1 - beta**2)) ** 2 - (friction * np.tan(np.pi / (2 * beta)) / beta) ** 2)


def largest_friction_without_stops(beta: float) -> float:
    U = np.tan(np.pi / (2 * beta)) / beta
    slope = lambda t: (np.sin(t / beta) + U * beta * (np.cos(t) - np.cos(t / beta))) / (beta * np.sin(t))  # noqa: E731
    grid = np.linspace(1e-4, np.pi - 1e-4, 2001)
    best = grid[np.argmax(slope(grid))]
    S = -minimize_scalar(
        lambda t: -slope(t), bounds=(max(1e-4, best - 0.01), min(np.pi - 1e-4, best + 0.01)), method="bounded"
    ).fun
    return 1 / ((1 - beta**2) ** 2 * (S**2 + U**2)) ** 0.5


@rows
def test_the_table_is_den_hartogs(beta, friction, amplitude, boundary, allowed):
    assert exact_amplitude(beta, friction) == pytest.approx(amplitude, abs=6e-6)
    assert largest_friction_without_stops(beta) == pytest.approx(boundary, abs=6e-6)


@rows
def test_amplitude_and_its_rate_in_the_harmonics(beta, friction, amplitude, boundary, allowed):
    orders = np.array([7, 15, 31, 63])
    errors = np.array([amplitude_error(beta, friction, n) for n in orders])
    assert errors[2] < allowed
    rate = -np.polyfit(np.log(orders), np.log(errors), 1)[0]
    assert 0.8 < rate < 1.15, errors


@rows
def test_the_error_is_a_term_in_one_over_n(beta, friction, amplitude, boundary, allowed):
    """So two orders extrapolate to what neither reaches: 2 x(63) - x(31)."""
    extrapolated = 2 * largest_slip(rub(beta, friction, 63)) - largest_slip(rub(beta, friction, 31))
    assert abs(extrapolated / exact_amplitude(beta, friction) - 1) < 0.3 * amplitude_error(beta, friction, 63)


@rows
def test_a_smaller_rho_is_more_accurate(beta, friction, amplitude, boundary, allowed):
    errors = [amplitude_error(beta, friction, 31, rho) for rho in (10.0, 1.0, 0.1)]
    assert errors[0] > 1.3 * errors[1] > 1.6 * errors[2], errors


@rows
def test_default_weight_converges_too(beta, friction, amplitude, boundary, allowed):
    assert amplitude_error(beta, friction, 31, None) < 2.2 * allowed
    assert amplitude_error(beta, friction, 31, None) < 0.5 * amplitude_error(beta, friction, 7, None)


@rows
def test_its_own_mass_closes_the_truncation(beta, friction, amplitude, boundary, allowed):
    """The error is then a term in 1/N^2, and below a tenth of the dashpots'."""
    orders, exact = np.array([7, 15, 31, 63]), exact_amplitude(beta, friction)
    errors = [abs(largest_slip(rub_with_inertia(beta, friction, highest)) / exact - 1) for highest in orders]
    assert errors[0] < 0.13 * amplitude_error(beta, friction, 7)
    assert errors[2] < 0.1 * allowed
    rate = -np.polyfit(np.log(orders), np.log(errors), 1)[0]
    assert 1.7 < rate < 2.4, errors


@rows
def test_the_surfaces_of_a_mass_slide_four_amplitudes_a_cycle(beta, friction, amplitude, boundary, allowed):
    """With seven harmonics, where dashpots leave the sliding up to 8 % short."""
    closed = rub_with_inertia(beta, friction, 7)
    assert closed.merit["J_T"] == pytest.approx(4 * amplitude, rel=1e-3)
    assert closed.merit["friction_dissipation"] == pytest.approx(4 * friction * amplitude, rel=1e-3)
    assert abs(closed.merit["energy_error"]) < 1e-6


@rows
def test_friction_harmonics_are_those_of_a_square_wave(beta, friction, amplitude, boundary, allowed):
    solution = rub(beta, friction, 63)
    orders = np.array(solution.orders)[:8]
    found = np.abs(solution.forces[:8, 0])
    np.testing.assert_allclose(found, 4 * friction / (orders * np.pi), rtol=0.012)
    np.testing.assert_allclose(found[0], 4 * friction / np.pi, rtol=1e-4)
    # in phase with the velocity, against it: friction on A along +t while it slides along -t
    velocity = 1j * orders * solution.output("tip")[:8]
    assert np.real(solution.forces[0, 0] / velocity[0]) < 0


@rows
def test_work_of_a_cycle(beta, friction, amplitude, boundary, allowed):
    solution = rub(beta, friction, 63)
    merit = solution.merit
    assert merit["friction_dissipation"] == pytest.approx(4 * friction * largest_slip(solution), rel=1e-3)
    assert merit["friction_dissipation"] == pytest.approx(4 * friction * amplitude, rel=allowed)
    assert merit["excitation_work"] == pytest.approx(merit["friction_dissipation"], rel=1e-3)
    assert merit["viscous_dissipation"] == 0.0


def share_at_rest(beta: float, friction: float) -> float:
    """Share of the period at less than 1 % of the largest velocity; a sine is there for 0.64 %."""
    velocity = np.abs(rub(beta, friction, 31).history("slip_velocity", 4096))
    return float(np.mean(velocity < 0.01 * velocity.max()))


@pytest.mark.parametrize("beta, boundary", [(0.8, 0.81742), (1.25, 0.69882), (0.6, 0.53153)])
def test_the_mass_stops_beyond_the_boundary_and_not_before(beta, boundary):
    assert share_at_rest(beta, 0.9 * boundary) < 0.009
    assert share_at_rest(beta, 1.2 * boundary) > 0.09


def find_boundary(beta: float, exact: float) -> float:
    """Largest friction at which no sample rests, by bisection within a tenth of the exact one."""
    low, high = 0.9 * exact, 1.1 * exact
    while high - low > 5e-4 * exact:
        middle = 0.5 * (low + high)
        rests = np.any(classify_contact(rub_with_inertia(beta, middle, 31), 4096) == STICK)
        low, high = (low, middle) if rests else (middle, high)
    return 0.5 * (low + high)


@pytest.mark.parametrize("beta, boundary", [(0.8, 0.81742), (1.25, 0.69882), (0.6, 0.53153)])
def test_a_mass_that_closes_the_truncation_begins_to_stop_at_the_boundary(beta, boundary):
    assert find_boundary(beta, boundary) == pytest.approx(boundary, rel=2e-3)


@pytest.mark.parametrize("beta, friction", [(0.8, 1.05), (0.6, 1.01), (1.25, 1.3)])
def test_a_force_above_the_load_holds_the_mass(beta, friction):
    solution = rub(beta, friction, 7)
    assert largest_slip(solution) < 1e-12
    np.testing.assert_allclose(solution.forces[0, 0], -1.0, atol=1e-10)


def test_all_harmonics_find_that_the_even_ones_vanish():
    """The mean, resolved, and the even harmonics are zero by symmetry."""
    odd = rub(0.8, 0.4, 7)
    full = solve(
        ContactProblem(
            friction_oscillator(),
            ContactLaws("prescribed", normal_force=0.4, friction=1.0),
            0.8 / (2 * np.pi),
            7,
            samples=448,
            rho_tangential=EXACT_RHO * 0.8,
        ),
        tolerance=1e-11,
    )
    np.testing.assert_allclose(full.forces[0::2], 0.0, atol=1e-8)
    np.testing.assert_allclose(full.forces[1::2], odd.forces, atol=1e-7)
