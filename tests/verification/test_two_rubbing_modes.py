"""Two masses, of which one rubs, with the third harmonic next to the second mode: first harmonics at low order.

Natural frequencies 1 and 3, undriven and without friction; the load is on the mass that does not rub, near the first.
Dry friction feeds the second mode by its third harmonic. The reference is time stepping, whose laws are other code.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, integrate, solve

COUPLING = (10 + np.sqrt(28)) / 4
GROUND = 10 - 2 * COUPLING  # so that the eigenvalues are 1 and 9
STIFFNESS = np.array([[GROUND + COUPLING, -COUPLING], [-COUPLING, COUPLING]])
DRIVEN = (0.95, 0.99, 1.03)  # over the first natural frequency


def pose(beta: float, harmonics: tuple[int, ...], closure: str = "mass") -> ContactProblem:
    """Friction as strong as the load."""
    model = ReducedModel(
        mass=np.eye(2),
        damping=0.01 * STIFFNESS,
        stiffness=STIFFNESS,
        tangential=[[1.0, 0.0]],
        load={1: [0.0, 1.0]},
        outputs={"rubbing": [1.0, 0.0], "driven": [0.0, 1.0]},
    )
    laws = ContactLaws("prescribed", normal_force=1.0, friction=1.0)
    return ContactProblem(model, laws, beta / (2 * np.pi), harmonics, samples=1024, closure=closure)


def first_harmonics(result) -> np.ndarray:
    at = result.orders.index(1)
    return np.array([result.output(name)[at] for name in ("rubbing", "driven")])


@lru_cache
def step(beta: float, steps: int) -> np.ndarray:
    """First harmonics of both masses in the steady state."""
    steady = integrate(pose(beta, (1,)), "rest", steps=steps, periods=600, tolerance=1e-8)
    assert steady.converged, steady.reason
    return first_harmonics(steady)


def find_error(beta: float, harmonics: tuple[int, ...], closure: str = "mass") -> float:
    found, reference = first_harmonics(solve(pose(beta, harmonics, closure))), step(beta, 3200)
    return np.linalg.norm(found - reference) / np.linalg.norm(reference)


def test_the_third_harmonic_is_next_to_the_second_mode():
    first, second = np.sqrt(np.linalg.eigvalsh(STIFFNESS))
    assert first == pytest.approx(1.0) and second == pytest.approx(3.0)
    assert max(abs(3 * beta / second - 1) for beta in DRIVEN) < 0.06


@pytest.mark.parametrize("beta", DRIVEN)
def test_the_reference_does_not_depend_on_the_step(beta):
    assert np.linalg.norm(step(beta, 1600) - step(beta, 3200)) < 3e-4 * np.linalg.norm(step(beta, 3200))


@pytest.mark.parametrize("beta", DRIVEN)
def test_two_odd_harmonics_are_within_two_per_cent_and_three_within_a_fifth(beta):
    """Measured: 1.8, 1.0 and 0.7 %, then 0.11, 0.02 and 0.04 %. One alone knows nothing of the second mode: 30 %."""
    errors = [find_error(beta, kept) for kept in ((1,), (1, 3), (1, 3, 5))]
    assert errors[0] > 0.25
    assert errors[1] < 0.02 and errors[2] < 0.002, errors


@pytest.mark.parametrize("beta, allowed", [(0.95, 0.012), (0.99, 0.004), (1.03, 0.006)])
def test_dashpots_need_many_harmonics_here(beta, allowed):
    """The harmonics left out see inertia and not damping: 1 to 23 % with three, 0.9, 0.3 and 0.5 % with sixteen."""
    kept = tuple(range(1, 32, 2))
    assert find_error(beta, kept, "dashpot") < allowed
    assert find_error(beta, (1, 3), "dashpot") > 1.5 * find_error(beta, (1, 3))
