"""A mass that rubs through a stiff spring, as friction dampers do, against its exact motion: accuracies are kept.

Each half period the spring first unloads while the slider sticks, for a small part of it where the spring is stiff,
then the slider slips until the mass turns. Few harmonics see nothing of that part, nor do some more: with dashpots in
the place of those left out the error stays at 2 % up to twenty harmonics, and looked small from any of them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import fsolve

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve, solve_to_accuracy
from ewr_fenicsx.accuracy.estimates import estimate_at_once

MASS, STIFFNESS, DAMPING, LIMIT, FORCE = 1.0, 1.5e5, 40.0, 36.0, 120.0  # kg, N/m, N s/m, N, N
HARMONICS = np.arange(1, 40, 2)


def move(spring: float, frequency: float, start: float, phase: float, sticks: float) -> tuple[np.ndarray, ...]:
    """Instants, positions and velocities over half a period from where the mass turns at ``start``.

    The slider sticks for the time ``sticks``. Both parts are linear: a harmonic motion and a decaying swing.
    """
    omega, time, found = 2 * np.pi * frequency, 0.0, []
    x, v = start, 0.0
    for stiffness, constant, end in (
        (STIFFNESS + spring, spring * start - LIMIT, sticks),
        (STIFFNESS, LIMIT, np.pi / omega),
    ):
        t = time + (end - time) * (1 - np.cos(np.pi * np.arange(2001) / 2000)) / 2
        forced = FORCE * np.exp(1j * phase) / (stiffness - MASS * omega**2 + 1j * omega * DAMPING)
        at, rate = forced * np.exp(1j * omega * t), 1j * omega * forced * np.exp(1j * omega * t)
        pole = -DAMPING / (2 * MASS) + 1j * np.sqrt(stiffness / MASS - (DAMPING / (2 * MASS)) ** 2)
        a = x - at[0].real - constant / stiffness
        swing = (a - 1j * (v - rate[0].real - pole.real * a) / pole.imag) * np.exp(pole * (t - time))
        found.append((t, at.real + constant / stiffness + swing.real, rate.real + (pole * swing).real))
        time, x, v = end, found[-1][1][-1], found[-1][2][-1]
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


@lru_cache
def find_motion(spring: float, frequency: float) -> np.ndarray:
    """Odd harmonics of the position [m], of the load's phase."""
    omega = 2 * np.pi * frequency
    size = FORCE / abs(STIFFNESS - MASS * omega**2 + 1j * omega * DAMPING) - LIMIT / STIFFNESS

    def miss(unknowns: np.ndarray) -> list[float]:
        start, phase, sticks = unknowns[0] * size, unknowns[1], unknowns[2] / omega
        _, x, v = move(spring, frequency, start, phase, sticks)
        return [(x[2000] - start) * spring / LIMIT + 2, x[-1] / start + 1, v[-1] / (omega * start)]

    lag = np.angle(1 / (STIFFNESS - MASS * omega**2 + 1j * omega * DAMPING))
    unknowns = fsolve(miss, [1.0, -lag, np.sqrt(4 * LIMIT / (spring * size))], xtol=1e-12)
    assert np.abs(miss(unknowns)).max() < 1e-9 and 0 < unknowns[2] < np.pi
    t, x, v = move(spring, frequency, unknowns[0] * size, unknowns[1], unknowns[2] / omega)
    assert np.all(v[2:-2] < 0), "it turns once"
    integrand = x[:, None] * np.exp(-1j * np.outer(omega * t, HARMONICS))
    amplitudes = 2 * omega / np.pi * np.trapz(integrand, t, axis=0)
    return amplitudes * np.exp(-1j * HARMONICS * unknowns[1])


def pose(spring: float, frequency: float, harmonics: int = 5) -> ContactProblem:
    model = ReducedModel(
        np.diag([MASS, 0.0]),
        np.diag([DAMPING, 0.0]),
        [[STIFFNESS + spring, -spring], [-spring, spring]],
        normal=np.zeros((1, 2)),
        tangential=[[0.0, 1.0]],
        load={1: [FORCE, 0.0]},
        outputs={"x": [1.0, 0.0]},
    )
    laws = ContactLaws(normal="prescribed", normal_force=LIMIT / 0.3, friction=0.3)
    return ContactProblem(model, laws, frequency, harmonics)


def measure_error(solution, spring: float, frequency: float) -> float:
    """Relative error of the oscillation, harmonics up to 39."""
    exact, found = find_motion(spring, frequency), np.zeros(HARMONICS.size, dtype=complex)
    for h, amplitude in zip(solution.orders, solution.output("x"), strict=True):
        if h in HARMONICS:
            found[(h - 1) // 2] = amplitude
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("frequency", [50.0, 70.0])
@pytest.mark.parametrize("stiffness", [5.0, 25.0, 100.0])
def test_an_accuracy_asked_for_is_kept(stiffness, frequency):
    """Two per cent passed for one, and for two thousandths; springs now meet these with few harmonics."""
    spring = stiffness * STIFFNESS
    for accuracy in (0.02, 0.01, 0.005, 0.002):
        found = solve_to_accuracy(pose(spring, frequency), accuracy)
        true = measure_error(found.solution, spring, frequency)
        assert found.reached and true <= accuracy, (accuracy, true)
        assert true / 5 < found.estimate.total < 5 * true or found.estimate.total < accuracy / 3
    assert found.solution.orders[-1] < 40 and "springs" in found.solution.problem.system.closures


@pytest.mark.parametrize("harmonics", [3, 5, 11])
@pytest.mark.parametrize("stiffness", [25.0, 100.0])
def test_the_error_of_a_solution_with_dashpots_is_told(stiffness, harmonics):
    """It was told to be twenty times less."""
    spring = stiffness * STIFFNESS
    for frequency in (50.0, 70.0):
        solution = solve(pose(spring, frequency, harmonics))
        true, told = measure_error(solution, spring, frequency), estimate_at_once(solution).total
        assert true > 0.01 and 0.8 * true < told < 3 * true


@pytest.mark.parametrize("stiffness", [5.0, 25.0, 100.0])
def test_springs_are_those_of_the_element_however_stiff(stiffness):
    """Though most of the pair's static flexibility is another spring's: with 21 harmonics a thousandth is left."""
    spring = stiffness * STIFFNESS
    problem = replace(pose(spring, 70.0, 21), closure="spring")
    (law,) = problem.system.laws
    assert law.closes == "springs" and law.flexibility == pytest.approx(1 / spring, rel=0.15)
    assert measure_error(solve(problem), spring, 70.0) < 1e-3
