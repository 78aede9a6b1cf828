"""Deviations of a ring of sectors, wave by wave: against the whole ring's exponents, and its motion in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from models import shake
from rings import step_all_sectors
from test_ring import ALIKE, RUB, SECTORS, ring, shroud

from ewr_fenicsx import ContactLaws, ContactProblem, ReducedModel, close_ring, solve, unroll_ring
from ewr_fenicsx.in_time import ring_growth
from ewr_fenicsx.in_time.deviations import differentiate_laws
from ewr_fenicsx.in_time.followed_modes import follow_waves
from ewr_fenicsx.in_time.hill import FOLLOWS, Hill
from ewr_fenicsx.in_time.ring_growth import find_ring_growth, leaves

TOP, SAMPLES = 5, 32 * SECTORS


@pytest.mark.parametrize(("make", "engine_order"), [(ring, 1), (ring, 2), (ring, -1), (shroud, 1), (shroud, 0)])
def test_exponents_of_all_waves_are_those_of_the_whole_ring(make, engine_order):
    model = make(engine_order)
    one, whole = (solve(ContactProblem(m, RUB, frequency=60.0, **ALIKE)) for m in (model, unroll_ring(model)))
    omega = one.problem.omega
    guess = (0.02 + 0.2j) * omega
    slopes, of_whole = (differentiate_laws(s, SAMPLES) for s in (one, whole))
    assert of_whole.changing.size == SECTORS * slopes.changing.size > 0
    expected, _ = Hill(whole.problem.system, of_whole, guess, TOP).find_nearest()
    system, found = one.problem.system, []
    modes = follow_waves(system, FOLLOWS * TOP * omega, range(SECTORS))
    for offset in range(SECTORS):
        waves = (np.arange(-TOP, TOP + 1) * engine_order + offset) % SECTORS
        found.append(Hill(system, slopes, guess, TOP, modes.pick(waves)).find_nearest()[0])
    found = np.concatenate(found)
    nearest = found[np.argsort(np.abs(found - guess))][: len(expected)]
    for exponent in expected:
        assert np.abs(nearest - exponent).min() < 1e-4 * omega


@pytest.mark.parametrize(
    ("make", "engine_order", "shaken", "frequency", "stays"),
    [
        (ring, 1, 1.0, 60.0, True),
        (ring, 2, 4.0, 40.0, True),
        (shroud, 2, 1.0, 60.0, True),
        (shroud, 1, 1.0, 60.0, False),
        (shroud, 1, 2.0, 90.0, False),
        (shroud, 2, 2.0, 90.0, False),
    ],
)
def test_motions_in_time_leave_a_wave_whose_deviations_grow(make, engine_order, shaken, frequency, stays):
    """With 15 harmonics; ``benchmarks/rings.py`` counts what fewer miss, and what more call unstable that hardly is."""
    solution = solve(ContactProblem(shake(make(engine_order), shaken), RUB, frequency, 15))
    apart, change = step_all_sectors(solution)
    assert (apart < 0.01 and change < 0.01) if stays else (apart > 0.05 and change > 0.1)
    assert leaves(solution.ring_growth) is not stays
    assert any("perhaps unstable: as truncated forces" in line for line in solution.cautions) is not stays
    assert any("stability is not known: no deviation grows much" in line for line in solution.cautions) is stays


def test_what_grows_least_or_not_is_told_with_its_diameters():
    growth = solve(ContactProblem(ring(1), RUB, 60.0, 9)).ring_growth
    assert 0.5 < growth.factor < 1.0 and growth.diameters in (0, 1, 2) and not leaves(growth)


def test_what_is_not_looked_at(monkeypatch):
    """Whole rings, and what would take long; the latter is told."""
    model = ring(1)
    solution = solve(ContactProblem(model, RUB, 60.0, 5))
    assert solve(ContactProblem(unroll_ring(model), RUB, 60.0, 5)).ring_growth is None
    monkeypatch.setattr(ring_growth, "MOST_WORK", 1.0)
    assert find_ring_growth(solution) is None
    told = "stability is not looked at; whether motions in time leave the wave"
    assert any(line.startswith(told) and "unroll_ring(model)" in line for line in replace(solution).cautions)


def test_a_joint_that_sticks_throughout_is_looked_at():
    """Where the next sector's motion feeds energy to a sector, the whole ring is unstable, and some wave grows."""
    model = ring(1)
    fed = replace(model, cyclic=replace(model.cyclic, damping=0.6 * np.abs(model.damping).max() * np.eye(model.size)))
    laws = ContactLaws("prescribed", "coulomb", friction=1e6, normal_force=1e6)
    one, whole = (solve(ContactProblem(m, laws, 60.0, 5)) for m in (fed, unroll_ring(fed)))
    assert not differentiate_laws(one, SAMPLES).changing.size
    assert whole.unstable and leaves(one.ring_growth)
    assert any("perhaps unstable" in line for line in one.cautions)
    stuck = solve(ContactProblem(model, laws, 60.0, 5))
    assert not leaves(stuck.ring_growth) and stuck.cautions == ()


@pytest.mark.parametrize("fed", [0.0, 0.6])
def test_a_bonded_joint_grows_as_its_free_vibrations_do(fed):
    """As in flutter, in a wave that need not be the load's; of the whole ring they are the Floquet multiplier."""
    model, glued = ring(1), ContactLaws("bonded", "bonded")
    damping = fed * np.abs(model.damping).max() * np.eye(model.size)
    model = replace(model, cyclic=replace(model.cyclic, damping=damping))
    one, whole = (solve(ContactProblem(m, glued, 60.0, 5)) for m in (model, unroll_ring(model)))
    assert leaves(one.ring_growth) == whole.unstable == (fed > 0)
    assert any(line.startswith("unstable: deviations of ") for line in one.cautions) == (fed > 0)
    if fed:
        assert one.ring_growth.factor == pytest.approx(abs(whole.multiplier), rel=1e-6)


def test_nothing_is_found_where_all_modes_are_far_above():
    model = ReducedModel([[1.0]], [[20.0]], [[1e6]], tangential=[[1.0]], load={1: [100.0]}, outputs={})
    masses = close_ring(model, [], [], sectors=6, engine_order=1, tangential=[[-1.0]])
    laws = ContactLaws(normal="prescribed", normal_force=100.0, friction=0.3)
    solution = solve(ContactProblem(masses, laws, 0.5, 7))
    assert solution.ring_growth is None and "stability is not looked at" in solution.cautions[-1]
