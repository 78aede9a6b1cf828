"""pyHarm, another harmonic balance with exact contact laws, on the same matrices: the answers agree.

It runs in an environment of its own, which `benchmarks/peers.py` makes; without it the tests are skipped. Where a pair
never slips its mean friction is free within limits, so two codes may find two steady states of the same laws: each
answer is therefore held against the steady state of time stepping that it starts, as well as against the other.

Source: pyHarm 1.2.2 (PyPI `pyHarm-os`), dynamic-Lagrangian contact.
"""

from __future__ import annotations

import numpy as np
import peers
import pytest

needs_peer = pytest.mark.skipif(
    peers.find_environment() is None, reason="pyHarm is not installed in build/peers; benchmarks/peers.py does it"
)


@pytest.mark.slow
@needs_peer
def test_full_stick_is_the_same_to_rounding():
    """Without slip both solve linear equations. (Means differ by the friction that the preload leaves in the pairs.)"""
    model = peers.two_trusses(4, 0.02)
    frequencies = peers.choose_frequencies(model, 4)
    solutions = [peers.sweep_ours(model, np.array([f]), 3, 64)[0][0] for f in frequencies]  # cold: no guiding step
    (run,) = peers.run_peer(model, frequencies, 3, 64, eps=(1.0,), solvers=("scipyroot",), variants=("mended",))["runs"]
    assert all(run["solved"]) and all(solution.iterations == 0 for solution in solutions)
    ours = np.array([solution.coordinates for solution in solutions])
    np.testing.assert_allclose(run["coordinates"][:, 1], ours[:, 1], atol=1e-7 * np.abs(ours[:, 1]).max())


@pytest.mark.slow
@needs_peer
def test_the_mended_jacobian_is_exact_and_the_one_that_comes_is_not():
    """So that the two rows of the benchmark mean what they say. Measured: 2e-11, and 30 to 40 % as it comes."""
    model = peers.two_trusses(4, 0.1)
    runs = peers.run_peer(model, peers.choose_frequencies(model, 2), 5, 128, eps=(1.0,), solvers=("scipyroot",))["runs"]
    error = {run["variant"]: run["jacobian_error"] for run in runs}
    assert error["mended"] < 1e-7
    assert error["as it comes"] > 0.1


@pytest.mark.slow
@needs_peer
def test_answers_agree_within_what_truncation_leaves():
    """Four pairs that slip and lift off near the resonance: each code approaches a steady state of the laws.

    Measured at N = 3, 5, 9: ours 2.0, 0.23, 0.13 % and pyHarm's 0.80, 0.26, 0.14 % from their own steady states,
    which are 0.5 % apart.
    """
    rows = peers.compare_answers(4, 0.06, (3, 9))
    assert all(row["solved"] == row["points"] for row in rows)
    few, many = rows
    assert many["our_error"] < 0.003 and many["peer_error"] < 0.003, many
    assert many["our_error"] < few["our_error"] / 3 and many["peer_error"] < few["peer_error"] / 3, rows
    assert many["distance"] < 0.01 and many["apart"] < 0.01, many


@pytest.mark.slow
@needs_peer
def test_answers_agree_where_the_steady_state_is_one():
    """One pair that slips in every period: nothing is left to the past, and the two answers close up with N.

    Measured: 1.8, 1.6, 0.73 % apart at N = 3, 5, 9.
    """
    few, many = peers.compare_answers(1, 1.0, (3, 9))
    assert few["solved"] == many["solved"] == many["points"]
    assert few["apart"] < 1e-5 and many["apart"] < 1e-5, "the steady states differ: this case would prove nothing"
    assert many["distance"] < 0.01 and many["distance"] < few["distance"] / 2, (few, many)
