"""The oscillating load grown from corner to corner: with few samples a period first, then with more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import dovetail

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, solve
from ewr_fenicsx.balance.balance import HarmonicBalance
from ewr_fenicsx.solver import growing_load
from ewr_fenicsx.solver.growing_load import BEGINS, SMALL, grow_load
from ewr_fenicsx.solver.growing_sets import choose_samples, sample_anew
from ewr_fenicsx.solver.ladder import begin_at_full_stick
from ewr_fenicsx.solver.newton_path import _Path


def pose(harmonics: int = 3, **options) -> ContactProblem:
    return ContactProblem(dovetail(excitation=150.0), ContactLaws(friction=0.3), 480.0, harmonics, **options)


@pytest.fixture
def balance() -> HarmonicBalance:
    return HarmonicBalance(pose().system)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"harmonics": 1}, [16, 32, 64, 128]),
        ({"harmonics": 5}, [16, 32, 64, 128, 256]),
        ({"harmonics": 9, "samples": 100}, [32, 64, 100]),
        ({"harmonics": 3, "samples": 16}, [16]),
        ({"harmonics": 3, "samples": 9}, [9]),
    ],
)
def test_samples_double_to_those_asked_for(options, expected):
    assert choose_samples(HarmonicBalance(pose(**options).system)) == expected


def test_samples_tell_the_harmonics_of_given_forces():
    model = ReducedModel([[1.0]], [[0.01]], [[1.0]], tangential=[[1.0]], load={1: [1.0]})
    laws = ContactLaws("prescribed", normal_force={0: [2.0], 12: [0.5]}, friction=0.3)
    balance = HarmonicBalance(ContactProblem(model, laws, 0.1, 3).system)
    assert 12 in balance.system.prescribed and choose_samples(balance)[0] > 24


def test_fewer_samples_are_the_same_unknowns_of_another_balance(balance):
    few, unknowns = sample_anew(balance, 16), balance.pack(*balance.full_stick)
    assert few.basis.samples == 16 and few.size == balance.size and few.force_unit == balance.force_unit
    np.testing.assert_array_equal(few.pack(*few.full_stick), unknowns)
    fine = sample_anew(balance, 4096).residual(unknowns)
    assert 0 < np.linalg.norm(balance.residual(unknowns) - fine) < np.linalg.norm(few.residual(unknowns) - fine)


def test_it_ends_at_the_solution(balance):
    found = grow_load(balance, 1e-9, begin_at_full_stick(balance))
    assert found.converged and found.reason == "the oscillating load: grown from corner to corner"
    solution = solve(pose(), tolerance=1e-10)
    expected = balance.pack(solution.forces, solution.rigid)
    np.testing.assert_allclose(found.unknowns, expected, atol=1e-6 * np.linalg.norm(expected))


def test_few_samples_take_a_fraction_of_the_corners(balance):
    crossed = []
    for samples in (16, balance.basis.samples):
        level = sample_anew(balance, samples)
        first, begun = growing_load._begin_with_little_load(level, 1e-9)
        path = _Path(level.firm, begun.unknowns, first)
        path.follow(1e-9, 10**5, tried=10**5)
        assert path.share == 1.0
        crossed.append(path.crossed)
    assert 0 < crossed[0] < 0.5 * crossed[1]


@pytest.mark.parametrize("small", [True, False], ids=["small", "large"])
def test_where_more_samples_lose_it_it_grows_with_as_many(balance, monkeypatch, small):
    """As often as there are more, or in large joints a few times."""
    assert balance.size <= SMALL and choose_samples(balance) == [16, 32, 64, 128]
    see, asked, hopeless = growing_load._see_more, [], [32, 64]

    def see_more(level, start, tolerance):
        asked.append(level.basis.samples)
        lost = level.basis.samples in hopeless and asked.count(level.basis.samples) == 1
        return replace(see(level, start, tolerance), converged=not lost)

    monkeypatch.setattr(growing_load, "_see_more", see_more)
    monkeypatch.setattr(growing_load, "SMALL", balance.size - (not small))
    failed = begin_at_full_stick(balance)
    found = grow_load(balance, 1e-9, failed)
    if small:
        assert found.converged and asked == [16, 32, 32, 64, 64, 128]
        return
    assert BEGINS == 2 and asked == [16, 32, 32, 64]
    assert not found.converged and found.unknowns is failed.unknowns
    assert found.reason == "the oscillating load: grown with 32 samples a period, lost with 64"
    assert found.iterations > 0 and found.residual == failed.residual


def test_what_takes_too_long_is_left(balance, monkeypatch):
    failed = begin_at_full_stick(balance)
    monkeypatch.setattr(growing_load, "GROWN_CORNERS", 10)
    lost = grow_load(balance, 1e-9, failed)
    assert not lost.converged and lost.reason.endswith("of the load in 10 corners")
