"""Deviations of a ring of sectors, wave by wave: against the whole ring's exponents, and its motion in time."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))

from test_ring import ALIKE, RUB, SECTORS, ring, shroud

from ewr_fenicsx import ContactLaws, ContactProblem, PeriodicSolution, integrate, solve, unroll_ring
from ewr_fenicsx.in_time import ring_growth
from ewr_fenicsx.in_time.deviations import differentiate_laws
from ewr_fenicsx.in_time.followed_modes import follow_waves
from ewr_fenicsx.in_time.hill import FOLLOWS, Hill
from ewr_fenicsx.in_time.ring_growth import find_ring_growth, leaves
from ewr_fenicsx.in_time.time_stepping import State

TOP, SAMPLES = 5, 32 * SECTORS


@pytest.mark.parametrize(("make", "engine_order"), [(ring, 1), (ring, 2), (ring, -1), (shroud, 1), (shroud, 0)])
def test_exponents_of_all_waves_are_those_of_the_whole_ring(make, engine_order):
    model = make(engine_order)
    one, whole = (solve(ContactProblem(m, RUB, frequency=60.0, **ALIKE)) for m in (model, unroll_ring(model)))
    omega = one.problem.omega
    guess = (0.02 + 0.2j) * omega
    slopes, of_whole = (differentiate_laws(s.problem.system, s.forces, s.rigid, SAMPLES) for s in (one, whole))
    assert of_whole.changing.size == SECTORS * slopes.changing.size > 0
    expected, _ = Hill(whole.problem.system, of_whole, guess, TOP).find_nearest()
    system, found = one.problem.system, []
    modes = follow_waves(system, FOLLOWS * TOP * omega)
    for offset in range(SECTORS):
        waves = (np.arange(-TOP, TOP + 1) * engine_order + offset) % SECTORS
        here = type(modes)(*(each[waves] for each in modes))
        found.append(Hill(system, slopes, guess, TOP, here).find_nearest()[0])
    found = np.concatenate(found)
    nearest = found[np.argsort(np.abs(found - guess))][: len(expected)]
    for exponent in expected:
        assert np.abs(nearest - exponent).min() < 1e-4 * omega


def step_from(solution: PeriodicSolution, periods: int = 60) -> tuple[float, float]:
    """Of the whole ring, begun on a sector's solution: how far sectors differ in the end, and still change a period."""
    problem = solution.problem
    cyclic, orders = problem.model.cyclic, np.array(solution.orders)[:, None]
    lag = 2 * np.pi * cyclic.engine_order / cyclic.sectors
    moved = np.hstack([solution.coordinates * np.exp(-1j * orders * lag * j) for j in range(cyclic.sectors)])
    start = State(moved.real.sum(axis=0), (1j * orders * problem.omega * moved).real.sum(axis=0))
    whole = ContactProblem(unroll_ring(problem.model), problem.laws, problem.frequency, solution.orders[-1])
    stepped = integrate(whole, start, 1024, periods, tolerance=0, theta=0.505)
    tips = [np.linalg.norm(stepped.output(f"tip_{j}")[1:]) for j in range(cyclic.sectors)]
    return float(np.ptp(tips) / np.mean(tips)), float(stepped.changes[-1])


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
    model = make(engine_order)
    model = replace(model, load={h: force if h == 0 else shaken * force for h, force in model.load.items()})
    solution = solve(ContactProblem(model, RUB, frequency, 15))
    apart, change = step_from(solution)
    assert (apart < 0.01 and change < 0.01) if stays else (apart > 0.05 and change > 0.1)
    assert leaves(solution.ring_growth) is not stays
    assert any("perhaps unstable" in line for line in solution.cautions) is not stays
    assert not any("not looked at" in line for line in solution.cautions)


def test_what_grows_least_or_not_is_told_with_its_diameters():
    growth = solve(ContactProblem(ring(1), RUB, 60.0, 9)).ring_growth
    assert 0.5 < growth.factor < 1.0 and growth.diameters in (0, 1, 2) and not leaves(growth)


def test_what_is_not_looked_at(monkeypatch):
    """Whole rings, joints that stick, laws that remember, and what would take long; the latter is told."""
    model = ring(1)
    solution = solve(ContactProblem(model, RUB, 60.0, 5))
    assert solve(ContactProblem(unroll_ring(model), RUB, 60.0, 5)).ring_growth is None
    stuck = solve(ContactProblem(model, ContactLaws("bonded", "bonded"), 60.0, 5))
    assert stuck.ring_growth is None and stuck.cautions == ()
    monkeypatch.setattr(ring_growth, "MOST_WORK", 1.0)
    assert find_ring_growth(solution.problem.system, solution.forces, solution.rigid) is None
    told = "stability is not looked at: whether motions in time leave the wave"
    assert any(line.startswith(told) and "unroll_ring(model)" in line for line in replace(solution).cautions)
