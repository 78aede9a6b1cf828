"""One mass with dry friction where Den Hartog's closed form degenerates: next to ``beta = 1/2`` and ``beta = 1/3``.

At ``beta = 1/2`` each stroke lasts one period of the free mass. Motions without stops may then carry any free
oscillation at twice the frequency, within limits: a continuum of solutions, marginally stable, all of the amplitude
``V``. The compliance at the second harmonic is infinite there. At ``beta = 1/3`` the factor ``U`` of friction is
infinite, and every motion has stops.

Source: Den Hartog (1931), as in ``test_den_hartog.py``; the continuum is derived here. Between two reversals
``x = V cos(beta t) + c cos(2 beta t)`` less the friction's own displacement; the free part ``c`` comes back after a
stroke, so that it reverses where ``cos(beta t)`` does, whatever c.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from checked_solutions import measure_residual
from small_models import friction_oscillator
from test_den_hartog import exact_amplitude, largest_friction_without_stops

from ewr_fenicsx import ContactLaws, ContactProblem, integrate, solve
from ewr_fenicsx.errors import NotConverged
from ewr_fenicsx.solution.solution import PeriodicSolution

HIGHEST = 15


def pose(beta: float, friction: float, second: complex = 0.0, closure: str = "mass") -> ContactProblem:
    """``second`` is a load at the second harmonic, which breaks the symmetry."""
    model = friction_oscillator(load={1: 1.0, 2: second} if second else {1: 1.0})
    laws = ContactLaws("prescribed", normal_force=friction, friction=1.0)
    return ContactProblem(model, laws, beta / (2 * np.pi), HIGHEST, samples=64 * HIGHEST, closure=closure)


def solve_and_check(problem: ContactProblem, start: PeriodicSolution | None = None) -> PeriodicSolution:
    """A solution whose residual holds, evaluated anew."""
    solution = solve(problem, start)
    assert measure_residual(solution) <= 1e-8
    return solution


def find_amplitude(solution: PeriodicSolution) -> float:
    return np.ptp(solution.history("slip", 4096)) / 2


@pytest.mark.parametrize("closure", ["mass", "dashpot"])
@pytest.mark.parametrize("friction", [0.1, 0.3])
@pytest.mark.parametrize("off", [0.0, 1e-9, -1e-9, 1e-6, -1e-6, 1e-3, -1e-3])
def test_next_to_a_half_the_amplitude_is_den_hartogs(off, friction, closure):
    """Measured: within 0.08 and 0.13 %."""
    solution = solve_and_check(pose(0.5 + off, friction, closure=closure))
    assert find_amplitude(solution) == pytest.approx(exact_amplitude(0.5 + off, friction), rel=2e-3)
    np.testing.assert_allclose(solution.output("tip")[0::2], 0.0, atol=1e-8)


@pytest.mark.parametrize("off", [1e-9, -1e-9, 1e-6])
@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_an_asymmetric_start_ends_in_the_continuum(off, friction):
    """Whatever oscillation at twice the frequency is left, the amplitude is that of all of them."""
    leaning = solve_and_check(pose(0.5 + off, friction, second=0.05j))
    assert abs(leaning.output("tip")[2]) > 0.3, "it is no asymmetric start"
    solution = solve_and_check(pose(0.5 + off, friction), leaning)
    assert find_amplitude(solution) == pytest.approx(exact_amplitude(0.5 + off, friction), rel=2e-3)


def test_one_of_the_asymmetric_solutions_is_found():
    """A load of 1e-9 at the second harmonic does not make it: it is there without."""
    solution = solve_and_check(pose(0.5 + 1e-9, 0.1, second=1e-9))
    exact = exact_amplitude(0.5 + 1e-9, 0.1)
    assert abs(solution.output("tip")[2]) > 0.1
    assert find_amplitude(solution) == pytest.approx(exact, rel=2e-3)


def test_a_load_at_a_harmonic_that_resonates_without_damping_ends_well():
    """At a half exactly: with a solution like those beside it, or, as measured, with a clear refusal."""
    beside = solve_and_check(pose(0.5 + 1e-6, 0.3, second=1e-2, closure="dashpot"))
    try:
        solution = solve_and_check(pose(0.5, 0.3, second=1e-2, closure="dashpot"))
    except NotConverged as refused:
        assert re.match(r"no periodic solution at 0\.0795775 Hz: .*; residual \d\.\de-\d\d after \d+", str(refused))
    else:
        assert find_amplitude(solution) == pytest.approx(find_amplitude(beside), rel=1e-2)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("off", [1e-2, -1e-2, 1e-3, -1e-3])
def test_next_to_a_third_the_amplitude_is_den_hartogs_up_to_where_stops_begin(off, share):
    """There a force of 0.2 to 2 % of the load stops the mass, and takes a twelfth of its amplitude before."""
    beta = 1 / 3 + off
    friction = share * largest_friction_without_stops(beta)
    solution = solve_and_check(pose(beta, friction))
    assert find_amplitude(solution) == pytest.approx(exact_amplitude(beta, friction), rel=2e-4)


@pytest.mark.parametrize("friction", [0.05, 0.2])
@pytest.mark.parametrize("off", [0.0, 1e-3, -1e-3])
def test_next_to_a_third_a_mass_that_stops_moves_as_in_time(off, friction):
    """Measured: 0.01 to 0.02 % under the weaker friction, 0.14 % under the other."""
    problem = pose(1 / 3 + off, friction)
    stepped = integrate(problem, "rest", steps=1600, periods=400, tolerance=1e-9)
    assert stepped.converged, stepped.reason
    amplitude = np.ptp(stepped.output_history("tip")) / 2
    assert find_amplitude(solve_and_check(problem)) == pytest.approx(amplitude, rel=2e-3 if friction > 0.1 else 4e-4)
