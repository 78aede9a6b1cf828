"""A mass that hits a stop, against the closed form of its periodic motion: harmonic balance rebounds with all speed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import fsolve

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve

STIFFNESS, MASS, DAMPING, FORCE, GAP = 1e6, 1.0, 40.0, 100.0, 1e-4  # N/m, kg, N s/m, N, m


def find_impacting_motion(frequency: float, restitution: float, guess: tuple[float, float]) -> np.ndarray:
    """Mean and first harmonic of the motion that hits the stop at ``-GAP`` once a period [m].

    Between impacts the mass is free. It leaves the stop at ``tau`` periods with a speed, and is back a period later
    with that speed over the restitution.

    Args:
        frequency: Of the force [Hz].
        restitution: Speed after an impact over that before.
        guess: ``tau`` [periods] and the speed after the impact [m/s].
    """
    omega, decay = 2 * np.pi * frequency, DAMPING / (2 * MASS)
    swing = np.sqrt(STIFFNESS / MASS - decay**2)
    forced = FORCE / (STIFFNESS - MASS * omega**2 + 1j * omega * DAMPING)

    def move(tau: float, speed: float, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        start, period = tau / frequency, 1 / frequency
        at = lambda t: (forced * np.exp(1j * omega * t)).real  # noqa: E731
        velocity = lambda t: (1j * omega * forced * np.exp(1j * omega * t)).real  # noqa: E731
        a = -GAP - at(start)
        free = (a - 1j * (speed - velocity(start) + decay * a) / swing) * np.exp((1j * swing - decay) * after * period)
        t = start + after * period
        return at(t) + free.real, velocity(t) + ((1j * swing - decay) * free).real

    def miss(unknowns: np.ndarray) -> list[float]:
        x, v = move(*unknowns, np.array(1.0))
        return [x / GAP + 1, restitution * v / unknowns[1] + 1]

    tau, speed = fsolve(miss, guess)
    after = (np.arange(4096) + 0.5) / 4096
    x, _ = move(tau, speed, after)
    assert speed > 0 and x.min() > -GAP
    return np.array([x.mean(), 2 * np.mean(x * np.exp(-2j * np.pi * (tau + after)))])


# Hz; guesses of instant and speed of the impact that loses nothing, and of the one that loses half
CASES = [(120.0, (0.49, 0.21), (0.44, 0.12)), (200.0, (0.51, 0.2), (0.56, 0.13))]


def balance_rebound(frequency: float, harmonics: int) -> np.ndarray:
    """Mean and first harmonic of the harmonic solution [m]."""
    model = ReducedModel([[MASS]], [[DAMPING]], [[STIFFNESS]], normal=[[1.0]], load={1: [FORCE]}, outputs={"x": [1.0]})
    laws = ContactLaws(tangential="frictionless", initial_gap=GAP)
    return solve(ContactProblem(model, laws, frequency, harmonics)).output("x")[:2]


@pytest.mark.parametrize("frequency, elastic, half", CASES)
def test_motion_tends_to_an_elastic_rebound(frequency, elastic, half):
    """Errors fall like 1/N, so that two sets of harmonics extrapolate to the limit; a loss at impact is far from it."""
    exact = find_impacting_motion(frequency, 1.0, elastic)
    lossy = find_impacting_motion(frequency, 0.5, half)
    few, more = (balance_rebound(frequency, n) for n in (20, 40))
    assert np.abs(few - exact).max() > 1.6 * np.abs(more - exact).max()
    limit, scale = 2 * more - few, np.abs(exact).max()
    assert np.abs(limit - exact).max() < 0.2 * scale
    assert np.abs(limit - lossy).max() > 0.6 * scale
