"""The Fourier basis: every operation against sums written out sample by sample."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ewr_fenicsx.errors import ModelError
from ewr_fenicsx.problem.harmonics import FourierBasis, sample_amplitudes, select_basis

BASES = [
    FourierBasis((0, 1, 2, 3), 16),
    FourierBasis((0,), 5),
    FourierBasis((1,), 3),
    FourierBasis((1, 3, 5), 64),
    FourierBasis((0, 2, 5), 11),
    FourierBasis((2, 3, 7), 33),
]
every_basis = pytest.mark.parametrize("basis", BASES, ids=lambda b: f"{b.orders}x{b.samples}")


def random_amplitudes(basis: FourierBasis, columns: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    amplitudes = rng.normal(size=(len(basis.orders), columns)) + 1j * rng.normal(size=(len(basis.orders), columns))
    if basis.orders[0] == 0:
        amplitudes[0] = amplitudes[0].real
    return amplitudes


def sum_series(orders: tuple[int, ...], amplitudes: np.ndarray, tau: float) -> np.ndarray:
    return np.real(sum(a * np.exp(1j * h * tau) for h, a in zip(orders, amplitudes, strict=True)))


def integrate_against(orders: tuple[int, ...], samples: np.ndarray) -> np.ndarray:
    """One-sided amplitudes by the rectangle rule, written as in a textbook."""
    n = samples.shape[0]
    rows = []
    for h in orders:
        total = sum(samples[i] * np.exp(-2j * np.pi * h * i / n) for i in range(n)) / n
        rows.append(total if h == 0 else 2 * total)
    return np.array(rows)


@every_basis
def test_synthesis_is_the_fourier_sum(basis):
    amplitudes = random_amplitudes(basis, 3)
    expected = [sum_series(basis.orders, amplitudes, 2 * np.pi * i / basis.samples) for i in range(basis.samples)]
    np.testing.assert_allclose(basis.synthesise(amplitudes), expected, atol=1e-13)


@every_basis
def test_projection_is_the_fourier_integral(basis):
    samples = np.random.default_rng(1).normal(size=(basis.samples, 2))
    found = basis.to_amplitudes(basis.project(samples))
    np.testing.assert_allclose(found, integrate_against(basis.orders, samples), atol=1e-14)


@every_basis
def test_round_trips(basis):
    amplitudes = random_amplitudes(basis, 4)
    coefficients = basis.to_coefficients(amplitudes)
    assert coefficients.shape == (basis.coefficients, 4) == (basis.slot.size, 4)
    np.testing.assert_array_equal(basis.to_amplitudes(coefficients), amplitudes)
    np.testing.assert_allclose(basis.project(basis.synthesise(amplitudes)), coefficients, atol=1e-13)


def test_coefficients_are_real_part_then_imaginary_part():
    basis = FourierBasis((0, 2), 8)
    np.testing.assert_array_equal(basis.to_coefficients(np.array([[5.0], [3.0 - 4.0j]]))[:, 0], [5.0, 3.0, -4.0])


@every_basis
@pytest.mark.parametrize("kind", ["random", "indicator", "one", "zero"])
def test_multiplication_is_multiplying_the_samples(basis, kind):
    """Aliased products included: the matrix acts exactly as synthesis, product and projection at the samples do."""
    rng = np.random.default_rng(2)
    weights = {
        "random": rng.normal(size=(basis.samples, 3)),
        "indicator": (rng.random((basis.samples, 3)) < 0.4).astype(float),
        "one": np.ones((basis.samples, 3)),
        "zero": np.zeros((basis.samples, 3)),
    }[kind]
    amplitudes = random_amplitudes(basis, 3, seed=3)
    expected = basis.project(weights * basis.synthesise(amplitudes))
    matrices = basis.multiplication(weights)
    assert matrices.shape == (3, basis.coefficients, basis.coefficients)
    found = np.einsum("kij,jk->ik", matrices, basis.to_coefficients(amplitudes))
    np.testing.assert_allclose(found, expected, atol=1e-13)


@given(st.integers(0, 2**32 - 1), st.sets(st.integers(0, 9), min_size=1), st.integers(0, 40))
def test_multiplication_for_any_set_of_harmonics(seed, orders, extra):
    orders = tuple(sorted(orders))
    basis = FourierBasis(orders, 2 * orders[-1] + 1 + extra)
    weights = np.random.default_rng(seed).normal(size=(basis.samples, 1))
    amplitudes = random_amplitudes(basis, 1, seed)
    found = basis.multiplication(weights)[0] @ basis.to_coefficients(amplitudes)
    np.testing.assert_allclose(found, basis.project(weights * basis.synthesise(amplitudes)), atol=1e-12)


@every_basis
def test_matrices_on_velocities_act_on_displacements(basis):
    omega = 3.7
    amplitudes = random_amplitudes(basis, 1)
    velocity = 1j * omega * np.array(basis.orders)[:, None] * amplitudes
    matrices = np.random.default_rng(4).normal(size=(2, 5, basis.coefficients))
    found = basis.differentiate_columns(matrices, omega) @ basis.to_coefficients(amplitudes)
    np.testing.assert_allclose(found, matrices @ basis.to_coefficients(velocity), atol=1e-12)


def test_velocity_is_the_slope_of_the_displacement():
    """Catches a wrong sign of i omega, which the test above would share."""
    basis, omega, step = FourierBasis((0, 1, 4), 64), 2.0, 1e-6
    amplitudes = random_amplitudes(basis, 1)
    slope = [
        omega
        * (sum_series(basis.orders, amplitudes, t + step) - sum_series(basis.orders, amplitudes, t - step))
        / 2
        / step
        for t in 2 * np.pi * np.arange(64) / 64
    ]
    identity = np.eye(basis.coefficients)
    velocity = basis.differentiate_columns(identity, omega) @ basis.to_coefficients(amplitudes)
    np.testing.assert_allclose(basis.synthesise(basis.to_amplitudes(velocity)), slope, atol=1e-7)


def test_given_signals_are_sampled_at_their_columns():
    amplitudes = {0: np.array([1.0, 2.0, 3.0]), 2: np.array([0.0, 1j, 0.5])}
    found = sample_amplitudes(amplitudes, np.array([2, 1]), 8)
    tau = 2 * np.pi * np.arange(8) / 8
    np.testing.assert_allclose(found, np.column_stack([3 + 0.5 * np.cos(2 * tau), 2 - np.sin(2 * tau)]), atol=1e-15)


@pytest.mark.parametrize(
    "harmonics, samples, orders, count",
    [
        (0, None, (0,), 1),
        (1, None, (0, 1), 128),
        (5, None, (0, 1, 2, 3, 4, 5), 256),
        (31, None, tuple(range(32)), 1024),
        ((5, 1, 3), None, (1, 3, 5), 256),
        (np.int64(2), 5, (0, 1, 2), 5),
        ([0, 4], 9, (0, 4), 9),
    ],
)
def test_basis_selected(harmonics, samples, orders, count):
    basis = select_basis(harmonics, samples)
    assert (basis.orders, basis.samples) == (orders, count)


@pytest.mark.parametrize(
    "harmonics, samples, message",
    [
        (-1, None, "harmonics = -1; give the highest one, from 0 to 10000, or a list of them"),
        (10**9, None, "harmonics = 1000000000; give the highest one, from 0 to 10000"),
        ((0, 10**6), None, r"harmonics up to 1e\+06; give none above 10000"),
        ((), None, "give distinct whole numbers from 0"),
        ((1, 1), None, "give distinct whole numbers from 0"),
        ((-2, 1), None, "give distinct whole numbers from 0"),
        ((np.nan, 1), None, "give distinct whole numbers from 0"),
        ((1, np.inf), None, "give distinct whole numbers from 0"),
        (5.0, None, "harmonics = 5.0; give the highest harmonic, a whole number, or a list of them"),
        ("5", None, "harmonics = '5'; give the highest harmonic, a whole number"),
        (["1"], None, r"harmonics = \['1'\]; give the highest harmonic, a whole number"),
        (5, 64.5, "samples = 64.5; give a whole number"),
        (5, 10, "samples = 10 cannot resolve harmonic 5; give at least 11"),
    ],
)
def test_impossible_bases_are_refused(harmonics, samples, message):
    with pytest.raises(ModelError, match=message):
        select_basis(harmonics, samples)


def test_fractional_harmonics_are_refused():
    with pytest.raises(ModelError, match="whole numbers"):
        select_basis((1, 2.5))
