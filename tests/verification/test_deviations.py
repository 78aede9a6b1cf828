"""Small deviations, stepped and in Hill's equations: against exponentials, scipy, each other, and a rod."""

from __future__ import annotations

import numpy as np
import pytest
from small_models import dovetail
from test_floquet import FRICTIONLESS, step_masses, two_masses
from test_floquet_linear import gyroscope, rate_of_gyroscope

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.in_time import floquet
from ewr_fenicsx.in_time.deviations import (
    PERIODS,
    differentiate_along,
    differentiate_laws,
    follow_modes,
    step_deviations,
)
from ewr_fenicsx.in_time.hill import SMALL, Hill

SPIRALS, STAYS = 0.42, 0.4  # Hz, of two_masses


def tap(model: ReducedModel, frequency: float, harmonics: int = 31):
    return solve(ContactProblem(model, FRICTIONLESS, frequency, harmonics))


def lengthen_stop(model: ReducedModel, elements: int, mass: float) -> ReducedModel:
    """The stop's spring of ``two_masses`` as a rod of so many elements that weighs little."""
    size, stop = model.size - 1 + elements, model.stiffness[-1, -1]
    stiffness, weights = np.zeros((size, size)), np.zeros(size)
    stiffness[:2, :2], weights[:2] = model.stiffness[:2, :2] - np.diag([0.0, stop]), 1.0
    for i in range(1, size - 1):  # from the second mass to the contact node
        stiffness[i : i + 2, i : i + 2] += elements * stop * np.array([[1.0, -1.0], [-1.0, 1.0]])
        weights[i : i + 2] += mass / elements / 2
    row, load, tip = np.zeros((3, size))
    row[-1], load[1], tip[1] = -1.0, 1.0, 1.0
    damping = 2e-5 * stiffness
    damping[:2, :2] += np.diag([0.01, 0.01])
    return ReducedModel(
        mass=np.diag(weights),
        damping=damping,
        stiffness=stiffness,
        normal=[row],
        load={1: load},
        outputs={"driven": tip},
    )


def differentiate(solution, samples: int):
    return solution.problem.system, differentiate_laws(solution, samples)


def sort_pairs(multipliers: np.ndarray) -> np.ndarray:
    """Largest first, one of each pair."""
    upper = multipliers[multipliers.imag >= -1e-12]
    return upper[np.lexsort((upper.imag, -np.abs(upper)))]


def test_stepping_converges_to_exponentials_at_second_order():
    model = gyroscope(np.array([[0.3, 1.6], [-1.6, -0.32]]))
    found = solve(ContactProblem(model, FRICTIONLESS, 0.11, 9))
    exact = sort_pairs(np.exp(np.linalg.eigvals(rate_of_gyroscope(model)) / 0.11))
    errors = []
    for samples in (512, 1024, 2048):
        stepped = sort_pairs(np.linalg.eigvals(step_deviations(*differentiate(found, samples)).matrix))
        errors.append(np.abs(stepped - exact).max())
    assert errors[0] < 0.02
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4.0, rtol=0.1)


@pytest.mark.parametrize("frequency", [STAYS, SPIRALS])
def test_near_a_guess_hill_finds_what_scipy_finds(frequency):
    """All four multipliers, those inside the unit circle too, from guesses a tenth off."""
    found = tap(two_masses(), frequency)
    exact = sort_pairs(step_masses(found))
    system, slopes = differentiate(found, found.problem.basis.samples)
    omega = system.compliance.omega
    for multiplier in exact:
        guess = np.log(1.1 * complex(multiplier)) * omega / (2 * np.pi)
        exponents = Hill(system, slopes, guess, 31).find_nearest()[0]
        assert np.exp(2 * np.pi * exponents[0] / omega) == pytest.approx(multiplier, rel=3e-3)


def test_few_and_many_unknowns_take_the_same_exponents(monkeypatch):
    found = tap(two_masses(), SPIRALS, 9)
    system, slopes = differentiate(found, 256)
    guess = (0.03 + 0.4j) * system.compliance.omega
    by_arnoldi = Hill(system, slopes, guess, 9).find_nearest()[0]
    assert SMALL < 19 * (2 * 2 + 1)
    monkeypatch.setattr("ewr_fenicsx.in_time.hill.SMALL", 1000)
    directly = Hill(system, slopes, guess, 9).find_nearest()[0]
    np.testing.assert_allclose(by_arnoldi, directly, rtol=1e-8)


@pytest.mark.parametrize(("excitation", "stuck"), [(300.0, 3), (1000.0, 0)])
def test_steady_rows_may_be_eliminated_or_not(excitation, stuck):
    """Rows that stick or stay closed throughout: the same exponents and multipliers, but for what is neutral.

    Where a row has stuck to is neutral, and no deviation of rows that are eliminated.
    """
    found = solve(ContactProblem(dovetail(excitation=excitation), ContactLaws(friction=0.2), 900.0, 7))
    system, slopes = differentiate(found, 512)
    assert slopes.steady.size >= 2 and slopes.changing.size >= 3
    whole = slopes.treat_all_as_changing()
    guess = (-0.1 + 0.3j) * system.compliance.omega
    short, long = (Hill(system, each, guess, 7).find_nearest()[0] for each in (slopes, whole))
    np.testing.assert_allclose(short[0], long[0], rtol=1e-6)
    assert np.abs(short).min() > 1e-3 * system.compliance.omega
    few, many = (np.linalg.eigvals(step_deviations(system, each).matrix) for each in (slopes, whole))
    assert [np.count_nonzero(np.abs(each - 1) < 1e-6) for each in (few, many)] == [0, stuck]
    few, many = (sort_pairs(each[np.abs(each - 1) > 1e-6]) for each in (few, many))
    assert len(few) >= 6
    np.testing.assert_allclose(few[:6], many[:6], rtol=1e-6)


@pytest.mark.parametrize("elements", [5, 120])
def test_a_light_rod_for_a_stop_changes_nothing(elements):
    """More coordinates than harmonics follow: the modes that are not stepped bend at once."""
    short = tap(two_masses(), SPIRALS, 15)
    long = tap(lengthen_stop(two_masses(), elements, 1e-5), SPIRALS, 15)
    system = long.problem.system
    assert len(follow_modes(system, 60 * system.compliance.omega).mass) == 2
    assert short.multiplier != 0
    assert long.multiplier == pytest.approx(short.multiplier, rel=1e-3)
    assert "leave it, most often for one that never repeats" in long.summary()
    assert tap(lengthen_stop(two_masses(), elements, 1e-5), STAYS, 15).multiplier == 0


@pytest.mark.parametrize("frequency", [STAYS, SPIRALS])
def test_along_the_motion_in_time_deviations_grow_as_along_its_series(frequency):
    found = tap(two_masses(), frequency)
    system, slopes = differentiate(found, 512)
    along = differentiate_along(found)
    series = floquet.measure_growth(step_deviations(system, slopes).matrix)
    assert along.samples == 512 * PERIODS
    stepped = floquet.measure_growth(step_deviations(system, along, PERIODS).matrix)
    assert stepped ** (1 / PERIODS) == pytest.approx(series, rel=0.02)


def test_where_more_steps_blow_up_fewer_are_taken(monkeypatch):
    found = tap(two_masses(), SPIRALS, 15)
    counts, step = [], floquet.step_deviations

    def blow_up(system, slopes):
        counts.append(slopes.samples)
        whole = step(system, slopes)
        return whole._replace(matrix=whole.matrix * np.inf) if len(counts) == 1 else whole

    exact = found.multiplier
    monkeypatch.setattr(floquet, "step_deviations", blow_up)
    guesses = floquet.guess_exponents(found, 1.0)
    assert counts == [512, 256]
    assert np.exp(max(guesses, key=lambda z: z.real) / found.problem.frequency) == pytest.approx(exact, rel=0.05)
